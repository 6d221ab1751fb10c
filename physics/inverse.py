"""The force-transfer model that the extended controller inverts: friction in series, pre-sliding, breakaway.

The rule of this file: quasi-static and lumped; one state for the rope in its sheath, one for the fabric on the
knee, each turning over with its own travel.  START → rope (κ) → sheath (c1·s1) → fabric (share w) → knee
(c2·s2) → fabric (1 − w) → END.  The whole stretch without friction is `physics.stretch`'s, less its constant.

Both exponents depend on the tension behind them, 1 + λ·(T/40 N − 1), and on the recent sliding speed,
1 + β·e^(−(v/vs)²), v lagging the speed (Stribeck; Hess and Soom); the rope in its sheath drags besides, c·v, below
a tension T0 in proportion to it: a slack rope does not press on its sheath.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from physics import laws
from physics.calibration import Calibration
from physics.laws import Array
from physics.path_laws import capstan, load_dependence, presliding, slowness
from physics.stretch import SHORT_N, WIDE_N, coefficients

CLOSE_N, CLOSE = 1e-9, 1e-9
"""Convergence limits of the search for a tension, N, and for a slip state."""


class Law(NamedTuple):
    """Scalars of the model: the stretch split into rope and fabric, (11), and the friction's; SI.

    `breakaway_travel` is vs. `drag` is the viscous friction, in full from `taut`, N. `fade` is the share of the
    speed's lag, per sample of the stated period. Beyond `reach`, N, the stretch goes on along its tangent.
    """

    constant: float
    quadratic: float
    linear: float
    short: float
    wide: float
    reach: float
    rope_compliance: float
    share: float
    cable_exponent: float
    rope_travel: float
    fabric_travel: float
    fabric_offset: float
    fabric_slope: float
    rope_per_knee: float
    knee_home: float
    breakaway: float
    fabric_breakaway: float
    breakaway_travel: float
    fade: float
    load_slope: float
    drag: float
    taut: float


class Slip(NamedTuple):
    """The model's memory: slip states −1…1, travels in sheath and on knee, m (NaN at the first), lagging speeds."""

    rope: float = 0.0
    fabric: float = 0.0
    rope_x: float = math.nan
    knee_x: float = math.nan
    rope_speed: float = 0.0
    fabric_speed: float = 0.0


class Path(NamedTuple):
    """Rope motion that a motion and a force require, by sample: m, N, slip states −1…1."""

    position: Array
    start: Array
    rope_slip: Array
    fabric_slip: Array


def law(calibration: Calibration, period_s: float, friction: float = 1.0, softness: float = 1.0) -> Law:
    """Return the model of a calibration for samples of `period_s`, its friction and its stretch scaled to the session.
    """
    constant, quadratic, linear = coefficients(calibration)
    return Law(
        constant=constant,
        quadratic=softness * quadratic,
        linear=softness * (linear - calibration.cable_compliance),
        short=softness * calibration.stretch_short,
        wide=softness * calibration.stretch_wide,
        reach=calibration.reach_n,
        rope_compliance=softness * calibration.cable_compliance,
        share=calibration.fabric_share,
        cable_exponent=friction * calibration.cable_exponent,
        rope_travel=calibration.presliding,
        fabric_travel=calibration.fabric_presliding,
        fabric_offset=friction * calibration.mu2 * calibration.phi0,
        fabric_slope=friction * calibration.mu2 * calibration.fabric_wrap,
        rope_per_knee=calibration.rope_per_knee,
        knee_home=float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT)),
        breakaway=calibration.breakaway,
        fabric_breakaway=calibration.fabric_breakaway,
        breakaway_travel=calibration.stribeck_speed * period_s,
        fade=-math.expm1(-period_s / calibration.stribeck_memory),
        load_slope=calibration.load_slope,
        drag=calibration.viscous / period_s,
        taut=calibration.viscous_tension,
    )


@njit(cache=True)
def elongation(law: Any, force: float) -> Any:
    """Return (stretch of the fabric, m, its slope, m/N) at a tension, N, without the constant."""
    # (10) and the saturating terms of `physics.stretch`; beyond `reach` along the tangent
    at = min(force, law.reach)
    by_short, by_wide = math.exp(-at / SHORT_N), math.exp(-at / WIDE_N)
    slope = law.linear + 2.0 * law.quadratic * at + law.short * by_short + law.wide * by_wide
    whole = ((law.quadratic * at + law.linear) * at + law.short * SHORT_N * (1.0 - by_short)
             + law.wide * WIDE_N * (1.0 - by_wide))
    return whole + slope * (force - at), slope


