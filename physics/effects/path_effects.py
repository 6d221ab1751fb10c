"""Effects of stretch and geometry: stiffness, creep, slack, backlash, moment arm, drum."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from physics.effects.effect import Effect, Trajectory, Values, of_table, value_of
from physics.memory_laws import crept
from physics.plant.fabric import FabricParameters
from physics.plant.leg import KNEE_AT_FIT, LegParameters
from physics.plant.motor import ServoParameters

FABRIC: Final = FabricParameters()
ROPE_PER_KNEE: Final = LegParameters().rope_per_knee
RADIUS: Final = ServoParameters().drum_radius_m


def _stiffness(course: Trajectory, values: Values) -> Trajectory:
    scale, shape = values.get("stiffness_scale", 1.0), values.get("stiffness_shape", 0.0)
    force = course.desired_n
    nominal = (FABRIC.stretch_a * force + FABRIC.stretch_b) * force
    changed = (FABRIC.stretch_a * (1.0 + shape) * force + FABRIC.stretch_b) * force / scale
    return course._replace(stretch_m=course.stretch_m + changed - nominal)


def _creep(course: Trajectory, values: Values) -> Trajectory:
    fresh = np.zeros(course.desired_n.size, dtype=np.bool_)
    gamma = crept(course.desired_n, course.time_s, fresh, values["creep_compliance"], values["creep_time"])
    return course._replace(stretch_m=course.stretch_m + gamma)


def _slack(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(rope_extra_m=course.rope_extra_m + values["slack"])


def _backlash(course: Trajectory, values: Values) -> Trajectory:
    half = 0.5 * values["knee_backlash"] * np.sign(course.knee_rad_s)
    return course._replace(knee_extra_rad=course.knee_extra_rad + half)


def _moment_arm(course: Trajectory, values: Values) -> Trajectory:
    more = values["rope_per_knee_quadratic"] * (course.knee_rad**2 - KNEE_AT_FIT**2)
    turned = (values.get("rope_per_knee", ROPE_PER_KNEE) - ROPE_PER_KNEE) * (course.knee_rad - KNEE_AT_FIT)
    return course._replace(rope_extra_m=course.rope_extra_m + more + turned)


def _eccentricity(course: Trajectory, values: Values) -> Trajectory:
    phase = values["eccentricity_phase"]
    payout = values["eccentricity"] * (np.sin(course.rope_m / RADIUS + phase) - math.sin(phase))
    return course._replace(rope_extra_m=course.rope_extra_m - payout)


EFFECTS: Final = (
    Effect(
        name="stiffness", site="cable and fabric", law="e = (b·F + (1 + h)·a·F²)/s", source="(10)",
        parameters=(
            of_table("stiffness_scale"),
            of_table("stiffness_shape"),
        ),
        forward={
            "plant.stiffness_scale": lambda v: v.get("stiffness_scale", 1.0),
            "plant.stiffness_shape": lambda v: v.get("stiffness_shape", 0.0),
        },
        inverse=_stiffness,
        signature="tension is off in one sense both ways, more with load",
        words="Rope and fabric together are stiffer, or softer, than the calibration's curve.",
        rivals=("start_gain", "end_gain", "fabric_creep"), experiment="dead_weight",
    ),
    Effect(
        name="fabric_creep", site="fabric", law="γ̇ = (J·T − γ)/τ", source="Kelvin–Voigt element",
        parameters=(
            of_table("creep_compliance"),
            of_table("creep_time"),
        ),
        forward={"plant.creep_compliance": value_of("creep_compliance"), "plant.creep_s": value_of("creep_time")},
        inverse=_creep,
        signature="tension relaxes while position is held, and comes back after unloading",
        words="The fabric creeps under load and recovers.",
        rivals=("slack", "stiffness", "friction_drift"), experiment="hold_return",
    ),
    Effect(
        name="slack", site="cable", law="T = 0 while e < 0; e = x − x0 − slack", source="a rope cannot push",
        parameters=(of_table("slack"),),
        forward={"plant.slack_m": value_of("slack")}, inverse=_slack,
        signature="tension begins late; elsewhere the curve is only shifted along the rope",
        words="There is rope to be wound up before it is taut.",
        rivals=("start_offset", "end_offset", "fabric_creep"), experiment="unload",
    ),
    Effect(
        name="knee_backlash", site="knee drive", law="dead band in θk", source="gear play of the reducer",
        parameters=(
            of_table("knee_backlash"),),
        forward={"plant.knee_backlash_rad": value_of("knee_backlash")}, inverse=_backlash,
        signature="the leg lags the knee drive by a fixed angle after each of its reversals",
        words="The knee's reducer has play.",
        rivals=("presliding",), experiment="locked_motor",
    ),
    Effect(
        name="moment_arm", site="leg", law="x2 = k2·θ + k3·θ²", source="(11), next order",
        parameters=(
            of_table("rope_per_knee_quadratic"),
            of_table("rope_per_knee"),
        ),
        forward={"plant.rope_per_knee_quadratic": value_of("rope_per_knee_quadratic"),
                 "plant.rope_per_knee": lambda values: values.get("rope_per_knee", ROPE_PER_KNEE)},
        inverse=_moment_arm,
        signature="rope and knee angle part by an even function of the angle",
        words="The leg's lever arm changes with the knee angle.",
        rivals=("drum_eccentricity", "stiffness"), experiment="locked_angles",
    ),
    Effect(
        name="drum_eccentricity", site="drum", law="x + A·(sin(x/R + φ) − sin φ)", source="an eccentric circle",
        parameters=(
            of_table("eccentricity"),
            of_table("eccentricity_phase"),
        ),
        forward={"plant.eccentricity_m": value_of("eccentricity"),
                 "plant.eccentricity_rad": value_of("eccentricity_phase")},
        inverse=_eccentricity,
        signature="rope and knee angle part periodically with the drum's angle, servo force and START tension by "
                  "its slope",
        words="The drum runs out of true.",
        rivals=("moment_arm",), experiment="full_turns",
    ),
)
