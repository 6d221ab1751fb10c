"""Inverses of effects and terms: the trajectory that a controller should lead so that an effect does not reach END.

An effect without one here (of END, of the drive's force) is nothing that START, rope and knee can undo.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from physics.effects.effect import Trajectory, Values
from physics.laws import Array
from physics.path_laws import crept, slipped
from physics.plant.components import KNEE_AT_FIT, CableParameters, FabricParameters, LegParameters, ServoParameters
from physics.plant.modulated import KNEE_RAD, LATER
from physics.terms import Course, Term

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


Undo = Callable[[Trajectory, Array], Trajectory]


def _factor(name: str) -> Undo:
    return lambda met, added: met._replace(**{name: getattr(met, name) * (1.0 + added)})


def _summand(name: str, of: Callable[[Trajectory, Array], Array]) -> Undo:
    return lambda met, added: met._replace(**{name: getattr(met, name) + of(met, added)})


UNDONE: Final[Mapping[str, Undo]] = {
    "cable": _factor("cable_exponent"),
    "fabric": _factor("fabric_exponent"),
    "stiffness": lambda met, added: met._replace(stretch_m=met.stretch_m / np.maximum(1.0 + added, 0.05)),
    "zero": _summand("rope_extra_m", lambda met, added: added),
    "arm": _summand("rope_extra_m", lambda met, added: added * (met.knee_rad - KNEE_RAD)),
    "dry": _summand("start_extra_n", lambda met, added: added * met.rope_slip),
    "viscous": _summand("start_extra_n", lambda met, added: added * met.rope_m_s),
    "start_gain": _factor("start_gain"),
    "start_offset": _summand("start_offset_n", lambda met, added: added),
}
"""Correction that each carrier needs: what a controller can do by START, rope and knee.  END is no input of it."""


def undone(met: Trajectory, terms: Sequence[Term], samples: int) -> Trajectory:
    """Return the corrections with `terms`; `samples`: of a gait cycle, for the gait's phase.

    Terms of END and of the drive need none; modulations by time have their value in a later trial.
    """
    phase = np.asarray(np.arange(met.time_s.size) % samples / samples)
    course = Course(met.time_s, met.rope_m, met.rope_m_s, met.tension_n, met.knee_rad, phase)
    for term in terms:
        if term.carrier not in UNDONE or term.modulation == "time_sine":
            continue
        later = LATER.get(term.modulation)
        added = term.course(course) if later is None else np.full(met.time_s.size, later * term.size)
        met = UNDONE[term.carrier](met, added)
    return met
