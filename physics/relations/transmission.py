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
from physics.relations.measured import Signals, end_tension, leg_angle, start_tension

Values = Mapping[str, float]

STRETCH_LINEAR: Final = STIFFNESS_B_MM_N * MILLI
STRETCH_BEND: Final = STIFFNESS_A_MM_N2 * MILLI
CALM_S: Final = 0.012
"""1σ of the low-pass on the tension whose stretch slides the fabric; the friction at its nodes sees it unfiltered."""
SHARES: Final = (chain.SHARE_AFTER, chain.SHARE_OVER, 1.0 - chain.SHARE_AFTER - chain.SHARE_OVER)
"""Shares of the fabric behind, on and before the knee."""


def cable_exponent(signals: Signals, p: Values) -> Array:
    """Return μ1·θ1 at each sample, with bend and drift."""
    return signals.remember(_cable_exponent, p["mu1"] * p["theta1"], p["cable_bend"], p["friction_drift"])


def _cable_exponent(signals: Signals, straight: float, bend: float, drift: float) -> Array:
    whole = straight * (1.0 + drift * signals.progress)
    if bend != 0.0 and signals.has("knee_angle_rad"):
        whole *= 1.0 + bend * np.abs(signals["knee_angle_rad"])
    return whole


def fabric_exponent(signals: Signals, p: Values) -> Array:
    """Return μ2·φ at each sample: φ = φ0 + κ·|θk|."""
    return signals.remember(_fabric_exponent, p["mu2"], p["phi0"], p["fabric_wrap"], p["friction_drift"])


def _fabric_exponent(signals: Signals, mu: float, upright: float, slope: float, drift: float) -> Array:
    wrap = np.full(signals.progress.size, upright)
    if signals.has("knee_angle_rad"):
        wrap += slope * np.abs(signals["knee_angle_rad"])
    exponent: Array = mu * np.maximum(wrap, 0.0) * (1.0 + drift * signals.progress)
    return exponent


def _stretch(p: Values) -> tuple[float, float]:
    """Return linear and quadratic coefficient of (10)."""
    return STRETCH_LINEAR / p["stiffness_scale"], STRETCH_BEND * (1.0 + p["stiffness_shape"]) / p["stiffness_scale"]


def cable_compliance(p: Values) -> float:
    """Return the rope's own compliance before the friction, m/N: its share of (10)'s linear coefficient."""
    return p["cable_share"] * STRETCH_LINEAR / p["stiffness_scale"]


def start_from_end(signals: Signals, p: Values) -> Array:
    """Return the START reading, N, that the tension at END and the rope's motion give."""
    start, slip = signals.remember(
        _along, before_knee(signals, p), _moved(signals, p, "rope_m"), p["pull_sign"], cable_exponent(signals, p),
        p["presliding"], p["presliding_shape"], p["cable_share_before"] * cable_compliance(p), *_law(p),
        p["tension_ratio"])
    return _read(signals, p, start if p["coulomb"] == 0.0 else start + p["coulomb"] * slip)


def _along(signals: Signals, tension: Array, position: Array, pull_sign: float, exponent: Array,
           *numbers: float) -> tuple[Array, Array]:
    """Return START tension, N, and the rope's mean slip state."""
    start, slip = chain.along_cable(tension, pull_sign * position, exponent, signals["time_s"], signals.fresh, *numbers)
    return start, slip


def before_knee(signals: Signals, p: Values) -> Array:
    """Return the tension before the knee, N, from that at END and the fabric's friction."""
    end = end_tension(signals, p)
    if p["mu2"] == 0.0:
        return end
    linear, bend = _stretch(p)
    return signals.remember(
        _before_knee, end, signals.remember(_calm, end), fabric_exponent(signals, p), _creep(signals, p, end),
        max(linear - cable_compliance(p), 1e-9), bend, _toe(p), p["presliding"] * p["fabric_presliding_ratio"],
        p["presliding_shape"], *_law(p))


def _before_knee(signals: Signals, end: Array, calmed: Array, exponent: Array, crept: Array,
                 *numbers: float) -> Array:
    return np.asarray(chain.over_fabric(end, calmed, exponent, crept, signals["time_s"], signals.fresh, *numbers))


def _calm(signals: Signals, tension: Array) -> Array:
    """Return a tension low-passed at `CALM_S`, since a sensor's noise slides no fabric."""
    samples = CALM_S / signals.step_s
    return np.asarray(gaussian_filter1d(tension, samples)) if samples > 0.5 else tension


def _moved(signals: Signals, p: Values, name: str) -> Array:
    """Return a motion as it was when the tensions were true that are stamped now."""
    return signals.column_later(name, -p["timestamp_skew"])


def _law(p: Values) -> tuple[float, float, float, float, float]:
    return p["load_slope"], p["stribeck_ratio"], p["stribeck_speed"], p["stribeck_memory"], p["slack_below"]


def _read(signals: Signals, p: Values, start: Array) -> Array:
    """Return what START reads, N, of its tension without drag."""
    measured = signals["tension_start_n"] if signals.has("tension_start_n") else np.zeros(0)
    return np.asarray(chain.read_at_start(
        start, signals["rope_m_s"], measured, signals.progress, p["viscous"], p["viscous_tension"], p["slack_below"],
        p["start_gain"], p["start_offset"], p["start_drift"]))


