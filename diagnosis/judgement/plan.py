"""Detection limits before a trial: the smallest size of each effect that an experiment would detect.

Equations, bands, reference RMSE and thresholds are those of a verdict, applied to a simulated reference trial. Δ:
change of the residuals by an effect; J: slopes of the nuisance parameters; P: their prior precision. Only the part of Δ
that the nuisance cannot absorb counts: Δ⊥ = Δ − J·(JᵀJ + P)⁻¹·Jᵀ·Δ. The size of the effect is scaled down, linearly,
until it would just be named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from diagnosis.data import integrity
from diagnosis.data.table import Table
from diagnosis.judgement.verdict import LEAST_GAIN, RIVAL_GAIN, least_fall
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.fit import Fit, solve
from diagnosis.problem.floors import FLOORS
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.problem import ProblemSetting, build_problem
from parameters import InputError
from physics.effects.catalogue import CATALOGUE, EffectParameter
from physics.laws import Array
from physics.relations.relation import RELATIONS

RISE: Final = 1.0 / (1.0 - LEAST_GAIN) ** 2 - 1.0
"""Mean square that an effect must add to an equation's residual, in squared reference RMSE. Without the effect the RMSE
is then lower by the share `LEAST_GAIN`."""


@dataclass(frozen=True)
class Limit:
    """Detection limit of one effect in an experiment.

    `size`: smallest detectable departure from the reference value (None: not detectable within the bounds), with the
    effect's other parameters at `shape`. `relation`: equation with the largest response. `like`: effects with the same
    response, within the verdict's share.
    """

    effect: str
    site: str
    parameter: str
    unit: str
    size: float | None
    likely: tuple[float, float]
    shape: Mapping[str, float]
    relation: str | None
    like: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """Detection limits of an experiment, and by equation its `floors` (reference RMSE) and effective `samples`.
    `blind`: effects that no equation of the experiment responds to."""

    limits: tuple[Limit, ...]
    floors: Mapping[str, float]
    samples: Mapping[str, float]
    blind: tuple[str, ...]

    def unit(self, relation: str) -> str:
        """Return the unit of a prediction equation."""
        return RELATIONS[relation].unit

    def as_json(self) -> dict[str, Any]:
        """Return the plan as plain values; `smallest` is null for an undetectable effect."""
        return {
            "relations": {name: {"unit": self.unit(name), "floor": floor, "samples": self.samples[name]}
                          for name, floor in self.floors.items()},
            "effects": [{"effect": limit.effect, "site": limit.site, "parameter": limit.parameter, "unit": limit.unit,
                         "smallest": limit.size, "likely": list(limit.likely), "shape": dict(limit.shape),
                         "relation": limit.relation, "like": list(limit.like)} for limit in self.limits],
            "blind": list(self.blind)}


def plan(simulated: Table, healthy: Sequence[Table] = (), calibration: Mapping[str, Any] | None = None) -> Plan:
    """Return the detection limits of an experiment, from a simulated reference trial of it.

    `healthy`: measured reference trials that replace the assumed reference RMSE of the bench population. Raises
    `InputError` if no equation can be checked or the trial has too few laps.
    """
    with threadpool_limits(1, user_api="blas"):
        return _planned(simulated, healthy, calibration)


def _planned(simulated: Table, healthy: Sequence[Table], calibration: Mapping[str, Any] | None) -> Plan:
    setting = build_problem([integrity.usable(simulated)], HealthyTrials(healthy), calibration or simulated.calibration)
    if not setting.checked or len(setting.folds) < integrity.LEAST_CYCLES:
        raise InputError(f"{simulated.source}: {len(setting.folds)} laps and {len(setting.checked)} relations to check;"
                         f" expected at least {integrity.LEAST_CYCLES} and one: give an experiment that moves.")
    return _Sight(setting, solve(setting.problem, setting.reference.values, setting.reference.nuisance)).plan()


def sight(setting: ProblemSetting, baseline: Fit) -> tuple[Limit, ...]:
    """Return the detection limit of every effect on a setting's own trials; `baseline`: their fit without an effect."""
    return _Sight(setting, baseline).plan().limits


_Seen = tuple[Mapping[str, float], NDArray[np.float32], float]


