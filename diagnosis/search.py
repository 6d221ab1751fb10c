"""Adds, pairs, swaps and deletions of effects, judged on cycles that the fit has not seen.

The rule of this file: effects mask each other, so no effect is dropped for what it gains alone: the best few
models are carried on together, each is offered every effect again, and what no longer pays is taken out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from diagnosis.candidates import Candidate
from diagnosis.fit import Fit, Free, Problem, solve
from diagnosis.screen import Screen, promises

Values = Mapping[str, float]

BEAM: Final = 4
FIRST_REFITS: Final = 8
PARAMETER: Final = 0.01
"""Share of the score that a parameter must take away to come before a simpler model."""
UNLIKELY: Final = 0.02
"""The same for a value outside the range where the catalogue expects it."""
LATER_REFITS: Final = 4


@dataclass(frozen=True)
class Model:
    """A set of effects fitted together; `by_relation`: χ² on cycles that a fit has not seen."""

    effects: tuple[Candidate, ...]
    fit: Fit
    by_relation: Mapping[str, float]

    @property
    def score(self) -> float:
        return sum(self.by_relation.values())

    @property
    def rank(self) -> float:
        """Return the score, dearer for every parameter that it took and for each where it is not expected."""
        cost = sum(PARAMETER * len(c.frees) + UNLIKELY * c.unlikely(self.fit.values) for c in self.effects)
        return self.score * (1.0 + cost)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(c.name for c in self.effects))


Pays = Callable[[Model, Model], bool]
"""Whether the second model is worth what it has more than the first."""
Open = Callable[[Model], bool]
"""Whether a model leaves something that a further effect could take away."""


@dataclass(frozen=True)
class Found:
    """The baseline, the chosen model, and every model that was fitted in full, best first."""

    baseline: Model
    best: Model
    models: tuple[Model, ...]

    def model(self, names: Sequence[str]) -> Model | None:
        """Return the model of exactly the effects `names`, if it was fitted."""
        wanted = tuple(sorted(names))
        return next((m for m in self.models if m.names == wanted), None)


class Search:
    """One search over one problem; `near`: effects are small enough for slopes to outlive one more of them."""

    def __init__(self, problem: Problem, start: Values, nuisance: Sequence[Free], offered: Sequence[Candidate],
                 folds: Sequence[frozenset[int]], pays: Pays, leaves: Open, near: bool = True) -> None:
        self.problem, self.nuisance, self.offered, self.folds = problem, tuple(nuisance), offered, folds
        self.pays, self.leaves, self.near = pays, leaves, near
        self.tried: dict[tuple[str, ...], Model] = {}
        self.grown: set[tuple[tuple[str, ...], str, int]] = set()
        self.baseline = self.model((), start)

    def free_of(self, effects: Sequence[Candidate]) -> tuple[Free, ...]:
        """Return what a model of `effects` may move: their slots in their bounds, the other nuisance in its bands."""
        own = {f.name: f for c in effects for f in c.frees}
        return tuple(f for f in self.nuisance if f.name not in own) + tuple(own.values())

    def model(self, effects: Sequence[Candidate], start: Values, near: Model | None = None) -> Model:
        """Fit `effects` from `start`, `near` a model; keep it when it beats the same effects from elsewhere."""
        known_fit = near.fit if near is not None and self.near else None
        fit = solve(self.problem, start, self.free_of(effects), known=known_fit)
        made = Model(tuple(effects), fit, Screen(self.problem, fit, self.folds).unseen())
        known = self.tried.get(made.names)
        if known is None or made.fit.cost < known.fit.cost:
            self.tried[made.names] = made
        return self.tried[made.names]

    def grow(self, model: Model, most: int) -> list[Model]:
        """Offer `model` every effect it lacks; fit in full the `most` promising by the screen, once a model."""
        offered = [c for c in self.offered if c.name not in model.names]
        chosen: dict[int, int] = {}
        for fall, c, s in promises(self.problem, model.fit, self.folds, offered):
            if fall <= 0.0 or len(chosen) == most:
                break
            chosen.setdefault(c, s)
        return [self._grown(model, offered[c], s) for c, s in chosen.items()]

    def _grown(self, model: Model, candidate: Candidate, start: int) -> Model:
        step = (model.names, candidate.name, start)
        if step not in self.grown:
            self.grown.add(step)
            rest = {f.name: f.mean for f in self.nuisance} if self.near else {}
            held = {f.name: model.fit.values[f.name] for c in model.effects for f in c.frees}
            self.model((*model.effects, candidate), {
                **model.fit.values, **rest, **held, **candidate.starts[start]}, model)
        return self.tried[tuple(sorted((*model.names, candidate.name)))]

    def prune(self, model: Model) -> Model:
        """Take out, one by one, the effects that do not pay for themselves, the least first."""
        while model.effects:
            lesser = [self.without(model, out) for out in model.effects]
            best = min(lesser, key=lambda m: m.score)
            if self.pays(best, model):
                break
            model = best
        return model

    def without(self, model: Model, out: Candidate) -> Model:
        """Return `model` less one effect, fitted anew."""
        left = [c for c in model.effects if c is not out]
        known = self.tried.get(tuple(sorted(c.name for c in left)))
        back = {f.name: self.baseline.fit.values[f.name] for f in out.frees}
        return known if known is not None and not left else self.model(left, {**model.fit.values, **back}, model)

    def _first(self, most: int) -> Model:
        """Return the best of all models of at most so many effects that were fitted on the way."""
        return min((m for m in self.tried.values() if len(m.effects) <= most), key=lambda m: m.rank)

    def run(self, most: int) -> Found:
        """Search to `most` effects; a level is opened only while something is left and the one before has paid.

        At the end each chosen effect's place is offered to all others, so that its rivals are known.
        """
        level, best = [self.baseline], self.baseline
        for depth in range(most):
            if not self.leaves(best):
                break
            grown = {m.names: m for model in level for m in self.grow(model, LATER_REFITS if depth else FIRST_REFITS)}
            level = sorted(grown.values(), key=lambda m: m.rank)[:BEAM]
            ahead = min((self.prune(m) for m in level[:2]), key=lambda m: m.rank, default=best)
            if ahead.rank >= best.rank or (depth > 0 and len(ahead.effects) <= len(best.effects)):
                break
            best = ahead
        for out in best.effects if len(best.effects) > 1 else ():
            self.grow(self.without(best, out), FIRST_REFITS)
        best = self.prune(self._first(len(best.effects))) if best.effects else best
        return Found(self.baseline, best, tuple(sorted(self.tried.values(), key=lambda m: m.rank)))
