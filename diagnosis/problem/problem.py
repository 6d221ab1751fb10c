"""Setting of a diagnosis: equations that can be checked, their blocks, reference, weights and candidate effects.

Columns, calibration and reference trials decide everything before the search starts. On a rig of another
kind without reference trials, the trials under diagnosis also fit the reference and scale the weights.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.data.table import Table
from diagnosis.problem import blocks as relations
from diagnosis.problem.blocks import Block
from diagnosis.problem.candidates import Candidate, candidates
from diagnosis.problem.cross_validation import folds_of
from diagnosis.problem.deviations import chance
from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.floors import CORRELATION_LENGTH, FLOORS, LEAST_CORRELATION_LENGTH, LEAST_FLOOR
from diagnosis.problem.healthy_reference import HealthyReference, like_this_bench, of_bench, of_unknown_rig
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.learnt_bands import Learnt
from physics.parameters import RELATION_PARAMETERS
from physics.relations import relation
from physics.relations.relation import RELATIONS

CORRELATED_S = 0.09
"""Time, s, over which residuals of a rig of another kind are correlated."""
UNEXPLAINED_SHARE = 0.3
"""Part of the baseline's residual that a search is expected not to explain on such a rig; scales the weights only."""


@dataclass(frozen=True)
class ProblemSetting:
    """Setting of one diagnosis: `checked` equations on `blocks`, with `folds` of their cycles.

    `any_rig`: a rig of another kind, without reference trials. `missing`: columns that each equation lacks. `floors`:
    reference RMSE, only with reference trials. `rate_hz`: sampling rate of all trials. `noise`: RMS noise of these
    trials by equation. `blind`: effects whose first equation lacks a column; these may be competing hypotheses and are
    never chosen.
    """

    any_rig: bool
    missing: Mapping[str, tuple[str, ...]]
    checked: tuple[str, ...]
    blocks: list[Block]
    folds: list[frozenset[int]]
    reference: HealthyReference
    declared: Mapping[str, float]
    weights: Mapping[str, float]
    floors: Mapping[str, float] | None
    offered: list[Candidate]
    learnt: Learnt | None = None
    rate_hz: float | None = None
    noise: Mapping[str, float] | None = None
    blind: Sequence[Candidate] = ()

    @property
    def problem(self) -> Problem:
        return Problem(self.blocks, self.weights, self.reference.prior)

    @property
    def taut(self) -> float | None:
        return None if self.any_rig else relations.TAUT_N

    @property
    def elsewhere(self) -> bool:
        """Whether the trials are of a rig of another kind that has reference trials."""
        return self.learnt is None and self.reference.kind == "healthy"

    @property
    def nameless(self) -> tuple[str, ...]:
        """Return the constants without prior on a rig of another kind that are in no effect of the catalogue."""
        return tuple(f.name for f in self.reference.nuisance if f.name in RELATION_PARAMETERS
                     and math.isinf(f.sigma) and RELATION_PARAMETERS[f.name].nameless)

    def samples(self, relation: str) -> int:
        return sum(b.keep.size for b in self.blocks if b.relation.name == relation)

    def independent(self, relation: str) -> float:
        """Return the effective number of samples of an equation on a rig of another kind."""
        step = float(np.median(np.diff(self.blocks[0].signals["time_s"])))
        return self.samples(relation) * min(1.0, step / CORRELATED_S)

    def noise_squares(self, relation: str) -> float:
        """Return the χ² of an equation due to the noise of these trials; 0 if the noise is not given."""
        return self.samples(relation) * (self.noise[relation] / self.weights[relation]) ** 2 if self.noise else 0.0

    def healthy_squares(self, relation: str, samples: int | None = None) -> float:
        """Return χ² of an equation in the reference condition, or of `samples` of it; 0 without reference trials."""
        count = self.samples(relation) if samples is None else samples
        return count * (self.floors[relation] / self.weights[relation]) ** 2 if self.floors else 0.0

    def structure_squares(self, relation: str) -> float:
        """Return the χ² of an equation due to systematic model error in the reference condition."""
        return self.healthy_squares(relation) - self.noise_squares(relation)

    @property
    def structure(self) -> float:
        """Return χ² due to systematic model error in the reference condition, summed over all equations."""
        return sum(self.structure_squares(n) for n in self.checked)

    def rmse(self, relation: str, chi_square: float) -> float:
        """Return the RMSE of an equation, in its unit, for a χ²."""
        return math.sqrt(max(chi_square, 0.0) / self.samples(relation)) * self.weights[relation]


