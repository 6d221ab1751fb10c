"""Relations between measured signals that should hold: the table of DESIGN §8's names.

The rule of this file: a relation predicts one measured signal from others through the laws of this room, over
the slots of `models_slots`; an effect that those laws do not read brings its own, by relation (`Effect.measured`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from physics.effects.catalogue import CATALOGUE
from physics.relations import drive_relations, transmission
from physics.relations.measured import Signals, Values

Array = NDArray[np.float64]


class Relation(NamedTuple):
    """One relation: it predicts `output`, in `unit`, from `columns`; `uses` names the slots its law reads.

    `bench_only`: it holds where (10) carries the load, not on a rig whose load is another.
    """

    name: str
    unit: str
    output: str
    columns: tuple[str, ...]
    law: Callable[[Signals, Values], Array]
    uses: frozenset[str]
    bench_only: bool = False


_FRICTION: Final = frozenset({
    "mu1", "mu2", "fabric_wrap", "cable_bend", "load_slope", "viscous", "stribeck_ratio", "stribeck_speed",
    "presliding", "presliding_shape", "fabric_presliding", "friction_drift", "start_gain", "start_offset",
    "start_drift", "tension_ratio", "coulomb", "cable_share", "share_before", "toe", "stiffness_scale",
    "stiffness_shape", "creep_compliance", "creep_time"})
_FABRIC: Final = frozenset({
    "mu2", "fabric_wrap", "load_slope", "stribeck_ratio", "stribeck_speed", "presliding", "presliding_shape",
    "fabric_presliding", "friction_drift", "start_gain", "start_offset", "start_drift"})
_END: Final = frozenset({"end_mass", "end_mass_arm", "end_gain", "end_offset", "end_drift", "end_delay", "end_filter"})
_PATH: Final = frozenset({
    "stiffness_scale", "stiffness_shape", "toe", "cable_share", "creep_compliance", "creep_time", "slack",
    "knee_backlash", "moment_arm", "eccentricity", "eccentricity_phase", "rope_zero", "home_preload",
    "knee_ratio"})
_DRIVE: Final = frozenset({
    "drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset", "drive_asymmetry", "drive_presliding",
    "drive_calm"})

RELATIONS: Final[Mapping[str, Relation]] = {
    relation.name: relation for relation in (
        Relation("friction", "N", "tension_start_n", ("tension_end_n", "servo_position_m"),
                 transmission.friction, _FRICTION | _END | {"timestamp_skew"}),
        Relation("elasticity", "N", "tension_start_n", ("servo_position_m", "knee_angle_rad"),
                 transmission.elasticity, _FRICTION | _PATH | {"timestamp_skew"}, bench_only=True),
        Relation("kinematics", "rad", "knee_angle_rad", ("servo_position_m",),
                 transmission.kinematics, _PATH | _END | _FABRIC | {"timestamp_skew"}),
        Relation("servo", "m", "servo_position_m", ("servo_target_m",), drive_relations.servo, frozenset({
            "servo_bandwidth", "servo_damping", "servo_delay", "current_limit", "supply_ohm"})),
        Relation("drive_force", "N", "servo_force_n", ("servo_position_m",),
                 drive_relations.drive_force, _DRIVE | {"start_gain", "start_offset", "start_drift", "timestamp_skew"}),
        Relation("knee", "rad", "knee_angle_rad", ("knee_target_rad",), drive_relations.knee, frozenset({
            "knee_bandwidth", "knee_damping", "knee_delay"})),
    )
}


def uses(relation: Relation) -> frozenset[str]:
    """Return the slots that move `relation`: its law's, and those of effects that bring their own law for it."""
    brought = {p.name for effect in CATALOGUE.values() if relation.name in effect.measured for p in effect.parameters}
    return relation.uses | brought


def predict(relation: Relation, signals: Signals, values: Values) -> Array:
    """Return the prediction of `relation`, with the laws that effects bring themselves put on top."""
    predicted = relation.law(signals, values)
    for effect in CATALOGUE.values():
        brought = effect.measured.get(relation.name)
        if brought is not None and any(p.name in values and values[p.name] != p.neutral for p in effect.parameters):
            predicted = brought(signals.columns, predicted, values)
    return predicted
