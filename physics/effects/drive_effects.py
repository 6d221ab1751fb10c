"""Effects of the servo and of the wire: friction and limits of the drive, time stamps, late and lost PDOs."""

from __future__ import annotations

import math
from typing import Final

from physics.effects.effect import Effect, EffectParameter, Trajectory, Values, takes, unchanged
from physics.plant.motor import ServoParameters
from physics.sampling_laws import Staleness

SERVO: Final = ServoParameters()


def _skew(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(lead_s=course.lead_s + values["timestamp_skew"])


def _drive(
    name: str, parameter: EffectParameter, target: str, law: str, signature: str, words: str, rivals: tuple[str, ...]
) -> Effect:
    return Effect(
        name=name, site="servo drive", law=law, source="friction of motor and reducer; J·ω̇",
        parameters=(parameter,), forward={f"plant.{target}": takes(parameter.name)}, inverse=unchanged,
        relations=("drive_force",), signature=signature, words=words, rivals=rivals, experiment="three_speeds",
    )


EFFECTS: Final = (
    _drive("drive_coulomb", EffectParameter("drive_coulomb", "N", 0.0, 50.0, (2.0, 10.0), None, "at the rope"),
           "servo_coulomb_n", "F = Fc·s", "servo force steps with the direction of motion, whatever load and speed",
           "Motor or reducer rub more than nominal.", ("drive_asymmetry", "drive_viscous", "drive_offset")),
    _drive("drive_viscous", EffectParameter("drive_viscous", "N·s/m", 0.0, 500.0, (30.0, 150.0), None, "at the rope"),
           "servo_viscous", "F = b·v", "servo force grows with speed",
           "Motor or reducer drag in proportion to speed more than nominal.", ("drive_coulomb", "drive_inertia")),
    _drive("drive_offset", EffectParameter("drive_offset", "N", -50.0, 50.0, (-5.0, 5.0), 0.0, "against pulling"),
           "servo_offset_n", "F = F0", "servo force is off by the same amount both ways",
           "A constant force acts on the drum that no sensor sees.", ("drive_asymmetry", "start_offset")),
    _drive("drive_asymmetry", EffectParameter("drive_asymmetry", "", -0.95, 0.95, (-0.5, 0.5), 0.0, "relative"),
           "servo_asymmetry", "F = Fc·(1 + α·sgn v)·sgn v", "the step with direction is larger one way",
           "The drive rubs more one way than the other.", ("drive_offset", "drive_coulomb")),
    _drive("drive_inertia", EffectParameter("drive_inertia", "kg", 0.5, 30.0, (3.5, 10.0), None, "J/R² at the rope"),
           "servo_inertia_kg", "F = M·v̇", "servo force follows the rope's acceleration",
           "Rotor, reducer and drum are heavier than nominal.", ("drive_viscous",)),
    Effect(
        name="saturation", site="servo drive", law="|i| ≤ i_max", source="current limit",
        parameters=(EffectParameter("current_limit", "A", 0.1, 30.0, (0.8, 3.0), None, "i_max"),),
        forward={"plant.current_limit_a": takes("current_limit")}, relations=("servo", "drive_force"),
        signature="the target leaves motion behind while the servo force stands at one value",
        words="The servo reaches its current limit.",
        rivals=("supply_sag", "drive_coulomb"), experiment="log_current",
    ),
    Effect(
        name="supply_sag", site="supply", law="U = U0 − R·P/U0", source="internal resistance of the supply",
        parameters=(EffectParameter("supply_ohm", "Ω", 0.0, 5.0, (1.0, 5.0), 0.0, "R"),),
        forward={"plant.supply_ohm": takes("supply_ohm")}, relations=("servo", "drive_force"),
        signature="the target leaves motion behind at speed under load",
        words="The supply sags, so that voltage limits speed.",
        rivals=("saturation",), experiment="log_current",
    ),
    Effect(
        name="timestamp_skew", site="bus", law="tensions(t) = true(t − d)", source="stamps taken at another instant",
        parameters=(EffectParameter("timestamp_skew", "s", 0.0, 0.1, (5e-3, 20e-3), 0.0, "d"),),
        forward={"start_sensor.skew_s": takes("timestamp_skew"), "end_sensor.skew_s": takes("timestamp_skew")},
        inverse=_skew, relations=("elasticity", "kinematics", "drive_force"),
        signature="both tensions are late against both positions",
        words="Tensions and positions are stamped at different instants.",
        rivals=("end_delay", "late_pdo"), experiment="step",
    ),
    Effect(
        name="late_pdo", site="bus", law="the value of one cycle arrives in a later one", source="bus log",
        parameters=(
            EffectParameter("late", "s", 0.0, 0.1, (1e-3, 20e-3), 0.0, "by how much"),
            EffectParameter("late_share", "", 0.0, 1.0, (0.01, 1.0), None, "of the PDOs"),
        ),
        forward={"bus.late_s": takes("late"), "bus.late_share": lambda values: values.get("late_share", 1.0)},
        relations=("bus",), signature="ages above one cycle, values that repeat and then jump",
        words="PDOs arrive after the cycle they belong to.",
        rivals=("end_delay", "lost_pdo"), experiment="bus_log",
        stale=lambda values, cycle_s: Staleness(values["late_share"], round(values["late"] / cycle_s)),
    ),
    Effect(
        name="lost_pdo", site="bus", law="the value of one cycle never arrives", source="bus log",
        parameters=(EffectParameter("lost_share", "", 0.0, 1.0, (0.005, 0.2), 0.0, "of the PDOs"),),
        forward={"bus.lost_share": takes("lost_share")},
        relations=("bus",), signature="gaps in the frames, repeats in the signals",
        words="PDOs are lost on the wire.",
        rivals=("late_pdo", "quantisation"), experiment="bus_log",
        stale=lambda values, cycle_s: Staleness(values["lost_share"], math.inf),
    ),
)
