"""Bounded least squares over complete cycles, with a Gaussian prior on the parameters.

A fit receives blocks and parameters, never the name of a cause. Cost: ½·Σ(r/w)² + ½·δᵀ·C⁻¹·δ. r: residual. w: the
equation's reference RMSE times the root of the number of samples per effective sample. δ: parameters less prior means.
C: prior covariance (`prior`). Slopes are computed once by differences, then updated with each step (Broyden 1965, Math.
Comp. 19, eq. 4.5). A fit that extends another one starts from its slopes, so that most steps cost one evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from diagnosis.problem.prior import NOTHING_TOGETHER, Free, Prior
from physics.laws import Array

Values = Mapping[str, float]

MAX_STEPS: Final = 80
DIFFERENCE: Final = 0.02
"""Step of a slope's difference, as a share of the parameter's scale: far above the tolerance of the submodels' solvers
(1 nm, 1 µN)."""
ENOUGH: Final = 1e-3
"""Predicted relative fall of the cost below which a fit has converged."""
ROUGHLY: Final = 5e-3
"""Predicted relative fall of the cost at which a coarse fit stops, if it only ranks which fits to continue."""
LEAST_PULL: Final = 1e-9
"""Gradient component, as a share of the largest, below which a parameter stays on its bound."""
SINGULAR: Final = 1e-9
"""Value added to the diagonal of the scaled curvature before its inversion."""
IDLE: Final = 1e-5
"""Predicted change of the cost, as a share of the cost, below which a parameter is not moved. Blocks that read only
such parameters need no evaluation."""
SHORT: Final = 1e-3
"""Step length, in parameter scales, below which a step does not update the slopes."""
TRUSTED: Final = 0.25
"""Ratio of actual to predicted fall of the cost, below which slopes are computed again."""
MOVED: Final = 0.25
"""Change of a parameter, in its scale, beyond which its slope is computed again."""


class Space:
    """Bounds, scales, prior means and prior precision of the free parameters of a fit, as arrays."""

    def __init__(self, free: Sequence[Free], prior: Prior) -> None:
        self.names = tuple(f.name for f in free)
        self.low, self.high = np.array([f.low for f in free]), np.array([f.high for f in free])
        self.scale, self.mean = np.array([f.scale for f in free]), np.array([f.mean for f in free])
        self.precision = prior.precision(free)

    def of(self, values: Values) -> Array:
        """Return the free parameters of `values`, as an array."""
        return np.array([values[name] for name in self.names])

    def put(self, values: Values, at: Array) -> dict[str, float]:
        """Return `values` with the free parameters replaced by `at`."""
        return {**values, **dict(zip(self.names, at.tolist(), strict=True))}

    def cost(self, residuals: Sequence[Array], at: Array) -> float:
        """Return the cost: half the sum of squared weighted residuals and of the prior penalty."""
        with np.errstate(over="ignore"):  # the square of a residual beyond 1e154 overflows: an infinite cost
            total = 0.5 * sum(float(r @ r) for r in residuals)
        total += 0.5 * self.penalty(at)
        return total if math.isfinite(total) else math.inf

    def penalty(self, at: Array) -> float:
        """Return the χ² of the parameters under their prior."""
        off = at - self.mean
        return float(off @ self.precision @ off)


class Problem:
    """Blocks with their weights and a prior; `cycles`: cycles that a fit may use, None for all."""

    def __init__(self, blocks: Sequence[Block], weights: Mapping[str, float], prior: Prior = NOTHING_TOGETHER,
                 cycles: frozenset[int] | None = None):
        self.blocks, self.weights, self.prior, self.cycles = blocks, weights, prior, cycles
        self.masks = [None if cycles is None else np.isin(b.cycle, list(cycles)) for b in blocks]

    def only(self, relation: str) -> Problem:
        """Return the part of the problem that belongs to one prediction equation."""
        return Problem([b for b in self.blocks if b.relation.name == relation], self.weights, self.prior, self.cycles)

    def residual(self, i: int, values: Values) -> Array:
        block, mask = self.blocks[i], self.masks[i]
        r = block.residual(values) / self.weights[block.relation.name]
        return r if mask is None else r[mask]

    def residuals(self, values: Values) -> list[Array]:
        return [self.residual(i, values) for i in range(len(self.blocks))]

    def slope(self, i: int, values: Values, residual: Array, f: Free) -> Array:
        """Return ∂residual/∂parameter of block `i` at `values`, by a one-sided difference within the bounds."""
        step = DIFFERENCE * f.scale
        if values[f.name] + step > f.high:
            step = -step
        return (self.residual(i, {**values, f.name: values[f.name] + step}) - residual) / step


@dataclass(frozen=True)
class Fit:
    """Result of a fit: all values, the cost, and by block the residuals and their slopes.

    `slopes`: one row for each parameter that the block reads, in single precision to save memory. `reads`: indices of
    these parameters in `free`. `curvature`: JᵀJ + C⁻¹, (free, free). `penalty`: χ² of the parameters under their prior,
    twice its part of the cost.
    """

    values: dict[str, float]
    cost: float
    free: tuple[Free, ...]
    residuals: list[Array]
    slopes: list[NDArray[np.float32]]
    reads: list[NDArray[np.intp]]
    curvature: Array
    penalty: float
    steps: int

    def every_slope(self) -> Array:
        """Return ∂residual/∂parameter of all blocks, (free, samples); one row for each of `free`."""
        every = np.zeros((len(self.free), sum(r.size for r in self.residuals)))
        at = 0
        for reads, rows in zip(self.reads, self.slopes, strict=True):
            every[reads, at:at + rows.shape[1]] = rows
            at += rows.shape[1]
        return every


class Slopes:
    """∂residual/∂parameter by block, one row for each parameter that the block reads, and their products (`grams`)."""

    def __init__(self, problem: Problem, free: Sequence[Free], space: Space, residuals: Sequence[Array],
                 known: Fit | None) -> None:
        self.problem, self.free, self.space = problem, free, space
        self.taken = np.full(len(free), np.nan)
        self.reads = [np.flatnonzero([f.name in b.uses for f in free]) for b in problem.blocks]
        self.row = [{int(j): i for i, j in enumerate(reads)} for reads in self.reads]
        self.rows = [np.zeros((reads.size, r.size)) for reads, r in zip(self.reads, residuals, strict=True)]
        if known is not None:
            self._carry(known)
        self.grams = [rows @ rows.T for rows in self.rows]

    def _carry(self, known: Fit) -> None:
        place = {f.name: j for j, f in enumerate(known.free)}
        for j, f in enumerate(self.free):
            if f.name in place:
                self.taken[j] = known.values[f.name]
        for i, mask in enumerate(self.problem.masks):
            there = {known.free[j].name: k for k, j in enumerate(known.reads[i].tolist())}
            both = [(k, there[self.free[j].name]) for j, k in self.row[i].items() if self.free[j].name in there]
            here, theirs = np.array(both, dtype=np.intp).reshape(-1, 2).T
            carried = known.slopes[i]
            self.rows[i][here] = carried[theirs] if mask is None else carried[np.ix_(theirs, np.flatnonzero(mask))]

    def stale(self, values: Values, thorough: bool = False) -> NDArray[np.intp]:
        """Return the parameters whose slope was never computed, or was computed too far from `values`.

        `thorough`: return all parameters as soon as any has moved since its slope was computed.
        """
        at = self.space.of(values)
        if thorough:
            return np.arange(at.size if (at != self.taken).any() else 0)
        return np.flatnonzero(~(np.abs(at - self.taken) <= MOVED * self.space.scale))

    def unknown(self) -> NDArray[np.intp]:
        """Return the parameters whose slope was never computed."""
        return np.flatnonzero(np.isnan(self.taken))

    def take(self, values: Values, residuals: Sequence[Array], which: NDArray[np.intp]) -> bool:
        """Compute the slopes of the parameters `which` by differences; return whether `which` held any.

        The outer loop is over parameters: the equations of one trial share intermediate results of their submodels.
        """
        wanted = {self.free[j].name: int(j) for j in which.tolist()}
        copies: list[tuple[int, int, int]] = []
        for name, j in wanted.items():
            for i, block in enumerate(self.problem.blocks):
                if name not in block.uses:
                    continue
                like = block.like(name, values)
                if like in wanted:
                    copies.append((i, self.row[i][j], self.row[i][wanted[like]]))
                else:
                    self.rows[i][self.row[i][j]] = self.problem.slope(i, values, residuals[i], self.free[j])
        for i, here, there in copies:
            self.rows[i][here] = self.rows[i][there]
        for i, rows in enumerate(self.rows):
            new = [self.row[i][j] for j in wanted.values() if j in self.row[i]]
            self.grams[i][new] = rows[new] @ rows.T
            self.grams[i][:, new] = self.grams[i][new].T
        self.taken[which] = self.space.of(values)[which]
        return which.size > 0

    def follow(self, step: Array, before: Sequence[Array], after: Sequence[Array]) -> None:
        """Update the slopes so that they reproduce the residuals' change over `step` (Broyden)."""
        for reads, rows, gram, old, new in zip(self.reads, self.rows, self.grams, before, after, strict=True):
            scale = self.space.scale[reads]
            way = step[reads] / scale
            length = float(way @ way)
            if length > SHORT**2 and np.isfinite(new).all():
                missed, way = new - old - step[reads] @ rows, way / scale / length
                crossed = np.outer(way, rows @ missed)
                gram += crossed + crossed.T + float(missed @ missed) * np.outer(way, way)
                rows += np.outer(way, missed)

    def curvature(self) -> Array:
        total = self.space.precision.copy()
        for gram, reads in zip(self.grams, self.reads, strict=True):
            total[np.ix_(reads, reads)] += gram
        return total

    def gradient(self, residuals: Sequence[Array], at: Array) -> Array:
        total: Array = self.space.precision @ (at - self.space.mean)
        for rows, reads, r in zip(self.rows, self.reads, residuals, strict=True):
            total[reads] += rows @ r
        return total


