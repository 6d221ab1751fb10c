"""The force-transfer model that the extended controller inverts: friction in series, pre-sliding, breakaway.

The rule of this file: quasi-static and lumped; one state for the rope in its sheath, one for the fabric on the
knee, each turning over with its own travel.  START → rope (κ) → sheath (c1·s1) → fabric (share w) → knee
(c2·s2) → fabric (1 − w) → END.  The whole stretch without friction is (10), less its constant.  What slides slowly
grips harder: both exponents grow by 1 + β·e^(−(v/vs)²), v lagging the sliding speed (Stribeck; Hess and Soom).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from physics import laws
from physics.calibration import Calibration

Array = NDArray[np.float64]


class Law(NamedTuple):
    """Scalars of the model: (10) split into rope and fabric, (11), and the friction's; SI.

    `breakaway_travel` is vs and `fade` the share of the lag, per sample of the period that the law was made for.
    """

    constant: float
    quadratic: float
    linear: float
    rope_compliance: float
    share: float
    cable_exponent: float
    rope_travel: float
    fabric_travel: float
    fabric_offset: float
    fabric_slope: float
    swing_k: float
    knee_home: float
    breakaway: float
    breakaway_travel: float
    fade: float


class Slip(NamedTuple):
    """The model's memory: slip states −1…1, travels in sheath and on knee, m (NaN at the first), lagging speeds."""

    rope: float = 0.0
    fabric: float = 0.0
    rope_x: float = math.nan
    knee_x: float = math.nan
    rope_speed: float = 0.0
    fabric_speed: float = 0.0


class Path(NamedTuple):
    """What a motion and a force ask of the rope, by sample: m, N, slip states −1…1."""

    position: Array
    start: Array
    rope_slip: Array
    fabric_slip: Array


def law(calibration: Calibration, period_s: float, friction: float = 1.0, softness: float = 1.0) -> Law:
    """The model of a calibration by samples of `period_s`, its friction and its stretch scaled to the day."""
    return Law(
        constant=calibration.stiffness_c,
        quadratic=softness * calibration.stiffness_a,
        linear=softness * (calibration.stiffness_b - calibration.cable_compliance),
        rope_compliance=softness * calibration.cable_compliance,
        share=calibration.fabric_share,
        cable_exponent=friction * calibration.cable_exponent,
        rope_travel=calibration.presliding,
        fabric_travel=calibration.fabric_presliding,
        fabric_offset=friction * calibration.fabric_friction * calibration.wrap_offset,
        fabric_slope=friction * calibration.fabric_friction * calibration.wrap_slope,
        swing_k=calibration.swing_k,
        knee_home=float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT)),
        breakaway=calibration.breakaway,
        breakaway_travel=calibration.breakaway_speed * period_s,
        fade=min(1.0, period_s / calibration.breakaway_memory),
    )


def adapted(law: Law, friction: float, breakaway: float) -> Law:
    """The law with its exponents scaled by `friction`, and another breakaway."""
    return law._replace(
        cable_exponent=friction * law.cable_exponent, fabric_offset=friction * law.fabric_offset,
        fabric_slope=friction * law.fabric_slope, breakaway=breakaway)


@njit(cache=True)
def turned(state: float, travel: float, length: float) -> float:
    """Pre-sliding state after `travel`, m: ds/dx = (1 − s·sgn v)/δ, integrated exactly."""
    if travel == 0.0:
        return state
    goal = 1.0 if travel > 0.0 else -1.0
    return goal - (goal - state) * math.exp(-abs(travel) / length)


@njit(cache=True)
def slowness(speed: float, scale: float) -> float:
    """e^(−(v/vs)²), both per sample."""
    return math.exp(-((speed / scale) ** 2))


@njit(cache=True)
def inverse(law: Any, slip: Any, force: float, knee: float) -> Any:
    """One sample from END to START: (rope position m, START N, exponents of sheath and knee, slowness of both, slip).

    `force` END, N; `knee` rad; `slip` a `Slip`, returned as a plain tuple.  ln(START/END) is the exponents' sum.
    """
    (constant, quadratic, linear, rope_compliance, share, cable_exponent, rope_travel, fabric_travel,
     fabric_offset, fabric_slope, swing_k, knee_home, breakaway, breakaway_travel, fade) = law
    rope, fabric, rope_x, knee_x, rope_speed, fabric_speed = slip
    on_knee = (1.0 - share) * (quadratic * force + linear) * force
    if not math.isnan(knee_x):
        fabric = turned(fabric, on_knee - knee_x, fabric_travel)
        fabric_speed += fade * (on_knee - knee_x - fabric_speed)
    knee_slow = slowness(fabric_speed, breakaway_travel)
    by_knee = (fabric_offset + fabric_slope * abs(knee)) * fabric * (1.0 + breakaway * knee_slow)
    tension = force * math.exp(by_knee)
    in_sheath = swing_k * (knee - knee_home) + on_knee + share * (quadratic * tension + linear) * tension
    if not math.isnan(rope_x):
        rope = turned(rope, in_sheath - rope_x, rope_travel)
        rope_speed += fade * (in_sheath - rope_x - rope_speed)
    sheath_slow = slowness(rope_speed, breakaway_travel)
    by_sheath = cable_exponent * rope * (1.0 + breakaway * sheath_slow)
    start = tension * math.exp(by_sheath)
    position = constant + in_sheath + rope_compliance * start
    return position, start, by_sheath, by_knee, sheath_slow, knee_slow, (
        rope, fabric, in_sheath, on_knee, rope_speed, fabric_speed)


