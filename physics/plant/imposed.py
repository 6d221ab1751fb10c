"""The rope path under a measured motion of drum and leg; both tensions are simulated.

The rule of this file: it is the plant's own chain (`chain`, `components`) without drives and without the leg's
mechanics; node 0 and the anchor follow cubic splines through the samples, in steps of `STEP_S` at most.
"""

import math
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from parameters import InputError
from physics.laws import Array
from physics.plant import step
from physics.plant.chain import creep, refresh_friction, slide, tensions
from physics.plant.components import GRAVITY, anchor
from physics.plant.derived import derive, settle
from physics.plant.modulated import extend, modulate
from physics.plant.state_layout import CABLE_NODES, NODES, SIZE, SLOT, PlantParameters
from physics.plant.step import SLOW, digest
from physics.terms import Term

STEP_S: Final = 2.0 * step.STEP_S
"""Longest step, s. Without drives the chain has the fastest mode; it turns by one radian in this step (twice
`derived.TURN`), of the two that an explicit step allows."""
CUTOFF_HZ: Final = 60.0
"""Cut-off of the zero-phase low-pass on the measured motion, Hz: pre-sliding would treat the encoder's noise as motion.
"""
REST_S: Final = 0.2
"""Time, s, in which the rope comes to rest before the first sample: its earlier motion is unknown."""


class Tensions(NamedTuple):
    """Simulated tensions at each sample, N: true tensions at START and END, END's cantilevered mass included."""

    start_n: Array
    end_n: Array


@njit(inline="always")
def _placed(m: Any, drum: float, drum_v: float, knee: float, knee_w: float) -> float:
    """Put node 0 and the anchor at their measured positions; return the velocity of the knee's surface, m/s."""
    m[SLOT.x], m[SLOT.v] = drum, drum_v
    m[SLOT.servo_x], m[SLOT.servo_v], m[SLOT.leg_q] = drum, drum_v, knee
    if m[SLOT.eccentricity_m] != 0.0:
        radius = m[SLOT.drum_radius_m]
        turn = (drum + m[SLOT.encoder_zero_m]) / radius + m[SLOT.eccentricity_rad]
        m[SLOT.x] += m[SLOT.eccentricity_m] * (math.sin(turn) - math.sin(m[SLOT.eccentricity_rad]))
        m[SLOT.v] += drum_v * m[SLOT.eccentricity_m] / radius * math.cos(turn)
    lever = m[SLOT.rope_per_knee] + 2.0 * m[SLOT.rope_per_knee_quadratic] * knee
    m[SLOT.x + NODES + 1] = anchor(m[SLOT.rope_per_knee], m[SLOT.rope_per_knee_quadratic], knee)
    m[SLOT.v + NODES + 1] = lever * knee_w
    return float(lever * knee_w)


@njit(inline="always")
def _moved(m: Any, surface: float, knee: float, n: int, dt: float) -> None:
    """Advance the cable nodes between the two driven ends by one step."""
    if n % SLOW == 0:
        drift = max(0.05, 1.0 + m[SLOT.friction_drift] * n * dt / m[SLOT.friction_drift_s])
        modulate(m, n * dt, SLOW * dt)
        refresh_friction(m, abs(knee), surface, drift, SLOW * dt)
        creep(m, SLOW * dt)
    tensions(m)
    slide(m, 1, CABLE_NODES + 1, 0.0, dt)
    slide(m, CABLE_NODES + 1, NODES + 1, surface, dt)


