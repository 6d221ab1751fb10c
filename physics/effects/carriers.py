"""Sites of the bench at which effects act, and constants that a term or a user's own effect may modulate."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from physics.effects.hypotheses import DRIVE, ELASTICITY, FRICTION, GEOMETRY, SENSOR, TIMING
from physics.forward.constant_table import ConstantTable
from physics.laws import Array
from physics.terms import Carrier


class Site(NamedTuple):
    """One site: place along the rope, in words, and work of the engineer if an effect is named there."""

    place: str
    to_do: str


SITES: Final[Mapping[str, Site]] = {
    "servo drive": Site("the servo drive, before the drum", "Turn the unloaded drum by hand, check coupling, bearing "
                        "and reducer, then record three_speeds."),
    "supply": Site("the supply of the servo drive", "Measure the supply voltage at the highest peak."),
    "drum": Site("the drum, between servo drive and START", "Measure the drum's runout with a dial gauge."),
    "START sensor": Site("the START load cell, between drum and cable", "Check its zero at the slack rope and its gain "
                         "with a known weight, then calibrate it."),
    "END sensor": Site("the END load cell, at the leg end of the rope", "Check its zero at the slack rope, its gain "
                       "with a known weight, its mount and its filter, then calibrate it."),
    "converter": Site("the converter of a load cell", "Set the converter's range to the tension that is measured."),
    "cable": Site("the rope in its sheath, between START and the fabric", "Look for a kink, another bend or a dry "
                  "rope; grease or replace it, then identify again."),
    "fabric": Site("the fabric on the knee, between cable and END", "Look at its seat and its wear; seat or replace "
                   "it, then identify again."),
    "cable and fabric": Site("the rope in its sheath and the fabric on the knee, between START and END", "Look at the "
                             "sheath first, then at the fabric's seat; mend, then identify again."),
    "knee drive": Site("the knee drive", "Swing the locked knee by hand: play is felt; then tighten the reducer."),
    "leg": Site("the anchor of the fabric on the leg", "Measure the anchor's lever arm at three knee angles."),
    "bus": Site("the bus", "Look at the bus log for late, lost or repeated frames, at cable and termination."),
}
"""Every site of the catalogue, by name."""


_C = Carrier
PATH_CARRIERS: Final[Mapping[str, Carrier]] = {
    "zero": _C("m", 3e-3, GEOMETRY, "zero of the rope"),
    "arm": _C("m/rad", 2e-3, GEOMETRY, "lever arm of the knee"),
    "stiffness": _C("", 0.25, ELASTICITY, "stiffness of the path"),
    "cable": _C("", 0.4, FRICTION, "friction of the cable"),
    "fabric": _C("", 0.5, FRICTION, "friction of the fabric"),
    "dry": _C("N", 2.0, FRICTION, "friction that no load changes"),
    "viscous": _C("N·s/m", 12.0, FRICTION, "viscous friction of the rope"),
    "cable_travel": _C("", 0.7, FRICTION, "pre-sliding travel of the cable"),
    "start_gain": _C("", 0.06, SENSOR, "gain of START"),
    "start_offset": _C("N", 2.0, SENSOR, "START"),
    "end_gain": _C("", 0.06, SENSOR, "gain of END"),
    "end_offset": _C("N", 2.0, SENSOR, "END"),
    "start_lag": _C("s", 0.01, TIMING, "lag of START"),
    "end_lag": _C("s", 0.01, TIMING, "lag of END"),
    "drive_coulomb": _C("N", 5.0, DRIVE, "Coulomb friction of the servo"),
    "drive_viscous": _C("N·s/m", 60.0, DRIVE, "viscous friction of the servo"),
    "drive_offset": _C("N", 3.0, DRIVE, "servo force"),
    "demand_gain": _C("", 0.1, DRIVE, "gain of the servo's force"),
}
"""Constants of the bench that terms may modulate; sizes as the catalogue's effects of the same constant have them."""
NEEDS: Final[Mapping[str, str]] = {"end_": "tension_end_n", "drive_": "servo_force_n", "demand_": "servo_force_n"}
"""Output without which the constants with a prefix move no output."""
SITES_OF: Final[Mapping[str, str]] = {
    "start_": "START sensor", "end_": "END sensor", "drive_": "servo drive", "demand_": "servo drive",
    "fabric": "fabric", "zero": "drum", "arm": "leg", "stiffness": "cable and fabric"}
"""Site of the constants with a prefix; any other is at the cable."""


def needed(carrier: str) -> tuple[str, ...]:
    """Return the outputs without which a carrier moves no output."""
    return tuple(output for prefix, output in NEEDS.items() if carrier.startswith(prefix))


def site_of(carrier: str) -> str:
    """Return the part of the bench that a carrier (a constant that a term changes) belongs to, as in `SITES`."""
    return next((site for prefix, site in SITES_OF.items() if carrier.startswith(prefix)), "cable")


def in_units(table: ConstantTable, q: Array, name: str, carrier: Carrier) -> float:
    """Return dq/da: the change of a coordinate by a unit of a term's coefficient at coordinates `q`.

    A relative coefficient changes the value v by v·a, an absolute one by a.
    """
    index = table.index[name]
    step = table.step[index]
    ahead = q.copy()
    ahead[index] += step
    value = float(table.values(q)[index])
    slope = (float(table.values(ahead)[index]) - value) / step
    return (value if carrier.relative else 1.0) / slope if abs(slope) > 1e-30 else 0.0
