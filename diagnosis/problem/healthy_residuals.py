"""Residuals of the fitted model in the reference condition: how far a trial repeats them, and where they scatter.

Each reference trial is held out, corrected by the discrepancy of the others, and fitted again inside the population's
bands, as a trial under diagnosis will be. A single trial is held out by cycles. The RMS of what remains is the
reference RMSE. Its local mean square over motion and load gives the weight of each sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem import discrepancy
from diagnosis.problem.blocks import Block, rmse
from diagnosis.problem.deviations import chance, chances, correlated
from diagnosis.problem.discrepancy import Discrepancy, Scatter
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.healthy_reference import HealthyReference
from diagnosis.problem.prior import Free

Array = NDArray[np.float64]
Values = Mapping[str, float]

STRUCTURE: Final = 0.25
"""Systematic error in which two benches of the population differ, as a share of the residual of the fitted model."""


@dataclass(frozen=True)
class HealthyResiduals:
    """Residuals in the reference condition, by prediction equation and in its unit.

    `floors`: reference RMSE, on held-out data with the discrepancy subtracted. `plain`: RMSE without the discrepancy.
    `misfit`: `plain` with the fit's sample weights. `spread`: standard deviation of the signal. `noise`: sensor noise
    of these trials, contained in both RMSE. `correlation_length`: samples per effective sample of the held-out
    residual. `discrepancies`: those that are used. `scatters`: local mean square of the model error.
    """

    floors: Mapping[str, float]
    plain: Mapping[str, float]
    misfit: Mapping[str, float]
    noise: Mapping[str, float]
    correlation_length: Mapping[str, float]
    spread: Mapping[str, float]
    discrepancies: Mapping[str, Discrepancy]
    scatters: Mapping[str, Scatter]


@dataclass(frozen=True)
class _Alone:
    """One equation on one trial fitted alone: features, residual, sample weights, and the number of the set held out
    together."""

    at: Array
    rest: Array
    certain: Array
    group: NDArray[np.intp]


def examine(trials: Sequence[Sequence[Block]], bench: HealthyReference, near: Sequence[Values],
            weights: Mapping[str, float], certain: Sequence[Sequence[Array]]) -> HealthyResiduals:
    """Fit each trial alone inside the bands of `bench` from `near`; return the residuals of held-out trials.

    `certain`: by trial and block, the weight of each sample in these fits.
    """
    held = [list(zip(trial, own, strict=True)) for trial, own in zip(trials, certain, strict=True)]
    alone = [_fitted(trial, {}, bench, start, weights) for trial, start in zip(held, near, strict=True)]
    told = _told(held, alone, bench.values)
    learnt = {n: _learnt(parts) for n, parts in told.items() if _motion(n)}
    if len(trials) > 1 and any(d.used for d in learnt.values()):
        # with the discrepancy subtracted, the constants no longer have to absorb it
        alone = [_fitted(trial, learnt, bench, values, weights) for trial, values in zip(held, alone, strict=True)]
        told = _told(held, alone, bench.values)
        learnt = {n: _learnt(parts) for n, parts in told.items() if _motion(n)}
    plain = {n: rmse(p.rest for p in parts) for n, parts in told.items()}
    unseen = _unseen(held, told, learnt, bench, alone, weights)
    left = {n: rmse(unseen[n]) for n in told}
    worth = {n: d for n, d in learnt.items() if d.used and left[n] < discrepancy.WORTH * plain[n]}
    rests = {n: unseen[n] if n in worth else [p.rest for p in parts] for n, parts in told.items()}
    noise = {n: math.sqrt(float(np.mean([chance(p.rest) ** 2 for p in parts]))) for n, parts in told.items()}
    return HealthyResiduals(
        floors={n: rmse(r) for n, r in rests.items()}, plain=plain, noise=noise, discrepancies=worth,
        misfit={n: _misfit(parts) for n, parts in told.items()},
        correlation_length={n: correlated(r) for n, r in rests.items()}, spread={n: _spread(trials, n) for n in told},
        scatters={n: _structure(parts, rests[n], another(len(trials))) for n, parts in told.items() if _motion(n)})


def another(trials: int) -> float:
    """Return the systematic error by which a further bench may differ, as a share of the residual of the fitted model.

    The bench-to-bench part of the residual counts once for the further bench. The mean over `trials` adds the same part
    divided by the root of their number.
    """
    return STRUCTURE * math.sqrt(1.0 + 1.0 / trials)


LEAST: Final = 0.1
"""Lower limit of the systematic error, as a share of the noise, both RMS: a smaller one cannot be determined."""


def noise_at(at: Sequence[Array], rests: Sequence[Array]) -> list[Array]:
    """Return the noise variance by sample, for each of several blocks of one equation."""
    every = np.concatenate([chances(r) for r in rests])
    local = discrepancy.scatter(np.concatenate(list(at)), every, 1e-24)
    return [local.of(x) for x in at]


def certainties(blocks: Sequence[Block], rests: Sequence[Array], values: Values) -> list[Array]:
    """Return the weight of each sample by block of any trials, from the local mean square of the residual."""
    found = [np.ones(b.keep.size) for b in blocks]
    for name in dict.fromkeys(b.relation.name for b in blocks if b.keep.size):
        mine = [i for i, b in enumerate(blocks) if b.relation.name == name and b.keep.size]
        at = [discrepancy.features(blocks[i].signals, values)[blocks[i].keep] for i in mine]
        noise = noise_at(at, [rests[i] for i in mine])
        left = _scattered(at, [rests[i] ** 2 - n for i, n in zip(mine, noise, strict=True)], noise)
        for i, x, n in zip(mine, at, noise, strict=True):
            found[i] = discrepancy.certainty(left.of(x), n)
    return found


def _scattered(at: Sequence[Array], squares: Sequence[Array], noise: Sequence[Array]) -> Scatter:
    least = LEAST**2 * float(np.mean(np.concatenate(list(noise))))
    return discrepancy.scatter(np.concatenate(list(at)), np.concatenate(list(squares)), least + 1e-24)


def _structure(parts: Sequence[_Alone], left: Sequence[Array], share: float) -> Scatter:
    """Return the local mean square of the model error of one equation on a further bench.

    `left`: held-out residuals. `share`: part of the plain residual in which a further bench may differ; the sum is
    limited to the larger of both squares.
    """
    at = [p.at for p in parts]
    noise = noise_at(at, left)
    return _scattered(at, [np.minimum(r**2 - n + share**2 * (p.rest**2 - n), np.maximum(r**2, p.rest**2) - n)
                           for p, r, n in zip(parts, left, noise, strict=True)], noise)


Held = Sequence[tuple[Block, Array]]


def _fitted(trial: Held, learnt: Mapping[str, Discrepancy], bench: HealthyReference, start: Values,
            weights: Mapping[str, float]) -> dict[str, float]:
    blocks = [discrepancy.corrected(b, learnt, bench.values, certain) for b, certain in trial]
    reads = frozenset().union(*(b.uses for b in blocks))
    free: list[Free] = [f for f in bench.nuisance if f.name in reads]
    return solve(Problem(blocks, weights, bench.prior), {**bench.values, **start}, free).values


def _told(held: Sequence[Held], alone: Sequence[Values], values: Values) -> dict[str, list[_Alone]]:
    found: dict[str, list[_Alone]] = {}
    for i, (trial, own) in enumerate(zip(held, alone, strict=True)):
        for block, certain in trial:
            if block.keep.size:
                group = np.full(block.keep.size, i, dtype=np.intp) if len(held) > 1 else block.cycle
                found.setdefault(block.relation.name, []).append(_Alone(
                    discrepancy.features(block.signals, values)[block.keep], block.residual(own), certain, group))
    return found


def _misfit(parts: Sequence[_Alone]) -> float:
    squares = sum(float(np.sum((p.certain * p.rest) ** 2)) for p in parts)
    return math.sqrt(squares / max(sum(float(np.sum(p.certain**2)) for p in parts), 1e-300))


def _learnt(parts: Sequence[_Alone]) -> Discrepancy:
    return discrepancy.learn([p.at for p in parts], [p.rest for p in parts], [p.group for p in parts])


def _unseen(held: Sequence[Held], told: Mapping[str, Sequence[_Alone]], learnt: Mapping[str, Discrepancy],
            bench: HealthyReference, alone: Sequence[Values], weights: Mapping[str, float]) -> dict[str, list[Array]]:
    """Return the residual of each trial with the discrepancy of the others subtracted; by cycles for a single trial."""
    if len(held) == 1:
        return {n: [_by_cycles(parts[0], learnt.get(n))] for n, parts in told.items()}
    found: dict[str, list[Array]] = {n: [] for n in told}
    for i, trial in enumerate(held):
        others = {n: discrepancy.again(d, *zip(*((p.at, p.rest) for p in told[n] if p.group[0] != i), strict=True))
                  for n, d in learnt.items() if d.used and any(p.group[0] != i for p in told[n])}
        values = _fitted(trial, others, bench, alone[i], weights)
        for block, _ in trial:
            if block.keep.size:
                found[block.relation.name].append(
                    discrepancy.corrected(block, others, bench.values).residual(values))
    return found


def _by_cycles(part: _Alone, known: Discrepancy | None) -> Array:
    if known is None or not known.used:
        return part.rest
    rest = part.rest.copy()
    for fold in np.array_split(np.unique(part.group), min(5, len(np.unique(part.group)))):
        inside = np.isin(part.group, fold)
        other = discrepancy.again(known, [part.at[~inside]], [part.rest[~inside]])
        rest[inside] -= other.of(part.at[inside])
    return rest


def _spread(trials: Sequence[Sequence[Block]], name: str) -> float:
    held = [b.signals[b.relation.output] for trial in trials for b in trial if b.relation.name == name]
    values = np.concatenate(held)
    return float(np.std(values[np.isfinite(values)]))


def _motion(relation: str) -> bool:
    """Whether an equation's discrepancy may depend on motion and load; the loops of servo and knee are excluded."""
    return relation not in ("servo", "knee")
