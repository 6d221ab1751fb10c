"""Effects of stretch and geometry: stiffness, creep, slack, backlash, moment arm, drum."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from physics.effects.effect import Effect, EffectParameter, Trajectory, Values, takes
from physics.memory_laws import crept
from physics.plant.fabric import FabricParameters
from physics.plant.leg import KNEE_AT_FIT, LegParameters
from physics.plant.motor import ServoParameters

FABRIC: Final = FabricParameters()
RATIO: Final = LegParameters().moment_arm_m
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
    more = values["moment_arm"] * (course.knee_rad**2 - KNEE_AT_FIT**2)
    turned = (values.get("knee_ratio", RATIO) - RATIO) * (course.knee_rad - KNEE_AT_FIT)
    return course._replace(rope_extra_m=course.rope_extra_m + more + turned)


def _eccentricity(course: Trajectory, values: Values) -> Trajectory:
    phase = values["eccentricity_phase"]
    payout = values["eccentricity"] * (np.sin(course.rope_m / RADIUS + phase) - math.sin(phase))
    return course._replace(rope_extra_m=course.rope_extra_m - payout)


EFFECTS: Final = (
    Effect(
        name="stiffness", site="cable and fabric", law="e = (b·F + (1 + h)·a·F²)/s", source="(10)",
        parameters=(
            EffectParameter("stiffness_scale", "", 0.3, 3.0, (0.75, 1.35), 1.0, "s: stiffness against (10)"),
            EffectParameter("stiffness_shape", "", -0.9, 1.0, (-0.5, 0.5), 0.0, "h: relative change of ak"),
        ),
        forward={
            "plant.stiffness_scale": lambda v: v.get("stiffness_scale", 1.0),
            "plant.stiffness_shape": lambda v: v.get("stiffness_shape", 0.0),
        },
        inverse=_stiffness, relations=("elasticity", "kinematics"),
        signature="tension is off in one sense both ways, more with load",
        words="Rope and fabric together are stiffer, or softer, than the calibration's curve.",
        rivals=("start_gain", "end_gain", "fabric_creep"), experiment="dead_weight",
    ),
    Effect(
        name="fabric_creep", site="fabric", law="γ̇ = (J·T − γ)/τ", source="Kelvin–Voigt element",
        parameters=(
            EffectParameter("creep_compliance", "m/N", 0.0, 0.2e-3, (0.01e-3, 0.04e-3), 0.0, "J"),
            EffectParameter("creep_time", "s", 0.05, 300.0, (0.2, 100.0), None, "τ"),
        ),
        forward={"plant.creep_compliance": takes("creep_compliance"), "plant.creep_s": takes("creep_time")},
        inverse=_creep, relations=("elasticity", "kinematics"),
        signature="tension relaxes while position is held, and comes back after unloading",
        words="The fabric creeps under load and recovers.",
        rivals=("slack", "stiffness", "friction_drift"), experiment="hold_return",
    ),
    Effect(
        name="slack", site="cable", law="T = 0 while e < 0; e = x − x0 − slack", source="a rope cannot push",
        parameters=(EffectParameter("slack", "m", -5e-3, 20e-3, (0.5e-3, 5e-3), 0.0, "length to be wound up first"),),
        forward={"plant.slack_m": takes("slack")}, inverse=_slack, relations=("elasticity", "kinematics"),
        signature="tension begins late; elsewhere the curve is only shifted along the rope",
        words="There is rope to be wound up before it is taut.",
        rivals=("start_offset", "end_offset", "fabric_creep"), experiment="unload",
    ),
    Effect(
        name="knee_backlash", site="knee drive", law="dead band in θk", source="gear play of the reducer",
        parameters=(
            EffectParameter(
                "knee_backlash", "rad", 0.0, 0.2, (math.radians(0.3), math.radians(2.0)), 0.0, "whole dead band"),),
        forward={"plant.knee_backlash_rad": takes("knee_backlash")}, inverse=_backlash,
        relations=("elasticity", "kinematics"),
        signature="the leg lags the knee drive by a fixed angle after each of its reversals",
        words="The knee's reducer has play.",
        rivals=("presliding",), experiment="locked_motor",
    ),
    Effect(
        name="moment_arm", site="leg", law="x2 = k2·θ + k3·θ²", source="(11), next order",
        parameters=(
            EffectParameter("moment_arm", "m/rad²", -0.01, 0.01, (-1.97e-3, 1.97e-3), 0.0, "k3; θ from upright"),
            EffectParameter("knee_ratio", "m/rad", 0.9 * RATIO, 1.1 * RATIO, (0.95 * RATIO, 1.05 * RATIO), None,
                            "k2; a swing finds the slope where it swings, not upright"),
        ),
        forward={"plant.moment_arm": takes("moment_arm"),
                 "plant.moment_arm_m": lambda values: values.get("knee_ratio", RATIO)}, inverse=_moment_arm,
        relations=("elasticity", "kinematics"),
        signature="rope and knee angle part by an even function of the angle",
        words="The leg's lever arm changes with the knee angle.",
        rivals=("drum_eccentricity", "stiffness"), experiment="locked_angles",
    ),
    Effect(
        name="drum_eccentricity", site="drum", law="x + A·(sin(x/R + φ) − sin φ)", source="an eccentric circle",
        parameters=(
            EffectParameter("eccentricity", "m", 0.0, 2e-3, (0.1e-3, 0.5e-3), 0.0, "A"),
            EffectParameter("eccentricity_phase", "rad", -math.pi, math.pi, (-math.pi, math.pi), None, "φ"),
        ),
        forward={"plant.eccentricity_m": takes("eccentricity"), "plant.eccentricity_rad": takes("eccentricity_phase")},
        inverse=_eccentricity, relations=("elasticity", "kinematics"),
        signature="rope and knee angle part periodically with the drum's angle",
        words="The drum runs out of true.",
        rivals=("moment_arm",), experiment="full_turns",
    ),
)
