"""Search for effects by adding, pairing, swapping and deleting them, judged on held-out cycles.

Effects mask each other, so that no effect is dropped for its gain alone. The best few models continue together, and
each is offered every effect again. Effects that no longer pass the selection test are removed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Protocol

from diagnosis.problem.candidates import Candidate
from diagnosis.problem.cross_validation import CycleSquares, unseen
from diagnosis.problem.fit import ENOUGH, ROUGHLY, Fit, Problem, solve
from diagnosis.problem.loops import settled
from diagnosis.problem.prior import Free
from diagnosis.problem.screen import promises
from physics.parameters import RELATION_PARAMETERS

Values = Mapping[str, float]

BEAM: Final = 4
FIRST_REFITS: Final = 8
PARAMETER: Final = 0.01
"""Share of the score by which each further parameter must reduce it, on data without known scatter."""
UNLIKELY: Final = 0.02
"""Share of the score charged for a value outside its expected range; with known scatter, twice a parameter's price."""
LATER_REFITS: Final = 4
WORTH_POLISHING: Final = 2.0
"""Cost ratio to the chosen fit above which a fit is not continued: it cannot become a competing hypothesis."""
LEVEL: Final = 4.0
"""Factor on the population's band of a base coefficient while its effect is fitted."""


@dataclass(frozen=True)
class FittedEffects:
    """Effects fitted together to `problem`, and their residuals on held-out cycles of the `folds`.

    `price`: χ² charged for a parameter; None for a share of the score, on a rig without known scatter.
    """

    effects: tuple[Candidate, ...]
    fit: Fit
    problem: Problem = field(repr=False)
    folds: Sequence[frozenset[int]] = field(repr=False)
    price: float | None = None

    @cached_property
    def unseen(self) -> CycleSquares:
        """Squared residuals of held-out cycles; expensive, so computed only for models that may be chosen."""
        return unseen(self.problem, self.folds, self.fit)

    @cached_property
    def by_relation(self) -> Mapping[str, float]:
        """Held-out χ² by equation."""
        return self.unseen.chi_square(self.problem.weights)

    @property
    def score(self) -> float:
        return sum(self.by_relation.values()) + self.prior_penalty

    @property
    def prior_penalty(self) -> float:
        """Return the prior penalty of the nuisance parameters, χ²."""
        return self.fit.penalty

    @property
    def rank(self) -> float:
        return self._priced(self.score)

    @property
    def fit_score(self) -> float:
        """Return the rank from the fit alone, without held-out cycles."""
        return self._priced(2.0 * self.fit.cost)

    def _priced(self, score: float) -> float:
        """Return a score plus the charge for each parameter of the effects and for each unexpected value."""
        cost = sum(PARAMETER * (c.counted or len(c.frees)) + UNLIKELY * c.unlikely(self.fit.values)
                   for c in self.effects)
        return score * (1.0 + cost) if self.price is None else score + self.price / PARAMETER * cost

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(c.name for c in self.effects))


class Criteria(Protocol):
    """Selection criteria of a search."""

    def pays(self, lesser: FittedEffects, model: FittedEffects, search: Search) -> bool:
        """Whether `model` passes the selection test against `lesser`; both are models of `search`."""

    def stopped(self, effect: Candidate, model: FittedEffects) -> bool:
        """Whether a bound limits an effect's size, so that it explains nothing."""

    def can_improve(self, model: FittedEffects) -> bool:
        """Whether a further effect could reduce the residual of a model."""

    def needs_full_search(self, model: FittedEffects, baseline: FittedEffects) -> bool:
        """Whether the residual of the foremost effects is so large that all must be fitted."""

    def needs_pairs(self, baseline: FittedEffects) -> bool:
        """Whether pairs must be tried because no single effect passes the selection test."""


@dataclass(frozen=True)
class SearchResult:
    """The baseline, the chosen model, and every model that was fitted in full, best first."""

    baseline: FittedEffects
    best: FittedEffects
    models: tuple[FittedEffects, ...]

    def model(self, names: Sequence[str]) -> FittedEffects | None:
        """Return the model of exactly the effects `names`; None if it was not fitted."""
        wanted = tuple(sorted(names))
        return next((m for m in self.models if m.names == wanted), None)


