"""Parts of a bench that maintenance changes, and the constants that a note about them resets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from logbook.bench_state import CONSTANTS
from parameters import InputError

PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "cable": ("cable", "bend", "load", "viscous", "dry", "cable_travel", "breakaway", "stribeck_speed",
              "stribeck_memory", "cable_compliance", "fabric_share", "zero"),
    "fabric": ("fabric", "wrap", "fabric_travel", "fabric_breakaway", "stiffness", "curve2", "curve3", "fabric_share",
               "prompt", "slow", "creep_compliance", "creep_time", "zero"),
    "knee": ("play", "gap", "arm", "arm2", "arm3", "zero"),
    "start": ("start_gain", "start_offset", "start_lag"),
    "end": ("end_gain", "end_offset", "end_lag"),
    "drive": ("drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset", "drive_asymmetry",
              "drive_viscous_asymmetry", "drive_travel", "demand_gain", "zero"),
}
"""Constants that maintenance of a part of the bench changes."""


def constants_of(parts: Sequence[str]) -> tuple[str, ...]:
    """Return the constants of parts or of single constants; raises `InputError` for a name that is neither."""
    named: list[str] = []
    for name in parts:
        if name.lower() not in PARTS and name not in CONSTANTS:
            raise InputError(f"--part {name}: is neither a part ({', '.join(PARTS)}) nor a constant; "
                             "bowden logbook show --all lists the constants.")
        named += PARTS.get(name.lower(), (name,))
    return tuple(c for c in dict.fromkeys(named) if c in CONSTANTS)
