"""Judgement of one setting: the search, and the results that a verdict reports from it.

Thresholds are those of `verdict`, selection criteria those of `criteria`. Figures of the chosen model are refitted fold
by fold. A parameter is reported as its declared reference value plus the change between the trial and the reference
trials.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from diagnosis.data.table import Table
from diagnosis.judgement import experiment_choice, verdict
from diagnosis.judgement.criteria import SearchCriteria
from diagnosis.problem import blocks
from diagnosis.problem.blocks import Block
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.problem import ProblemSetting
from diagnosis.search.search import FittedEffects, Search, SearchResult
from physics.effects.catalogue import CATALOGUE
from physics.parameters import PARAMETERS, RELATION_PARAMETERS
from physics.relations.relation import RELATIONS

MOST_ON_BENCH: Final = 2
"""Most effects in one verdict on the bench; data that need a third one are reported as unexplained."""
MOST_ELSEWHERE: Final = 6
"""Most effects on a rig that is compared with an ideal transmission, where every departure is an effect."""


class Judge:
    """One search and its verdict.

    `within`: the judgement whose ambiguity set this one splits, on data without a reference RMSE.
    """

    def __init__(self, setting: ProblemSetting, holdout: Sequence[Table], within: Judge | None = None) -> None:
        self.setting, self.holdout, self.within = setting, holdout, within
        names = None if within is None else within.rivals()
        offered = [c for c in setting.offered if names is None or c.name in names]
        self.criteria = SearchCriteria(setting, splits=within is not None)
        self.search = Search(setting.problem, setting.reference.values, setting.reference.nuisance, offered,
                             setting.folds, self.criteria, near=not setting.any_rig, scatter=within is None,
                             blind=setting.blind if within is None else ())
        for model in within.found.models if within is not None else ():
            own = [c for c in offered if c.name in model.names]
            if len(own) == len(model.effects) > 0:
                # the parameters fitted to the gait alone are a starting point beside the experiment, too
                self.search.model(own, {**self.search.start, **model.fit.values})
        most = MOST_ELSEWHERE if setting.any_rig else MOST_ON_BENCH
        self.found: SearchResult = self.search.run(most if within is None else len(within.found.best.effects))

    def word(self) -> str:
        """Return the verdict: none, found, ambiguous or unexplained."""
        if self._strange():
            return "unexplained"
        if not self.found.best.effects:
            return "none"
        return "found" if len(self.rivals()) == len(self.found.best.effects) else "ambiguous"

    def _strange(self) -> bool:
        return self.criteria.has_unexplained_residual(self.found.best, self.found.baseline)

    def rivals(self) -> list[str]:
        """Return the ambiguity set, the chosen effects first; empty if the chosen model has a lack of fit."""
        if self._strange():
            return []
        if self.within is not None:
            return list(verdict.unsplit(self.found, self.setting.structure, self.criteria.differs))
        # on the gait alone two confounded effects both have a large σ, which does not exclude either
        return list(verdict.rivals(self.found, lambda c, m: self.criteria.leads(c, m, self.search),
                                   lambda lesser, m: self.criteria.pays(lesser, m, self.search)))

    def holding(self) -> list[Block]:
        """Return the blocks without those of an experiment in equations that no model of the ambiguity set fits there.

        The residuals of reference trials hold for their own motion. On another motion a submodel may be wrong; its
        residual then carries no information about which effect is present.
        """
        class_of = [m for m in self.found.models if len(m.effects) == len(self.found.best.effects)]
        kept = set[int]()
        for name in self.setting.checked:
            there = self._of_experiment(name)
            expected = self.setting.healthy_squares(name, sum(self.setting.blocks[i].keep.size for i in there))
            if min(self._left(m, there) for m in class_of) <= verdict.STRANGE**2 * expected:
                kept.update(there)
        return [b for i, b in enumerate(self.setting.blocks) if i in kept or not of_experiment(b)]

    def told_by(self, kept: Sequence[Block]) -> bool:
        """Whether the `kept` blocks of an experiment read a parameter of some effect in the ambiguity set."""
        return any(of_experiment(b) and b.uses & c.parameters for b in kept for c in self.search.offered)

    def _of_experiment(self, relation: str) -> list[int]:
        """Return the indices of an equation's blocks that an experiment recorded."""
        return [i for i, b in enumerate(self.setting.blocks) if b.relation.name == relation and of_experiment(b)]

    @staticmethod
    def _left(model: FittedEffects, places: Sequence[int]) -> float:
        return sum(float(model.fit.residuals[i] @ model.fit.residuals[i]) for i in places)

    def experiment(self) -> str | None:
        """Return the experiment that splits the ambiguity set by calculation; None if the set needs no experiment."""
        blind = {c.name for c in self.setting.blind}
        return experiment_choice.choose([n for n in self.rivals() if n not in blind], self.found, self.setting)

    def blind_rivals(self) -> list[str]:
        """Return, as sentences, the competing hypotheses that only a missing column could separate from the chosen
        effects."""
        shows = {c.name: CATALOGUE[c.name].relations[0] for c in self.setting.blind}
        lacks = {name: ", ".join(columns) for name, columns in self.setting.missing.items()}
        return [f"{name} shows first in {shows[name]}: record {lacks[shows[name]]} to tell it from what is named."
                for name in self.rivals() if name in shows]

    def causes(self) -> list[dict[str, Any]]:
        """Return the chosen effects with their parameters and each one's gain in %."""
        return [] if self._strange() else [self._cause(c) for c in self.found.best.effects]

    def _cause(self, cause: Candidate) -> dict[str, Any]:
        own = {p.name: p.unit for p in CATALOGUE[cause.name].parameters}
        best = self.found.best
        parameters, was = {}, {}
        for f in cause.frees:
            shift = self.setting.declared[f.name] - self.setting.reference.values[f.name]
            at, was[f.name] = best.fit.values[f.name], f.mean + shift
            change = at - self.setting.reference.values[f.name]
            half = verdict.spread(best.unseen.fitted, f.name, verdict.curvature_sigma(best, f.name),
                                  self._likeness(f.name), change)
            told = {"value": at, "low": at - half, "high": at + half}
            shifted = {key: _inside(value + shift, f.low, f.high) for key, value in told.items()}
            parameters[f.name] = {**shifted, "unit": own[f.name] if f.name in own else PARAMETERS[f.name].unit}
        without = self.search.without(best, cause)
        return {"effect": cause.name, "site": cause.site, "parameters": parameters, "was": was,
                "gain_percent": 100.0 * max(verdict.cut(without, best).values())}

    def _likeness(self, parameter: str) -> float:
        """Return 1σ of the reference value in the bench population; 0 if the parameter has no band."""
        reference, fit = self.setting.reference, self.found.best.fit
        band = next((f for f in reference.nuisance if f.name == parameter and math.isfinite(f.sigma)), None)
        return 0.0 if band is None else reference.prior.expected(band, fit.free, fit.values)[1]

    def session(self) -> dict[str, Any] | None:
        """Return the differences from the reference trials of a rig of another kind, named or not; None on the bench.

        `as_identified`: RMSE by equation of the reference model without refitting. `shifts`: constants that differ
        significantly, with 95 % intervals from the fit's curvature.
        """
        if not self.setting.elsewhere:
            return None
        was, best = self.setting.reference.values, self.found.best
        named = {f.name for c in best.effects for f in c.frees}
        shifts = []
        for f in best.fit.free:
            at, half = best.fit.values[f.name], 1.96 * verdict.curvature_sigma(best, f.name)
            if f.name in RELATION_PARAMETERS and f.name not in named and 0.0 < half < abs(at - was[f.name]):
                shifts.append({"parameter": f.name, "was": was[f.name], "value": at, "low": at - half,
                               "high": at + half, "unit": RELATION_PARAMETERS[f.name].unit})
        return {"as_identified": {n: blocks.rmse(b.residual(was) for b in self.setting.blocks if b.relation.name == n)
                                  for n in self.setting.checked}, "shifts": shifts}

    def figures(self) -> dict[str, verdict.Figures]:
        """Return the figures of every equation; those that were not checked are marked."""
        lacking = blocks.allowed(self.holdout) if self.holdout else {}
        ahead = blocks.blocks_of(
            self.holdout, [n for n in self.setting.checked if not lacking[n]], self.setting.taut,
            self.setting.rate_hz) if lacking else []
        ahead = self.setting.learnt.weighed(ahead).blocks if self.setting.learnt is not None else ahead
        return {name: self._figures(name, ahead) for name in RELATIONS}

    def _figures(self, name: str, ahead: Sequence[Block]) -> verdict.Figures:
        unit = RELATIONS[name].unit
        if name not in self.setting.checked:
            return verdict.Figures(unit, False)
        before, after = self.found.baseline.unseen, self.found.best.unseen
        gain, low, high = verdict.gain(before, after, name)
        mine = [b for b in ahead if b.relation.name == name and b.keep.size]
        held, mended = (blocks.rmse(b.residual(m.fit.values) for b in mine) if mine else None
                        for m in (self.found.baseline, self.found.best))
        floor = self.setting.floors[name] if self.setting.floors else None
        return verdict.Figures(unit, True, floor, before.rmse(name), after.rmse(name), held, mended, gain, low, high)

    def limits(self) -> dict[str, Mapping[str, Any]] | None:
        """Return the smallest size of each effect that these data could detect; None on a rig of another kind."""
        if self.setting.any_rig or self.setting.elsewhere:
            return None
        from diagnosis.judgement.plan import sight

        named = {f.name: self._size(f.name) for c in (() if self._strange() else self.found.best.effects)
                 for f in c.frees}
        # the detection limit of a named effect is at most its size
        told: dict[str, Mapping[str, Any]] = {}
        for limit in sight(self.setting, self.found.baseline.fit):
            size = limit.size
            if size is not None and limit.parameter in named:
                size = min(size, named[limit.parameter])
            told[limit.effect] = {"parameter": limit.parameter, "value": size, "unit": limit.unit}
        return told

    def _size(self, parameter: str) -> float:
        """Return the size of a named parameter: its change, or its reported departure from the neutral value if
        smaller."""
        at, declared = self.found.best.fit.values[parameter], self.setting.declared[parameter]
        change = abs(at - self.setting.reference.values[parameter])
        neutral = PARAMETERS[parameter].neutral
        told = at + declared - self.setting.reference.values[parameter]
        return change if neutral is None else min(change, abs(told - neutral))

    def on_bounds(self) -> list[str]:
        """Return, as sentences, the chosen effects' parameters that rest on a bound: these are not measurements."""
        if self._strange():
            return []
        values = self.found.best.fit.values
        return [f"{c.name}: {name} stands on its bound, {values[name]:.4g}; it is not measured."
                for c in self.found.best.effects for name in c.on_bound(values)]


def of_experiment(block: Block) -> bool:
    """Whether a block is of an experiment, not of a gait trial."""
    return not block.signals.has("gait_percent")


def _inside(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
