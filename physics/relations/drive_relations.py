"""Prediction equations of the drives: `drive_force`, `servo` and `knee` between measured signals.

A drive is described by its target and its force alone; forces in N and motion in m at the rope.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from physics import memory_laws as states
from physics.laws import Array
from physics.plant.motor import ServoParameters
from physics.relations.measured import Signals, start_tension

Mask = NDArray[np.bool_]
Values = Mapping[str, float]

SERVO: Final = ServoParameters()
FORCE_PER_AMPERE: Final = SERVO.torque_constant / SERVO.drum_radius_m
SUBSTEPS: Final = 8


def drive_force(signals: Signals, p: Values) -> Array:
    """Predict the servo's force, N: START tension on the drum's arm, Coulomb by direction, viscous, inertia, offset.

    About a turning axis, N·m: a mass off the axis, m·g·r·sin(q + φ), besides.
    """
    slip, square = signals.remember(_turned, p["drive_presliding"], p["drive_calm"], p["drive_stribeck_ratio"],
                                   p["drive_stribeck_speed"] if p["drive_stribeck_ratio"] != 1.0 else 1.0)
    force = p["drive_coulomb"] * (slip + p["drive_asymmetry"] * square) + p["drive_offset"]
    speed = signals["rope_m_s"]
    drag = speed if p["drive_viscous_asymmetry"] == 0.0 else speed + p["drive_viscous_asymmetry"] * np.abs(speed)
    force = force + p["drive_viscous"] * drag + p["drive_inertia"] * signals["rope_m_s2"]
    if p["unbalance"] != 0.0 and signals.has("turned_rad"):
        force = force + p["unbalance"] * np.sin(signals["turned_rad"] + p["unbalance_phase"])
    if signals.has("tension_start_n"):
        force = force + arm(signals, p) * signals.later(start_tension(signals, p), p["timestamp_skew"])
    return np.asarray(force / p["demand_gain"])


def arm(signals: Signals, p: Values) -> Array | float:
    """Return the rope that an eccentric drum draws per metre at its mean radius: by virtual work, force per tension."""
    if p["eccentricity"] == 0.0:
        return 1.0
    turned = signals["servo_position_m"] / p["drum_radius"] + p["eccentricity_phase"]
    return np.asarray(1.0 + p["eccentricity"] / p["drum_radius"] * np.cos(turned))


def _turned(signals: Signals, distance: float, calm: float, ratio: float, slow: float) -> tuple[Array, Array]:
    """Return the state −1…1 of the drive's friction and its square, each by its Stribeck curve.

    It turns over within milliseconds.
    """
    if signals.fine is None:
        slip = _slip(signals["rope_m"], signals["rope_m_s"], signals.fresh, distance, calm)
        curve = _curve(signals["rope_m_s"], ratio, slow)
        return curve * slip, curve * slip**2
    slip = _slip(signals.fine.rope_m, signals.fine.rope_m_s, signals.fine.fresh, distance, calm)
    curve = _curve(signals.fine.rope_m_s, ratio, slow)
    return signals.fine.thinned(curve * slip), signals.fine.thinned(curve * slip**2)


def _curve(speed: Array, ratio: float, slow: float) -> Array | float:
    """Return the friction over that in quick motion, by speed; `slow` is the Stribeck speed, m/s."""
    return 1.0 if ratio == 1.0 else np.asarray(1.0 + (ratio - 1.0) * np.exp(-((speed / slow) ** 2)))


def _slip(position: Array, speed: Array, fresh: Mask, distance: float, calm: float) -> Array:
    slip = states.slipped(position, fresh, distance)
    return np.asarray(slip * np.tanh(np.abs(speed) / calm)) if calm > 0.0 else slip


@njit(cache=True)
def tracked(
    target: Array, load: Array, time: Array, fresh: Mask, bandwidth: float, damping: float, mass: float,
    coulomb: float, viscous: float, force: float, sag: float, volts: float, ohm: float, constant: float,
) -> Array:
    """Return the position that follows `target` by a second-order loop whose force is limited.

    `force`: limit by current, N; `constant`: N per ampere (and V per m/s); the voltage left by the sag limits too.
    """
    out = np.empty(target.size)
    limited = force < np.inf or sag > 0.0
    w = 2.0 * np.pi * bandwidth
    spring, damper = w * w, 2.0 * damping * w
    per_volt, per_mass, per_force = constant / ohm, 1.0 / mass, 1.0 / constant
    x, v, bus = 0.0, 0.0, volts
    for k in range(target.size):
        if fresh[k]:
            x, v = target[k], 0.0
        else:
            # a step of the loop is stable while it is shorter than the loop's own times
            steps = max(SUBSTEPS, int(w * (1.0 + 2.0 * damping) * (time[k] - time[k - 1])) + 1)
            dt, onwards = (time[k] - time[k - 1]) / steps, (target[k] - target[k - 1]) / steps
            for i in range(steps):
                aim = target[k - 1] + (i + 1) * onwards
                wanted = spring * (aim - x) - damper * v
                if limited:
                    resisting = load[k] + viscous * v + coulomb * min(1.0, max(-1.0, 1e3 * v))
                    most = min(force, max(0.0, (bus - constant * abs(v)) * per_volt))
                    given = min(most, max(-most, mass * wanted + resisting))
                    if sag > 0.0:
                        drawn = max(0.0, given * v + ohm * (per_force * given) ** 2)
                        bus = max(0.2 * volts, volts - sag * drawn / volts)
                    wanted = (given - resisting) * per_mass
                v += dt * wanted
                x += dt * v
        out[k] = x
    return out


def servo(signals: Signals, p: Values) -> Array:
    """Predict the rope's position, m, from its target: delay, second-order loop, limits of current and voltage."""
    aim = signals.column_later("servo_target_m", -p["servo_delay"])
    load = signals["tension_start_n"] if signals.has("tension_start_n") else np.zeros(aim.size)
    return np.asarray(tracked(
        aim, load, signals["time_s"], signals.fresh, p["servo_bandwidth"], p["servo_damping"],
        max(p["drive_inertia"], 1e-3), p["drive_coulomb"], p["drive_viscous"], p["current_limit"] * FORCE_PER_AMPERE,
        p["supply_ohm"], SERVO.supply_v, SERVO.winding_ohm, FORCE_PER_AMPERE))


def knee(signals: Signals, p: Values) -> Array:
    """Predict the knee angle, rad, from its target: delay and second-order loop."""
    aim = signals.column_later("knee_target_rad", -p["knee_delay"])
    still = np.zeros(aim.size)
    return np.asarray(tracked(
        aim, still, signals["time_s"], signals.fresh, p["knee_bandwidth"], p["knee_damping"], 1.0, 0.0, 0.0,
        np.inf, 0.0, 1e9, 1.0, 1.0))
