"""Effects of the two tension sensors: what they carry, scale, shift, delay and round."""

from __future__ import annotations

from typing import Final

import numpy as np

from physics.converter import SensorParameters
from physics.effects.effect import Effect, Trajectory, Values, of_table, value_of

SENSOR: Final = SensorParameters()


def _start_gain(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_gain=course.start_gain * values["start_gain"])


def _start_offset(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_offset"])


def _start_drift(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_offset_n=course.start_offset_n + values["start_drift"] * np.asarray(course.progress))


def _gain(side: str, rival: str) -> Effect:
    return Effect(
        name=f"{side}_gain", site=f"{side.upper()} sensor", law="reading = g·T", source="bridge sensitivity",
        parameters=(of_table(f"{side}_gain"),),
        forward={f"{side}_sensor.gain": value_of(f"{side}_gain")},
        inverse=_start_gain if side == "start" else _no_use,
        signature="one sensor is off in proportion to the tension, in no direction of motion",
        words=f"The {side.upper()} sensor's gain is wrong.",
        rivals=(rival, "stiffness"), experiment="dead_weight" if side == "end" else "swapped_sensors",
    )


def _offset(side: str) -> Effect:
    return Effect(
        name=f"{side}_offset", site=f"{side.upper()} sensor", law="reading = T + o", source="bridge zero",
        parameters=(of_table(f"{side}_offset"),),
        forward={f"{side}_sensor.offset_n": value_of(f"{side}_offset")},
        inverse=_start_offset if side == "start" else _no_use,
        signature="one sensor is off by the same force everywhere, slack included",
        words=f"The {side.upper()} sensor's zero is wrong.",
        rivals=("slack", "end_mass") if side == "end" else ("slack",), experiment="unload",
    )


def _drift(side: str) -> Effect:
    return Effect(
        name=f"{side}_drift", site=f"{side.upper()} sensor", law="reading = T + d·t/T, T the trial",
        source="bridge temperature, first order",
        parameters=(of_table(f"{side}_drift"),),
        forward={
            f"{side}_sensor.drift_n": value_of(f"{side}_drift"),
            f"{side}_sensor.drift_s": lambda values: values.get("trial_s", SENSOR.drift_s),
        },
        inverse=_start_drift if side == "start" else _no_use,
        signature="one sensor's level trends with time, slack included",
        words=f"The {side.upper()} sensor's zero drifts.",
        rivals=("friction_drift",), experiment="rest_repeat",
    )


def _no_use(course: Trajectory, values: Values) -> Trajectory:
    """Return `course` unchanged: END is out of the loop, so its errors change the verification, not the control."""
    del values
    return course


EFFECTS: Final = (
    Effect(
        name="end_mass", site="END sensor", law="reading = T + m·(g·cos θk + L·θ̈k)",
        source="the paper, 5.2 and Fig. 15",
        parameters=(
            of_table("end_mass"),
            of_table("end_mass_arm"),
        ),
        forward={
            "plant.end_mass_kg": value_of("end_mass"),
            "plant.end_mass_arm_m": lambda values: values.get("end_mass_arm", 0.25),
        },
        inverse=_no_use,
        signature="END moves with the leg's angle and acceleration, also at zero tension",
        words="The END sensor, mounted on a cantilever, weighs itself and the rope.",
        rivals=("end_offset",), experiment="slack_swing",
    ),
    _gain("end", "start_gain"), _gain("start", "end_gain"),
    _offset("end"), _offset("start"), _drift("end"), _drift("start"),
    Effect(
        name="end_delay", site="END sensor", law="reading(t) = T(t − d)", source="dead time of converter or bus",
        parameters=(of_table("end_delay"),),
        forward={"end_sensor.delay_s": value_of("end_delay")}, inverse=_no_use,
        signature="END is late: off in proportion to dT/dt",
        words="The END signal arrives late by a fixed time.",
        rivals=("end_filter", "viscous_friction", "timestamp_skew"), experiment="step",
    ),
    Effect(
        name="end_filter", site="END sensor", law="τ·dy/dt + y = T", source="first-order low-pass",
        parameters=(of_table("end_filter"),),
        forward={"end_sensor.lag_s": value_of("end_filter")}, inverse=_no_use,
        signature="END is late and rounded: off in proportion to dT/dt",
        words="The END signal is filtered more than the calibration says.",
        rivals=("end_delay", "viscous_friction"), experiment="step",
    ),
    Effect(
        name="quantisation", site="converter", law="reading = q·round(T/q)", source="step of the converter or PDO",
        parameters=(of_table("quantum"),),
        forward={"start_sensor.quantum_n": value_of("quantum"), "end_sensor.quantum_n": value_of("quantum")},
        inverse=_no_use,
        signature="readings sit on a grid",
        words="The tension is read in steps that are too coarse.",
        rivals=("lost_pdo",), experiment="bus_log", grid=value_of("quantum"),
    ),
)
