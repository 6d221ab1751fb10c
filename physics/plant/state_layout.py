"""Layout of the plant's one flat float64 array.

A declared parameter, a derived coefficient and a state each have one index, named once; the compiled step and the
Python around it use the same names.
"""

from collections import namedtuple
from dataclasses import dataclass
from typing import Any, Final

from parameters import declarations
from physics.plant.components import CableParameters, FabricParameters, LegParameters, ServoParameters

CABLE_NODES: Final = 6
FABRIC_NODES: Final = 5
NODES: Final = CABLE_NODES + FABRIC_NODES
ELEMENTS: Final = NODES + 1
MODULATIONS_MOST: Final = 4
"""Most rows of terms that the plant follows: three terms, one of which may need a second row (`plant.modulated`)."""
TERM_WIDTH: Final = 11
"""Numbers of a row: present, target, modulation, relative, base, two parameters, two coefficients, two states."""


@dataclass(frozen=True)
class PlantParameters(LegParameters, FabricParameters, CableParameters, ServoParameters):
    """Parameters of the whole bench with their nominal values, units, bounds and sources; assumed ones are marked."""


_SCALARS: Final = (
    # derived once
    "k_lead", "c_lead", "k_segment", "b_fabric", "a4", "half", "e_tangent", "t_tangent", "k_tangent", "bandwidth",
    # state: servo, knee drive, leg, creep, time
    "servo_x", "servo_v", "current", "integral", "servo_s",
    "motor_q", "motor_w", "motor_t", "motor_s", "leg_q", "leg_w", "leg_a", "creep", "steps",
    # outputs, in the order of plant.Outputs
    "out_servo_x", "out_servo_v", "out_motor_q", "out_motor_w", "out_leg_q", "out_start", "out_end",
    # what only the truth tells
    "bus_v", "leg_friction",
    # readings of START and END are gain·tension + N under terms that act on them
    "term_start_gain", "term_start_n", "term_end_gain", "term_end_n",
)
_ARRAYS: Final = {
    # nodes 1…NODES between the drum's rope (0) and the leg's anchor (NODES + 1)
    "x": NODES + 2, "v": NODES + 2, "s": NODES + 2, "recent": NODES + 2, "grip": NODES + 2, "drag": NODES + 2,
    "inverse_mass": NODES + 2, "inverse_delta": NODES + 2,
    # elements 0…NODES: element e joins nodes e and e + 1
    "tension": ELEMENTS, "free": ELEMENTS, "damping": ELEMENTS, "share": ELEMENTS, "per_share": ELEMENTS,
    "terms": MODULATIONS_MOST * TERM_WIDTH,
}


def _layout() -> tuple[Any, int]:
    names = [name for name, _, _ in declarations(PlantParameters)]
    slots = {name: i for i, name in enumerate([*names, *_SCALARS])}
    size = len(slots)
    for name, length in _ARRAYS.items():
        slots[name] = size
        size += length
    return namedtuple("Slots", slots)(**slots), size


_LAYOUT: Final = _layout()
SLOT: Final = _LAYOUT[0]
SIZE: Final = _LAYOUT[1]
PARAMETER_NAMES: Final = tuple(name for name, _, _ in declarations(PlantParameters))