class _Sight:
    """Residuals of one reference trial, and their change by each effect."""

    def __init__(self, setting: ProblemSetting, baseline: Fit) -> None:
        self.setting, self.problem, self.fit = setting, setting.problem, baseline
        self.slopes = self.fit.every_slope()
        self.inverse = np.linalg.pinv(self.fit.curvature, rcond=1e-12)
        names = [b.relation.name for b in setting.blocks]
        self.place = np.concatenate([np.full(r.size, names.index(n)) for n, r in zip(
            names, self.fit.residuals, strict=True)])
        self.names = names

    def plan(self) -> Plan:
        """Return the detection limit of every effect, and the effects that no equation of this trial responds to."""
        seen = {c.name: self._best(c) for c in self.setting.offered}
        limits = tuple(self._limit(c, *seen[c.name], seen) for c in self.setting.offered)
        blind = tuple(name for name in CATALOGUE if name not in seen)
        return Plan(limits, {n: self._floor(n) for n in dict.fromkeys(self.names)},
                    {n: self._independent(n) for n in dict.fromkeys(self.names)}, blind)

    def _best(self, candidate: Candidate) -> _Seen:
        """Return the start of the smallest detectable effect, Δ⊥ at this start, and the detectable share of Δ⊥."""
        moving, at = _moving(candidate), self.setting.reference.values
        tried = [(start, *self._share(self._change(start))) for start in candidate.starts]
        start, change, share = min(tried, key=lambda one: one[2] * abs(one[0][moving.name] - at[moving.name]))
        return start, change.astype(np.float32), share  # kept for all candidates

    def _change(self, start: Mapping[str, float]) -> Array:
        values = {**self.fit.values, **start}
        change = np.concatenate(self.problem.residuals(values)) - np.concatenate(self.fit.residuals)
        return np.asarray(change - self.slopes.T @ (self.inverse @ (self.slopes @ change)))

    def _share(self, change: Array) -> tuple[Array, float]:
        """Return Δ⊥ and the share of it that just meets both thresholds; infinite if Δ⊥ is zero."""
        fall = float(change @ change)
        by_relation = [float(change[self.place == i] @ change[self.place == i]) / self._independent(name)
                       for i, name in enumerate(self.names)]
        if fall <= 0.0 or max(by_relation) <= 0.0:
            return change, math.inf
        least = least_fall(sum(self._independent(n) - self.setting.noise_squares(n) for n in dict.fromkeys(self.names)))
        return change, max(math.sqrt(least / fall), math.sqrt(RISE / max(by_relation)))

    def _limit(self, candidate: Candidate, start: Mapping[str, float], change: NDArray[np.float32], share: float,
               seen: Mapping[str, _Seen]) -> Limit:
        moving = _moving(candidate)
        size = share * abs(start[moving.name] - self.setting.reference.values[moving.name])
        loudest = [float(change[self.place == i] @ change[self.place == i]) / self._independent(n)
                   for i, n in enumerate(self.names)]
        hidden = not math.isfinite(share) or size > moving.high - moving.low
        return Limit(
            candidate.name, candidate.site, moving.name, moving.unit, None if hidden else size, moving.likely,
            {name: value for name, value in start.items() if name != moving.name},
            None if hidden else self.names[int(np.argmax(loudest))],
            () if hidden else tuple(other for other, (_, theirs, their_share) in seen.items()
                                    if other != candidate.name and math.isfinite(their_share)
                                    and _alike(change, theirs) >= RIVAL_GAIN))

    def _floor(self, name: str) -> float:
        """Return the reference RMSE of an equation, in its unit, or the RMSE of this trial if larger."""
        rests = [r for n, r in zip(self.names, self.fit.residuals, strict=True) if n == name]
        off = math.sqrt(float(np.mean(np.concatenate(rests) ** 2))) * self.setting.weights[name]
        return max((self.setting.floors or FLOORS).get(name, 0.0), off)

    def _independent(self, name: str) -> float:
        """Return χ² of an equation in the reference condition: its samples × (reference RMSE / weight)²."""
        return self.setting.samples(name) * (self._floor(name) / self.setting.weights[name]) ** 2


def _moving(candidate: Candidate) -> EffectParameter:
    """Return the parameter of an effect's size; the others are its shape."""
    parameters = CATALOGUE[candidate.name].parameters
    free = [p for p in parameters if p.name in candidate.parameters]
    return next((p for p in free if p.neutral is not None), free[0])


def _alike(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Return the share of χ² of `one` that `other`, scaled, explains."""
    both = float(one @ one) * float(other @ other)
    return float(one @ other) ** 2 / both if both > 0.0 else 0.0
