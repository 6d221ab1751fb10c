"""Effects of friction: in the sheath, on the knee, and how it depends on load, speed, bend, travel and time."""

from __future__ import annotations

from typing import Final

import numpy as np

from physics.effects.effect import Effect, Trajectory, Values, of_table, value_of
from physics.laws import Array
from physics.memory_laws import slipped
from physics.plant.cable import CableParameters
from physics.plant.fabric import FabricParameters

CABLE: Final = CableParameters()
FABRIC: Final = FabricParameters()


def _cable(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(cable_exponent=np.full_like(course.cable_exponent, values["mu1"] * CABLE.theta1_rad))


def _fabric(course: Trajectory, values: Values) -> Trajectory:
    mu2, kappa = values.get("mu2", FABRIC.mu2), values.get("fabric_wrap", FABRIC.fabric_wrap)
    return course._replace(fabric_exponent=mu2 * (FABRIC.wrap_rad + kappa * np.abs(course.knee_rad)))


def _bend(course: Trajectory, values: Values) -> Trajectory:
    bent = np.maximum(0.0, 1.0 + values["cable_bend"] * np.abs(course.knee_rad))
    return course._replace(cable_exponent=course.cable_exponent * bent)


def _scaled(course: Trajectory, factor: Array) -> Trajectory:
    return course._replace(
        cable_exponent=course.cable_exponent * factor, fabric_exponent=course.fabric_exponent * factor)


def _load(course: Trajectory, values: Values) -> Trajectory:
    return _scaled(course, np.maximum(0.05, 1.0 + values["load_slope"] * (course.tension_n / 40.0 - 1.0)))


def _stribeck(course: Trajectory, values: Values) -> Trajectory:
    fading = np.exp(-((course.rope_m_s / values["stribeck_speed"]) ** 2))
    return _scaled(course, 1.0 + (values["stribeck_ratio"] - 1.0) * fading)


def _drift(course: Trajectory, values: Values) -> Trajectory:
    return _scaled(course, np.maximum(0.05, 1.0 + values["friction_drift"] * course.progress))


def _viscous(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(start_extra_n=course.start_extra_n + values["viscous"] * course.rope_m_s)


def _presliding(course: Trajectory, values: Values) -> Trajectory:
    fresh = np.zeros(course.rope_m.size, dtype=np.bool_)
    fresh[0] = True
    slip = slipped(course.rope_m, fresh, values["presliding"])
    strained = slipped(course.stretch_m, fresh, values["presliding"])
    return course._replace(rope_slip=slip, fabric_slip=strained)


EFFECTS: Final = (
    Effect(
        name="cable_friction", site="cable", law="T_start/T_end = e^(μ1·θ1·s)", source="(3)",
        parameters=(of_table("mu1"),),
        forward={"plant.mu1": value_of("mu1")}, inverse=_cable,
        signature="END and START step apart with the rope's direction, in proportion to the tension",
        words="The rope rubs in its sheath more, or less, than the calibration says.",
        rivals=("fabric_friction", "stribeck", "load_dependent_friction"), experiment="known_bend",
    ),
    Effect(
        name="fabric_friction", site="fabric", law="T_in/T_out = e^(μ2·φ·s)", source="(7)",
        parameters=(of_table("mu2"),),
        forward={"plant.mu2": value_of("mu2")}, inverse=_fabric,
        signature="END and START step apart with the fabric's strain rate, in proportion to tension and wrap",
        words="The fabric rubs on the knee more, or less, than the calibration says.",
        rivals=("fabric_wrap", "cable_friction"), experiment="locked_angles",
    ),
    Effect(
        name="fabric_wrap", site="fabric", law="φ = φ0 + κ·|θk|", source="(7), φ(t)",
        parameters=(
            of_table("fabric_wrap"),),
        forward={"plant.fabric_wrap": value_of("fabric_wrap")}, inverse=_fabric,
        signature="the friction loop widens as the knee flexes",
        words="The fabric wraps round the knee more, or less, with flexion than the calibration says.",
        rivals=("fabric_friction", "cable_bend"), experiment="locked_angles",
    ),
    Effect(
        name="cable_bend", site="cable", law="θ1 = θ10·(1 + κb·|θk|)", source="capstan law at a moving bend",
        parameters=(of_table("cable_bend"),),
        forward={"plant.cable_bend": value_of("cable_bend")}, inverse=_bend,
        signature="the loop's width follows the knee angle, with the rope's direction",
        words="The leg bends the sheath as it swings, so that its friction changes with the knee angle.",
        rivals=("cable_friction", "fabric_wrap"), experiment="locked_angles",
    ),
    Effect(
        name="load_dependent_friction", site="cable and fabric", law="μ(T) = μ·(1 + λ·(T/40 N − 1))",
        source="first order of Howell's law F = a·N^n",
        parameters=(of_table("load_slope"),),
        forward={"plant.load_slope": value_of("load_slope")}, inverse=_load,
        signature="the loop is not proportional to the tension",
        words="The friction coefficient itself changes with the load.",
        rivals=("stribeck", "cable_friction", "fabric_friction"), experiment="two_peaks",
    ),
    Effect(
        name="viscous_friction", site="cable", law="F = b·v", source="Newtonian grease film",
        parameters=(of_table("viscous"),),
        forward={"plant.viscous": value_of("viscous")}, inverse=_viscous,
        signature="START exceeds END in proportion to the rope's speed, whatever the load",
        words="Grease drags on the rope in proportion to its speed.",
        rivals=("end_delay", "end_filter"), experiment="two_speeds",
    ),
    Effect(
        name="stribeck", site="cable and fabric", law="μ(v) = μc + (μs − μc)·e^(−(v/vs)²)",
        source="Stribeck curve; the paper's breakaway, Fig. 15",
        parameters=(
            of_table("stribeck_ratio"),
            of_table("stribeck_speed"),
            of_table("stribeck_memory"),
        ),
        forward={"plant.stribeck_ratio": value_of("stribeck_ratio"),
                 "plant.stribeck_speed_m_s": value_of("stribeck_speed"),
                 "plant.stribeck_memory_s": value_of("stribeck_memory")},
        inverse=_stribeck,
        signature="a peak of friction after each reversal and at the start of loading",
        words="The rope breaks away: it rubs more at rest and at creep than when it slides.",
        rivals=("cable_friction", "presliding", "load_dependent_friction"), experiment="dither",
    ),
    Effect(
        name="presliding", site="cable and fabric", law="ds/dx = (1 − s·sgn v)/δ", source="Dahl; Palli et al.",
        parameters=(of_table("presliding"),),
        forward={"plant.presliding_m": value_of("presliding"), "plant.fabric_presliding_m": value_of("presliding")},
        inverse=_presliding,
        signature="friction turns over with travel after a reversal, at no rate; minor loops",
        words="Friction needs a travel, not a moment, to turn over after a reversal.",
        rivals=("knee_backlash", "stribeck"), experiment="amplitude_sweep",
    ),
    Effect(
        name="friction_drift", site="cable and fabric", law="μ(t) = μ·(1 + ρ·t/T), T the trial",
        source="wear or heat, first order",
        parameters=(
            of_table("friction_drift"),),
        forward={
            "plant.friction_drift": value_of("friction_drift"),
            "plant.friction_drift_s": lambda values: values.get("trial_s", CABLE.friction_drift_s),
        },
        inverse=_drift,
        signature="the friction loop's width trends from cycle to cycle",
        words="Friction changes during the trial, as with heat or wear.",
        rivals=("cable_friction", "start_drift", "end_drift"), experiment="rest_repeat",
    ),
)