@njit(cache=True)
def tensed(law: Any, stretched: float, guess: float) -> float:
    """Return the tension, N, of the fabric at the stretch `stretched`, m, by Newton's method from a guess; 0 if it is
    slack."""
    if stretched <= 0.0:
        return 0.0
    force = max(guess, 0.0)
    for _ in range(30):
        whole, slope = elongation(law, force)
        change = (stretched - whole) / slope
        force = max(0.0, force + change)
        if abs(change) < CLOSE_N:
            break
    return force


@njit(cache=True)
def inverse(law: Any, slip: Any, force: float, knee: float) -> Any:
    """Return one sample from END to START: (rope position m, START N, exponents of sheath and knee, slowness of both,
    slip).

    `force` END, N; `knee` rad; `slip` a `Slip`, returned as a plain tuple. ln((START − drag)/END) is the exponents'
    sum.
    """
    rope, fabric, rope_x, knee_x, rope_speed, fabric_speed = slip
    # (7) against the direction of transfer: T = F·e^(s·μ2·φ), s and the Stribeck factor by the fabric's own slip
    on_knee = (1.0 - law.share) * elongation(law, force)[0]
    if not math.isnan(knee_x):
        fabric = presliding(fabric, on_knee - knee_x, law.fabric_travel)
        fabric_speed += law.fade * (on_knee - knee_x - fabric_speed)
    knee_slow = slowness(fabric_speed, law.breakaway_travel)
    by_knee = ((law.fabric_offset + law.fabric_slope * abs(knee)) * fabric * (1.0 + law.fabric_breakaway * knee_slow)
               * load_dependence(law.load_slope, force))
    tension = capstan(force, by_knee)
    # rope in the sheath: (11) and the stretch on both sides of the knee; then (3), and the drag of a taut rope
    in_sheath = law.rope_per_knee * (knee - law.knee_home) + on_knee + law.share * elongation(law, tension)[0]
    moved = 0.0
    if not math.isnan(rope_x):
        moved = in_sheath - rope_x
        rope = presliding(rope, moved, law.rope_travel)
        rope_speed += law.fade * (moved - rope_speed)
    sheath_slow = slowness(rope_speed, law.breakaway_travel)
    by_sheath = (law.cable_exponent * rope * (1.0 + law.breakaway * sheath_slow)
                 * load_dependence(law.load_slope, tension))
    start = capstan(tension, by_sheath) + law.drag * moved * min(1.0, tension / law.taut)
    position = law.constant + in_sheath + law.rope_compliance * start
    return position, start, by_sheath, by_knee, sheath_slow, knee_slow, (
        rope, fabric, in_sheath, on_knee, rope_speed, fabric_speed)


@njit(cache=True)
def held_by_position(law: Any, position: float, knee: float, start: float, drag: float, by_sheath: float) -> Any:
    """Return END tension, N, from the stretch of the fabric, friction aside; NaN if it is not taut.

    `position` is free of the zero's shift; `drag` and `by_sheath` place only the share of the stretch before the
    knee.
    """
    stretched = position - law.constant - law.rope_per_knee * (knee - law.knee_home) - law.rope_compliance * start
    tension = capstan(max(start - drag, 0.0), -by_sheath)
    after = (stretched - law.share * elongation(law, tension)[0]) / (1.0 - law.share)
    if after <= 0.0:
        return math.nan
    return tensed(law, after, tension)


@njit(cache=True)
def _path(law: Any, force: Any, knee: Any, laps: int, out: Any) -> None:
    slip = (0.0, 0.0, math.nan, math.nan, 0.0, 0.0)
    for _lap in range(laps):
        for i in range(force.size):
            position, start, _sheath, _knee, _slow, _slower, slip = inverse(law, slip, force[i], knee[i])
            out[0, i], out[1, i], out[2, i], out[3, i] = position, start, slip[0], slip[1]