def build_problem(trials: Sequence[Table], healthy: HealthyTrials,
                  calibration: Mapping[str, Any] | None) -> ProblemSetting:
    """Return the setting of a diagnosis of `trials`: the equations that can be checked, and their reference."""
    missing = relations.allowed(trials)
    any_rig = calibration is None and not like_this_bench(trials)
    checked = tuple(n for n, lacks in missing.items() if not lacks and not (any_rig and RELATIONS[n].bench_only))
    rate = healthy.rate(trials) if healthy and not any_rig else relations.working_rate(trials)
    blocks = relations.blocks_of(trials, checked, None if any_rig else relations.TAUT_N, rate)
    checked = tuple(n for n in checked if any(b.relation.name == n and b.keep.size for b in blocks))
    blocks = [b for b in blocks if b.relation.name in checked]
    folds = folds_of(np.concatenate([b.cycle for b in blocks])) if blocks else []
    if any_rig:
        return _unknown(missing, checked, blocks, folds, rate)
    return _bench(missing, checked, blocks, folds, healthy, calibration, rate)


def _bench(missing: Mapping[str, tuple[str, ...]], checked: tuple[str, ...], blocks: list[Block],
           folds: list[frozenset[int]], healthy: HealthyTrials, calibration: Mapping[str, Any] | None, rate: float
           ) -> ProblemSetting:
    reference = of_bench(calibration)
    if healthy:
        return _learnt(missing, checked, blocks, folds, healthy.fit(checked, reference, rate), rate)
    floors = {n: FLOORS[n] for n in checked}
    weights = {n: floors[n] * math.sqrt(CORRELATION_LENGTH[n]) for n in checked}
    return ProblemSetting(False, missing, checked, blocks, folds, reference, reference.values, weights, None,
                          candidates(checked, reference.values, reference.nuisance), rate_hz=rate)


def _learnt(missing: Mapping[str, tuple[str, ...]], checked: tuple[str, ...], blocks: list[Block],
            folds: list[frozenset[int]], learnt: Learnt, rate: float) -> ProblemSetting:
    values, nuisance = learnt.reference.values, learnt.reference.nuisance
    weighed = learnt.weighed(blocks)
    noise = {n: weighed.noise.get(n) or _chance(weighed.blocks, n, values) for n in checked}
    floors = {n: max(weighed.floors.get(n, FLOORS[n]), LEAST_FLOOR[n]) for n in checked}
    weights = {n: max(weighed.weights.get(n, FLOORS[n] * math.sqrt(CORRELATION_LENGTH[n])),
                      LEAST_FLOOR[n] * math.sqrt(LEAST_CORRELATION_LENGTH)) for n in checked}
    return ProblemSetting(False, missing, checked, weighed.blocks, folds, learnt.reference, values, weights, floors,
                          candidates(checked, values, nuisance), learnt, rate, noise,
                          candidates(checked, values, nuisance, blind=True))


def _unknown(missing: Mapping[str, tuple[str, ...]], checked: tuple[str, ...], blocks: list[Block],
             folds: list[frozenset[int]], rate: float) -> ProblemSetting:
    first = of_unknown_rig(blocks)
    even = {n: _deviation(blocks, n) for n in checked}
    values = solve(Problem(blocks, even), first.values, first.nuisance).values
    values["pull_sign"] = math.copysign(1.0, values["coulomb"])
    reference = HealthyReference(first.kind, values, first.nuisance)
    values = solve(Problem(blocks, even), values, first.nuisance).values
    step = float(np.median(np.diff(blocks[0].signals["time_s"]))) if blocks else 1.0
    per_sample = math.sqrt(max(1.0, CORRELATED_S / step))
    weights = {n: UNEXPLAINED_SHARE * per_sample * relations.rmse(
        b.residual(values) for b in blocks if b.relation.name == n) for n in checked}
    offered = offered_on(blocks, checked, reference)
    return ProblemSetting(True, missing, checked, blocks, folds, reference, reference.values, weights, None, offered,
                          rate_hz=rate)


def offered_on(blocks: Sequence[Block], checked: tuple[str, ...], reference: HealthyReference) -> list[Candidate]:
    """Return the effects that the equations can show on these signals of a rig of any kind."""
    return [c for c in candidates(checked, reference.values, reference.nuisance, True)
            if any(c.parameters & relation.read_on(b.relation, b.signals) for b in blocks)]


def _chance(blocks: Sequence[Block], name: str, values: Mapping[str, float]) -> float:
    """Return the noise of an equation, RMS over its blocks."""
    held = [chance(b.residual(values)) ** 2 for b in blocks if b.relation.name == name]
    return math.sqrt(float(np.mean(held)))


def _deviation(blocks: Sequence[Block], name: str) -> float:
    held = [b.signals[b.relation.output][b.keep] for b in blocks if b.relation.name == name]
    return float(np.std(np.concatenate(held))) or 1.0
