"""The servo motor at the drum: current loop, voltage limit, friction, inertia; all mechanics at the rope.

The rule of this file: what sits between the torque demand and the rope's pull on the drum, and nothing
behind it.  Forces in N and velocities in m/s of rope; currents in A at the reducer's output side.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit

from parameters import parameter


@dataclass(frozen=True)
class ServoParameters:
    """An RD-X6-like 48 V servo; the paper names the type only, so every figure is assumed."""

    drum_radius_m: float = parameter(
        0.020, "m", "radius of the drum", low=10e-3, high=0.1, source="assumed: fits a 40 N·m·10 % bench")
    supply_v: float = parameter(48.0, "V", "supply voltage", low=0.0, high=60.0, source="paper, 5.2")
    supply_ohm: float = parameter(
        0.0, "Ω", "internal resistance of the supply (sag)", low=0.0, high=5.0, source="assumed: a stiff supply")
    current_limit_a: float = parameter(
        7.5, "A", "limit of the motor current", low=0.0, high=30.0, source="assumed: 6.75 N·m peak at the output")
    torque_constant: float = parameter(
        0.9, "N·m/A", "torque and back-EMF constant at the output", low=0.05, high=2.0,
        source="assumed: maker's class of a 1:6 48 V actuator")
    winding_ohm: float = parameter(
        0.6, "Ω", "winding resistance", low=0.05, high=5.0, source="assumed: maker's class")
    winding_h: float = parameter(
        0.4e-3, "H", "winding inductance", low=0.1e-3, high=10e-3, source="assumed: maker's class")
    current_bandwidth_hz: float = parameter(
        800.0, "Hz", "bandwidth of the current loop", low=50.0, high=3000.0, source="assumed: field-oriented drives")
    servo_inertia_kg: float = parameter(
        2.5, "kg", "rotor, reducer and drum as a mass at the rope (J/R²)", low=0.5, high=30.0,
        source="assumed: J = 1.0e-3 kg·m² at the output")
    servo_coulomb_n: float = parameter(
        1.0, "N", "Coulomb friction of motor and reducer at the rope", low=0.0, high=50.0,
        source="assumed: 1 % of rated torque")
    servo_viscous: float = parameter(
        10.0, "N·s/m", "viscous friction of motor and reducer at the rope", low=0.0, high=500.0,
        source="assumed: maker's class")
    servo_offset_n: float = parameter(
        0.0, "N", "constant force against pulling", low=-50.0, high=50.0, source="assumed: none")
    servo_asymmetry: float = parameter(
        0.0, "", "Coulomb friction greater pulling (> 0) than releasing, relative", low=-0.95, high=0.95,
        source="assumed: none")
    servo_presliding_m: float = parameter(
        20e-6, "m", "rope travel over which motor friction turns over", low=2e-6, high=2e-3,
        source="assumed: 1 mrad of the drum")
    eccentricity_m: float = parameter(
        0.0, "m", "amplitude A of the drum's eccentricity A·sin(x/R + φ)", low=-2e-3, high=2e-3,
        source="assumed: none")
    eccentricity_rad: float = parameter(
        0.0, "rad", "phase φ of the drum's eccentricity", low=-6.3, high=6.3, source="assumed: none")


@njit(inline="always")
def dahl(s: float, travel: float) -> float:
    """Return the pre-sliding state after `travel` (in units of δ): ds/dx = (1 − s·sgn v)/δ; |s| ≤ 1 is kept."""
    dz = min(1.0, max(-1.0, travel))
    return s + dz - s * abs(dz)


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
    wanted = bandwidth * henry * error + integral + back_emf
    volts = min(bus_v, max(-bus_v, wanted))
    if volts == wanted:
        integral += bandwidth * ohm * error * dt
    return current + dt / henry * (volts - ohm * current - back_emf), integral
