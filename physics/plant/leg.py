"""The knee drive and the leg it swings: motor, 1:20 reducer with backlash, leg, END sensor on its cantilever.

The rule of this file: angles at the knee, flexion negative; the rope pulls towards extension with the
moment arm dx/dθ = k2 + 2·k3·θ, which is (11) by virtual work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from numba import njit

from parameters import parameter
from physics import laws

GRAVITY: Final = 9.80665
KNEE_AT_FIT: Final = float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
"""The knee angle, rad, at which (10) was fitted: there the anchor's displacement is zero."""


@dataclass(frozen=True)
class LegParameters:
    """57BL75S10-230 motor, PX6-57 1:20 reducer, lower-leg model, END sensor."""

    moment_arm_m: float = parameter(
        laws.SWING_K_MM_DEG * 1e-3 / laws.DEGREE, "m/rad", "k2: rope displacement per knee angle",
        low=0.005, high=0.2, source="(11): k2")
    moment_arm: float = parameter(
        0.0, "m/rad²", "k3: quadratic part of the rope displacement k2·θ + k3·θ²",
        low=-0.02, high=0.02, source="(11): linear")
    knee_inertia: float = parameter(
        0.01, "kg·m²", "rotor of the knee motor behind the reducer", low=1e-3, high=0.5,
        source="assumed: 2.3e-5 kg·m² by 20²")
    knee_coulomb_nm: float = parameter(
        0.3, "N·m", "Coulomb friction of knee motor and reducer", low=0.0, high=10.0, source="assumed: maker's class")
    knee_viscous: float = parameter(
        0.05, "N·m·s/rad", "viscous friction of knee motor and reducer", low=0.0, high=10.0,
        source="assumed: maker's class")
    knee_presliding_rad: float = parameter(
        5e-4, "rad", "travel over which the knee drive's friction turns over", low=1e-5, high=0.05,
        source="assumed: tooth compliance")
    knee_lag_s: float = parameter(
        1e-3, "s", "lag of the knee motor's current loop", low=1e-4, high=0.05, source="assumed: block commutation")
    knee_torque_limit_nm: float = parameter(
        17.0, "N·m", "peak torque of the knee drive at the knee", low=0.5, high=200.0, source="assumed: maker's class")
    knee_stall_nm: float = parameter(
        60.0, "N·m", "torque at which the supply's voltage would stall it", low=1.0, high=1000.0,
        source="assumed: maker's class")
    knee_no_load_rad_s: float = parameter(
        15.7, "rad/s", "no-load speed at the knee", low=1.0, high=100.0, source="assumed: 3000 1/min behind 1:20")
    reducer_stiffness: float = parameter(
        2000.0, "N·m/rad", "torsional stiffness of reducer and shaft", low=200.0, high=1e4,
        source="assumed: maker's class")
    reducer_damping: float = parameter(
        1.5, "N·m·s/rad", "damping of reducer and shaft", low=0.0, high=10.0, source="assumed: 15 % of critical")
    knee_backlash_rad: float = parameter(
        0.0, "rad", "whole dead band of the reducer", low=0.0, high=0.2, source="assumed: none")
    leg_inertia: float = parameter(
        0.03, "kg·m²", "lower-leg model about the knee", low=5e-3, high=1.0, source="assumed: 0.6 kg at 0.2 m")
    leg_moment_kg_m: float = parameter(
        0.09, "kg·m", "mass times lever of the lower-leg model", low=0.0, high=5.0, source="assumed: 0.6 kg at 0.15 m")
    leg_damping: float = parameter(
        0.02, "N·m·s/rad", "damping of the knee bearing", low=0.0, high=5.0, source="assumed: ball bearings")
    stop_low_rad: float = parameter(
        -1.75, "rad", "mechanical stop in flexion", low=-3.0, high=-1.0, source="assumed: beyond the travel of 90°")
    stop_high_rad: float = parameter(
        0.35, "rad", "mechanical stop in extension", low=0.0, high=1.0, source="assumed: beyond upright")
    stop_stiffness: float = parameter(
        500.0, "N·m/rad", "stiffness of the stops", low=10.0, high=2000.0, source="assumed: rubber")
    end_mass_kg: float = parameter(
        0.0, "kg", "mass that the END sensor carries on its cantilever", low=0.0, high=0.5,
        source="paper, 5.2: named, not given")
    end_mass_arm_m: float = parameter(
        0.25, "m", "lever of the END sensor from the knee", low=0.0, high=1.0, source="assumed: geometry")
    start_knee_rad: float = parameter(
        0.0, "rad", "knee angle at power-on", low=-1.6, high=0.2, source="assumed: upright")
    start_slack_m: float = parameter(
        5e-3, "m", "slack of the rope at power-on", low=0.0, high=1.0, source="assumed: the rope hangs")


@njit(inline="always")
def anchor(k2: float, k3: float, knee_rad: float) -> float:
    """Return the displacement of the rope's anchor, m, towards the motor: k2·θ + k3·θ² from 13 % of gait on."""
    return k2 * (knee_rad - KNEE_AT_FIT) + k3 * (knee_rad * knee_rad - KNEE_AT_FIT * KNEE_AT_FIT)


@njit(inline="always")
def knee_limit(torque: float, speed: float, peak: float, stall: float, no_load: float) -> float:
    """Return the torque that the knee motor can give at `speed`, N·m: current limit and voltage line."""
    high = min(peak, stall * max(0.0, 1.0 - speed / no_load))
    low = max(-peak, -stall * max(0.0, 1.0 + speed / no_load))
    return min(high, max(low, torque))


@njit(inline="always")
def reducer(twist: float, rate: float, half_band: float, stiffness: float, damping: float) -> float:
    """Return the torque through the reducer onto the leg, N·m; none while `twist` is inside the dead band."""
    if half_band == 0.0:
        return stiffness * twist + damping * rate
    pressed = max(0.0, abs(twist) - half_band)
    elastic = stiffness * math.copysign(pressed, twist)
    bound = abs(elastic)
    return elastic + min(bound, max(-bound, damping * rate))
