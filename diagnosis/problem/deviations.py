"""Several trials of one bench in one fit: what is common to them, how far each stands apart, how much is chance.

The rule of this file: a trial's own deviation of a parameter is a parameter `NAME@TRIAL` beside the common one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from diagnosis.problem.fit import Free
from physics.parameters import RELATION_PARAMETERS

Array = NDArray[np.float64]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Deviating(Block):
    """A block of one of several like benches: what is common, and how far this bench is from it (`SLOT@BENCH`)."""

    common: Block
    bench: int
    own: tuple[str, ...]

    def residual(self, values: Values) -> Array:
        return self.common.residual({**values, **{
            n: min(max(values[n] + values[f"{n}@{self.bench}"], min(low, values[n])), high)
            for n in self.own for low, high in (RELATION_PARAMETERS[n].rig_bounds,)}})


def deviating(block: Block, bench: int, nuisance: Sequence[Free]) -> Deviating:
    """Return `block` of the bench of a number, which may stand apart from what is common in the slots of `nuisance`."""
    own = tuple(f.name for f in nuisance if f.name in block.uses)
    return Deviating(block.relation, block.signals, block.keep, block.cycle,
                     block.uses | {f"{n}@{bench}" for n in own}, common=block, bench=bench, own=own)


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