@njit(cache=True)
def held_by_position(law: Any, position: float, knee: float, start: float, by_sheath: float) -> Any:
    """END tension, N, that the stretch of the fabric tells, friction aside; NaN where it is not taut.

    `position` is free of the zero's shift; `by_sheath` places only the share of the stretch before the knee.
    """
    constant, quadratic, linear, rope_compliance, share = law[:5]
    swing_k, knee_home = law[10], law[11]
    stretch = position - constant - swing_k * (knee - knee_home) - rope_compliance * start
    tension = start * math.exp(-by_sheath)
    after = (stretch - share * (quadratic * tension + linear) * tension) / (1.0 - share)
    inside = linear * linear + 4.0 * quadratic * after
    if after <= 0.0 or inside <= 0.0:
        return math.nan
    if quadratic == 0.0:
        return after / linear
    return (math.sqrt(inside) - linear) / (2.0 * quadratic)


@njit(cache=True)
def _path(law: Any, force: Any, knee: Any, laps: int, out: Any) -> None:
    slip = (0.0, 0.0, math.nan, math.nan, 0.0, 0.0)
    for _lap in range(laps):
        for i in range(force.size):
            position, start, _sheath, _knee, _slow, _slower, slip = inverse(law, slip, force[i], knee[i])
            out[0, i], out[1, i], out[2, i], out[3, i] = position, start, slip[0], slip[1]


@njit(cache=True)
def _end_from_start(law: Any, position: Any, start: Any, knee: Any, end: Any, predicted: Any) -> None:
    (constant, quadratic, linear, rope_compliance, share, cable_exponent, rope_travel, fabric_travel,
     fabric_offset, fabric_slope, swing_k, knee_home, breakaway, breakaway_travel, fade) = law
    rope, fabric, knee_x, rope_speed, fabric_speed = 0.0, 0.0, 0.0, 0.0, 0.0
    before = position[0] - rope_compliance * start[0]
    for i in range(start.size):
        in_sheath = position[i] - rope_compliance * start[i]
        rope = turned(rope, in_sheath - before, rope_travel)
        rope_speed += fade * (in_sheath - before - rope_speed)
        before = in_sheath
        grip = 1.0 + breakaway * slowness(rope_speed, breakaway_travel)
        tension = max(start[i], 0.0) * math.exp(-cable_exponent * rope * grip)
        exponent = (fabric_offset + fabric_slope * abs(knee[i])) * (
            1.0 + breakaway * slowness(fabric_speed, breakaway_travel))
        low, high = -1.0, 1.0
        for _halving in range(24):
            slip = 0.5 * (low + high)
            force = tension * math.exp(-exponent * slip)
            moved = (1.0 - share) * (quadratic * force + linear) * force
            if turned(fabric, moved - knee_x, fabric_travel) > slip:
                low = slip
            else:
                high = slip
        fabric_speed += fade * (moved - knee_x - fabric_speed)
        fabric, knee_x = slip, moved
        end[i] = force
        predicted[i] = (constant + swing_k * (knee[i] - knee_home) + moved
                        + share * (quadratic * tension + linear) * tension + rope_compliance * start[i])


def path(law: Law, desired: Array, knee: Array, laps: int = 2) -> Path:
    """What gives `desired` (N) at END with the knee at `knee` (rad), by sample, periodic after `laps`."""
    out = np.zeros((4, desired.size))
    _path(law, desired, knee, laps, out)
    return Path(*out)


def end_from_start(law: Law, position: Array, start: Array, knee: Array) -> tuple[Array, Array]:
    """END tension, N, and rope position, m, that the model puts behind a measured START; slips begin at zero.

    `start` must be smooth: its noise would turn the friction over.
    """
    end, predicted = np.zeros(start.size), np.zeros(start.size)
    _end_from_start(law, position, start, knee, end, predicted)
    return end, predicted


def prepare() -> None:
    """Compile what the control cycle calls, or load it from numba's cache."""
    some = law(Calibration(), 1e-3)
    inverse(some, Slip(), 1.0, -0.5)
    inverse(some, tuple(Slip()), 1.0, -0.5)
    held_by_position(some, 0.01, -0.5, 10.0, 0.2)
    end_from_start(some, np.zeros(2), np.zeros(2), np.zeros(2))
