"""A running bus to control cycles, frame by frame: what `decode` makes of a log, while it happens.

The rule of this file: the rows that `decode.cycles` gives for the same frames, by the same `decode.layout`.  A row is
one SYNC and is given out when the next SYNC ends it; what did not come is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from eds.bench.bench_network import NAMES, WireLayout
from trial.decode import INPUTS, NO_TENSION, SYNC, TARGETS, PdoSource, layout, offsets
from trial.signals import UNITS, with_observers

Place = tuple[int, int, float, float, bool]  # in the PDO, in the row, scale, divisor, optional


class Follower:
    """Rows of one bench's bus; `names` are their columns, `units` the units."""

    def __init__(self, wire: WireLayout) -> None:
        arrivals = [f"{NAMES[node]}_pdo_arrival_ns" for node in wire.nodes if node in NAMES]
        units = {signal.name: signal.unit for signal in with_observers(wire.network.bench)}
        observed = [name for name in units if name not in UNITS]
        self.names = ("time_s", *INPUTS.values(), *TARGETS, "servo_velocity_m_s", *arrivals, *observed)
        self.units = {name: units[name] for name in self.names}
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
        known, row = self._sources.get(can_id), self._row
        if known is None or row is None or len(data) < known[0].plan.size:
            return None
        source, places, arrival = known
        values = source.plan.unpack(data)
        for at, column, scale, divisor, optional in places:
            row[column] = math.nan if optional and values[at] == NO_TENSION else values[at] * scale / divisor
        if arrival is not None:
            row[arrival] = float(time_ns - self._sync_ns)
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


def _sources(
    wire: WireLayout, columns: Mapping[str, int]
) -> dict[int, tuple[PdoSource, tuple[Place, ...], int | None]]:
    found = {}
    for source in layout(wire):
        order = {bit: at for at, (_, bit) in enumerate(offsets(source.plan))}
        places = tuple((order[one.bit], columns[one.signal], one.scale, one.divisor, one.optional)
                       for one in source.places)
        found[source.plan.cob_id] = source, places, None if source.arrival is None else columns[source.arrival]
    return found
