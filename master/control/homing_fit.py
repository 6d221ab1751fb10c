"""What today's bench is, from the pull and release of homing: START, encoder and knee only.

The rule of this file: the model's shape is the calibration's; a day may scale its friction and its stretch, shift
the encoder zero and START's offset, and nothing else.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from physics import inverse
from physics.calibration import Calibration

Array = NDArray[np.float64]

SMOOTHED = 4
"""Control cycles averaged into one point of the fit: START's noise must not turn the friction over."""
TAUT_N = 4.0
STEPS = 6
SOFT_M = 60e-6
"""Residual beyond which a point counts less (Huber): reversals, where the lumped model is poorest."""
_DIFFERENCES = (0.02, 0.01)


class HomingFit(NamedTuple):
    """Friction and stretch against the calibration's, the encoder zero's shift (m), START's reading when slack (N)."""

    friction: float = 1.0
    softness: float = 1.0
    zero_m: float = 0.0
    start_offset_n: float = 0.0


def smoothed(column: Array, points: int = SMOOTHED) -> Array:
    """Means of `points` samples each; what is left over at the end is dropped."""
    return np.asarray(column[: len(column) // points * points].reshape(-1, points).mean(axis=1))


def led(column: Array, period_s: float, lag_s: float) -> Array:
    """A column as it would read without its lag, to the first order."""
    return np.asarray(column + lag_s * np.gradient(column, period_s))


def adapt(
    calibration: Calibration, period_s: float, position: Array, start: Array, knee: Array, slack_reading_n: float
) -> Generator[None, None, HomingFit]:
    """Fit the day to one pull and release by Gauss–Newton; columns by control cycle, m, N, rad.

    The residual is the rope position that the model puts behind the measured START, where the rope is taut.
    A generator, so that a control cycle can go on between its steps; it returns the day.
    """
    points = SMOOTHED
    x, angle = smoothed(position, points), smoothed(knee, points)
    tension = led(smoothed((start - slack_reading_n) / calibration.start_gain, points), points * period_s,
                  calibration.start_lag)
    taut = tension > TAUT_N

    def residual(friction: float, softness: float) -> Array:
        law = inverse.law(calibration, points * period_s, friction, softness)
        return np.asarray((inverse.end_from_start(law, x, tension, angle)[1] - x)[taut])

    friction, softness, zero = 1.0, 1.0, 0.0
    for _ in range(STEPS):
        left = residual(friction, softness) + zero
        yield
        by_friction = (residual(friction + _DIFFERENCES[0], softness) + zero - left) / _DIFFERENCES[0]
        yield
        by_softness = (residual(friction, softness + _DIFFERENCES[1]) + zero - left) / _DIFFERENCES[1]
        yield
        weight = np.sqrt(np.minimum(1.0, SOFT_M / np.maximum(np.abs(left), 1e-9)))
        slopes = np.column_stack([by_friction, by_softness, np.ones_like(left)]) * weight[:, None]
        change = np.linalg.lstsq(slopes, -left * weight, rcond=None)[0]
        friction = float(np.clip(friction + change[0], 0.3, 3.0))
        softness = float(np.clip(softness + change[1], 0.5, 2.0))
        zero += float(change[2])
    return HomingFit(friction, softness, zero, slack_reading_n)