def _creep(signals: Signals, p: Values, force: Array) -> Array:
    """Return the creep under a tension, m."""
    compliance = p["creep_compliance"]
    return signals.remember(_crept, force if compliance > 0.0 else None, compliance,
                            p["creep_time"] if compliance > 0.0 else 0.0)


def _crept(signals: Signals, force: Array | None, compliance: float, time_s: float) -> Array:
    if force is None:
        return np.zeros(signals.progress.size)
    return states.crept(force, signals["time_s"], signals.fresh, compliance, time_s)


def friction(signals: Signals, p: Values) -> Array:
    """Predict START tension, N, from END tension over rope motion: (3) and (7) in series, with memory."""
    return start_from_end(signals, p)


def _toe(p: Values) -> float:
    """Return the additional stretch of the path under the first newtons, beyond (10), m."""
    return p["toe"] / p["stiffness_scale"]


def wound(signals: Signals, p: Values, position: Array) -> Array:
    """Return the rope drawn in at the drum, m, from the encoder's position: zero, homing, slack, eccentricity."""
    bent = p["eccentricity"] != 0.0
    return signals.remember(
        _drawn, position, p["rope_zero"] + p["slack"] - _homed(p), p["eccentricity"],
        p["drum_radius"] if bent else 1.0, p["eccentricity_phase"] if bent else 0.0)


def _drawn(signals: Signals, position: Array, zero: float, eccentricity: float, radius: float, phase: float) -> Array:
    del signals
    drawn = position - zero
    if eccentricity != 0.0:
        drawn = drawn + eccentricity * (np.sin(position / radius + phase) - math.sin(phase))
    return np.asarray(drawn)


def _homed(p: Values) -> float:
    """Return how far homing to a preload moves the zero when the stretch is not that of (10)."""
    preload = p["home_preload"]
    linear, bend = _stretch(p)
    toe = _toe(p) - p["toe"]
    return (linear - STRETCH_LINEAR) * preload + (bend - STRETCH_BEND) * preload**2 - toe * math.expm1(
        -preload / chain.TOE_N)


def anchored(signals: Signals, angle: Array, skew: float, ratio: float, quadratic: float) -> Array:
    """Return the rope's share that the knee takes, m, `skew` s before: (11) from the knee angle of 13 % of gait."""
    angle = signals.later(angle, -skew)
    taken = ratio * (angle - KNEE_AT_FIT)
    return taken + quadratic * (angle**2 - KNEE_AT_FIT**2) if quadratic != 0.0 else taken


def elasticity(signals: Signals, p: Values) -> Array:
    """Predict START tension, N, from rope and knee position: (10) and (11) inverted, then friction."""
    linear, bend = _stretch(p)
    anchor = signals.remember(anchored, leg_angle(signals, p), p["timestamp_skew"], p["rope_per_knee"],
                              p["rope_per_knee_quadratic"])
    start = signals.remember(
        _from_motion, wound(signals, p, _moved(signals, p, "servo_position_m")), anchor, fabric_exponent(signals, p),
        cable_exponent(signals, p), linear, bend, _toe(p), cable_compliance(p), p["creep_compliance"], p["creep_time"],
        p["presliding"] * p["fabric_presliding_ratio"], p["presliding"], p["presliding_shape"], p["load_slope"],
        p["stribeck_ratio"], p["stribeck_speed"], p["stribeck_memory"])
    return _read(signals, p, start)


def _from_motion(signals: Signals, drum: Array, anchor: Array, fabric: Array, cable: Array, *numbers: float) -> Array:
    _end, start = chain.from_motion(drum, anchor, signals["time_s"], signals.fresh, fabric, cable, *numbers)
    return start


def kinematics(signals: Signals, p: Values) -> Array:
    """Predict the knee angle, rad, from rope position and the stretch under the measured tensions."""
    angle = signals["knee_angle_rad"]
    left = wound(signals, p, signals["servo_position_m"]) - p["pull_sign"] * _stretched(signals, p)
    if p["rope_per_knee_quadratic"] != 0.0:
        left = left - p["rope_per_knee_quadratic"] * (angle**2 - KNEE_AT_FIT**2)
    return np.asarray(KNEE_AT_FIT + left / p["rope_per_knee"] + (angle - leg_angle(signals, p)))


def _stretched(signals: Signals, p: Values) -> Array:
    """Return the stretch of the whole path, m: the fabric's at END tension, the rope's own at START tension."""
    linear, bend = _stretch(p)
    at_start, at_end = signals.has("tension_start_n"), signals.has("tension_end_n")
    if not at_start and not at_end:
        return np.zeros(signals.progress.size)
    start = start_tension(signals, p) if at_start else end_tension(signals, p)
    end = end_tension(signals, p) if at_end else start
    before = before_knee(signals, p) if at_end else end
    return signals.remember(
        _whole_stretch, start, end, before, _creep(signals, p, end), cable_compliance(p),
        linear - cable_compliance(p), bend, _toe(p), p["timestamp_skew"])


def _whole_stretch(signals: Signals, start: Array, end: Array, before: Array, crept: Array, compliance: float,
                   own: float, bend: float, toe: float, skew: float) -> Array:
    middle = 0.5 * (end + before)
    parts = zip(SHARES, (end, middle, before), strict=True)
    stretch = compliance * start + crept + sum(share * (own + bend * at) * at for share, at in parts)
    if toe != 0.0:
        stretch -= toe * chain.toed(end, middle, before, np.array(SHARES))
    return signals.later(stretch, skew)
