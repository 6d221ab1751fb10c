"""Bounded least squares over whole cycles, with what is known beforehand about the parameters.

The rule of this file: a fit sees blocks and slots, never the name of a cause.  Cost: ½·Σ(r/w)² + ½·Σ((p − p0)/σ)²,
w the relation's floor times the root of the samples that count as one.  Slopes are taken again only where the
last ones have stopped predicting what a step gains: most steps cost one evaluation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.relations import Block

Array = NDArray[np.float64]
Values = Mapping[str, float]

MAX_STEPS: Final = 40
DIFFERENCE: Final = 0.02
"""Step of a slope, of a slot's scale: far above what the laws' own solvers leave (1 nm, 1 µN)."""
ENOUGH: Final = 2e-4
"""Relative fall of the cost below which a fit has arrived."""
TRUSTED: Final = 0.6
"""Share of the predicted gain that a step must reach for its slopes to be used again."""


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
        """Return ∂residual/∂slot of block `i` at `values`, one-sided, inside the bounds."""
        step = DIFFERENCE * f.scale
        if values[f.name] + step > f.high:
            step = -step
        return (self.residual(i, {**values, f.name: values[f.name] + step}) - residual) / step

    def slopes(self, values: Values, residuals: Sequence[Array], free: Sequence[Free]) -> list[Array]:
        """Return, by block, ∂residual/∂slot as one row a slot; rows of slots that the block does not read are zero."""
        found = []
        for i, block in enumerate(self.blocks):
            rows = np.zeros((len(free), residuals[i].size))
            for j, f in enumerate(free):
                if f.name in block.uses:
                    rows[j] = self.slope(i, values, residuals[i], f)
            found.append(rows)
        return found


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


def solve(problem: Problem, start: Values, free: Sequence[Free], max_steps: int = MAX_STEPS) -> Fit:
    """Minimise the cost over `free` from `start` by Levenberg–Marquardt with the bounds projected."""
    values = dict(start)
    for f in free:
        values[f.name] = min(max(values[f.name], f.low), f.high)
    residuals = problem.residuals(values)
    cost, slopes = _cost(residuals, free, values), problem.slopes(values, residuals, free)
    curvature, damping, fresh, steps = _curvature(slopes, free), 1e-3, True, 0
    while free and steps < max_steps and damping < 1e6:
        steps += 1
        gradient = _gradient(slopes, residuals, free, values)
        trial, predicted = _stepped(values, free, gradient, curvature, damping)
        tried = problem.residuals(trial)
        gain = cost - _cost(tried, free, trial)
        if gain > 0.0:
            values, residuals, cost = trial, tried, cost - gain
            damping = max(damping / 5.0, 1e-9)
        elif fresh:
            damping *= 8.0
        if fresh and max(gain, predicted) < ENOUGH * cost:
            break
        if gain < max(TRUSTED * predicted, 10.0 * ENOUGH * cost) and (gain > 0.0 or not fresh):
            slopes, fresh = problem.slopes(values, residuals, free), True
            curvature = _curvature(slopes, free)
        elif gain > 0.0:
            fresh = False
    return Fit(values, cost, tuple(free), residuals, slopes, curvature, steps)


def _cost(residuals: Sequence[Array], free: Sequence[Free], values: Values) -> float:
    total = 0.5 * sum(float(r @ r) for r in residuals) + 0.5 * sum(f.pull(values[f.name]) ** 2 for f in free)
    return total if np.isfinite(total) else np.inf


def _curvature(slopes: Sequence[Array], free: Sequence[Free]) -> Array:
    return np.asarray(sum((j @ j.T for j in slopes), np.diag([f.stiffness for f in free])))


def _gradient(slopes: Sequence[Array], residuals: Sequence[Array], free: Sequence[Free], values: Values) -> Array:
    prior = np.array([f.pull(values[f.name]) / f.sigma for f in free])
    return np.asarray(sum((j @ r for j, r in zip(slopes, residuals, strict=True)), prior))


def _stepped(values: Values, free: Sequence[Free], gradient: Array, curvature: Array, damping: float
             ) -> tuple[dict[str, float], float]:
    """Return the next values and the gain that the slopes promise; slots that would leave stop on their bound."""
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
    promised = -float(gradient @ step) - 0.5 * float(step @ curvature @ step)
    new = np.clip(at + step, at + down, at + up)
    return {**values, **{f.name: float(v) for f, v in zip(free, new, strict=True)}}, promised
