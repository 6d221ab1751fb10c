"""Inputs of one control cycle, and the controller's entries in a row of the trial.

Names and units only; `exchange` fills them, `guard` and the controllers read them.
"""

import itertools
import math
from typing import Final, NamedTuple

from eds.bench.bench_network import WireLayout, tpdo_cob_id
from eds.pdo_plan import PdoPlan

NAN: Final = math.nan
SERVO, KNEE, START, END = range(4)
"""Places of a force path's devices; bit i of `missing` and the PDO columns of a row are those of place i."""


def places(wire: WireLayout) -> tuple[int, ...]:
    """Return the node ids of a force path: servo, knee, START and, if the path has that load cell, END."""
    return tuple(node for node in wire.path if node)


class ObserverSlots(NamedTuple):
    """Plan of an observer's TPDO, and (field of the PDO, column among those of all observers) of each signal."""

    plan: PdoPlan
    places: tuple[tuple[int, int], ...]


def observer_slots(wire: WireLayout) -> dict[int, ObserverSlots]:
    """Return by COB-ID the fields of the observers' TPDOs, columns in the order of `trial.signals.with_observers`."""
    found: dict[int, ObserverSlots] = {}
    column = 0
    for device in wire.network.bench.observers:
        fields = [device.type.sent.index(one.part) for one in device.type.observed]
        plan = wire.tpdo[tpdo_cob_id(device.node_id)]
        found[plan.cob_id] = ObserverSlots(plan, tuple(zip(fields, itertools.count(column), strict=False)))
        column += len(fields)
    return found


class Inputs(NamedTuple):
    """Values latched by one SYNC, SI; `missing` has a bit for each PDO, by its place, that is older than it.

    On a bench without END `end_n` is NaN and END's bit is never set; without a knee drive `knee_status` is 0.
    """

    sync_ns: int
    servo_status: int
    servo_position_m: float
    servo_force_n: float
    knee_status: int
    knee_angle_rad: float
    start_n: float
    end_n: float
    missing: int


class CycleAnnotations(NamedTuple):
    """Columns of `trial.signals.CycleRow` that a controller gives, else NaN; `cycle` −1 outside the gait.

    `own` are the values of the controller's own columns, in their order. `follows_phase` False: the force follows no
    phase, so that this control cycle is like that of no other gait cycle. `zero_m`: shift of the rope's zero since
    homing that the controller follows, m.
    """

    gait_percent: float = NAN
    desired_force_n: float = NAN
    estimated_end_force_n: float = NAN
    cycle: float = -1.0
    held: float = 0.0
    feedforward_m: float = NAN
    impedance_dx_m: float = NAN
    friction_ratio: float = NAN
    rope_direction: float = NAN
    strain_direction: float = NAN
    estimated_end_half_n: float = NAN
    own: tuple[float, ...] = ()
    follows_phase: bool = True
    zero_m: float = 0.0


NOTHING = CycleAnnotations()


class KeptCycle(NamedTuple):
    """One complete cycle that an identification keeps: target and position of the rope, m, knee, rad, tensions, N.

    `desired` and `estimated` are the controller's END forces, N; NaN outside of a gait.
    """

    target: float
    position: float
    knee: float
    start: float
    end: float
    desired: float
    estimated: float
