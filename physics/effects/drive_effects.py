"""Effects of the servo and of the wire: friction and limits of the drive, time stamps, late and lost PDOs."""

from __future__ import annotations

import math
from typing import Final

from physics.effects.effect import Effect, Trajectory, Values, of_table, unchanged, value_of
from physics.plant.motor import ServoParameters
from physics.sampling_laws import Staleness

SERVO: Final = ServoParameters()


def _skew(course: Trajectory, values: Values) -> Trajectory:
    return course._replace(lead_s=course.lead_s + values["timestamp_skew"])


def _drive(
    name: str, target: str, law: str, signature: str, words: str, rivals: tuple[str, ...],
) -> Effect:
    return Effect(
        name=name, site="servo drive", law=law, source="friction of motor and reducer; J·ω̇",
        parameters=(of_table(name),), forward={f"plant.{target}": value_of(name)}, inverse=unchanged,
        signature=signature, words=words, rivals=rivals, experiment="three_speeds",
    )


"""The force that a drive needs for its own motion determines at which load its limits act."""
EFFECTS: Final = (
    _drive("drive_coulomb", "servo_coulomb_n", "F = Fc·s",
           "servo force steps with the direction of motion, whatever load and speed",
           "Motor or reducer rub more than nominal.", ("drive_asymmetry", "drive_viscous", "drive_offset")),
    _drive("drive_viscous", "servo_viscous", "F = b·v", "servo force grows with speed",
           "Motor or reducer drag in proportion to speed more than nominal.", ("drive_coulomb", "drive_inertia")),
    _drive("drive_offset", "servo_offset_n", "F = F0", "servo force is off by the same amount both ways",
           "A constant force acts on the drum that no sensor sees.", ("drive_asymmetry", "start_offset")),
    _drive("drive_asymmetry", "servo_asymmetry", "F = Fc·(1 + α·sgn v)·sgn v",
           "the step with direction is larger one way",
           "The drive rubs more one way than the other.", ("drive_offset", "drive_coulomb")),
    _drive("drive_inertia", "servo_inertia_kg", "F = M·v̇", "servo force follows the rope's acceleration",
           "Rotor, reducer and drum are heavier than nominal.", ("drive_viscous",)),
    _drive("drive_viscous_asymmetry", "servo_viscous_asymmetry", "F = b·(v + β·|v|)",
           "servo force grows with speed more one way than the other",
           "Motor or reducer drag more one way than the other.", ("drive_viscous", "drive_asymmetry")),
    _drive("drive_presliding", "servo_presliding_m", "ds/dx = (1 − s·sgn v)/δ",
           "servo force turns over gradually after each reversal, at any speed",
           "The drive's own friction needs travel to turn over.", ("drive_coulomb", "drive_inertia")),
    Effect(
        name="unbalance", site="servo drive", law="F = (m·g·r/R)·sin(q + φ)", source="weight on a lever",
        parameters=(of_table("unbalance"), of_table("unbalance_phase")),
        forward={"plant.servo_unbalance_n": value_of("unbalance"),
                 "plant.servo_unbalance_rad": value_of("unbalance_phase")},
        signature="servo force follows the sine of the axis' angle, at any speed",
        words="A mass off the axis pulls with gravity: it is another than it was.",
        rivals=("drive_offset", "drive_inertia", "demand_gain"), experiment="three_speeds",
    ),
    Effect(
        name="drive_stribeck", site="servo drive", law="F = Fc·s·(1 + (r − 1)·e^(−(v/vs)²))",
        source="Stribeck curve", parameters=(of_table("drive_stribeck_ratio"), of_table("drive_stribeck_speed")),
        forward={"plant.servo_stribeck_ratio": value_of("drive_stribeck_ratio"),
                 "plant.servo_stribeck_speed_m_s": value_of("drive_stribeck_speed")},
        signature="servo force is greater at creep than in quick motion",
        words="The drive breaks away: it rubs more at creep than when it runs.",
        rivals=("drive_coulomb", "drive_viscous"), experiment="three_speeds",
    ),
    _drive("demand_gain", "demand_gain", "F = g·F_said",
           "servo force is off in proportion to START tension",
           "The drive gives more, or less, force than it says: its torque constant is another.",
           ("start_gain", "drive_coulomb")),
    Effect(
        name="saturation", site="servo drive", law="|i| ≤ i_max", source="current limit",
        parameters=(of_table("current_limit"),),
        forward={"plant.current_limit_a": value_of("current_limit")},
        signature="the target leaves motion behind while the servo force stands at one value",
        words="The servo reaches its current limit.",
        rivals=("supply_sag", "drive_coulomb"), experiment="log_current",
    ),
    Effect(
        name="supply_sag", site="supply", law="U = U0 − R·P/U0", source="internal resistance of the supply",
        parameters=(of_table("supply_ohm"),),
        forward={"plant.supply_ohm": value_of("supply_ohm")},
        signature="the target leaves motion behind at speed under load",
        words="The supply sags, so that voltage limits speed.",
        rivals=("saturation",), experiment="log_current",
    ),
    Effect(
        name="timestamp_skew", site="bus", law="tensions(t) = true(t − d)", source="stamps taken at another instant",
        parameters=(of_table("timestamp_skew"),),
        forward={"start_sensor.skew_s": value_of("timestamp_skew"), "end_sensor.skew_s": value_of("timestamp_skew")},
        inverse=_skew,
        signature="both tensions are late against both positions",
        words="Tensions and positions are stamped at different instants.",
        rivals=("end_delay", "late_pdo"), experiment="step",
    ),
    Effect(
        name="late_pdo", site="bus", law="the value of one cycle arrives in a later one", source="bus log",
        parameters=(
            of_table("late"),
            of_table("late_share"),
        ),
        forward={"bus.late_s": value_of("late"), "bus.late_share": lambda values: values.get("late_share", 1.0)},
        signature="ages above one cycle, values that repeat and then jump",
        words="PDOs arrive after the cycle they belong to.",
        rivals=("end_delay", "lost_pdo"), experiment="bus_log",
        stale=lambda values, cycle_s: Staleness(values["late_share"], round(values["late"] / cycle_s)),
    ),
    Effect(
        name="lost_pdo", site="bus", law="the value of one cycle never arrives", source="bus log",
        parameters=(of_table("lost_share"),),
        forward={"bus.lost_share": value_of("lost_share")},
        signature="gaps in the frames, repeats in the signals",
        words="PDOs are lost on the wire.",
        rivals=("late_pdo", "quantisation"), experiment="bus_log",
        stale=lambda values, cycle_s: Staleness(values["lost_share"], math.inf),
    ),
)
