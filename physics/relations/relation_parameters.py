"""The parameters of the relations between measured signals: one flat table.

The rule of this file: a slot says its value on the healthy bench, how far like benches differ (1σ), its value
in an ideal transmission (rigid, frictionless, sensors true), and its bounds on any rig; what an effect may do
to it stands in the catalogue.  Sources of σ: DIAGNOSIS' tolerances of like benches; ours where marked.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from physics.plant.cable import CableParameters
from physics.plant.fabric import FabricParameters
from physics.plant.leg import LegParameters
from physics.plant.motor import ServoParameters

CABLE: Final = CableParameters()
FABRIC: Final = FabricParameters()
LEG: Final = LegParameters()
SERVO: Final = ServoParameters()
INFINITE: Final = math.inf


class Slot(NamedTuple):
    """One parameter of the relations.

    `free`: on a rig that nothing is known of it is whatever the data say; `bench_only`: its law reads this
    bench's geometry (angle zero, wrap, drum), so on such a rig it says nothing.  `law`: 1σ of what is the same on
    like benches and another on others, so that healthy trials alone move it.
    """

    name: str
    unit: str
    healthy: float
    sigma: float
    ideal: float
    low: float
    high: float
    free: bool = False
    bench_only: bool = False
    law: float = 0.0


_FRICTION: Final = (
    Slot("mu1", "", CABLE.mu1, 0.03 * CABLE.mu1, 0.0, 0.0, 2.0),
    Slot("mu2", "", FABRIC.mu2, 0.05 * FABRIC.mu2, 0.0, 0.0, 2.0, bench_only=True),
    Slot("theta1", "rad", CABLE.theta1_rad, 0.0, CABLE.theta1_rad, 0.0, 20.0),
    Slot("phi0", "rad", FABRIC.wrap_rad, 0.0, FABRIC.wrap_rad, 0.0, 6.0),
    Slot("fabric_wrap", "1/rad", FABRIC.fabric_wrap, 0.0, 0.0, 0.0, 4.0, bench_only=True),
    Slot("cable_bend", "1/rad", 0.0, 0.05, 0.0, -0.7, 1.5, bench_only=True),
    Slot("load_slope", "", 0.0, 0.03, 0.0, -0.8, 0.8),
    Slot("viscous", "N·s/m", 0.0, 0.5, 0.0, -1e4, 1e4, free=True),
    Slot("stribeck_ratio", "", 1.0, 0.05, 1.0, 0.3, 4.0),
    Slot("stribeck_speed", "m/s", 0.010, 0.0, 0.010, 1e-3, 0.1),
    Slot("presliding", "m", CABLE.presliding_m, 0.3 * CABLE.presliding_m, 1e-6, 1e-6, 3e-3),
    Slot("presliding_shape", "", 1.0, 0.0, 1.0, 0.0, 1.5, law=0.3),
    Slot("fabric_presliding", "", 1.0, 0.0, 1.0, 0.1, 5.0, law=0.5),
    Slot("friction_drift", "", 0.0, 0.0, 0.0, -0.95, 3.0),
    Slot("tension_ratio", "", 1.0, 0.0, 1.0, -10.0, 10.0, free=True),
    Slot("coulomb", "N", 0.0, 0.0, 0.0, -1e3, 1e3, free=True),
    Slot("pull_sign", "", 1.0, 0.0, 1.0, -1.0, 1.0),
    Slot("slack_below", "N", 0.3, 0.0, -INFINITE, -INFINITE, 10.0),
)
_PATH: Final = (
    Slot("stiffness_scale", "", 1.0, 0.03, 1e3, 0.05, 1e3),
    Slot("stiffness_shape", "", 0.0, 0.05, 0.0, -4.0, 1.0),
    Slot("cable_share", "", (CABLE.lead_compliance + 0.5 * CABLE.sheath_compliance) / FABRIC.stretch_b, 0.013,
         0.1, 0.0, 1.0, free=True),
    Slot("share_before", "", 1.0, 0.0, 0.5, 0.0, 1.0, free=True),
    Slot("toe", "m", 0.0, 2e-4, 0.0, -2e-3, 2e-3),
    Slot("home_preload", "N", 20.0, 10.0, 0.0, 0.0, 20.0),
    Slot("creep_compliance", "m/N", 0.0, 0.0, 0.0, 0.0, 2e-4),
    Slot("creep_time", "s", 5.0, 0.0, 5.0, 0.05, 300.0),
    Slot("slack", "m", 0.0, 0.0, 0.0, -5e-3, 2e-2),
    Slot("rope_zero", "m", CABLE.encoder_zero_m, 2e-4, 0.0, -1.0, 1.0, free=True),
    Slot("knee_ratio", "m/rad", LEG.moment_arm_m, 0.005 * LEG.moment_arm_m, LEG.moment_arm_m, -10.0, 10.0, free=True),
    Slot("moment_arm", "m/rad²", 0.0, 1.5e-4, 0.0, -0.01, 0.01, bench_only=True),
    Slot("knee_backlash", "rad", 0.0, 0.0, 0.0, 0.0, 0.2),
    Slot("eccentricity", "m", 0.0, 0.0, 0.0, 0.0, 2e-3, bench_only=True),
    Slot("eccentricity_phase", "rad", 0.0, 0.0, 0.0, -math.pi, math.pi, bench_only=True),
    Slot("drum_radius", "m", SERVO.drum_radius_m, 0.0, SERVO.drum_radius_m, 1e-3, 0.5),
)
_SENSORS: Final = (
    Slot("end_mass", "kg", 0.0, 0.0, 0.0, 0.0, 0.5, bench_only=True),
    Slot("end_mass_arm", "m", LEG.end_mass_arm_m, 0.0, LEG.end_mass_arm_m, 0.05, 0.6, bench_only=True),
    Slot("end_gain", "", 1.0, 0.003, 1.0, 0.5, 1.5),
    Slot("start_gain", "", 1.0, 0.003, 1.0, 0.5, 1.5),
    Slot("end_offset", "N", 0.0, 0.1, 0.0, -20.0, 20.0),
    Slot("start_offset", "N", 0.0, 0.1, 0.0, -1e3, 1e3, free=True),
    Slot("end_drift", "N", 0.0, 0.0, 0.0, -20.0, 20.0),
    Slot("start_drift", "N", 0.0, 0.0, 0.0, -20.0, 20.0),
    Slot("end_delay", "s", 0.0, 3e-4, 0.0, 0.0, 0.1),
    Slot("end_filter", "s", 0.0, 0.0, 0.0, 0.0, 0.1),
    Slot("timestamp_skew", "s", 0.0, 3e-4, 0.0, 0.0, 0.1),
)
_DRIVES: Final = (
    Slot("drive_coulomb", "N", SERVO.servo_coulomb_n, 0.1 * SERVO.servo_coulomb_n, 0.0, 0.0, 1e4),
    Slot("drive_viscous", "N·s/m", SERVO.servo_viscous, 0.1 * SERVO.servo_viscous, 0.0, 0.0, 1e5),
    Slot("drive_inertia", "kg", SERVO.servo_inertia_kg, 0.05 * SERVO.servo_inertia_kg, 0.0, 0.0, 1e4),
    Slot("drive_offset", "N", SERVO.servo_offset_n, 0.1, 0.0, -1e4, 1e4),
    Slot("drive_asymmetry", "", SERVO.servo_asymmetry, 0.02, 0.0, -0.95, 0.95),
    Slot("drive_presliding", "m", SERVO.servo_presliding_m, 1.0 * SERVO.servo_presliding_m,
         SERVO.servo_presliding_m, 1e-6, 2e-3),
    Slot("drive_calm", "m/s", 5e-4, 1e-3, 0.0, 0.0, 0.02),
    Slot("current_limit", "A", SERVO.current_limit_a, 0.0, INFINITE, 0.1, INFINITE, bench_only=True),
    Slot("supply_ohm", "Ω", 0.0, 0.0, 0.0, 0.0, 5.0, bench_only=True),
    Slot("servo_bandwidth", "Hz", 25.0, 6.0, 25.0, 1.0, 500.0, free=True),
    Slot("servo_damping", "", 0.9, 0.2, 0.9, 0.2, 3.0, free=True),
    Slot("servo_delay", "s", 2e-3, 1e-3, 2e-3, -0.01, 0.1, free=True),
    Slot("knee_bandwidth", "Hz", 20.0, 6.0, 20.0, 1.0, 500.0, free=True),
    Slot("knee_damping", "", 0.9, 0.2, 0.9, 0.2, 3.0, free=True),
    Slot("knee_delay", "s", 2e-3, 1e-3, 2e-3, -0.01, 0.1, free=True),
)

SLOTS: Final = {slot.name: slot for slot in (*_FRICTION, *_PATH, *_SENSORS, *_DRIVES)}


def healthy() -> dict[str, float]:
    """Return the slots' values on the nominal healthy bench."""
    return {name: slot.healthy for name, slot in SLOTS.items()}


def ideal() -> dict[str, float]:
    """Return the slots' values in a rigid, frictionless transmission with true sensors."""
    return {name: slot.ideal for name, slot in SLOTS.items()}
