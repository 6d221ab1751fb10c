"""A running bus to control cycles, frame by frame: what `decode` makes of a log, while it happens.

The rule of this file: the rows that `decode.cycles` gives for the same frames, by the same `decode.layout`.  A row is
one SYNC and is given out when the next SYNC ends it; what did not come is NaN.
"""

import math
from collections.abc import Mapping

from eds.bench.bench_network import WireLayout
from trial.decode import INPUTS, NO_TENSION, SYNC, TARGETS, PdoSource, layout, offsets, prefixes
from trial.signals import of_bench

Place = tuple[int, int, float, float, float, bool]  # in the PDO, in the row, scale, divisor, offset, optional


class Follower:
    """Rows of one bench's bus; `names` are their columns, `units` the units."""

    def __init__(self, wire: WireLayout) -> None:
        units = {signal.name: signal.unit for signal in of_bench(wire.network.bench)}
        bench = wire.network.bench
        self._prefixes = prefixes(bench)
        own = [f"{prefix}{name}" for prefix, nodes in zip(self._prefixes, wire.paths, strict=True)
               for name in (*INPUTS.values(), *TARGETS.values(), "servo_velocity_m_s",
                            *(f"{place}_pdo_arrival_ns" for place, node in nodes._asdict().items() if node))]
        observed = [f"{device.name}_{one.ending}" for device in bench.observers for one in device.type.observed]
        self.names = ("time_s", *own, *observed)
        self.units = {name: units[name] for name in self.names}
        columns = {name: place for place, name in enumerate(self.names)}
        self._sources = _sources(wire, columns)
        self._moved = [(columns[f"{prefix}servo_position_m"], columns[f"{prefix}servo_velocity_m_s"])
                       for prefix in self._prefixes]
        self._row: list[float] | None = None
        self._first_ns = self._sync_ns = 0
        self._before = [math.nan] * (1 + len(self._moved))  # time, and position of each path, of the row before

    def frame(self, time_ns: int, can_id: int, data: bytes) -> tuple[int, list[float]] | None:
        """Take a base-format data frame; returns the time of the SYNC (ns) and the row that it ended, or None."""
        if can_id == SYNC:
            return self._next(time_ns)
        row = self._row
        if row is None:
            return None
        for source, places, arrival in self._sources.get(can_id, ()):
            if len(data) < source.plan.size:
                return None
            values = source.plan.unpack(data)
            for at, column, scale, divisor, offset, optional in places:
                value = values[at] * scale / divisor
                row[column] = math.nan if optional and values[at] == NO_TENSION else value + offset if offset else value
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
        step = row[0] - self._before[0]
        if step > 0:
            for (position, velocity), before in zip(self._moved, self._before[1:], strict=True):
                row[velocity] = (row[position] - before) / step
        self._before = [row[0], *(row[position] for position, _ in self._moved)]


def _sources(
    wire: WireLayout, columns: Mapping[str, int]
) -> dict[int, list[tuple[PdoSource, tuple[Place, ...], int | None]]]:
    found: dict[int, list[tuple[PdoSource, tuple[Place, ...], int | None]]] = {}
    for source in layout(wire):
        order = {bit: at for at, (_, bit) in enumerate(offsets(source.plan))}
        places = tuple((order[one.bit], columns[one.signal], one.scale, one.divisor, one.offset, one.optional)
                       for one in source.places)
        found.setdefault(source.plan.cob_id, []).append(
            (source, places, None if source.arrival is None else columns[source.arrival]))
    return found
