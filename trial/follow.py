"""A running bus to control cycles, frame by frame: what `decode` makes of a log, while it happens.

The rule of this file: the same rows as `decode.cycles` gives for the same frames.  A row is one SYNC and is given
out when the next SYNC ends it; what did not come is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from eds.bench import NAMES, SERVO, Wire, tpdo_cob_id
from eds.plan import PdoPlan
from eds.scales import drum_radius_m
from trial.decode import INPUTS, NO_TENSION, SYNC, TARGETS, inputs_of
from trial.signals import UNITS

TENSION = 0x7130  # the object whose least integer says that there is no value


class _Place(NamedTuple):
    """Where one mapped object goes: column, SI per count, and whether it can say that it has no value."""

    column: int
    scale: float
    optional: bool


class _Source(NamedTuple):
    """What a PDO fills: a place for each mapped object, None for what is no signal, and its arrival's column."""

    plan: PdoPlan
    places: tuple[_Place | None, ...]
    arrival: int | None


class Follower:
    """Rows of one bench's bus; `names` are their columns, `units` the units."""

    def __init__(self, wire: Wire) -> None:
        arrivals = [f"{NAMES[node]}_pdo_arrival_ns" for node in wire.nodes]
        self.names = ("time_s", *INPUTS.values(), *TARGETS, "servo_velocity_m_s", *arrivals)
        self.units = {name: UNITS[name] for name in self.names}
        columns = {name: place for place, name in enumerate(self.names)}
        self._sources = _sources(wire, columns)
        self._position, self._velocity = columns["servo_position_m"], columns["servo_velocity_m_s"]
        self._row: list[float] | None = None
        self._first_ns = self._sync_ns = 0
        self._before = (math.nan, math.nan)  # time and position of the row before

    def frame(self, time_ns: int, can_id: int, data: bytes) -> tuple[int, list[float]] | None:
        """Take a base-format data frame; returns the time of the SYNC (ns) and the row that it ended, or None."""
        if can_id == SYNC:
            return self._next(time_ns)
        source, row = self._sources.get(can_id), self._row
        if source is None or row is None or len(data) < source.plan.size:
            return None
        for raw, place in zip(source.plan.unpack(data), source.places, strict=True):
            if place is not None:
                row[place.column] = math.nan if place.optional and raw == NO_TENSION else raw * place.scale
        if source.arrival is not None:
            row[source.arrival] = float(time_ns - self._sync_ns)
        return None

    def _next(self, time_ns: int) -> tuple[int, list[float]] | None:
        ended, sync_ns = self._row, self._sync_ns
        if ended is None:
            self._first_ns = time_ns
        else:
            self._differentiate(ended)
        self._row, self._sync_ns = [math.nan] * len(self.names), time_ns
        self._row[0] = (time_ns - self._first_ns) / 1e9
        return None if ended is None else (sync_ns, ended)

    def _differentiate(self, row: list[float]) -> None:
        seconds, position = row[0], row[self._position]
        step = seconds - self._before[0]
        if step > 0:
            row[self._velocity] = (position - self._before[1]) / step
        self._before = (seconds, position)


def _sources(wire: Wire, columns: Mapping[str, int]) -> dict[int, _Source]:
    radius = drum_radius_m(wire.nodes[SERVO].dictionary)
    found = {}
    for node in wire.nodes:
        plan, signals = wire.tpdo[tpdo_cob_id(node)], inputs_of(wire, node)
        places: list[_Place | None] = []
        for field in (field for field in plan.fields if not field.dummy):
            name = signals.get(field.key)
            scale = field.scale / radius if name == "servo_force_n" else field.scale
            places.append(None if name is None else _Place(columns[name], scale, field.key >> 8 == TENSION))
        found[plan.cob_id] = _Source(plan, tuple(places), columns[f"{NAMES[node]}_pdo_arrival_ns"])
    fields = [field for field in wire.targets.fields if not field.dummy]
    targets = tuple(_Place(columns[name], field.scale, False) for name, field in zip(TARGETS, fields, strict=True))
    found[wire.targets.cob_id] = _Source(wire.targets, targets, None)
    return found