class Search:
    """One search over one problem.

    `near`: effects are small enough for slopes to stay valid with one more of them. `scatter`: the weights are known on
    these data, so that χ² is absolute. `blind`: effects that are fitted in place of a chosen one, and never chosen.
    """

    def __init__(self, problem: Problem, start: Values, nuisance: Sequence[Free], offered: Sequence[Candidate],
                 folds: Sequence[frozenset[int]], criteria: Criteria, near: bool = True,
                 scatter: bool = True, blind: Sequence[Candidate] = ()) -> None:
        self.problem, self.nuisance, self.offered, self.folds = problem, tuple(nuisance), offered, folds
        self.blind = blind
        self.criteria, self.near = criteria, near
        # Schwarz 1978: half the logarithm of the samples in the logarithm of the likelihood
        self.price = math.log(max(sum(b.keep.size for b in problem.blocks), 2)) if near and scatter else None
        self.start = {**start, **(settled(problem, start, nuisance, corners=False) if near else {})}
        self.tried: dict[tuple[str, ...], FittedEffects] = {}
        self.grown: set[tuple[tuple[str, ...], str, int]] = set()
        self.arrived: set[tuple[str, ...]] = set()
        self.lacks: dict[tuple[tuple[str, ...], str], FittedEffects] = {}
        self.model((), self.start)

    @property
    def baseline(self) -> FittedEffects:
        """Best fit without any effect."""
        return self.tried[()]

    def free_of(self, effects: Sequence[Candidate]) -> tuple[Free, ...]:
        """Return the free parameters of a model of `effects`: these in their bounds, the nuisance in bands."""
        level = {name for c in effects for name in c.level}
        own = {f.name: replace(f, sigma=f.scale) if f.name in c.level else f for c in effects for f in c.frees}
        return tuple(_released(f) if f.name in level else f for f in self.nuisance if f.name not in own) + tuple(
            own.values())

    @cached_property
    def origin(self) -> Fit:
        """Residuals and slopes at the start of the search, without any effect."""
        return solve(self.problem, self.start, self.nuisance, max_steps=0)

    def model(self, effects: Sequence[Candidate], start: Values, near: Fit | None = None, thorough: bool = True
              ) -> FittedEffects:
        """Fit `effects` from `start`, `near` a fit; keep the result if it has the lowest cost for these effects."""
        known_fit = near if self.near else None
        fit = solve(self.problem, start, self.free_of(effects), known=known_fit, thorough=thorough,
                    enough=ENOUGH if thorough else ROUGHLY)
        names = tuple(sorted(c.name for c in effects))
        known = self.tried.get(names)
        if known is None or fit.cost < known.fit.cost:
            self.tried[names] = FittedEffects(tuple(effects), fit, self.problem, self.folds, self.price)
            (self.arrived.add if thorough else self.arrived.discard)(names)
        return self.tried[names]

    def polished(self, model: FittedEffects) -> FittedEffects:
        """Return the model of these effects, its fit continued until slopes at the final point confirm convergence."""
        if model.names not in self.arrived:
            self.model(model.effects, model.fit.values, model.fit)
            self.arrived.add(model.names)
        return self.tried[model.names]

    def grow(self, model: FittedEffects, most: int, among: Sequence[Candidate] | None = None) -> list[FittedEffects]:
        """Screen every effect that `model` lacks (of those `among`), and fit the `most` promising ones in full.

        Screening alternates between slopes at the model's fit and at the reference constants. If the fit has absorbed a
        missing effect, its own slopes are misleading.
        """
        offered = [c for c in (self.offered if among is None else among) if c.name not in model.names]
        screened = [promises(self.problem, fit, self.folds, offered) for fit in (
            model.fit, *([self._unbent(model)] if self.near else []))]
        chosen: dict[int, int] = {}
        for _, c, s in itertools.chain.from_iterable(zip(*screened, strict=True)):
            if len(chosen) == most:
                break
            chosen.setdefault(c, s)
        return [self._grown(model, offered[c], s) for c, s in chosen.items()]

    def _unbent(self, model: FittedEffects) -> Fit:
        """Return residuals and slopes with a model's effects present and nuisance parameters as at the start."""
        if not model.effects:
            return self.origin
        kept = {f.name: model.fit.values[f.name] for c in model.effects for f in c.frees}
        return solve(self.problem, {**self.start, **kept}, self.free_of(model.effects), max_steps=0)

    def grow_all(self, model: FittedEffects) -> list[FittedEffects]:
        """Fit `model` with each effect that it lacks, from every starting point."""
        offered = [c for c in self.offered if c.name not in model.names]
        return [self._grown(model, c, s) for c in offered for s in range(len(c.starts))]

    def _grown(self, model: FittedEffects, candidate: Candidate, start: int) -> FittedEffects:
        step = (model.names, candidate.name, start)
        if step not in self.grown:
            self.grown.add(step)
            begun = candidate.starts[start] if start >= 0 else {}
            effects = (*model.effects, candidate)
            self.model(effects, {**model.fit.values, **begun}, model.fit, not self.near)
            # nuisance constants that absorbed the effect can hide another minimum: start again from the reference
            kept = {f.name: model.fit.values[f.name] for c in model.effects for f in c.frees}
            self.model(effects, {**self.start, **kept, **begun}, self.origin if self.near else None, not self.near)
        return self.tried[tuple(sorted((*model.names, candidate.name)))]

    def _from_all_starts(self, model: FittedEffects) -> FittedEffects:
        """Return a grown model, its last effect fitted from all starts because it may have several minima."""
        *rest, last = model.effects
        lesser = self.tried[tuple(sorted(c.name for c in rest))]
        for start in range(len(last.starts) if self.near else 0):
            self._grown(lesser, last, start)
        return self.tried[model.names]

    def prune(self, model: FittedEffects) -> FittedEffects:
        """Return `model` after removing, one by one, the effects that fail the selection test, the weakest first."""
        while model.effects:
            stopped = [c for c in model.effects if self.criteria.stopped(c, model)]
            lesser = [self.without(model, out) for out in stopped or model.effects]
            best = min(lesser, key=lambda m: m.score)
            if not stopped and self.criteria.pays(best, model, self):
                break
            model = best
        return model

    def without(self, model: FittedEffects, out: Candidate) -> FittedEffects:
        """Return `model` without one effect, refitted: the other effects may then be in another minimum."""
        left = [c for c in model.effects if c is not out]
        back = {f.name: self.baseline.fit.values[f.name] for f in out.frees}
        return self.model(left, {**model.fit.values, **back}, model.fit)

    def level_alone(self, model: FittedEffects, law: Candidate) -> FittedEffects:
        """Return `model` with an effect absent and its base coefficient free, refitted; the result is no candidate."""
        key = (model.names, law.name)
        if key not in self.lacks:
            own = law.parameters - set(law.level)
            free = tuple(f for f in self.free_of(model.effects) if f.name not in own)
            back = {name: self.start[name] for name in own}
            fit = solve(self.problem, {**model.fit.values, **back}, free, known=model.fit, thorough=True)
            self.lacks[key] = FittedEffects(model.effects, fit, self.problem, self.folds, self.price)
        return self.lacks[key]

    def lacking(self, model: FittedEffects, constant: str) -> FittedEffects:
        """Return `model` with one nuisance constant absent instead of free, refitted; the result is no candidate."""
        key = (model.names, constant)
        if key not in self.lacks:
            free = tuple(f for f in self.free_of(model.effects) if f.name != constant)
            fit = solve(self.problem, {**model.fit.values, constant: RELATION_PARAMETERS[constant].in_ideal}, free,
                        thorough=True)
            self.lacks[key] = FittedEffects(model.effects, fit, self.problem, self.folds, self.price)
        return self.lacks[key]

    def _ahead(self, grown: Iterable[FittedEffects], best: FittedEffects) -> tuple[FittedEffects, list[FittedEffects]]:
        """Return the best of the `grown` models, pruned (`best` if `grown` is empty), and the next level."""
        foremost = sorted((self.polished(self._from_all_starts(m)) for m in _foremost(
            {m.names: m for m in grown}.values())), key=lambda m: m.rank)
        return self._best_pruned(foremost) if foremost else best, foremost

    def _best_pruned(self, models: Iterable[FittedEffects]) -> FittedEffects:
        """Return the best of `models` after removing effects that fail: one weak effect may mask the others."""
        best: FittedEffects | None = None
        for model in sorted(models, key=lambda m: m.rank):
            if best is not None and best.rank <= model.rank:
                break
            pruned = self.prune(self.polished(model))
            best = pruned if best is None or pruned.rank < best.rank else best
        assert best is not None
        return best

    def _ordered(self, model: FittedEffects) -> FittedEffects:
        """Return `model` with its effects ordered by the score without each, the largest first."""
        left = {c.name: self.without(model, c).score for c in model.effects}
        return replace(model, effects=tuple(sorted(model.effects, key=lambda c: -left[c.name])))

    def _first(self, most: int) -> FittedEffects:
        """Return the best, pruned, of all fitted models with at most `most` effects."""
        lengths = range(most + 1)
        return self._best_pruned(m for k in lengths for m in _foremost(
            m for m in self.tried.values() if len(m.effects) == k))

    def run(self, most: int) -> SearchResult:
        """Search up to `most` effects; a further level is opened only if the last one passed and a residual remains.

        If no single effect passes, pairs are tried once; each effect must pass beside the other, and both together.

        If the foremost effects have a lack of fit, all effects are fitted, because a screen by slopes can miss one.

        At the end, effects declared similar replace each chosen effect; beside two chosen ones also the foremost
        others. This gives the competing hypotheses.
        """
        level, best, paired = [self.baseline], self.baseline, False
        for depth in range(most):
            if not self.criteria.can_improve(best):
                break
            # the screen ranks by residuals and ignores the prior penalty of several parts that move together
            whole = [] if depth else [self._grown(best, c, -1) for c in self.offered if c.counted is not None]
            ahead, grown = self._ahead(itertools.chain((m for model in level for m in self.grow(
                model, LATER_REFITS if depth else FIRST_REFITS)), whole), best)
            if depth == 0 and self.criteria.needs_full_search(ahead, self.baseline):
                ahead, grown = self._ahead(self.grow_all(self.baseline), best)
            level, more = grown, len(ahead.effects) > len(best.effects) and ahead.rank < best.rank
            if not more and depth + 1 < most and not paired and self.criteria.needs_pairs(best):
                # two effects that mask each other (inertia and drag of a run-up) cannot be detected one by one
                paired = True
                continue
            if not more:
                break
            # the pruned model passes the selection test against the lesser models as refitted meanwhile
            best = ahead
        for out in best.effects:
            left = self.without(best, out)
            if len(best.effects) > 1:
                self.grow(left, FIRST_REFITS)
            for c in self.offered if self.near else ():
                if c.name in out.rivals and c.name not in best.names:
                    self._from_all_starts(self._grown(left, c, 0))
        best = self._ordered(self._first(len(best.effects))) if best.effects else self.baseline
        for out, blind in itertools.product(best.effects, self.blind):
            self._from_all_starts(self._grown(self.without(best, out), blind, 0))
        for near in [m for m in self.tried.values() if len(m.effects) == len(best.effects) > 0
                     and m.fit.cost < WORTH_POLISHING * best.fit.cost]:
            self.polished(near)
        return SearchResult(self.baseline, best, tuple(sorted(self.tried.values(), key=lambda m: m.fit_score)))


def _released(f: Free) -> Free:
    """Return a widened band of a base coefficient, whose effect describes it at another load, bend or time."""
    wide = LEVEL * f.sigma
    return replace(f, low=max(min(f.low, 0.0), f.mean - 3.0 * wide), high=f.mean + 3.0 * wide, sigma=wide)


def _foremost(models: Iterable[FittedEffects]) -> list[FittedEffects]:
    """Return the `BEAM` models of the best fit score, best first."""
    return sorted(models, key=lambda m: m.fit_score)[:BEAM]
