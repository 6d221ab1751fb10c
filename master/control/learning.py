"""Learning over gait cycles: the feedback's addition in one cycle becomes feedforward in the next.

Pure functions; convergent by design. P leads from rope position to estimated END force, C is the feedback, T = PC/(1
+ PC), d a lead in cycles and Q the zero-phase filter. One gait cycle changes the correction by

    c' = Q·(c + γ·z^d·u),   u the feedback's part;   so   c' = Q·(1 − γ·z^d·T)·c + terms without c.

It converges from any start if |Q·(1 − γ·z^d·T)| < 1 at every frequency: T is near one and in phase in the pass band
of Q, and Q is small where T turns. `contraction` evaluates that bound.
"""

from __future__ import annotations

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
    """Q by its response at the frequencies of one gait cycle, γ, and the lead in control cycles."""

    response: Array
    gain: float
    lead: int


def design(samples: int, period_s: float, lead: int, cutoff_hz: float = CUTOFF_HZ,
           gain: float = GAIN) -> LearningFilter:
    """Return the filter for gait cycles of `samples` control cycles: Gaussian, −6 dB at the cut-off, zero phase."""
    return LearningFilter(passes(np.asarray(np.fft.rfftfreq(samples, period_s), dtype=np.float64), cutoff_hz), gain,
                          lead)


def passes(frequency_hz: Array, cutoff_hz: float) -> Array:
    """Return the magnitude of the filter Q at a frequency."""
    return np.asarray(np.exp(-math.log(2.0) * (frequency_hz / cutoff_hz) ** 2), dtype=np.float64)


def learn(correction: tuple[float, ...], added: Array, filter_: LearningFilter) -> tuple[float, ...]:
    """Return the next gait cycle's correction by sample, m; `added` is the feedback's part, m, by sample."""
    ahead = filter_.gain * np.roll(added, -filter_.lead)
    total = ahead if not correction else np.array(correction) + ahead
    smooth = np.fft.irfft(np.fft.rfft(total) * filter_.response, added.size)
    return tuple(smooth.tolist())


def columns(history: Any, samples: int) -> tuple[Array, Array]:
    """Return (feedback, tracking error) of one gait cycle by sample, m, from a linked list (sample, both, …, older).

    Samples that are fractions, of a felt phase, are interpolated.
    """
    if history is not None and not isinstance(history[0], int):
        places, one, other = _listed(history)
        grid = np.arange(samples)
        return np.interp(grid, places, one, period=samples), np.interp(grid, places, other, period=samples)
    feedback, tracked = np.zeros(samples), np.zeros(samples)
    while history is not None:
        sample, one, other, _evidence, history = history
        feedback[sample], tracked[sample] = one, other
    return feedback, tracked


def _listed(history: Any) -> tuple[list[float], list[float], list[float]]:
    places: list[float] = []
    one: list[float] = []
    other: list[float] = []
    while history is not None:
        place, fed, missed, _evidence, history = history
        places.append(place)
        one.append(fed)
        other.append(missed)
    return places, one, other


def contraction(
    slope_n_m: float, stiffness_n_m: float, damping_n_s_m: float, delay_s: float, lag_s: float, lead_s: float,
    cutoff_hz: float = CUTOFF_HZ, gain: float = GAIN, highest_hz: float = 60.0,
) -> float:
    """Return the greatest |Q·(1 − γ·z^d·T)| over frequency: below 1 the correction converges.

    The plant is `slope_n_m` behind a dead time and a first-order lag; the feedback 1/(B·s + K).
    """
    frequency = np.linspace(0.01, highest_hz, 4000)
    s = 2j * np.pi * frequency
    loop = slope_n_m * np.exp(-s * delay_s) / (1.0 + s * lag_s) / (damping_n_s_m * s + stiffness_n_m)
    closed = loop / (1.0 + loop)
    return float(np.max(passes(frequency, cutoff_hz) * np.abs(1.0 - gain * np.exp(s * lead_s) * closed)))
