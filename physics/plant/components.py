"""Parts of the plant, with parameters and equations: servo motor, Bowden cable, fabric, knee drive with the leg.

The servo is what sits between the torque demand and the rope's pull on the drum; all its mechanics are at the rope, in
N and m/s, its currents in A at the reducer's output side. The cable is (3) distributed along the sheath: a node that
slides over dθ satisfies T1/T2 = e^(μ·dθ) exactly, with the friction force s·(T1 + T2)·tanh(μ·dθ/2) and the pre-sliding
state s. The whole path stretches by (10); the stretch beyond the rope's own linear compliance is the fabric's, by
shares of its length, and continues along its tangent from 90 % of the turning tension. Angles are at the knee, flexion
negative; the rope pulls towards extension with the moment arm dx/dθ = k2 + 2·k3·θ, which is (11) by virtual work.
"""

import math
from dataclasses import dataclass
from typing import Final

from numba import njit

from physics import laws
from physics.parameters import declared
from physics.path_laws import stretched


@dataclass(frozen=True)
class ServoParameters:
    """Parameters of a 48 V servo like the RD-X6; the paper names the type only, so every figure is assumed."""

    drum_radius_m: float = declared("drum_radius")
    supply_v: float = declared("supply")
    supply_ohm: float = declared("supply_ohm")
    current_limit_a: float = declared("current_limit")
    torque_constant: float = declared("torque_constant")
    winding_ohm: float = declared("winding_resistance")
    winding_h: float = declared("winding_inductance")
    current_bandwidth_hz: float = declared("current_bandwidth")
    servo_inertia_kg: float = declared("drive_inertia")
    servo_coulomb_n: float = declared("drive_coulomb")
    servo_viscous: float = declared("drive_viscous")
    servo_viscous_asymmetry: float = declared("drive_viscous_asymmetry")
    demand_gain: float = declared("demand_gain")
    servo_offset_n: float = declared("drive_offset")
    servo_unbalance_n: float = declared("unbalance")
    servo_unbalance_rad: float = declared("unbalance_phase")
    servo_asymmetry: float = declared("drive_asymmetry")
    servo_presliding_m: float = declared("drive_presliding")
    servo_stribeck_ratio: float = declared("drive_stribeck_ratio")
    servo_stribeck_speed_m_s: float = declared("drive_stribeck_speed")
    eccentricity_m: float = declared("eccentricity")
    eccentricity_rad: float = declared("eccentricity_phase")


@njit(inline="always")
def supply(volts: float, ohms: float, shaft_watts: float) -> float:
    """Return the bus voltage, V, under the load `shaft_watts`; a supply does not take power back."""
    return max(0.2 * volts, volts - ohms * max(0.0, shaft_watts) / max(volts, 1.0))


@njit(inline="always")
def current_step(
    current: float, integral: float, demand_a: float, back_emf: float, bus_v: float,
    ohm: float, henry: float, bandwidth: float, dt: float,
) -> tuple[float, float]:
    """Return current and integral after `dt`: PI by pole cancellation, back-EMF fed forward, voltage limited.

    `bandwidth` in rad/s; the integral stands still while the voltage saturates.
    """
    error = demand_a - current
    # pole cancellation: Ki/Kp = R/L, so that the closed loop is a first-order lag of `bandwidth`
    wanted = bandwidth * henry * error + integral + back_emf
    volts = min(bus_v, max(-bus_v, wanted))
    if volts == wanted:
        integral += bandwidth * ohm * error * dt
    return current + dt / henry * (volts - ohm * current - back_emf), integral


@dataclass(frozen=True)
class CableParameters:
    """Parameters of rope, sheath and the friction between them."""

    mu1: float = declared("mu1")
    theta1_rad: float = declared("theta1")
    cable_bend: float = declared("cable_bend")
    load_slope: float = declared("load_slope")
    viscous: float = declared("viscous")
    stribeck_ratio: float = declared("stribeck_ratio")
    stribeck_speed_m_s: float = declared("stribeck_speed")
    stribeck_memory_s: float = declared("stribeck_memory")
    presliding_m: float = declared("presliding")
    friction_drift: float = declared("friction_drift")
    friction_drift_s: float = declared("friction_drift_time")
    lead_compliance: float = declared("lead_compliance")
    sheath_compliance: float = declared("sheath_compliance")
    slack_m: float = declared("slack")
    encoder_zero_m: float = declared("rope_zero")
    slack_drag: float = declared("slack_drag")


@njit(inline="always")
def spring(elongation: float, rate: float, stiffness: float, damping: float) -> float:
    """Return the tension of an element of rope, N: linear, never pushing; damping at most as large as the force."""
    elastic = stiffness * max(0.0, elongation)
    return elastic + min(elastic, max(-elastic, damping * rate))


@dataclass(frozen=True)
class FabricParameters:
    """Parameters of the fabric and of its friction over the knee."""

    mu2: float = declared("mu2")
    wrap_rad: float = declared("phi0")
    fabric_wrap: float = declared("fabric_wrap")
    fabric_presliding_m: float = declared("fabric_presliding")
    stretch_a: float = declared("stretch_a")
    stretch_b: float = declared("stretch_b")
    stiffness_scale: float = declared("stiffness_scale")
    stiffness_shape: float = declared("stiffness_shape")
    share_before: float = declared("fabric_share_before")
    share_after: float = declared("fabric_share_after")
    creep_compliance: float = declared("creep_compliance")
    creep_s: float = declared("creep_time")


@njit(inline="always")
def strap(
    elongation: float, rate: float, damping: float, per_share: float, b: float, a4: float, half: float,
    e_tangent: float, t_tangent: float, k_tangent: float,
) -> float:
    """Return the tension of an element of fabric, N; `per_share` = 1/w, `a4` = −4a, `half` = −1/(2a).

    Never pushing; damping at most as large as the elastic force.
    """
    e = max(0.0, elongation) * per_share
    elastic = stretched(e, b, a4, half, e_tangent, k_tangent)
    return elastic + min(elastic, max(-elastic, damping * rate))


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
