"""Adds, pairs, swaps and deletions of effects, judged on cycles that the fit has not seen.

The rule of this file: effects mask each other, so no effect is dropped for what it gains alone: the best few
models are carried on together, each is offered every effect again, and what no longer pays is taken out.
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
"""Share of the score that a parameter must take away to come before a simpler model, where nothing says its scatter."""
UNLIKELY: Final = 0.02
"""The same for a value outside the range where the catalogue expects it; elsewhere twice a parameter's price."""
LATER_REFITS: Final = 4
WORTH_POLISHING: Final = 2.0
"""Cost of a fit, of the chosen one's, from which it is no rival however it is carried on."""
LEVEL: Final = 4.0
"""How much wider than among like benches the level of a law is when the law is an effect."""


@dataclass(frozen=True)
class FittedEffects:
    """A set of effects fitted together, to `problem`, and what it leaves on the cycles of `folds` when refitted.

    `price`: χ² that a parameter costs; None: a share of the score, on a rig of which no scatter is known.
    """

    effects: tuple[Candidate, ...]
    fit: Fit
    problem: Problem = field(repr=False)
    folds: Sequence[frozenset[int]] = field(repr=False)
    price: float | None = None

    @cached_property
    def unseen(self) -> CycleSquares:
        """Squares on cycles that a fit has not seen: expensive, so computed only for models that may be chosen."""
        return unseen(self.problem, self.folds, self.fit)

    @cached_property
    def by_relation(self) -> Mapping[str, float]:
        """χ² of the same."""
        return self.unseen.chi_square(self.problem.weights)

    @property
    def score(self) -> float:
        return sum(self.by_relation.values()) + self.prior_penalty

    @property
    def prior_penalty(self) -> float:
        """Return what the nuisance pays for standing away from what is known of it."""
        return self.fit.penalty

    @property
    def rank(self) -> float:
        return self._priced(self.score)

    @property
    def fit_score(self) -> float:
        """Return the rank as far as the fit alone says it."""
        return self._priced(2.0 * self.fit.cost)

    def _priced(self, score: float) -> float:
        """Return a score with what each parameter costs that the model took, and each where it is not expected."""
        cost = sum(PARAMETER * (c.counted or len(c.frees)) + UNLIKELY * c.unlikely(self.fit.values)
                   for c in self.effects)
        return score * (1.0 + cost) if self.price is None else score + self.price / PARAMETER * cost

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(c.name for c in self.effects))


class Criteria(Protocol):
    """What leads a search."""

    def pays(self, lesser: FittedEffects, model: FittedEffects, search: Search) -> bool:
        """Whether `model` is worth what it has more than `lesser`; both are models of `search`."""

    def stopped(self, effect: Candidate, model: FittedEffects) -> bool:
        """Whether a bound has stopped an effect's size, so that it explains nothing."""

    def can_improve(self, model: FittedEffects) -> bool:
        """Whether a model leaves something that a further effect could take away."""

    def needs_full_search(self, model: FittedEffects, baseline: FittedEffects) -> bool:
        """Whether the foremost effects left so much that all have to be fitted."""

    def needs_pairs(self, baseline: FittedEffects) -> bool:
        """Whether, where no effect pays by itself, two may that only pay together."""


@dataclass(frozen=True)
class SearchResult:
    """The baseline, the chosen model, and every model that was fitted in full, best first."""

    baseline: FittedEffects
    best: FittedEffects
    models: tuple[FittedEffects, ...]

    def model(self, names: Sequence[str]) -> FittedEffects | None:
        """Return the model of exactly the effects `names`, if it was fitted."""
        wanted = tuple(sorted(names))
        return next((m for m in self.models if m.names == wanted), None)


