"""Joint fit of several trials of one bench: common parameters, each trial's own deviations, and the noise.

A trial's deviation of a parameter is a further parameter, `NAME@TRIAL`, beside the common one.
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
"""Samples over which noise is taken as stationary: 0.2 s at the highest working rate."""
PASSED: Final = 0.7
"""Mean power of white noise behind the low-pass of the thinning (run forward and back), relative to its mid-band power.
With it the median of a window estimates the noise at any working rate, which a test holds to 5 %."""

PHASES: Final = 20
"""Phases of a cycle at which its repeatability is computed."""


@dataclass(frozen=True)
class Deviating(Block):
    """Block of one trial of several: the common parameters, each shifted by this trial's own deviation (`NAME@TRIAL`).

    `own`: for each parameter that may deviate, the deviation's name and the parameter's bounds.
    """

    common: Block
    own: Mapping[str, tuple[str, float, float]]

    def residual(self, values: Values) -> Array:
        return self.common.residual({**values, **{
            slot: min(max(values[slot] + values[name], min(low, values[slot])), high)
            for slot, (name, low, high) in self.own.items()}})

    def like(self, name: str, values: Values) -> str | None:
        """Return the parameter that `name` deviates: within the bounds the residual reads only the sum of both."""
        slot, _, bench = name.partition("@")
        if not bench:
            return None
        _, low, high = self.own[slot]
        return slot if low < values[slot] + values[name] < high else None


def deviating(block: Block, bench: int, nuisance: Sequence[Free]) -> Deviating:
    """Return `block` with a deviation (numbered `bench`) for each parameter of `nuisance` that it reads."""
    own = {f.name: (f"{f.name}@{bench}", *RELATION_PARAMETERS[f.name].rig_bounds) for f in nuisance
           if f.name in block.uses}
    return Deviating(block.relation, block.signals, block.keep, block.cycle,
                     block.uses | {name for name, _, _ in own.values()}, common=block, own=own)


def chances(rest: Array) -> Array:
    """Return, by sample, the variance of a residual's white part, from second differences over every other sample.

    Sensor noise is white at the working rate. Systematic model error is not, except for a few samples after a reversal,
    which a median excludes. The median is over `WINDOW` samples, because an equation has less noise while the rope is
    slack. The differences measure mid-band power; `PASSED` converts it to the mean power.
    """
    bent = np.abs(rest[4:] - 2.0 * rest[2:-2] + rest[:-4])
    if bent.size < WINDOW:
        return np.zeros(rest.size)
    whole = 1.4826 * np.median(sliding_window_view(bent, WINDOW), axis=1)
    before = (rest.size - whole.size) // 2
    local = np.pad(whole, (before, rest.size - whole.size - before), mode="edge")
    return np.asarray(PASSED * local**2 / 6.0)


def chance(rest: Array) -> float:
    """Return 1σ of the white part of a residual, over all its samples."""
    return math.sqrt(float(np.mean(chances(rest)))) if rest.size else 0.0


def correlated(rests: Sequence[Array]) -> float:
    """Return how many neighbouring samples make one effective sample: 1 + 2·Σρ over the first positive lags."""
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
    """Return the cycles per effective cycle, from 1 to all: systematic error repeats each cycle, noise does not.

    `cycles`: cycle of each sample of each of `rests`. Cycles are compared at equal shares of their duration.
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
