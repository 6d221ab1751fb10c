"""What healthy trials teach: where the relations really rest, how far they are from holding, how much is chance.

The rule of this file: healthy data move everything that the catalogue can move, a little, towards what they
show, so that what the laws have in common with no bench is not mistaken for a cause later; the floors are of
the trials one by one, each with its own nuisance inside the bands of like benches.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block, rmse
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.fit import Free, Problem, solve
from diagnosis.problem.reference import BAND, Reference
from physics.parameters import RELATION_PARAMETERS

Array = NDArray[np.float64]
Values = Mapping[str, float]

LEARNT: Final = 2.0
"""1σ of what healthy data may teach about a healthy value, of that by which like benches differ."""
TEACHING: Final = 0.1
"""1σ of what healthy data may teach about an effect's parameter, of the half width of its likely range."""


@dataclass(frozen=True)
class HealthyFit:
    """What healthy trials say: the reference they moved; by relation, RMSE (floor) and correlation length (samples)."""

    reference: Reference
    floors: Mapping[str, float]
    correlation_length: Mapping[str, float]


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


def fit_healthy(trials: Sequence[Sequence[Block]], reference: Reference, offered: Sequence[Candidate],
          floors: Mapping[str, float], correlation_length: Mapping[str, float]) -> HealthyFit:
    """Fit what all healthy benches have in common together with each one's own deviation, then each bench alone.

    `floors`, `correlation_length`: what is assumed before they are seen.
    """
    blocks = [deviating(b, i, reference.nuisance) for i, trial in enumerate(trials) for b in trial]
    weights = {n: floors[n] * math.sqrt(correlation_length[n]) for n in floors}
    deviations = [Free(f"{f.name}@{i}", -BAND * f.sigma, BAND * f.sigma, 0.0, f.sigma, f.scale)
                  for i in range(len(trials)) for f in reference.nuisance] if len(trials) > 1 else []
    start = {**reference.values, **{f"{f.name}@{i}": 0.0 for i in range(len(trials)) for f in reference.nuisance}}
    together = solve(Problem(blocks, weights), start, (*_teachable(reference, offered), *deviations), thorough=True)
    taught = {n: together.values[n] for n in reference.values}
    bands = tuple(_recentred(f, taught[f.name], len(trials)) for f in reference.nuisance)
    moved = Reference(reference.kind, taught, bands)
    rests: dict[str, list[Array]] = {n: [] for n in floors}
    for i, trial in enumerate(trials):
        near = {**taught, **{f.name: taught[f.name] + together.values[f"{f.name}@{i}"] for f in reference.nuisance}}
        alone = solve(Problem(trial, weights), near, bands, thorough=True).values
        for block in trial:
            rests[block.relation.name].append(block.residual(alone))
    return HealthyFit(moved, {n: rmse(r) for n, r in rests.items()}, {n: correlated(r) for n, r in rests.items()})


def _teachable(reference: Reference, offered: Sequence[Candidate]) -> tuple[Free, ...]:
    """Everything that may move on healthy data: the nuisance in its bands, effects a little about their rest."""
    known = {f.name: _widened(f) for f in reference.nuisance}
    for candidate in offered:
        for f in candidate.frees:
            if f.name not in known:
                sigma = 2.0 * TEACHING * f.scale
                known[f.name] = dataclasses.replace(f, sigma=sigma, mean=reference.values[f.name])
    for name, p in RELATION_PARAMETERS.items():
        if p.law > 0.0:
            known[name] = Free(name, *p.rig_bounds, reference.values[name], p.law, p.law)
    return tuple(known.values())


def _widened(f: Free) -> Free:
    (low, high), half = RELATION_PARAMETERS[f.name].rig_bounds, LEARNT * BAND * f.sigma
    return dataclasses.replace(f, low=max(low, f.mean - half), high=min(high, f.mean + half), sigma=LEARNT * f.sigma)


def _recentred(f: Free, at: float, trials: int) -> Free:
    """Return the band about the mean of so many benches, which is itself off by σ/√n."""
    sigma = f.sigma * math.sqrt(1.0 + 1.0 / trials)
    (low, high), half = RELATION_PARAMETERS[f.name].rig_bounds, BAND * sigma
    return dataclasses.replace(f, mean=at, sigma=sigma, low=max(low, at - half), high=min(high, at + half))


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
