"""Effects of the two tension sensors: what they carry, scale, shift, delay and round."""

from __future__ import annotations

from typing import Final

import numpy as np

from physics.converter import SensorParameters
from physics.effects.effect import Effect, EffectParameter, Trajectory, Values, takes

SENSOR: Final = SensorParameters()


def _start_gain(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_gain=course.start_gain * values["start_gain"])


def _start_offset(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_offset"])


def _start_drift(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_drift"] * np.asarray(course.progress))


def _gain(side: str, rival: str) -> Effect:
    relations = ("friction", "kinematics") if side == "end" else ("friction", "elasticity")
    return Effect(
        name=f"{side}_gain", site=f"{side.upper()} sensor", law="reading = g·T", source="bridge sensitivity",
        parameters=(EffectParameter(f"{side}_gain", "", 0.5, 1.5, (0.92, 1.08), 1.0, "g"),),
        forward={f"{side}_sensor.gain": takes(f"{side}_gain")},
        inverse=_start_gain if side == "start" else _no_use, relations=relations,
        signature="one sensor is off in proportion to the tension, in no direction of motion",
        words=f"The {side.upper()} sensor's gain is wrong.",
        rivals=(rival, "stiffness"), experiment="dead_weight" if side == "end" else "swapped_sensors",
    )


def _offset(side: str) -> Effect:
    return Effect(
        name=f"{side}_offset", site=f"{side.upper()} sensor", law="reading = T + o", source="bridge zero",
        parameters=(EffectParameter(f"{side}_offset", "N", -20.0, 20.0, (-3.0, 3.0), 0.0, "o"),),
        forward={f"{side}_sensor.offset_n": takes(f"{side}_offset")},
        inverse=_start_offset if side == "start" else _no_use,
        relations=("friction", "end_sensor") if side == "end" else ("friction", "elasticity", "start_sensor"),
        signature="one sensor is off by the same force everywhere, slack included",
        words=f"The {side.upper()} sensor's zero is wrong.",
        rivals=("slack", "end_mass") if side == "end" else ("slack",), experiment="unload",
    )


def _drift(side: str) -> Effect:
    return Effect(
        name=f"{side}_drift", site=f"{side.upper()} sensor", law="reading = T + d·t/T, T the trial",
        source="bridge temperature, first order",
        parameters=(EffectParameter(f"{side}_drift", "N", -20.0, 20.0, (-3.0, 3.0), 0.0, "d: over the trial"),),
        forward={
            f"{side}_sensor.drift_n": takes(f"{side}_drift"),
            f"{side}_sensor.drift_s": lambda values: values.get("trial_s", SENSOR.drift_s),
        },
        inverse=_start_drift if side == "start" else _no_use,
        relations=("friction", "end_sensor") if side == "end" else ("friction", "elasticity", "start_sensor"),
        signature="one sensor's level trends with time, slack included",
        words=f"The {side.upper()} sensor's zero drifts.",
        rivals=("friction_drift",), experiment="rest_repeat",
    )


def _no_use(course: Trajectory, values: Values) -> Trajectory:
    """END is out of the loop: its errors change what is verified, not what is done."""
    del values
    return course


EFFECTS: Final = (
    Effect(
        name="end_mass", site="END sensor", law="reading = T + m·(g·cos θk + L·θ̈k)",
        source="the paper, 5.2 and Fig. 15",
        parameters=(
            EffectParameter("end_mass", "kg", 0.0, 0.5, (0.05, 0.15), 0.0, "m, carried on the cantilever"),
            EffectParameter("end_mass_arm", "m", 0.05, 0.6, (0.15, 0.35), None, "L, from the knee"),
        ),
        forward={
            "plant.end_mass_kg": takes("end_mass"),
            "plant.end_mass_arm_m": lambda values: values.get("end_mass_arm", 0.25),
        },
        inverse=_no_use, relations=("friction", "kinematics", "end_sensor"),
        signature="END moves with the leg's angle and acceleration, also at zero tension",
        words="The END sensor, mounted on a cantilever, weighs itself and the rope.",
        rivals=("end_offset",), experiment="slack_swing",
    ),
    _gain("end", "start_gain"), _gain("start", "end_gain"),
    _offset("end"), _offset("start"), _drift("end"), _drift("start"),
    Effect(
        name="end_delay", site="END sensor", law="reading(t) = T(t − d)", source="dead time of converter or bus",
        parameters=(EffectParameter("end_delay", "s", 0.0, 0.1, (5e-3, 20e-3), 0.0, "d"),),
        forward={"end_sensor.delay_s": takes("end_delay")}, inverse=_no_use, relations=("friction", "kinematics"),
        signature="END is late: off in proportion to dT/dt",
        words="The END signal arrives late by a fixed time.",
        rivals=("end_filter", "viscous_friction", "timestamp_skew"), experiment="step",
    ),
    Effect(
        name="end_filter", site="END sensor", law="τ·dy/dt + y = T", source="first-order low-pass",
        parameters=(EffectParameter("end_filter", "s", 0.0, 0.1, (5e-3, 20e-3), 0.0, "τ"),),
        forward={"end_sensor.lag_s": takes("end_filter")}, inverse=_no_use, relations=("friction", "kinematics"),
        signature="END is late and rounded: off in proportion to dT/dt",
        words="The END signal is filtered more than the calibration says.",
        rivals=("end_delay", "viscous_friction"), experiment="step",
    ),
    Effect(
        name="quantisation", site="converter", law="reading = q·round(T/q)", source="step of the converter or PDO",
        parameters=(EffectParameter("quantum", "N", 0.0, 20.0, (0.1, 2.0), 0.0, "q"),),
        forward={"start_sensor.quantum_n": takes("quantum"), "end_sensor.quantum_n": takes("quantum")},
        inverse=_no_use, relations=("start_sensor", "end_sensor"),
        signature="readings sit on a grid",
        words="The tension is read in steps that are too coarse.",
        rivals=("lost_pdo",), experiment="bus_log", grid=takes("quantum"),
    ),
)
