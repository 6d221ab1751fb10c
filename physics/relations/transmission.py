"""Relations of the transmission: `friction`, `elasticity` and `kinematics` between measured signals.

The rule of this file: each law predicts one measured signal from others, through (3), (7), (10) and (11).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from physics import memory_laws as states
from physics.laws import MILLI, STIFFNESS_A_MM_N2, STIFFNESS_B_MM_N, Array
from physics.plant.leg import KNEE_AT_FIT
from physics.relations import tension_chain as chain
from physics.relations.measured import Signals, end_tension, leg_angle, start_reading, start_tension

Values = Mapping[str, float]

STRETCH_LINEAR: Final = STIFFNESS_B_MM_N * MILLI
STRETCH_BEND: Final = STIFFNESS_A_MM_N2 * MILLI
UNSURE_N: Final = 1.0
"""Tension below which a sensor's word does not decide whether a rope that is dragged is taut."""
CALM_S: Final = 0.012
"""1σ of the low-pass on the tension whose stretch slides the fabric; the friction at its nodes sees it unfiltered."""
SHARES: Final = (chain.SHARE_AFTER, chain.SHARE_OVER, 1.0 - chain.SHARE_AFTER - chain.SHARE_OVER)
"""Shares of the fabric behind, on and before the knee."""


def cable_exponent(signals: Signals, p: Values) -> Array:
    """Return μ1·θ1 at each sample, with bend and drift."""
    whole = np.full(signals.progress.size, p["mu1"] * p["theta1"])
    if p["cable_bend"] != 0.0 and signals.has("knee_angle_rad"):
        whole *= 1.0 + p["cable_bend"] * np.abs(signals["knee_angle_rad"])
    return whole * (1.0 + p["friction_drift"] * signals.progress)


def fabric_exponent(signals: Signals, p: Values) -> Array:
    """Return μ2·φ at each sample: φ = φ0 + κ·|θk|."""
    wrap = np.full(signals.progress.size, p["phi0"])
    if signals.has("knee_angle_rad"):
        wrap += p["fabric_wrap"] * np.abs(signals["knee_angle_rad"])
    exponent: Array = p["mu2"] * np.maximum(wrap, 0.0) * (1.0 + p["friction_drift"] * signals.progress)
    return exponent


def _stretch(p: Values) -> tuple[float, float]:
    """Return linear and quadratic coefficient of (10)."""
    return STRETCH_LINEAR / p["stiffness_scale"], STRETCH_BEND * (1.0 + p["stiffness_shape"]) / p["stiffness_scale"]


def cable_compliance(p: Values) -> float:
    """Return the rope's own compliance before the friction, m/N: its share of (10)'s linear coefficient."""
    return p["cable_share"] * STRETCH_LINEAR / p["stiffness_scale"]


def start_from_end(signals: Signals, p: Values) -> Array:
    """Return the START reading, N, that the tension at END and the rope's motion give."""
    start, slip = signals.remember(_along, p)
    if p["coulomb"] != 0.0:
        start = start + p["coulomb"] * slip
    return start_reading(signals, p, _undecided(signals, p, start, _with_drag(signals, p, start)))


def before_knee(signals: Signals, p: Values) -> Array:
    """Return the tension before the knee, N, from that at END and the fabric's friction."""
    if p["mu2"] == 0.0:
        return end_tension(signals, p)
    return signals.remember(_before_knee, p)


def _before_knee(signals: Signals, p: Values) -> Array:
    end = end_tension(signals, p)
    linear, bend = _stretch(p)
    crept = _creep(signals, p, end) if p["creep_compliance"] > 0.0 else np.zeros(end.size)
    return np.asarray(chain.over_fabric(
        end, _calm(signals, end), fabric_exponent(signals, p), crept, signals["time_s"], signals.fresh,
        max(linear - cable_compliance(p), 1e-9), bend, _toe(p), p["presliding"] * p["fabric_presliding_ratio"],
        p["presliding_shape"], *_law(p)))


def _calm(signals: Signals, tension: Array) -> Array:
    """Return a tension without what is quicker than `CALM_S`: a sensor's noise slides no fabric."""
    samples = CALM_S / float(np.median(np.diff(signals["time_s"])))
    return np.asarray(gaussian_filter1d(tension, samples)) if samples > 0.5 else tension


def _moved(signals: Signals, p: Values, name: str) -> Array:
    """Return a motion as it was when the tensions were true that are stamped now."""
    return signals.later(signals[name], -p["timestamp_skew"])


def _law(p: Values) -> tuple[float, float, float, float, float]:
    return p["load_slope"], p["stribeck_ratio"], p["stribeck_speed"], p["stribeck_memory"], p["slack_below"]


def _along(signals: Signals, p: Values) -> tuple[Array, Array]:
    """Return START tension, N, and the rope's mean slip state."""
    start, slip = chain.along_cable(
        before_knee(signals, p), p["pull_sign"] * _moved(signals, p, "rope_m"), cable_exponent(signals, p),
        signals["time_s"], signals.fresh, p["presliding"], p["presliding_shape"],
        p["cable_share_before"] * cable_compliance(p), *_law(p), p["tension_ratio"])
    return start, slip


def _with_drag(signals: Signals, p: Values, start: Array) -> Array:
    """Add the rope's viscous drag while it is taut; a rope that can be slack never pushes."""
    if p["viscous"] == 0.0:
        return start
    taut = np.clip(start / 0.5, 0.0, 1.0) if p["slack_below"] > 0.0 else 1.0
    dragged = start + p["viscous"] * signals["rope_m_s"] * taut
    return np.maximum(dragged, np.minimum(start, 0.0)) if p["slack_below"] > 0.0 else np.asarray(dragged)


