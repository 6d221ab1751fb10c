"""The servo motor at the drum: current loop, voltage limit, friction, inertia; all mechanics at the rope.

The rule of this file: what sits between the torque demand and the rope's pull on the drum, and nothing
behind it.  Forces in N and velocities in m/s of rope; currents in A at the reducer's output side.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit

from physics.parameters import declared


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