def solve(problem: Problem, start: Values, free: Sequence[Free], max_steps: int = MAX_STEPS, known: Fit | None = None,
          thorough: bool = False, enough: float = ENOUGH) -> Fit:
    """Minimise the cost over `free` from `start` by Levenberg–Marquardt with the bounds projected.

    `known`: a fit of the same blocks whose slopes are valid near `start`. `thorough`: converge only by slopes that were
    all computed at the final point. `enough`: relative fall of the cost below which the fit has converged.
    """
    space = Space(free, problem.prior)
    at = np.clip(space.of(start), space.low, space.high)
    values = space.put(start, at)
    residuals = problem.residuals(values)
    cost, slopes = space.cost(residuals, at), Slopes(problem, free, space, residuals, known)
    slopes.take(values, residuals, slopes.unknown())
    curvature, damping, steps = slopes.curvature(), 1e-3, 0
    while free and steps < max_steps and damping < 1e6:
        steps += 1
        new, predicted = _stepped(at, space, slopes.gradient(residuals, at), curvature, damping, cost)
        gain, arrived = 0.0, predicted < enough * cost
        if not arrived:
            trial = space.put(values, new)
            tried = problem.residuals(trial)
            gain = cost - space.cost(tried, new)
            slopes.follow(new - at, residuals, tried)
        if gain > 0.0:
            at, values, residuals, cost = new, trial, tried, cost - gain
            damping = max(damping / 5.0, 1e-9)
        if gain < TRUSTED * predicted or arrived:
            renewed = slopes.take(values, residuals, slopes.stale(values, thorough and arrived))
            if arrived and not renewed:
                break
            damping *= 1.0 if renewed or gain > 0.0 else 8.0
        curvature = slopes.curvature()
    return Fit(values, cost, tuple(free), residuals, [rows.astype(np.float32) for rows in slopes.rows], slopes.reads,
               curvature, space.penalty(at), steps)


