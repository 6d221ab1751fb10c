"""Homing fit: the bench in this session, from the pull and release of homing; START, encoder and knee only.

The model's shape is the calibration's; a session may scale its friction and its stretch, shift the encoder zero and
START's offset, and nothing else.

Friction and stretch are estimated relative to homing in the identification's session, since a lumped model estimates
other ones from a loop than END shows. Creep widens a loop, too: it is estimated as a nuisance parameter.
"""

import math
from collections.abc import Generator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from physics import inverse
from physics.calibration import Calibration
from physics.laws import Array

SMOOTHED = 4
"""Control cycles averaged into one point of the fit: START's noise must not turn the friction over."""
TAUT_N = 4.0
STEPS = 6
SOFT_M = 60e-6
"""Residual beyond which a point counts less (Huber): reversals, where the lumped model is poorest."""
EFFECTIVE_SAMPLES = 40.0
"""Effective number of independent samples in one motion of homing."""
_PRIOR: Final = np.array((0.2, 0.04, 1e-2, 2e-6))
"""Standard deviations: friction, stretch, zero (m), creep (m/(N·s))."""
_DIFFERENCES: Final = np.array((0.02, 0.01, 1e-4, 1e-7))
_LOW, _HIGH = np.array((0.3, 0.5, -1.0, -1e-4)), np.array((3.0, 2.0, 1.0, 1e-4))
_NEUTRAL: Final = np.array((1.0, 1.0, 0.0, 0.0))


class HomingFit(NamedTuple):
    """Deviation of this session's bench from the calibration, as homing measured it.

    Friction and stretch as factors, the encoder zero's shift, m, START's reading when slack, N; START's lag beyond the
    calibration's, s.
    """

    friction: float = 1.0
    softness: float = 1.0
    zero_m: float = 0.0
    start_offset_n: float = 0.0
    lag_s: float = 0.0


def smoothed(column: Array, points: int = SMOOTHED) -> Array:
    """Return the means of `points` samples each; a remainder at the end is omitted."""
    return np.asarray(column[: len(column) // points * points].reshape(-1, points).mean(axis=1))


def lag_compensated(column: Array, period_s: float, lag_s: float) -> Array:
    """Return a column with its lag compensated, to the first order."""
    return np.asarray(column + lag_s * np.gradient(column, period_s))


class _Loop(NamedTuple):
    """The loop as the fit sees it: means of `SMOOTHED` control cycles, and which of them are taut."""

    position: Array
    start: Array
    knee: Array
    taut: NDArray[np.bool_]


def adapt(
    calibration: Calibration, period_s: float, position: Array, start: Array, knee: Array, slack_reading_n: float,
    lag_s: float = 0.0,
) -> Generator[None, None, HomingFit]:
    """Fit the session's deviations to one pull and release by Gauss–Newton steps with Huber's weights; columns by
    control cycle, m, N, rad.

    The residual is the rope position by the model for the measured START, less the measured one, where the rope is
    taut. A generator, so that a control cycle runs between its steps; it returns a `HomingFit`.
    """
    step_s = SMOOTHED * period_s
    pull = smoothed((start - slack_reading_n) / calibration.start_gain)
    tension = lag_compensated(pull, step_s, calibration.start_lag + lag_s)
    loop = _Loop(smoothed(position), tension, smoothed(knee), tension > TAUT_N)
    prior, found = np.diag(1.0 / _PRIOR), _NEUTRAL.copy()
    for _ in range(STEPS):
        left = _missed(calibration, step_s, loop, found)
        yield
        slopes = []
        for way, size in zip(np.diag(_DIFFERENCES), _DIFFERENCES, strict=True):
            slopes.append((_missed(calibration, step_s, loop, found + way) - left) / size)
            yield
        by = np.sqrt(np.minimum(1.0, SOFT_M / np.maximum(np.abs(left), 1e-9))) / SOFT_M * math.sqrt(
            min(1.0, EFFECTIVE_SAMPLES / max(left.size, 1)))
        rows = np.vstack([np.column_stack(slopes) * by[:, None], prior])
        wanted = np.concatenate([-left * by, prior @ (_NEUTRAL - found)])
        found = np.clip(found + np.linalg.lstsq(rows, wanted, rcond=None)[0], _LOW, _HIGH)
    friction, softness, zero, _creep = found.tolist()
    return HomingFit(friction / calibration.homed_friction, softness / calibration.homed_softness, zero,
                     slack_reading_n, lag_s)


def _missed(calibration: Calibration, step_s: float, loop: _Loop, found: Array) -> Array:
    """Return the rope position by the model for the measured START, less the measured one, m, where the rope is taut.
    """
    friction, softness, zero, creep = found.tolist()
    law = inverse.law(calibration, step_s, friction, softness)
    end, position = inverse.end_from_start(law, loop.position - zero, loop.start, loop.knee)
    crept = creep * step_s * np.cumsum(end)
    return np.asarray((position + zero + crept - loop.position)[loop.taut])
