"""Inverses of effects: the trajectory that a controller should lead so that an effect does not reach END.

An effect without one here (of END, of the drive's force) is nothing that START, rope and knee can undo.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from physics.effects.effect import Trajectory, Values
from physics.laws import Array
from physics.memory_laws import crept, slipped
from physics.plant.cable import CableParameters
from physics.plant.fabric import FabricParameters
from physics.plant.leg import KNEE_AT_FIT, LegParameters
from physics.plant.motor import ServoParameters

CABLE: Final = CableParameters()
FABRIC: Final = FabricParameters()
ROPE_PER_KNEE: Final = LegParameters().rope_per_knee
RADIUS: Final = ServoParameters().drum_radius_m


def cable(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(cable_exponent=np.full_like(course.cable_exponent, values["mu1"] * CABLE.theta1_rad))


def fabric(course: Trajectory, values: Values) -> Trajectory:
    mu2, kappa = values.get("mu2", FABRIC.mu2), values.get("fabric_wrap", FABRIC.fabric_wrap)
    return course._replace(fabric_exponent=mu2 * (FABRIC.wrap_rad + kappa * np.abs(course.knee_rad)))


def bend(course: Trajectory, values: Values) -> Trajectory:
    bent = np.maximum(0.0, 1.0 + values["cable_bend"] * np.abs(course.knee_rad))
    return course._replace(cable_exponent=course.cable_exponent * bent)


def _scaled(course: Trajectory, factor: Array) -> Trajectory:
    return course._replace(
        cable_exponent=course.cable_exponent * factor, fabric_exponent=course.fabric_exponent * factor)


def load(course: Trajectory, values: Values) -> Trajectory:
    return _scaled(course, np.maximum(0.05, 1.0 + values["load_slope"] * (course.tension_n / 40.0 - 1.0)))


def stribeck(course: Trajectory, values: Values) -> Trajectory:
    fading = np.exp(-((course.rope_m_s / values["stribeck_speed"]) ** 2))
    return _scaled(course, 1.0 + (values["stribeck_ratio"] - 1.0) * fading)


def drift(course: Trajectory, values: Values) -> Trajectory:
    return _scaled(course, np.maximum(0.05, 1.0 + values["friction_drift"] * course.progress))


def viscous(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_extra_n=course.start_extra_n + values["viscous"] * course.rope_m_s)


def presliding(course: Trajectory, values: Values) -> Trajectory:
    fresh = np.zeros(course.rope_m.size, dtype=np.bool_)
    fresh[0] = True
    slip = slipped(course.rope_m, fresh, values["presliding"])
    strained = slipped(course.stretch_m, fresh, values["presliding"])
    return course._replace(rope_slip=slip, fabric_slip=strained)


def stiffness(course: Trajectory, values: Values) -> Trajectory:
    scale, shape = values.get("stiffness_scale", 1.0), values.get("stiffness_shape", 0.0)
    force = course.desired_n
    nominal = (FABRIC.stretch_a * force + FABRIC.stretch_b) * force
    changed = (FABRIC.stretch_a * (1.0 + shape) * force + FABRIC.stretch_b) * force / scale
    return course._replace(stretch_m=course.stretch_m + changed - nominal)


def creep(course: Trajectory, values: Values) -> Trajectory:
    fresh = np.zeros(course.desired_n.size, dtype=np.bool_)
    gamma = crept(course.desired_n, course.time_s, fresh, values["creep_compliance"], values["creep_time"])
    return course._replace(stretch_m=course.stretch_m + gamma)


def slack(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(rope_extra_m=course.rope_extra_m + values["slack"])


def backlash(course: Trajectory, values: Values) -> Trajectory:
    half = 0.5 * values["knee_backlash"] * np.sign(course.knee_rad_s)
    return course._replace(knee_extra_rad=course.knee_extra_rad + half)


def moment_arm(course: Trajectory, values: Values) -> Trajectory:
    more = values["rope_per_knee_quadratic"] * (course.knee_rad**2 - KNEE_AT_FIT**2)
    turned = (values.get("rope_per_knee", ROPE_PER_KNEE) - ROPE_PER_KNEE) * (course.knee_rad - KNEE_AT_FIT)
    return course._replace(rope_extra_m=course.rope_extra_m + more + turned)


def eccentricity(course: Trajectory, values: Values) -> Trajectory:
    phase = values["eccentricity_phase"]
    payout = values["eccentricity"] * (np.sin(course.rope_m / RADIUS + phase) - math.sin(phase))
    return course._replace(rope_extra_m=course.rope_extra_m - payout)


def start_gain(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_gain=course.start_gain * values["start_gain"])


def start_offset(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_offset"])


def start_drift(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_drift"] * np.asarray(course.progress))


def skew(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(lead_s=course.lead_s + values["timestamp_skew"])