def _undecided(signals: Signals, p: Values, start: Array, dragged: Array) -> Array:
    """Return START tension, N, `dragged` or not as START itself says, where END cannot say whether the rope is taut.

    The drag at the edge of slack is anything from none to all of it: the relation holds where START is in between.
    """
    if p["viscous"] == 0.0 or p["slack_below"] <= 0.0 or not signals.has("tension_start_n"):
        return dragged
    taut = np.maximum(start + p["viscous"] * signals["rope_m_s"], np.minimum(start, 0.0))
    said = np.clip(start_tension(signals, p), np.minimum(start, taut), np.maximum(start, taut))
    return np.where(start < UNSURE_N, said, dragged)


def _creep(signals: Signals, p: Values, force: Array) -> Array:
    return states.crept(force, signals["time_s"], signals.fresh, p["creep_compliance"], p["creep_time"])


def friction(signals: Signals, p: Values) -> Array:
    """Predict START tension, N, from END tension over rope motion: (3) and (7) in series, with memory."""
    return start_from_end(signals, p)


def _toe(p: Values) -> float:
    """Return what the first newtons stretch the path more than (10), m."""
    return p["toe"] / p["stiffness_scale"]


def _toed(p: Values, force: Array) -> Array | float:
    return _toe(p) * -np.expm1(-np.maximum(force, 0.0) / chain.TOE_N) if p["toe"] != 0.0 else 0.0


def wound(signals: Signals, p: Values, position: Array) -> Array:
    """Return the rope drawn in at the drum, m, from the encoder's position: zero, homing, slack, eccentricity."""
    drawn = position - p["rope_zero"] - p["slack"] + _homed(p)
    if p["eccentricity"] != 0.0:
        turn = position / p["drum_radius"] + p["eccentricity_phase"]
        drawn = drawn + p["eccentricity"] * (np.sin(turn) - math.sin(p["eccentricity_phase"]))
    return np.asarray(drawn)


def _homed(p: Values) -> float:
    """Return how far homing to a preload moves the zero when the stretch is not that of (10)."""
    preload = p["home_preload"]
    linear, bend = _stretch(p)
    toe = _toe(p) - p["toe"]
    return (linear - STRETCH_LINEAR) * preload + (bend - STRETCH_BEND) * preload**2 - toe * math.expm1(
        -preload / chain.TOE_N)


def anchored(p: Values, angle: Array) -> Array:
    """Return the rope's share that the knee takes, m: (11) from the knee angle of 13 % of gait."""
    taken = p["rope_per_knee"] * (angle - KNEE_AT_FIT)
    if p["rope_per_knee_quadratic"] != 0.0:
        taken = taken + p["rope_per_knee_quadratic"] * (angle**2 - KNEE_AT_FIT**2)
    return np.asarray(taken)


def elasticity(signals: Signals, p: Values) -> Array:
    """Predict START tension, N, from rope and knee position: (10) and (11) inverted, then friction."""
    start = signals.remember(_from_motion, p)
    return start_reading(signals, p, _undecided(signals, p, start, _with_drag(signals, p, start)))


def _from_motion(signals: Signals, p: Values) -> Array:
    position, angle = (signals.later(values, -p["timestamp_skew"])
                       for values in (signals["servo_position_m"], leg_angle(signals, p)))
    linear, bend = _stretch(p)
    _end, start = chain.from_motion(
        wound(signals, p, position), anchored(p, angle), signals["time_s"], signals.fresh,
        fabric_exponent(signals, p), cable_exponent(signals, p), linear, bend, _toe(p), cable_compliance(p),
        p["creep_compliance"], p["creep_time"],
        p["presliding"] * p["fabric_presliding_ratio"], p["presliding"], p["presliding_shape"],
        p["load_slope"], p["stribeck_ratio"], p["stribeck_speed"], p["stribeck_memory"])
    return start


def kinematics(signals: Signals, p: Values) -> Array:
    """Predict the knee angle, rad, from rope position and the stretch under the measured tensions."""
    position, angle = signals["servo_position_m"], signals["knee_angle_rad"]
    left = wound(signals, p, position) - p["pull_sign"] * _stretched(signals, p)
    if p["rope_per_knee_quadratic"] != 0.0:
        left = left - p["rope_per_knee_quadratic"] * (angle**2 - KNEE_AT_FIT**2)
    return np.asarray(KNEE_AT_FIT + left / p["rope_per_knee"] + (angle - leg_angle(signals, p)))


def _stretched(signals: Signals, p: Values) -> Array:
    """Return the stretch of the whole path, m: the fabric's at END tension, the rope's own at START tension."""
    linear, bend = _stretch(p)
    ends = [signals.has("tension_start_n"), signals.has("tension_end_n")]
    if not any(ends):
        return np.zeros(signals.progress.size)
    start = start_tension(signals, p) if ends[0] else None
    end = end_tension(signals, p) if ends[1] else start
    assert end is not None
    start = end if start is None else start
    own = linear - cable_compliance(p)
    before = before_knee(signals, p) if ends[1] else end
    middle = 0.5 * (end + before)
    parts = zip(SHARES, (end, middle, before), strict=True)
    stretch = cable_compliance(p) * start + sum(share * ((own + bend * at) * at + _toed(p, at)) for share, at in parts)
    if p["creep_compliance"] > 0.0:
        stretch = stretch + _creep(signals, p, end)
    return signals.later(stretch, p["timestamp_skew"])
