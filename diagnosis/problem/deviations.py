"""Several trials of one bench in one fit: what is common to them, how far each stands apart, how much is chance.

The rule of this file: a trial's own deviation of a parameter is a parameter `NAME@TRIAL` beside the common one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from diagnosis.problem.prior import Free
from physics.parameters import RELATION_PARAMETERS

Array = NDArray[np.float64]
Values = Mapping[str, float]

WINDOW: Final = 24
"""Samples over which noise is taken to be even: 0.2 s at the highest working rate."""
PASSED: Final = 0.7
"""Share of a white noise's power that the low-pass before the thinning, run forward and back, leaves of what the middle
of the band has; with it the median of a window says the noise of any working rate (a test holds it to 5 %)."""

PHASES: Final = 20
"""Places of a cycle at which its repetition is looked for."""


@dataclass(frozen=True)
class Deviating(Block):
    """A block of one of several like benches: what is common, and how far this bench is from it (`SLOT@BENCH`).

    `own`: by slot in which it may deviate, the deviation's name and the slot's bounds.
    """

    common: Block
    own: Mapping[str, tuple[str, float, float]]

    def residual(self, values: Values) -> Array:
        return self.common.residual({**values, **{
            slot: min(max(values[slot] + values[name], min(low, values[slot])), high)
            for slot, (name, low, high) in self.own.items()}})

    def like(self, name: str, values: Values) -> str | None:
        """Return the slot whose deviation `name` is: only their sum is read, while it is inside the bounds."""
        slot, _, bench = name.partition("@")
        if not bench:
            return None
        _, low, high = self.own[slot]
        return slot if low < values[slot] + values[name] < high else None


def deviating(block: Block, bench: int, nuisance: Sequence[Free]) -> Deviating:
    """Return `block` of the bench of a number, which may stand apart from what is common in the slots of `nuisance`."""
    own = {f.name: (f"{f.name}@{bench}", *RELATION_PARAMETERS[f.name].rig_bounds) for f in nuisance
           if f.name in block.uses}
    return Deviating(block.relation, block.signals, block.keep, block.cycle,
                     block.uses | {name for name, _, _ in own.values()}, common=block, own=own)


def chances(rest: Array) -> Array:
    """Return, by sample, the square of the white part of a residual: from second differences over every other sample.

    A sensor's noise is white at the working rate and what a law lacks is not, but for the few samples after a reversal,
    which a median leaves out; it is taken over `WINDOW` samples, since a relation shows less noise in a slack rope than
    in a taut one.  These differences see the middle of the band, which the low-pass of the working rate leaves as it
    is; of the rest it leaves `PASSED`.
    """
    bent = np.abs(rest[4:] - 2.0 * rest[2:-2] + rest[:-4])
    if bent.size < WINDOW:
        return np.zeros(rest.size)
    whole = 1.4826 * np.median(sliding_window_view(bent, WINDOW), axis=1)
    before = (rest.size - whole.size) // 2
    local = np.pad(whole, (before, rest.size - whole.size - before), mode="edge")
    return np.asarray(PASSED * local**2 / 6.0)


def chance(rest: Array) -> float:
    """Return 1σ of the white part of a residual, over all of it."""
    return math.sqrt(float(np.mean(chances(rest)))) if rest.size else 0.0


def correlated(rests: Sequence[Array]) -> float:
    """Return how many neighbouring samples count as one: 1 + 2·Σρ over the first positive lags."""
    total, energy = np.zeros(1), 0.0
    for rest in rests:
        centred = rest - rest.mean()
        n = centred.size
        spectrum = np.fft.rfft(centred, 2 * n)
        covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
        if total.size < n:
            total = np.pad(total, (0, n - total.size))
        total[:n] += covariance
        energy += covariance[0]
    if energy <= 0.0:
        return 1.0
    rho = total / energy
    negative = np.flatnonzero(rho[1:] <= 0.0)
    last = int(negative[0]) + 1 if negative.size else rho.size
    return float(1.0 + 2.0 * rho[1:last].sum())


def repeated(rests: Sequence[Array], cycles: Sequence[NDArray[np.intp]]) -> float:
    """Return how many cycles count as one, from 1 to all: what a law lacks comes again in each cycle, noise does not.

    `cycles`: by sample of each of `rests`, its cycle; compared is by the share of a cycle that has passed.
    """
    one, many, count = 0.0, 0.0, 1
    for rest, cycle in zip(rests, cycles, strict=True):
        held = [rest[cycle == c] for c in np.unique(cycle)]
        held = [r for r in held if r.size >= PHASES]
        if len(held) < 2:
            continue
        binned = np.array([np.interp(np.linspace(0.0, 1.0, PHASES), np.linspace(0.0, 1.0, r.size), r) for r in held])
        one, many, count = one + float(np.mean(binned**2)), many + float(np.mean(binned.mean(axis=0) ** 2)), len(held)
    return 1.0 + max(count * many / one - 1.0, 0.0) if one > 0.0 else 1.0