def _stepped(at: Array, space: Space, gradient: Array, curvature: Array, damping: float, cost: float
             ) -> tuple[Array, float]:
    """Return the next parameters and the predicted fall of the cost; a parameter stops on its bound."""
    down, up = space.low - at, space.high - at
    # a parameter that neither residuals nor prior constrain is not moved
    idle = np.diag(curvature) <= 0.0
    scale = np.sqrt(np.where(idle, 1.0, np.diag(curvature)))
    even = np.where(idle[:, None] | idle, np.eye(at.size), curvature / np.outer(scale, scale))
    # damping by each parameter's curvature conditional on all others: of two confounded ones only the sum is well known
    alone = 1.0 / np.maximum(np.diag(_solved(even + SINGULAR * np.eye(at.size), np.eye(at.size))), 1.0)
    slope = np.where(idle, 0.0, gradient / scale)
    step = _between(even + damping * np.diag(alone), slope, down * scale, up * scale) / scale
    step[np.maximum(np.abs(gradient * step), (scale * step) ** 2) < IDLE * cost] = 0.0
    promised = -float(gradient @ step) - 0.5 * float(step @ curvature @ step)
    return np.clip(at + step, space.low, space.high), promised


def _between(matrix: Array, gradient: Array, down: Array, up: Array) -> Array:
    """Return the step x between bounds (which include 0) that minimises ½·xᵀ·matrix·x + gradient·x, by active sets.

    A parameter that would cross its bound stops on it. Of the parameters on bounds, the one with the largest inward
    gradient is released (Nocedal and Wright 2006, algorithm 16.3).
    """
    step, slope = np.zeros(gradient.size), gradient
    held = ((down >= 0.0) & (slope > 0.0)) | ((up <= 0.0) & (slope < 0.0))
    for _ in range(4 * gradient.size):
        free = np.flatnonzero(~held)
        way = np.zeros(step.size)
        if free.size:
            way[free] = -_solved(matrix[np.ix_(free, free)], slope[free])
        room = np.where(way > 0.0, up - step, np.where(way < 0.0, down - step, np.inf)) / np.where(way == 0.0, 1.0, way)
        share = min(1.0, float(room.min()))
        step = np.clip(step + share * way, down, up)
        slope = gradient + matrix @ step
        if share < 1.0:
            held |= room <= share
            continue
        back = np.where(held & (step <= down), -slope, np.where(held & (step >= up), slope, 0.0))
        if back.max(initial=0.0) <= LEAST_PULL * float(np.abs(gradient).max(initial=0.0)):
            break
        held[np.argmax(back)] = False
    return step


def _solved(matrix: Array, right: Array) -> Array:
    """Solve a linear system; return the shortest solution if rounding has made the matrix singular.

    The solution is zero if submodels that overflow have made the matrix non-finite.
    """
    try:
        return np.asarray(np.linalg.solve(matrix, right))
    except np.linalg.LinAlgError:
        if not np.isfinite(matrix).all():
            return np.zeros_like(right)
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0])
