"""What today's bench is, from the motions of homing: START, encoder and knee only.

The rule of this file: the model's shape is the calibration's; a day may scale its friction in the sheath and on the
knee and its stretch, shift the encoder zero and START's offset, wear play into the knee, and nothing else.

A pull and a release tell the friction, against what they told on the day of the identification.  A swing of the knee
under a held START tells play from friction by a second one under another tension: friction grows with it.  Play that
is smaller under the larger tension is a gap that the load closes, and none to lead a taut rope by.  Creep makes a
loop wider, too, and a swing has a friction of its own: both are estimated, and let go of.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from typing import Final, NamedTuple

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
WHOLE = 40.0
"""Points of one motion that are worth as many independent ones."""
SETTLED_M = 1.5e-3
"""Rope that a swing moves before it is known which way everything slides."""
_LOOP: Final = (0.2, 0.04, 1e-2, 2e-6, 1e-9, 1e-9, 1e-9)
_SWINGS: Final = (1e-9, 1e-9, 5e-4, 2e-6, 0.15, 6e-3, 6e-3)
"""Standard deviations: friction, stretch, zero (m), creep (m/(N·s)), friction of a swing, play in each of them (rad).

The loop's for a day; the swings' about what the loop told.
"""
_DIFFERENCES: Final = (0.02, 0.01, 1e-4, 1e-7, 0.02, 1e-3, 1e-3)
_LOW: Final = np.array([0.3, 0.5, -1.0, -1e-4, 0.5, 0.0, 0.0])
_HIGH: Final = np.array([3.0, 2.0, 1.0, 1e-4, 2.0, 0.02, 0.02])
_NEUTRAL: Final = np.array([1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
_PLAY: Final = 5
LEAST_PLAY_RAD: Final = 1.5e-3
"""Play below which none is led by: what the fit makes of a bench without any."""


class HomingFit(NamedTuple):
    """Today against the calibration.

    Friction and stretch as factors, the encoder zero's shift, m, START's reading when slack, N; play at the knee, rad,
    and START's lag beyond the calibration's, s.
    """

    friction: float = 1.0
    softness: float = 1.0
    zero_m: float = 0.0
    start_offset_n: float = 0.0
    play_rad: float = 0.0
    lag_s: float = 0.0


class Motion(NamedTuple):
    """One motion of homing by control cycle, m, N, rad; `sliding`: the slip states that it begins with, −1…1."""

    position: Array
    start: Array
    knee: Array
    sliding: float = 0.0


def smoothed(column: Array, points: int = SMOOTHED) -> Array:
    """Means of `points` samples each; what is left over at the end is dropped."""
    return np.asarray(column[: len(column) // points * points].reshape(-1, points).mean(axis=1))


def led(column: Array, period_s: float, lag_s: float) -> Array:
    """A column as it would read without its lag, to the first order."""
    return np.asarray(column + lag_s * np.gradient(column, period_s))


class _Points(NamedTuple):
    """A motion as the fit sees it: means of `SMOOTHED` control cycles, which of them count, and the play's place."""

    position: Array
    start: Array
    knee: Array
    sliding: float
    counted: NDArray[np.bool_]
    play: int


def adapt(
    calibration: Calibration, period_s: float, motions: Sequence[Motion], slack_reading_n: float, lag_s: float = 0.0
) -> Generator[None, None, HomingFit]:
    """Fit the day to the motions of homing: the pull and release, then two swings, or none.

    The residual is the rope position that the model puts behind the measured START, where the rope is taut.
    A generator, so that a control cycle can go on between its steps; it returns the day.
    """
    step_s = SMOOTHED * period_s
    loop, *swings = [_points(calibration, step_s, motion, slack_reading_n, lag_s, _PLAY + max(i - 1, 0))
                     for i, motion in enumerate(motions)]
    found = yield from _fitted(calibration, step_s, [loop], _NEUTRAL, _LOOP)
    friction, softness, zero = found[:3].tolist()
    play = 0.0
    if swings:
        swung = yield from _fitted(calibration, step_s, swings, found, _SWINGS)
        play = float(swung[_PLAY:].min())
    return HomingFit(friction / calibration.homed_friction, softness, zero, slack_reading_n,
                     play if play > LEAST_PLAY_RAD else 0.0, lag_s)


def _fitted(
    calibration: Calibration, step_s: float, points: Sequence[_Points], expected: Array, doubts: Sequence[float]
) -> Generator[None, None, Array]:
    """The day's unknowns by Gauss–Newton with Huber's weights, about the expected ones."""
    prior = np.diag([1.0 / doubt for doubt in doubts])
    free = [i for i, doubt in enumerate(doubts) if doubt > 1e-8]
    found = expected.copy()
    for _ in range(STEPS):
        rows, wanted = [prior], [prior @ (expected - found)]
        for each in points:
            left = _missed(calibration, step_s, each, found)
            slopes = np.zeros((left.size, found.size))
            for i in free:
                way = np.zeros(found.size)
                way[i] = _DIFFERENCES[i]
                slopes[:, i] = (_missed(calibration, step_s, each, found + way) - left) / _DIFFERENCES[i]
                yield
            by = np.sqrt(np.minimum(1.0, SOFT_M / np.maximum(np.abs(left), 1e-9))) / SOFT_M * math.sqrt(
                min(1.0, WHOLE / max(left.size, 1)))
            rows.append(slopes * by[:, None])
            wanted.append(-left * by)
        change = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)[0]
        found = np.clip(found + change, _LOW, _HIGH)
    return found


def _points(
    calibration: Calibration, step_s: float, motion: Motion, slack_reading_n: float, lag_s: float, play: int
) -> _Points:
    position, knee = smoothed(motion.position), smoothed(motion.knee)
    start = led(smoothed((motion.start - slack_reading_n) / calibration.start_gain), step_s,
                calibration.start_lag + lag_s)
    moved = np.cumsum(np.abs(np.diff(position, prepend=position[:1])))
    counted = (start > TAUT_N) & ((moved > SETTLED_M) if motion.sliding else True)
    return _Points(position, start, knee, motion.sliding, counted, play)


def _missed(calibration: Calibration, step_s: float, points: _Points, found: Array) -> Array:
    """Rope position that the model puts behind START, less the measured one, m, at the points that count."""
    friction, softness, zero, creep, swung = found[:_PLAY].tolist()
    law = inverse.law(calibration, step_s, friction * (swung if points.sliding else 1.0), softness)
    leg = inverse.followed(points.knee, max(0.0, float(found[points.play])) if points.sliding else 0.0)
    end, position = inverse.end_from_start(law, points.position - zero, points.start, leg, points.sliding)
    crept = creep * step_s * np.cumsum(end)
    return np.asarray((position + zero + crept - points.position)[points.counted])
