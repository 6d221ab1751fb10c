"""Held-out χ² from one linearisation: the score of a fit, and the expected improvement by every candidate.

Screening only ranks candidates. Every reported figure comes from full fits, fold by fold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.candidates import Candidate
from diagnosis.problem.fit import Fit, Problem
from physics.laws import Array

RIDGE: Final = 1e-6
ROUNDS: Final = 6
"""Most iterations in which parameters that would cross their bounds are fixed."""


class Screen:
    """Normal matrices by fold and equation, over each free parameter and each extra column of residual change."""

    def __init__(self, problem: Problem, fit: Fit, folds: Sequence[frozenset[int]], count: int,
                 extra: Callable[[int, Array], None]) -> None:
        """Linearise `problem` about `fit`; `extra` writes a block's residual change for `count` further columns."""
        self.known = len(fit.free)
        self.down = np.array([-math.inf if fit.values[f.name] > f.low else 0.0 for f in fit.free])
        self.up = np.array([math.inf if fit.values[f.name] < f.high else 0.0 for f in fit.free])
        self.free, self.prior, self.precision = fit.free, problem.prior, problem.prior.precision(fit.free)
        self.off = np.array([fit.values[f.name] - f.mean for f in fit.free])
        self.names = sorted(problem.weights)
        size = self.known + count
        shape = (len(folds), len(self.names))
        self.gram, self.slope, self.cost = np.zeros((*shape, size, size)), np.zeros((*shape, size)), np.zeros(shape)
        for i, block in enumerate(problem.blocks):
            columns = np.zeros((size, fit.residuals[i].size))
            columns[fit.reads[i]] = fit.slopes[i]
            extra(i, columns[self.known:])
            self._add(self.names.index(block.relation.name), columns, fit.residuals[i], block.cycle, folds)
        every, slope = self.gram.sum(axis=(0, 1)), self.slope.sum(axis=(0, 1))
        self.diagonal = np.diag(every).copy()
        alone = len(folds) == 1  # one fold judges itself
        self.left = np.array([every if alone else every - g for g in self.gram.sum(axis=1)])
        self.left_slope = np.array([slope if alone else slope - g for g in self.slope.sum(axis=1)])
        self.own = np.ascontiguousarray(self.gram[:, :, :self.known, :self.known])

    def _add(self, relation: int, columns: Array, rest: Array, cycle: NDArray[np.intp],
             folds: Sequence[frozenset[int]]) -> None:
        at = np.flatnonzero(columns.any(axis=1))
        for k, fold in enumerate(folds):
            inside = np.isin(cycle, list(fold))
            part, r = columns[np.ix_(at, np.flatnonzero(inside))], rest[inside]
            self.gram[k, relation, at[:, None], at] += part @ part.T
            self.slope[k, relation, at] += part @ r
            self.cost[k, relation] += float(r @ r)

    def unseen(self, extra: int | None = None, released: Sequence[int] = ()) -> dict[str, float]:
        """Return held-out χ² by equation, the free parameters (and one extra column) fitted to the other folds.

        A parameter on its bound moves only inwards, unless it is `released` from bounds and prior.
        """
        at = np.arange(self.known) if extra is None else np.append(np.arange(self.known), self.known + extra)
        more = len(at) - self.known
        held = list(released)
        prior = np.zeros((at.size, at.size))
        prior[:self.known, :self.known] = self.precision if not held else self.prior.precision([
            replace(f, sigma=math.inf) if j in held else f for j, f in enumerate(self.free)])
        pull = np.append(prior[:self.known, :self.known] @ self.off, np.zeros(more))
        down, up = np.append(self.down, np.full(more, -np.inf)), np.append(self.up, np.full(more, np.inf))
        down[held], up[held] = -np.inf, np.inf
        gram = self.left[:, at[:, None], at] + prior
        gram[:, np.arange(at.size), np.arange(at.size)] += RIDGE * self.diagonal[at] + 1e-12
        steps = _inside(gram, self.left_slope[:, at] + pull, down, up)
        known = steps[:, None, :self.known]
        total = self.cost + 2.0 * (self.slope[:, :, at] @ steps[:, :, None])[:, :, 0]
        total += ((self.own @ known[..., None])[..., 0] * known).sum(axis=2)
        if extra is not None:
            place, size = self.known + extra, steps[:, None, -1]
            across = (self.gram[:, :, place, :self.known] @ steps[:, :self.known, None])[:, :, 0]
            total += 2.0 * size * across + size**2 * self.gram[:, :, place, place]
        return dict(zip(self.names, total.sum(axis=0).tolist(), strict=True))


def _inside(gram: Array, slope: Array, down: Array, up: Array) -> Array:
    """Return the minimising steps of several normal matrices; parameters that would cross a bound are fixed."""
    steps = -np.linalg.solve(gram, slope[:, :, None])[:, :, 0]
    for step, matrix, right, beyond in zip(steps, gram, slope, (steps < down) | (steps > up), strict=True):
        moving, out = np.ones(right.size, dtype=np.bool_), beyond
        for _ in range(ROUNDS - 1):
            if not out.any():
                break
            moving &= ~out
            free = np.flatnonzero(moving)
            step[:] = 0.0
            step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], right[free])
            out = (step < down) | (step > up)
    return np.asarray(steps)


def promises(problem: Problem, fit: Fit, folds: Sequence[frozenset[int]], offered: Sequence[Candidate]
             ) -> list[tuple[float, int, int]]:
    """Return (fall of held-out χ², candidate, start) for every start of every candidate, best first.

    Start −1 continues from the fit itself, for a candidate whose parameters are all free there already.
    """
    starts = [(c, s) for c, candidate in enumerate(offered) for s in range(len(candidate.starts))]

    def changes(i: int, rows: Array) -> None:
        for j, (c, s) in enumerate(starts):
            if offered[c].parameters & problem.blocks[i].uses:
                rows[j] = problem.residual(i, {**fit.values, **offered[c].starts[s]}) - fit.residuals[i]

    screen = Screen(problem, fit, folds, len(starts), changes)
    base = sum(screen.unseen().values())
    falls = [(base - sum(screen.unseen(j).values()), c, s) for j, (c, s) in enumerate(starts)]
    place = {f.name: j for j, f in enumerate(fit.free)}
    for c, candidate in enumerate(offered):
        if candidate.parameters <= place.keys():
            released = [place[name] for name in candidate.parameters]
            falls.append((base - sum(screen.unseen(released=released).values()), c, -1))
    return sorted(falls, reverse=True)
