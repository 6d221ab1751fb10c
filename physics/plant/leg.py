"""The knee drive and the leg it swings: motor, 1:20 reducer with backlash, leg, END sensor on its cantilever.

The rule of this file: angles at the knee, flexion negative; the rope pulls towards extension with the
moment arm dx/dθ = k2 + 2·k3·θ, which is (11) by virtual work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from numba import njit

from physics import laws
from physics.parameters import declared

GRAVITY: Final = 9.80665
KNEE_AT_FIT: Final = float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
"""Knee angle, rad, at which (10) was fitted: the anchor's displacement is zero there."""


@dataclass(frozen=True)
class LegParameters:
    """Parameters of the 57BL75S10-230 motor, the PX6-57 1:20 reducer, the lower-leg model and the END sensor."""

    rope_per_knee: float = declared("rope_per_knee")
    rope_per_knee_quadratic: float = declared("rope_per_knee_quadratic")
    knee_inertia: float = declared("knee_inertia")
    knee_coulomb_nm: float = declared("knee_coulomb")
    knee_viscous: float = declared("knee_viscous")
    knee_presliding_rad: float = declared("knee_presliding")
    knee_lag_s: float = declared("knee_lag")
    knee_torque_limit_nm: float = declared("knee_torque_limit")
    knee_stall_nm: float = declared("knee_stall")
    knee_no_load_rad_s: float = declared("knee_no_load")
    reducer_stiffness: float = declared("reducer_stiffness")
    reducer_damping: float = declared("reducer_damping")
    knee_backlash_rad: float = declared("knee_backlash")
    leg_inertia: float = declared("leg_inertia")
    leg_moment_kg_m: float = declared("leg_moment")
    leg_damping: float = declared("leg_damping")
    stop_low_rad: float = declared("stop_low")
    stop_high_rad: float = declared("stop_high")
    stop_stiffness: float = declared("stop_stiffness")
    end_mass_kg: float = declared("end_mass")
    end_mass_arm_m: float = declared("end_mass_arm")
    start_knee_rad: float = declared("start_knee")
    start_slack_m: float = declared("start_slack")


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