@njit(cache=True)
def _end_from_start(law: Any, position: Any, start: Any, knee: Any, end: Any, predicted: Any) -> None:
    rope, fabric, knee_x, rope_speed, fabric_speed, force = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    before = position[0] - law.rope_compliance * start[0]
    for i in range(start.size):
        in_sheath = position[i] - law.rope_compliance * start[i]
        moved = in_sheath - before
        before = in_sheath
        rope = presliding(rope, moved, law.rope_travel)
        rope_speed += law.fade * (moved - rope_speed)
        grip = law.cable_exponent * rope * (1.0 + law.breakaway * slowness(rope_speed, law.breakaway_travel))
        pulled = max(start[i] - law.drag * moved * min(1.0, max(start[i], 0.0) / law.taut), 0.0)
        tension = capstan(pulled, -grip)
        for _ in range(2):
            tension = capstan(pulled, -grip * load_dependence(law.load_slope, tension))
        whole = (law.fabric_offset + law.fabric_slope * abs(knee[i])) * (
            1.0 + law.fabric_breakaway * slowness(fabric_speed, law.breakaway_travel))
        # the fabric's slip depends on END, which depends on the slip: regula falsi with Illinois' halving
        low, high, at_low, at_high, side = -1.0, 1.0, 2.0, -2.0, 0
        slip = fabric
        for _step in range(40):
            to_end = math.exp(-whole * slip)
            force = tension * math.exp(-whole * slip * load_dependence(law.load_slope, tension * to_end))
            on_knee = (1.0 - law.share) * elongation(law, force)[0]
            left = presliding(fabric, on_knee - knee_x, law.fabric_travel) - slip
            if abs(left) < CLOSE:
                break
            if left > 0.0:
                low, at_low = slip, left
                at_high = 0.5 * at_high if side > 0 else at_high
                side = 1
            else:
                high, at_high = slip, left
                at_low = 0.5 * at_low if side < 0 else at_low
                side = -1
            slip = (low * at_high - high * at_low) / (at_high - at_low)
        fabric_speed += law.fade * (on_knee - knee_x - fabric_speed)
        fabric, knee_x = slip, on_knee
        end[i] = force
        predicted[i] = (law.constant + law.rope_per_knee * (knee[i] - law.knee_home) + on_knee
                        + law.share * elongation(law, tension)[0] + law.rope_compliance * start[i])


def path(law: Law, desired: Array, knee: Array, laps: int = 2) -> Path:
    """Return the rope motion that gives `desired` (N) at END with the knee at `knee` (rad), periodic after `laps`."""
    out = np.zeros((4, desired.size))
    _path(law, desired, knee, laps, out)
    return Path(*out)


@njit(cache=True)
def _loss(law: Any, force: Any, knee: Any, drag: Any, exponent: Any) -> None:
    slip = (0.0, 0.0, math.nan, math.nan, 0.0, 0.0)
    for i in range(force.size):
        _position, start, by_sheath, by_knee, _slow, _slower, slip = inverse(law, slip, force[i], knee[i])
        exponent[i] = by_sheath + by_knee
        drag[i] = start - force[i] * math.exp(exponent[i])


def loss(law: Law, force: Array, knee: Array) -> tuple[Array, Array]:
    """Return the rope's drag in START, N, and ln((START − drag)/END) by sample, for END `force`, N, and `knee`, rad."""
    drag, exponent = np.zeros(force.size), np.zeros(force.size)
    _loss(law, force, knee, drag, exponent)
    return drag, exponent


def end_from_start(law: Law, position: Array, start: Array, knee: Array) -> tuple[Array, Array]:
    """Return END tension, N, and rope position, m, by the model for a measured START; slips begin at zero.

    `start` must be smooth: its noise would turn the friction over.
    """
    end, predicted = np.zeros(start.size), np.zeros(start.size)
    _end_from_start(law, position, start, knee, end, predicted)
    return end, predicted


def prepare() -> None:
    """Compile the functions of the control cycle, or load them from numba's cache."""
    some = law(Calibration(), 1e-3)
    inverse(some, Slip(), 1.0, -0.5)
    inverse(some, tuple(Slip()), 1.0, -0.5)
    held_by_position(some, 0.01, -0.5, 10.0, 0.0, 0.2)
    end_from_start(some, np.zeros(2), np.zeros(2), np.zeros(2))
