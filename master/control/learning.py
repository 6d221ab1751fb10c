"""Learning over gait cycles: the feedback's addition in one cycle becomes feedforward in the next.

Pure functions; convergent by design. P leads from rope position to estimated END force, C is the feedback, T = PC/(1
+ PC), d a lead in cycles and Q the zero-phase filter. One gait cycle changes the correction by

    c' = Q·(c + γ·z^d·u),   u the feedback's part;   so   c' = Q·(1 − γ·z^d·T)·c + terms without c.

It converges from any start if |Q·(1 − γ·z^d·T)| < 1 at every frequency: T is near one and in phase in the pass band
of Q, and Q is small where T turns.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from physics.laws import Array

CUTOFF_HZ = 8.0
GAIN = 0.5
TRACKED_HZ = 15.0
"""Cut-off of the learning for the drive alone: there is no rope and no friction in its loop."""


@dataclass(frozen=True)
class LearningFilter:
    """Q by its response at the frequencies of one gait cycle, and the lead in control cycles."""

    response: Array
    lead: int


def design(samples: int, period_s: float, lead: int, cutoff_hz: float = CUTOFF_HZ) -> LearningFilter:
    """Return the filter for gait cycles of `samples` control cycles: Gaussian, −6 dB at the cut-off, zero phase."""
    return LearningFilter(passes(np.asarray(np.fft.rfftfreq(samples, period_s), dtype=np.float64), cutoff_hz), lead)


def passes(frequency_hz: Array, cutoff_hz: float) -> Array:
    """Return the magnitude of the filter Q at a frequency."""
    return np.asarray(np.exp(-math.log(2.0) * (frequency_hz / cutoff_hz) ** 2), dtype=np.float64)


def learn(correction: tuple[float, ...], added: Array, filter_: LearningFilter) -> tuple[float, ...]:
    """Return the next gait cycle's correction by sample, m; `added` is the feedback's part, m, by sample."""
    ahead = GAIN * np.roll(added, -filter_.lead)
    total = ahead if not correction else np.array(correction) + ahead
    smooth = np.fft.irfft(np.fft.rfft(total) * filter_.response, added.size)
    return tuple(smooth.tolist())


def columns(history: Any, samples: int) -> tuple[Array, Array]:
    """Return (feedback, tracking error) of one gait cycle by sample, m, from a linked list (sample, both, …, older).

    Samples that are fractions, of a felt phase, are interpolated.
    """
    places, one, other = list[Any](), list[float](), list[float]()
    while history is not None:
        place, fed, missed, _evidence, history = history
        places.append(place)
        one.append(fed)
        other.append(missed)
    if places and not isinstance(places[0], int):
        grid = np.arange(samples)
        return np.interp(grid, places, one, period=samples), np.interp(grid, places, other, period=samples)
    feedback, tracked = np.zeros(samples), np.zeros(samples)
    feedback[places], tracked[places] = one, other
    return feedback, tracked