class Search:
    """One search over one problem.

    `near`: effects are small enough for slopes to outlive one more of them.  `scatter`: the laws' scatter is known on
    these data, so that χ² is one.  `blind`: effects that are fitted in a chosen one's place, and never chosen.
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
        """The best fit without any effect."""
        return self.tried[()]

    def free_of(self, effects: Sequence[Candidate]) -> tuple[Free, ...]:
        """Return what a model of `effects` may move: their parameters in their bounds, other nuisance in bands."""
        level = {name for c in effects for name in c.level}
        own = {f.name: replace(f, sigma=f.scale) if f.name in c.level else f for c in effects for f in c.frees}
        return tuple(_released(f) if f.name in level else f for f in self.nuisance if f.name not in own) + tuple(
            own.values())

    @cached_property
    def origin(self) -> Fit:
        """What the residuals do where the search starts, no effect at work."""
        return solve(self.problem, self.start, self.nuisance, max_steps=0)

    def model(self, effects: Sequence[Candidate], start: Values, near: Fit | None = None, thorough: bool = True
              ) -> FittedEffects:
        """Fit `effects` from `start`, `near` a fit; keep it when it beats the same effects from elsewhere."""
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
        """Return the model of these effects, its fit carried on to where slopes taken there say that it has arrived."""
        if model.names not in self.arrived:
            self.model(model.effects, model.fit.values, model.fit)
            self.arrived.add(model.names)
        return self.tried[model.names]

    def grow(self, model: FittedEffects, most: int, among: Sequence[Candidate] | None = None) -> list[FittedEffects]:
        """Offer `model` every effect it lacks (of those `among`); fit in full the `most` promising by the screen.

        Screened in turns by slopes at the model's fit and at the healthy constants: where what is lacking has bent
        the fit, slopes there point elsewhere.
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
        """Return what the residuals do with a model's effects at work and the nuisance where the search started."""
        if not model.effects:
            return self.origin
        kept = {f.name: model.fit.values[f.name] for c in model.effects for f in c.frees}
        return solve(self.problem, {**self.start, **kept}, self.free_of(model.effects), max_steps=0)

    def grow_all(self, model: FittedEffects) -> list[FittedEffects]:
        """Fit `model` with each effect it lacks, from every start."""
        offered = [c for c in self.offered if c.name not in model.names]
        return [self._grown(model, c, s) for c in offered for s in range(len(c.starts))]

    def _grown(self, model: FittedEffects, candidate: Candidate, start: int) -> FittedEffects:
        step = (model.names, candidate.name, start)
        if step not in self.grown:
            self.grown.add(step)
            begun = candidate.starts[start] if start >= 0 else {}
            effects = (*model.effects, candidate)
            self.model(effects, {**model.fit.values, **begun}, model.fit, not self.near)
            # what the nuisance did in the effect's place is a way into another minimum
            kept = {f.name: model.fit.values[f.name] for c in model.effects for f in c.frees}
            self.model(effects, {**self.start, **kept, **begun}, self.origin if self.near else None, not self.near)
        return self.tried[tuple(sorted((*model.names, candidate.name)))]

    def _from_all_starts(self, model: FittedEffects) -> FittedEffects:
        """Return a grown model with its last effect fitted from each of its starts: a law may have several minima."""
        *rest, last = model.effects
        lesser = self.tried[tuple(sorted(c.name for c in rest))]
        for start in range(len(last.starts) if self.near else 0):
            self._grown(lesser, last, start)
        return self.tried[model.names]

    def prune(self, model: FittedEffects) -> FittedEffects:
        """Take out, one by one, the effects that do not pay for themselves, the least first."""
        while model.effects:
            stopped = [c for c in model.effects if self.criteria.stopped(c, model)]
            lesser = [self.without(model, out) for out in stopped or model.effects]
            best = min(lesser, key=lambda m: m.score)
            if not stopped and self.criteria.pays(best, model, self):
                break
            model = best
        return model

    def without(self, model: FittedEffects, out: Candidate) -> FittedEffects:
        """Return `model` less one effect, fitted anew from there: in its place the rest may be in another minimum."""
        left = [c for c in model.effects if c is not out]
        back = {f.name: self.baseline.fit.values[f.name] for f in out.frees}
        return self.model(left, {**model.fit.values, **back}, model.fit)

    def level_alone(self, model: FittedEffects, law: Candidate) -> FittedEffects:
        """Return `model` with a law as it is on a healthy bench and its level free, fitted anew; it is no candidate."""
        key = (model.names, law.name)
        if key not in self.lacks:
            own = law.parameters - set(law.level)
            free = tuple(f for f in self.free_of(model.effects) if f.name not in own)
            back = {name: self.start[name] for name in own}
            fit = solve(self.problem, {**model.fit.values, **back}, free, known=model.fit, thorough=True)
            self.lacks[key] = FittedEffects(model.effects, fit, self.problem, self.folds, self.price)
        return self.lacks[key]

    def lacking(self, model: FittedEffects, constant: str) -> FittedEffects:
        """Return `model` with one constant of the nuisance absent instead of free, fitted anew; it is no candidate."""
        key = (model.names, constant)
        if key not in self.lacks:
            free = tuple(f for f in self.free_of(model.effects) if f.name != constant)
            fit = solve(self.problem, {**model.fit.values, constant: RELATION_PARAMETERS[constant].in_ideal}, free,
                        thorough=True)
            self.lacks[key] = FittedEffects(model.effects, fit, self.problem, self.folds, self.price)
        return self.lacks[key]

    def _ahead(self, grown: Iterable[FittedEffects], best: FittedEffects) -> tuple[FittedEffects, list[FittedEffects]]:
        """Return the best of the `grown` models, pruned (`best` where there are none), and the next level."""
        foremost = sorted((self.polished(self._from_all_starts(m)) for m in _foremost(
            {m.names: m for m in grown}.values())), key=lambda m: m.rank)
        return self._best_pruned(foremost) if foremost else best, foremost

    def _best_pruned(self, models: Iterable[FittedEffects]) -> FittedEffects:
        """Return the best of `models` with what does not pay taken out: what one of them lacks may hide the others."""
        best: FittedEffects | None = None
        for model in sorted(models, key=lambda m: m.rank):
            if best is not None and best.rank <= model.rank:
                break
            pruned = self.prune(self.polished(model))
            best = pruned if best is None or pruned.rank < best.rank else best
        assert best is not None
        return best

    def _ordered(self, model: FittedEffects) -> FittedEffects:
        """Return `model` with the effect first whose absence would leave most."""
        left = {c.name: self.without(model, c).score for c in model.effects}
        return replace(model, effects=tuple(sorted(model.effects, key=lambda c: -left[c.name])))

    def _first(self, most: int) -> FittedEffects:
        """Return the best, pruned, of all models of at most so many effects that were fitted on the way."""
        lengths = range(most + 1)
        return self._best_pruned(m for k in lengths for m in _foremost(
            m for m in self.tried.values() if len(m.effects) == k))

    def run(self, most: int) -> SearchResult:
        """Search to `most` effects; a level is opened only while something is left and the one before has paid.

        Where no effect pays by itself, pairs are tried, once: each must pay beside the other, and both together.

        Where the foremost effects leave structure, all are fitted: a screen by slopes can miss one.

        At the end the place of each chosen effect is offered to those that look like it, of two also to the foremost
        of the others, so that its rivals are known.
        """
        level, best, paired = [self.baseline], self.baseline, False
        for depth in range(most):
            if not self.criteria.can_improve(best):
                break
            # the screen ranks by residuals and does not see what the prior pays for several parts that move together
            whole = [] if depth else [self._grown(best, c, -1) for c in self.offered if c.counted is not None]
            ahead, grown = self._ahead(itertools.chain((m for model in level for m in self.grow(
                model, LATER_REFITS if depth else FIRST_REFITS)), whole), best)
            if depth == 0 and self.criteria.needs_full_search(ahead, self.baseline):
                ahead, grown = self._ahead(self.grow_all(self.baseline), best)
            level, more = grown, len(ahead.effects) > len(best.effects) and ahead.rank < best.rank
            if not more and depth + 1 < most and not paired and self.criteria.needs_pairs(best):
                # two effects that hide each other (inertia and drag of a run-up) show nothing one by one
                paired = True
                continue
            if not more:
                break
            # it pays: what did not was taken out, beside what fits on the way had made of the lesser models
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
    """Return a band made wide for the level of a law that is said about another load, bend or time."""
    wide = LEVEL * f.sigma
    return replace(f, low=max(min(f.low, 0.0), f.mean - 3.0 * wide), high=f.mean + 3.0 * wide, sigma=wide)


def _foremost(models: Iterable[FittedEffects]) -> list[FittedEffects]:
    """Return the few of the best fit score, best first."""
    return sorted(models, key=lambda m: m.fit_score)[:BEAM]
