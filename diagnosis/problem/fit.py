"""Bounded least squares over whole cycles, with what is known beforehand about the parameters.

The rule of this file: a fit sees blocks and parameters, never the name of a cause.  Cost: ½·Σ(r/w)² + ½·Σ((p − p0)/σ)²,
w the relation's floor times the root of the samples that count as one.  Slopes are taken by differences once and
then follow each step (Broyden 1965, Math. Comp. 19, eq. 4.5); a fit that adds to another starts from that one's: most
steps cost one evaluation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from physics.laws import Array

Values = Mapping[str, float]

MAX_STEPS: Final = 40
DIFFERENCE: Final = 0.02
"""Step of a slope, of a parameter's scale: far above what the laws' own solvers leave (1 nm, 1 µN)."""
ENOUGH: Final = 1e-3
"""Relative fall of the cost below which a fit has arrived."""
IDLE: Final = 1e-5
"""Share of the cost below which a parameter's step is not made: the blocks that read it need no evaluation."""
SHORT: Final = 1e-3
"""Step, of the scales, below which it teaches nothing of the slopes."""
TRUSTED: Final = 0.25
"""Share of the predicted gain that a step must reach for its slopes to be used again."""
MOVED: Final = 0.25
"""Change of a parameter, in its scale, beyond which its slope is taken again."""


@dataclass(frozen=True)
class Free:
    """A parameter of a fit: bounds, and a prior of `mean` ± `sigma` (infinite: nothing known beforehand)."""

    name: str
    low: float
    high: float
    mean: float
    sigma: float
    scale: float

    def pull(self, value: float) -> float:
        return (value - self.mean) / self.sigma if np.isfinite(self.sigma) else 0.0

    @property
    def stiffness(self) -> float:
        return 1.0 / self.sigma**2 if np.isfinite(self.sigma) else 0.0


class Problem:
    """Blocks with their weights and, for each, the samples that a fit may see."""

    def __init__(self, blocks: Sequence[Block], weights: Mapping[str, float], cycles: frozenset[int] | None = None):
        self.blocks = blocks
        self.weights = weights
        self.masks = [None if cycles is None else np.isin(b.cycle, list(cycles)) for b in blocks]

    def residual(self, i: int, values: Values) -> Array:
        block, mask = self.blocks[i], self.masks[i]
        r = block.residual(values) / self.weights[block.relation.name]
        return r if mask is None else r[mask]

    def residuals(self, values: Values) -> list[Array]:
        return [self.residual(i, values) for i in range(len(self.blocks))]

    def slope(self, i: int, values: Values, residual: Array, f: Free) -> Array:
        """Return ∂residual/∂parameter of block `i` at `values`, one-sided, inside the bounds."""
        step = DIFFERENCE * f.scale
        if values[f.name] + step > f.high:
            step = -step
        return (self.residual(i, {**values, f.name: values[f.name] + step}) - residual) / step


@dataclass(frozen=True)
class Fit:
    """Where a fit arrived: all values, the cost, and what the residual does there, in the order of `free`."""

    values: dict[str, float]
    cost: float
    free: tuple[Free, ...]
    residuals: list[Array]
    slopes: list[Array]
    curvature: Array
    steps: int


class Slopes:
    """∂residual/∂parameter by block, one row a parameter; rows of parameters that a block does not read are zero."""

    def __init__(self, problem: Problem, free: Sequence[Free], residuals: Sequence[Array], known: Fit | None) -> None:
        self.problem, self.free = problem, free
        self.scale = np.array([f.scale for f in free])
        self.taken = np.full(len(free), np.nan)
        self.rows = [np.zeros((len(free), r.size)) for r in residuals]
        self.reads = [np.flatnonzero([f.name in b.uses for f in free]) for b in problem.blocks]
        if known is not None:
            self._carry(known)

    def _carry(self, known: Fit) -> None:
        place = {f.name: j for j, f in enumerate(known.free)}
        both = [(j, place[f.name]) for j, f in enumerate(self.free) if f.name in place]
        here, there = np.array(both, dtype=np.intp).reshape(-1, 2).T
        self.taken[here] = [known.values[self.free[j].name] for j, _ in both]
        for rows, carried, mask in zip(self.rows, known.slopes, self.problem.masks, strict=True):
            rows[here] = carried[there] if mask is None else carried[np.ix_(there, np.flatnonzero(mask))]

    def stale(self, values: Values, thorough: bool = False) -> NDArray[np.intp]:
        """Return the parameters whose slope was never taken, or too far from `values`.

        `thorough`: all parameters, as soon as one was elsewhere when the slopes were taken.
        """
        at = np.array([values[f.name] for f in self.free])
        if thorough:
            return np.arange(at.size if (at != self.taken).any() else 0)
        return np.flatnonzero(~(np.abs(at - self.taken) <= MOVED * self.scale))

    def unknown(self) -> NDArray[np.intp]:
        """Return the parameters whose slope was never taken."""
        return np.flatnonzero(np.isnan(self.taken))

    def take(self, values: Values, residuals: Sequence[Array], which: NDArray[np.intp]) -> bool:
        """Take the slopes of the parameters `which` by differences; return whether there were any."""
        for i, block in enumerate(self.problem.blocks):
            for j in which.tolist():
                if self.free[j].name in block.uses:
                    self.rows[i][j] = self.problem.slope(i, values, residuals[i], self.free[j])
        self.taken[which] = [values[self.free[j].name] for j in which.tolist()]
        return which.size > 0

    def follow(self, step: Array, before: Sequence[Array], after: Sequence[Array]) -> None:
        """Make the slopes agree with what `step` did."""
        for rows, reads, old, new in zip(self.rows, self.reads, before, after, strict=True):
            way = step[reads] / self.scale[reads]
            length = float(way @ way)
            if length > SHORT**2 and np.isfinite(new).all():
                missed = new - old - step[reads] @ rows[reads]
                rows[reads] += np.outer(way / self.scale[reads] / length, missed)

    def curvature(self) -> Array:
        total = np.diag([f.stiffness for f in self.free])
        for rows, reads in zip(self.rows, self.reads, strict=True):
            total[np.ix_(reads, reads)] += rows[reads] @ rows[reads].T
        return total

    def gradient(self, residuals: Sequence[Array], values: Values) -> Array:
        total = np.array([f.pull(values[f.name]) / f.sigma for f in self.free])
        for rows, reads, r in zip(self.rows, self.reads, residuals, strict=True):
            total[reads] += rows[reads] @ r
        return total


