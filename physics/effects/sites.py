"""Sites of the bench at which effects act: place along the rope and work of the engineer after a change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


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
