"""What the laws leave on the healthy trials: how much of it another trial repeats, and how far it scatters where.

The rule of this file: each healthy trial is judged by what the other ones teach, fitted again inside the bands of like
benches as a trial in question will be (a single one by cycles); what that leaves is the floor, and where in motion and
load it is left says how much a sample there may count.
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
"""Share of what the laws leave that one like bench may leave in another way than another one."""


@dataclass(frozen=True)
class HealthyResiduals:
    """By relation, what the laws leave on the healthy trials.

    `floors`: RMSE with the discrepancy taken off, on what it was not learnt on; `plain`: without it; `misfit`: that one
    with each sample counted as the fit counts it, beside the signal's own `spread`; `noise`: what of both is the
    sensors' noise of these trials, which another trial need not have; `correlation_length`: how many samples of the
    former count as one; `discrepancies`: what was learnt; `scatters`: where it scatters.
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
    """One relation on one trial that was fitted alone: its features, what the law leaves, how much that counts, and
    what is held back together."""

    at: Array
    rest: Array
    certain: Array
    group: NDArray[np.intp]


def examine(trials: Sequence[Sequence[Block]], bench: HealthyReference, near: Sequence[Values],
            weights: Mapping[str, float], certain: Sequence[Sequence[Array]]) -> HealthyResiduals:
    """Fit each trial alone inside the bands of `bench` from `near`, learn what the laws leave, judge it on the unseen.

    `certain`: by trial and block, how much each sample counts in these fits.
    """
    held = [list(zip(trial, own, strict=True)) for trial, own in zip(trials, certain, strict=True)]
    alone = [_fitted(trial, {}, bench, start, weights) for trial, start in zip(held, near, strict=True)]
    told = _told(held, alone, bench.values)
    learnt = {n: _learnt(parts) for n, parts in told.items() if _motion(n)}
    if len(trials) > 1 and any(d.used for d in learnt.values()):
        # with the discrepancy taken off the constants need not stand in for it any more
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
    """Return the share of what the laws leave that a further like bench may leave in another way than `trials` did.

    One bench's own way is taken for that of all where it alone taught it: the mean of `trials` is off by as much again,
    over the root of their number.
    """
    return STRUCTURE * math.sqrt(1.0 + 1.0 / trials)


LEAST: Final = 0.1
"""Share of the noise below which nothing is known of what else a relation leaves."""


def noise_at(at: Sequence[Array], rests: Sequence[Array]) -> list[Array]:
    """Return, by sample of each of some blocks of one relation, the square of its noise."""
    every = np.concatenate([chances(r) for r in rests])
    local = discrepancy.scatter(np.concatenate(list(at)), every, 1e-24)
    return [local.of(x) for x in at]


def certainties(blocks: Sequence[Block], rests: Sequence[Array], values: Values) -> list[Array]:
    """Return, by block of any trials, how much each sample counts by how far its law is from holding about there."""
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
    """Return where a relation is from holding on a further bench: what is `left` on the unseen, and its own way.

    `share`: of what the laws plainly leave, that a further bench leaves in its own way; it is off by no more than they.
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
    """Return what each trial leaves of what the other ones teach; of a single one, each cycle."""
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
    """Whether a relation's discrepancy may follow motion and load: a drive's own loop is what it is."""
    return relation not in ("servo", "knee")
