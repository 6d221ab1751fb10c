"""Closing one recorded gait cycle into a periodic curve, without a step.

The rule of this file: outside ±`CLOSED_PERCENT` of the seam nothing changes; inside, a quintic on each side
takes up the mismatch in value, slope and curvature, so that the closed curve is C2 everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from physics.laws import Array

CLOSED_PERCENT: Final = 10.0
CYCLE_POINTS: Final = 1000
_BENDING_WEIGHT: Final = 4.0
"""Weight of bending against departure, %²: a balance, not an equation. Larger: a smoother seam that departs further
from the recording."""


def _quintic(width: float, begin: Array, end: Array) -> Array:
    """Return ascending coefficients of the quintic over [0, width] with (value, slope, curvature) at both ends."""
    powers = np.arange(6)
    rows = [np.eye(6)[0], np.eye(6)[1], 2.0 * np.eye(6)[2]]
    rows.append(width**powers)
    rows.append(powers * width ** np.maximum(powers - 1, 0))
    rows.append(powers * (powers - 1) * width ** np.maximum(powers - 2, 0))
    solved: Array = np.linalg.solve(np.array(rows), np.concatenate([begin, end]))
    return solved


def _corrections(seam: Array, mismatch: Array) -> tuple[Array, Array]:
    """Return the quintics before and after the seam; `seam` is the correction's state on its left side."""
    still = np.zeros(3)
    return _quintic(CLOSED_PERCENT, still, seam), _quintic(CLOSED_PERCENT, seam - mismatch, still)


def _cost(
    curve: Callable[[Array, int], Array], seam: Array, mismatch: Array
) -> Array:
    """Return samples of departure and of weighted bending over the window: the cost that the seam's state minimises."""
    u = np.linspace(0.0, CLOSED_PERCENT, 101)
    before, after = (np.polynomial.Polynomial(c) for c in _corrections(seam, mismatch))
    bend_before = before.deriv(2)(u) + curve(100.0 - CLOSED_PERCENT + u, 2)
    bend_after = after.deriv(2)(u) + curve(u, 2)
    bending = _BENDING_WEIGHT * np.concatenate([bend_before, bend_after])
    return np.concatenate([before(u), after(u), bending])


def closed(curve: Callable[[Array, int], Array]) -> Callable[[Array], tuple[Array, Array]]:
    """Return a periodic C2 curve: percent → (value, slope per %), equal to `curve` off the seam.

    `curve(percent, order)` gives the value (0) and derivatives (1, 2) per percent on 0…100.
    """
    mismatch = np.array([float(curve(np.array([0.0]), n)[0] - curve(np.array([100.0]), n)[0]) for n in range(3)])
    base = _cost(curve, np.zeros(3), mismatch)
    columns = [_cost(curve, unit, mismatch) - base for unit in np.eye(3)]
    fitted = np.linalg.lstsq(np.stack(columns, axis=1), -base, rcond=None)[0]
    seam = fitted.astype(np.float64)
    before, after = (np.polynomial.Polynomial(c) for c in _corrections(seam, mismatch))

    def evaluate(percent: Array) -> tuple[Array, Array]:
        t = np.mod(percent, 100.0)
        left = t - (100.0 - CLOSED_PERCENT)
        value, slope = curve(t, 0), curve(t, 1)
        value = value + np.where(left > 0.0, before(left), 0.0) + np.where(t < CLOSED_PERCENT, after(t), 0.0)
        slope = slope + np.where(left > 0.0, before.deriv()(left), 0.0)
        return value, slope + np.where(t < CLOSED_PERCENT, after.deriv()(t), 0.0)

    return evaluate