def solve(problem: Problem, start: Values, free: Sequence[Free], max_steps: int = MAX_STEPS, known: Fit | None = None,
          thorough: bool = False) -> Fit:
    """Minimise the cost over `free` from `start` by Levenberg–Marquardt with the bounds projected.

    `known`: a fit of the same blocks whose slopes are near those at `start`.  `thorough`: it has arrived only where
    slopes say so that were all taken there.
    """
    values = {**start, **{f.name: min(max(start[f.name], f.low), f.high) for f in free}}
    residuals = problem.residuals(values)
    cost, slopes = _cost(residuals, free, values), Slopes(problem, free, residuals, known)
    slopes.take(values, residuals, slopes.unknown())
    curvature, damping, steps = slopes.curvature(), 1e-3, 0
    while free and steps < max_steps and damping < 1e6:
        steps += 1
        trial, predicted = _stepped(values, free, slopes.gradient(residuals, values), curvature, damping, cost)
        gain, arrived = 0.0, predicted < ENOUGH * cost
        if not arrived:
            tried = problem.residuals(trial)
            gain = cost - _cost(tried, free, trial)
            slopes.follow(np.array([trial[f.name] - values[f.name] for f in free]), residuals, tried)
        if gain > 0.0:
            values, residuals, cost = trial, tried, cost - gain
            damping = max(damping / 5.0, 1e-9)
        if gain < TRUSTED * predicted or arrived:
            renewed = slopes.take(values, residuals, slopes.stale(values, thorough and arrived))
            if arrived and not renewed:
                break
            damping *= 1.0 if renewed or gain > 0.0 else 8.0
        curvature = slopes.curvature()
    return Fit(values, cost, tuple(free), residuals, slopes.rows, curvature, steps)


def _cost(residuals: Sequence[Array], free: Sequence[Free], values: Values) -> float:
    with np.errstate(over="ignore"):  # a residual beyond 1e154 is as infinite as its square
        total = 0.5 * sum(float(r @ r) for r in residuals)
    total += 0.5 * sum(f.pull(values[f.name]) ** 2 for f in free)
    return total if np.isfinite(total) else np.inf


def _stepped(values: Values, free: Sequence[Free], gradient: Array, curvature: Array, damping: float,
             cost: float) -> tuple[dict[str, float], float]:
    """Return the next values and the gain that the slopes predict; parameters that would leave stop on their bound."""
    at = np.array([values[f.name] for f in free])
    down, up = np.array([f.low for f in free]) - at, np.array([f.high for f in free]) - at
    scale = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
    damped = curvature + damping * np.diag(scale**2)
    moving = ~(((down >= 0.0) & (gradient > 0.0)) | ((up <= 0.0) & (gradient < 0.0)))
    step = np.zeros(len(free))
    while moving.any():
        pushed = (gradient + damped @ np.where(moving, 0.0, step))[moving] / scale[moving]
        even = damped[np.ix_(moving, moving)] / np.outer(scale[moving], scale[moving])
        step[moving] = -np.linalg.lstsq(even, pushed, rcond=1e-12)[0] / scale[moving]
        out = moving & ((step < down) | (step > up))
        if not out.any():
            break
        step[out] = np.clip(step, down, up)[out]
        moving &= ~out
    step[np.maximum(np.abs(gradient * step), (scale * step) ** 2) < IDLE * cost] = 0.0
    promised = -float(gradient @ step) - 0.5 * float(step @ curvature @ step)
    new = np.clip(at + step, at + down, at + up)
    return {**values, **{f.name: float(v) for f, v in zip(free, new, strict=True)}}, promised
