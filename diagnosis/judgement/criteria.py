"""Selection criteria of the effect search: accepting an effect, searching for a further one, reporting a lack of fit.

The thresholds are those of `verdict`. A criterion compares models on held-out cycles within one setting, and fits
nothing except through the search.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from diagnosis.judgement import verdict
from diagnosis.problem.candidates import Candidate
from diagnosis.problem.healthy_reference import BAND
from diagnosis.problem.problem import ProblemSetting
from diagnosis.search.search import FittedEffects, Search
from physics.effects.catalogue import CATALOGUE
from physics.effects.effect import Effect
from physics.parameters import PARAMETERS


@dataclass(frozen=True)
class SearchCriteria:
    """Selection criteria of one setting.

    `splits`: only an ambiguity set found elsewhere is split, on data without a reference RMSE.
    """

    setting: ProblemSetting
    splits: bool = False

    def pays(self, lesser: FittedEffects, model: FittedEffects, search: Search) -> bool:
        """Whether `model` passes the selection test against `lesser`; both are models of `search`."""
        if self.splits:
            return True
        added = [c for c in model.effects if c not in lesser.effects]
        if not all(self.says(c, model, search) for c in added):
            return False
        if self.setting.any_rig:
            return self._likelier(lesser, model, search)
        # a held-out fall can be due to a poor local minimum in one fold; a fall on all cycles cannot
        relief = lesser.prior_penalty - model.prior_penalty
        least = verdict.STRAINED if self.setting.elsewhere else verdict.LEAST_FALL
        least_fall = least if relief >= least else verdict.least_fall(
            self.setting.structure, self.setting.elsewhere)
        fall = self._fall(lesser, model, added)
        if min(fall, 2.0 * (lesser.fit.cost - model.fit.cost)) < least_fall:
            return False
        if any(model.by_relation[n] - lesser.by_relation[n] > max(self.noise(n, lesser), verdict.MISMATCH * fall)
               for n in self.setting.checked):
            return False
        if model.prior_penalty > lesser.prior_penalty + verdict.STRAINED:
            return False
        if lesser.effects and any(c.unlikely(model.fit.values, verdict.STRETCHED) for c in added):
            return False
        if any(self._beyond(c, model) or self.stopped(c, model) for c in added):
            return False
        if relief >= least:
            # constants of a reference bench can fit nearly as well, but only in conflict with their prior
            return True
        kept = 1.0 - verdict.FURTHER_ELSEWHERE
        if self.setting.elsewhere and all(model.by_relation[n] > kept * lesser.by_relation[n]
                                          for n in self.setting.checked):
            return False
        noise = {n: self.setting.noise_squares(n) for n in self.setting.checked}
        cuts, base = verdict.cut(lesser, model, noise), search.baseline
        share_least = verdict.LEAST_FURTHER if lesser.effects else verdict.LEAST_GAIN
        return any(share >= share_least and lesser.by_relation[n] - model.by_relation[n]
                   >= verdict.MISMATCH * self._excess(base, n) for n, share in cuts.items())

    def _fall(self, lesser: FittedEffects, model: FittedEffects, added: Sequence[Candidate]) -> float:
        """Return the fall of the score in the equations that the effects `added` move (in all, if none was added).

        An improvement elsewhere (a servo loop, refitted from another start) is not credited to these effects.
        """
        own = frozenset().union(*(c.parameters for c in added))
        reached = dict.fromkeys(b.relation.name for b in self.setting.blocks if not own or b.uses & own)
        return lesser.prior_penalty - model.prior_penalty + sum(
            lesser.by_relation[n] - model.by_relation[n] for n in reached)

    def _likelier(self, lesser: FittedEffects, model: FittedEffects, search: Search) -> bool:
        """Whether a model passes without reference trials, as fitted or without a constant outside the catalogue.

        If such a constant (e.g. load-free friction) is not needed beside the effect, the effect is tested without it.
        An effect of the catalogue has priority over a constant that could absorb it.
        """
        if self._takes(lesser, model, search.baseline):
            return True
        units = {p.unit for c in model.effects if c not in lesser.effects for p in CATALOGUE[c.name].parameters}
        # a sensor's offset is as constant as such a parameter: neither replaces the other
        for name in self.setting.nameless if lesser.effects and units != {"N"} else ():
            bare = search.lacking(model, name)
            if not self._takes(bare, model, search.baseline) and self._takes(
                    search.lacking(lesser, name), bare, search.baseline):
                return True
        return False

    def _takes(self, lesser: FittedEffects, model: FittedEffects, base: FittedEffects) -> bool:
        """Whether a model is likelier than a lesser one in some equation, by the likelihood ratio n·ln(χ²₀/χ²₁).

        n: effective number of samples. A minimum share of χ² is required as well, because no rig follows a submodel
        exactly.
        """
        for n, share in verdict.cut(lesser, model).items():
            left, fall = model.by_relation[n], lesser.by_relation[n] - model.by_relation[n]
            least = max(verdict.MISMATCH_ELSEWHERE * base.by_relation[n],
                        verdict.FURTHER_ELSEWHERE * lesser.by_relation[n] if lesser.effects else 0.0)
            if left <= 0.0 or share < verdict.LEAST_GAIN_ELSEWHERE or fall < least:
                continue
            if self.setting.independent(n) * math.log(lesser.by_relation[n] / left) >= verdict.LEAST_RATIO:
                return True
        return False

    def noise(self, relation: str, model: FittedEffects) -> float:
        """Return by how much χ² of an equation may rise by chance: three standard deviations of χ²."""
        expected = self.setting.healthy_squares(relation) or model.by_relation[relation]
        return 3.0 * math.sqrt(2.0 * max(expected, 1.0))

    def says(self, effect: Candidate, model: FittedEffects, search: Search) -> bool:
        """Whether an effect of a model is detected: it differs from the reference, beyond its base coefficient."""
        return self.differs(effect, model) and self.leads(effect, model, search)

    def _beyond(self, effect: Candidate, model: FittedEffects) -> bool:
        """Whether a parameter changed by more than twice the largest departure from absence in the catalogue."""
        healthy = self.setting.reference.values
        for name, (low, high) in effect.likely.items():
            absent = PARAMETERS[name].neutral
            if name in effect.parameters and absent is not None:
                most = 2.0 * max(abs(low - absent), abs(high - absent))
                if abs(model.fit.values[name] - healthy[name]) > most:
                    return True
        return False

    def stopped(self, effect: Candidate, model: FittedEffects) -> bool:
        """Whether a bound limits the size of an effect: a need for a larger size than possible indicates another cause.

        Shape parameters may rest on a bound. The test applies only to a rig of another kind with reference trials.
        Against an ideal transmission no other cause can be named; on the bench, systematic error drives parameters to
        bounds (0034).
        """
        shapes = _shapes(CATALOGUE[effect.name])
        return self.setting.elsewhere and any(name not in shapes for name in effect.on_bound(model.fit.values))

    def differs(self, effect: Candidate, model: FittedEffects) -> bool:
        """Whether a parameter of an effect lies outside the population's band; inside the band no effect is reported.

        The band is conditional on the other constants of the model. An effect that is freed with its base coefficient,
        or that has no band in the reference condition, must also differ significantly from its reference value.
        """
        at, healthy = model.fit.values, self.setting.reference.values
        bands = {f.name: f for f in self.setting.reference.nuisance if math.isfinite(f.sigma)}
        together = not self.setting.any_rig and not effect.level and any(f.name in bands for f in effect.frees)
        if not together and not any(abs(at[f.name] - healthy[f.name])
                                    > verdict.CERTAIN * verdict.curvature_sigma(model, f.name) for f in effect.frees):
            return False
        outside = [f.name for f in effect.frees if f.name not in bands
                   or not self.setting.reference.within(bands[f.name], model.fit.free, model.fit.values)]
        if self.setting.any_rig or self.setting.elsewhere:
            return bool(outside) or (effect.counted is not None and self.setting.reference.prior.squares(
                {f.name: at[f.name] - healthy[f.name] for f in effect.frees}) > BAND**2)
        absences = {p.name: p.neutral for p in CATALOGUE[effect.name].parameters}
        shapes = _shapes(CATALOGUE[effect.name])
        changes = {n: model.fit.values[n] - self.setting.reference.values[n] for n in outside if n not in shapes}
        # a parameter without neutral value (friction, stiffness) is judged by its band or its catalogue scale
        return any(verdict.material(CATALOGUE[effect.name], n, c) if absences[n] is not None else
                   n in bands or abs(c) >= verdict.MATERIAL * scale for n, c in changes.items()
                   for scale in (next(f.scale for f in effect.frees if f.name == n),))

    def leads(self, effect: Candidate, model: FittedEffects, search: Search) -> bool:
        """Whether an effect is needed beyond its base coefficient, which is freed with it.

        A base coefficient holds at one load, bend or time. Within the range of the effect it may be off by the share
        that the effect changes it by. If it has moved further, the effect must reduce χ² by at least as much as the
        base coefficient does.
        """
        values, healthy = model.fit.values, self.setting.reference.values
        change = max((abs(values[f.name] - healthy[f.name]) for f in effect.frees), default=0.0)
        named = {f.name for c in model.effects for f in c.frees}
        bands = [f for f in self.setting.reference.nuisance if f.name in effect.level and f.name not in named]
        if self.setting.elsewhere and bands:
            level = search.level_alone(model, effect)
            kept = 1.0 - verdict.FURTHER_ELSEWHERE
            return all(self.setting.reference.within(f, model.fit.free, values) for f in bands) or any(
                model.by_relation[n] <= kept * level.by_relation[n] for n in self.setting.checked)
        if all(max(values[f.name] - f.high, f.low - values[f.name]) <= change * abs(healthy[f.name]) for f in bands):
            return True
        if self.setting.any_rig:
            return False
        level, lesser = search.level_alone(model, effect), search.without(model, effect)
        law = 2.0 * (level.fit.cost - model.fit.cost)
        return law >= verdict.LEAST_FALL and law >= lesser.fit.cost - model.fit.cost

    def can_improve(self, model: FittedEffects) -> bool:
        """Whether a further effect may be detected: the χ² exceeds the reference, or the prior penalty is too large.

        An effect may lie entirely within the bands of the reference condition. A second one is searched if the first
        still has a prior penalty beyond chance. Without reference trials the answer is always yes.
        """
        if self.setting.floors is None or self.splits or self._strained(model) or (
                not model.effects and model.prior_penalty > verdict.STRAINED):
            return True
        return any(self._excess(model, n) > verdict.OPEN * self.setting.structure_squares(n)
                   + self.noise(n, model) for n in self.setting.checked)

    def has_unexplained_residual(self, model: FittedEffects, baseline: FittedEffects) -> bool:
        """Whether a model has a lack of fit; this requires reference trials."""
        if self.setting.floors is None or self.splits:
            return False
        checked = self.setting.checked
        rise = self._rise(model, [n for n in checked if self._excess(model, n) >= verdict.STRANGE_FALL])
        left, whole = (sum(self._excess(m, n) for n in checked) for m in (model, baseline))
        if rise <= verdict.STRANGE - 1.0:
            return False
        if not model.effects:
            return True
        return left > verdict.STRANGE_SHARE * whole and rise * left > verdict.STRANGE_NAMED * whole

    def needs_full_search(self, model: FittedEffects, baseline: FittedEffects) -> bool:
        """Whether all effects must be fitted because the foremost ones fail; this requires reference trials."""
        if self.setting.floors is None or self.splits:
            return False
        return self.has_unexplained_residual(model, baseline) or (not model.effects and (
            self._rise(model, self.setting.checked) > verdict.WANTING - 1.0 or self._strained(model, verdict.TWICE)))

    def needs_pairs(self, baseline: FittedEffects) -> bool:
        """Whether pairs of effects must be tried, as two may pass only together: the baseline has a lack of fit.

        On a rig of another kind without reference trials every departure from the ideal is an effect, and any two may
        mask each other.
        """
        return not self.splits and (self.setting.any_rig or self.has_unexplained_residual(baseline, baseline))

    def _strained(self, model: FittedEffects, deviations: float = verdict.THRICE) -> bool:
        """Whether the prior penalty of a model exceeds its mean by more than `deviations` standard deviations of χ²."""
        count = sum(math.isfinite(f.sigma) for f in model.fit.free)
        return model.prior_penalty > count + deviations * math.sqrt(2.0 * count)

    def _rise(self, model: FittedEffects, relations: Sequence[str]) -> float:
        """Return the largest RMSE of the `relations`, in units of its reference RMSE, less 1; −1 without relations."""
        floors = self.setting.floors or {}
        return max((self.setting.rmse(n, model.by_relation[n]) / floors[n] for n in relations), default=0.0) - 1.0

    def _excess(self, model: FittedEffects, relation: str) -> float:
        return max(model.by_relation[relation] - self.setting.healthy_squares(relation), 0.0)


def _shapes(effect: Effect) -> set[str]:
    """Return the shape parameters of an effect whose size is another parameter.

    Examples: the speed of a breakaway, the phase of a drum. They have no neutral value, and no spread in the bench
    population.
    """
    if all(p.neutral is None for p in effect.parameters):
        return set()
    return {p.name for p in effect.parameters if p.neutral is None and not PARAMETERS[p.name].like_benches}