def _compile(sources: int) -> Any:
    @njit(cache=True, error_model="numpy")
    def run(m: Any, time: Any, rope: Any, leg: Any, rest: int, start: Any, end: Any) -> None:
        _ = sources
        surface = _placed(m, rope[3, 0], 0.0, leg[3, 0], 0.0)
        for i in range(1, NODES + 1):
            m[SLOT.x + i] = m[SLOT.x] + (m[SLOT.x + NODES + 1] - m[SLOT.x]) * i / (NODES + 1)
        for n in range(rest):
            _moved(m, surface, leg[3, 0], 0 if n % SLOW == 0 else 1, STEP_S)
        done = 0
        for k in range(time.size):
            j = min(k, time.size - 2)
            u = time[k] - time[j]
            q = leg[3, j] + u * (leg[2, j] + u * (leg[1, j] + u * leg[0, j]))
            swing = 2.0 * leg[1, j] + 6.0 * leg[0, j] * u
            start[k] = m[SLOT.term_start_gain] * m[SLOT.tension] + m[SLOT.term_start_n]
            carried = m[SLOT.end_mass_kg] * (GRAVITY * math.cos(q) + m[SLOT.end_mass_arm_m] * swing)
            end[k] = m[SLOT.term_end_gain] * (m[SLOT.tension + NODES] + carried) + m[SLOT.term_end_n]
            if k == time.size - 1:
                break
            span = time[k + 1] - time[k]
            steps = max(1, math.ceil(span / STEP_S - 1e-6))
            dt = span / steps
            for i in range(1, steps + 1):
                u = i * dt
                x = rope[3, k] + u * (rope[2, k] + u * (rope[1, k] + u * rope[0, k]))
                v = rope[2, k] + u * (2.0 * rope[1, k] + 3.0 * u * rope[0, k])
                q = leg[3, k] + u * (leg[2, k] + u * (leg[1, k] + u * leg[0, k]))
                w = leg[2, k] + u * (2.0 * leg[1, k] + 3.0 * u * leg[0, k])
                surface = _placed(m, x, v, q, w)
                _moved(m, surface, q, done, dt)
                done += 1

    return run


_run: Final[Any] = _compile(digest() ^ zlib.crc32(Path(__file__).read_bytes()))


class ImposedMotion(NamedTuple):
    """A measured motion as it is followed: stamps, s; cubic splines through drum, m, and knee, rad, each (4, n − 1)."""

    time: Array
    rope: Array
    knee: Array


def motion(time_s: Array, servo_position_m: Array, knee_angle_rad: Array) -> ImposedMotion:
    """Return the motion through the samples.

    Raises `InputError` where the samples are fewer than four, not in order of time, or not finite.
    """
    time, rope, knee = (np.ascontiguousarray(v, dtype=np.float64) for v in (time_s, servo_position_m, knee_angle_rad))
    if time.size < 4 or not np.isfinite(time).all() or (np.diff(time) <= 0.0).any():
        raise InputError("simulate: time_s must hold four rising values at least; mend the time column.")
    for name, values in (("servo_position_m", rope), ("knee_angle_rad", knee)):
        if not np.isfinite(values).all():
            raise InputError(f"simulate: {name} is not a number at row {int(np.argmin(np.isfinite(values))) + 2}; "
                             "fill it in or cut the trial there.")
    return ImposedMotion(time, _spline(time, rope), _spline(time, knee))


def simulate(parameters: PlantParameters, moved: ImposedMotion, terms: Sequence[Term] = ()) -> Tensions:
    """Return both tensions, N, that the simulated bench of `parameters` has under a measured motion, one per sample.

    Terms of sensors act on the tensions, too.
    """
    memory = np.zeros(SIZE)
    derive(memory, parameters)
    settle(memory, parameters)
    extend(memory, terms, "simulate")
    start, end = np.empty(moved.time.size), np.empty(moved.time.size)
    rope = moved.rope.copy()
    rope[3] -= parameters.encoder_zero_m
    _run(memory, moved.time, rope, moved.knee, round(REST_S / STEP_S), start, end)
    return Tensions(start, end)


def _spline(time: Array, values: Array) -> Array:
    """Return the coefficients (4, n − 1) of the cubic spline through the samples behind the low-pass."""
    step = float(np.median(np.diff(time)))
    if CUTOFF_HZ * step < 0.4 and values.size > 64:
        values = sosfiltfilt(butter(2, 2.0 * CUTOFF_HZ * step, output="sos"), values)
    return np.ascontiguousarray(CubicSpline(time, values).c)
