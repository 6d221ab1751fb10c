"""CAN frames to control cycles, by the PDO plans: the signal of each mapped object, and a whole log at once.

A row is one SYNC. A TPDO belongs to the SYNC before it in the log, a target to the cycle in which it was computed;
values that did not arrive in a cycle are NaN. Nothing is held over and nothing guessed. `layout` alone maps objects
to signals; `cycles` decodes a log by it, and `Follower` a running bus: a row is given out when the next SYNC ends it.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eds.bench.bench_network import NAMES, WireLayout, tpdo_cob_id
from eds.declaration import EXTENDS, MIRROR_RAD, DeclaredBench, DeclaredDevice, ForcePath
from eds.pdo_plan import Field, PdoPlan
from eds.scale_factors import drum_radius_m
from trial.convert.frames import rising
from trial.signals import PDO_NAMES, of_bench

Floats = NDArray[np.float64]

SYNC, NMT, EMCY_FIRST, EMCY_LAST = 0x080, 0x000, 0x081, 0x0FF
NO_TENSION = -32768  # what a sensor without a valid value sends as 0x7130
TENSION = 0x7130
NMT_WORDS = {1: "start", 2: "stop", 128: "enter pre-operational", 129: "reset node", 130: "reset communication"}

# (place in a force path, part that an object of its TPDO plays): signal
INPUTS = {
    ("servo", "statusword"): "servo_statusword", ("servo", "position"): "servo_position_m",
    ("servo", "torque"): "servo_force_n", ("knee", "statusword"): "knee_statusword",
    ("knee", "position"): "knee_angle_rad", ("start", "value"): "tension_start_n", ("end", "value"): "tension_end_n",
}
TARGETS = {"servo": "servo_target_m", "knee": "knee_target_rad"}
ANGLES = ("knee_angle_rad", "knee_target_rad")


class Place(NamedTuple):
    """Object in a PDO and the signal that it holds: value in SI = raw × `scale` / `divisor` + `offset`.

    `field` is the object's type and length, `bit` its first bit in the PDO. `optional`: the least integer of the type
    means that the value is missing.
    """

    signal: str
    scale: float
    divisor: float
    optional: bool
    field: Field
    bit: int
    offset: float = 0.0


class PdoSource(NamedTuple):
    """Contents of a PDO: its plan, a name for counts, its signals, and the column of its arrival, if any."""

    plan: PdoPlan
    name: str
    places: tuple[Place, ...]
    arrival: str | None


class DecodedCycles(NamedTuple):
    """Control cycles: the time of each SYNC (ns, strictly rising), columns by signal name, and counted anomalies."""

    time_ns: NDArray[np.int64]
    columns: dict[str, Floats]
    counts: dict[str, int]


def prefixes(bench: DeclaredBench) -> tuple[str, ...]:
    """Return the prefix of each force path's signals; empty on a bench of a single path."""
    return ("",) if len(bench.force_paths) == 1 else tuple(f"{path.name}." for path in bench.force_paths)


def layout(wire: WireLayout) -> tuple[PdoSource, ...]:
    """Return the contents of every PDO of a bench: the nodes' TPDOs by force path, then the targets.

    The TPDO of a joint that two paths share is listed for each of them.
    """
    found, bench = [], wire.network.bench
    paths = list(zip(bench.force_paths, prefixes(bench), wire.paths, strict=True))
    for path, prefix, nodes in paths:
        radius = drum_radius_m(wire.nodes[nodes.servo].dictionary)
        for place, node in zip(PDO_NAMES, nodes, strict=True):
            if node:
                found.append(_input(wire, path, prefix, place, node, radius))
    found += [_observed(wire, device) for device in bench.observers]
    for name, plan, nodes_of in wire.master_frames():
        if name == "target":
            targets = [_counted(Place(prefix + signal, field.scale, 1.0, False, field, bit), path)
                       for (field, bit), node in zip(offsets(plan), nodes_of, strict=True)
                       for path, prefix, nodes in paths
                       for place, signal in TARGETS.items() if getattr(nodes, place) == node]
            count_name = "target" if len(paths) == 1 else f"target_{plan.cob_id:x}"
            found.append(PdoSource(plan, count_name, tuple(targets), None))
    return tuple(found)


def _input(wire: WireLayout, path: ForcePath, prefix: str, place: str, node: int, radius: float) -> PdoSource:
    """Return the signals that a TPDO carries for one force path."""
    plan, entry = wire.tpdo[tpdo_cob_id(node)], wire.nodes[node]
    sent = next(device.type.sent for device in wire.network.bench.devices if device.node_id == node)
    signals = {entry.part(part).entry.key: signal for (of, part), signal in INPUTS.items()
               if of == place and part in sent}
    places = [_counted(Place(prefix + signals[field.key], field.scale,
                             radius if signals[field.key] == "servo_force_n" else 1.0, field.key >> 8 == TENSION, field,
                             bit), path)
              for field, bit in offsets(plan) if field.key in signals]
    return PdoSource(plan, prefix + place, tuple(places), f"{prefix}{place}_pdo_arrival_ns")


def _counted(place: Place, path: ForcePath) -> Place:
    """Return a place with a joint's angle as its path counts it."""
    if path.acts != EXTENDS or not place.signal.endswith(ANGLES):
        return place
    return place._replace(scale=-place.scale, offset=MIRROR_RAD)


def _observed(wire: WireLayout, device: DeclaredDevice) -> PdoSource:
    """Return the contents of an observer's TPDO."""
    plan, entry = wire.tpdo[tpdo_cob_id(device.node_id)], wire.nodes[device.node_id]
    names = {entry.part(one.part).entry.key: f"{device.name}_{one.ending}" for one in device.type.observed}
    places = tuple(Place(names[field.key], field.scale, 1.0, False, field, bit)
                   for field, bit in offsets(plan) if field.key in names)
    return PdoSource(plan, device.name, places, None)


def bench_channel(rows: NDArray[np.void], wire: WireLayout) -> int:
    """Return the channel with the most SYNC and PDO frames of this bench."""
    known = [SYNC, *(plan.cob_id for plan in wire.target_frames), *wire.tpdo]
    ours = np.isin(rows["can_id"], known) & (rows["flags"] == 0)
    return int(np.bincount(rows["channel"][ours], minlength=1).argmax())


def cycles(rows: NDArray[np.void], wire: WireLayout) -> DecodedCycles:
    """Decode the frames of one channel; without SYNC there are no cycles."""
    rows = rows[rows["flags"] == 0]
    sync = np.flatnonzero(rows["can_id"] == SYNC)
    times, coarse = rising(rows["time_ns"][sync])
    found = DecodedCycles(times, {"time_s": (times - times[:1].sum()) / 1e9},
                          {"cycles": len(sync), "coarse_stamps": coarse})
    for source in layout(wire):
        _fill(found, rows, sync, source)
    for prefix in prefixes(wire.network.bench) if len(sync) > 1 else ():
        position = found.columns[f"{prefix}servo_position_m"]
        velocity = np.diff(position, prepend=np.nan) / np.diff(found.columns["time_s"], prepend=np.nan)
        found.columns[f"{prefix}servo_velocity_m_s"] = velocity
    return DecodedCycles(times, {name: column for name, column in found.columns.items() if not np.isnan(column).all()},
                         found.counts)


def _place(
    found: DecodedCycles, rows: NDArray[np.void], sync: NDArray[np.intp], plan: PdoPlan, name: str
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of a PDO and the cycle of each; counts short, early, missing and repeated frames."""
    every = np.flatnonzero(rows["can_id"] == plan.cob_id)
    whole = every[rows["dlc"][every] >= plan.size]
    cycle = np.searchsorted(sync, whole, side="right") - 1
    whole, cycle = whole[cycle >= 0], cycle[cycle >= 0]
    there = len(np.unique(cycle))
    found.counts[f"short_{name}_pdos"] = len(every) - int(np.count_nonzero(rows["dlc"][every] >= plan.size))
    found.counts[f"missing_{name}_pdos"] = len(sync) - there
    found.counts[f"repeated_{name}_pdos"] = len(cycle) - there
    return whole, cycle


def _fill(found: DecodedCycles, rows: NDArray[np.void], sync: NDArray[np.intp], source: PdoSource) -> None:
    place, cycle = _place(found, rows, sync, source.plan, source.name)
    if source.arrival is not None:
        arrival = rows["time_ns"][place] - rows["time_ns"][sync][cycle]
        found.columns[source.arrival] = _column(len(sync), cycle, arrival.astype(np.float64))
    for one in source.places:
        raw = _raw(rows["data"][place], one.field, one.bit)
        values = raw * one.scale / one.divisor
        if one.offset:
            values += one.offset
        if one.optional:
            values[raw == NO_TENSION] = np.nan
        found.columns[one.signal] = _column(len(sync), cycle, values)


def _column(length: int, cycle: NDArray[np.intp], values: Floats) -> Floats:
    column = np.full(length, np.nan)
    column[cycle] = values  # of several in one cycle the last stays
    return column


def offsets(plan: PdoPlan) -> list[tuple[Field, int]]:
    """Return the mapped objects of a PDO, dummies left out, and the bit where each begins."""
    offset, found = 0, []
    for field in plan.fields:
        if not field.dummy:
            found.append((field, offset))
        offset += field.bits
    return found


def _raw(data: NDArray[np.uint8], field: Field, offset: int) -> Floats:
    """Return a field's raw counts from frames' eight bytes, any bit offset and width up to 64."""
    word = np.ascontiguousarray(data).view("<u8").ravel() >> np.uint64(offset)
    if field.bits == 64:
        return word.astype(np.int64 if field.signed else np.uint64).astype(np.float64)
    word &= np.uint64((1 << field.bits) - 1)
    raw = word.astype(np.int64)
    if field.signed:
        raw = np.where(raw >> (field.bits - 1) & 1, raw - (1 << field.bits), raw)
    return raw.astype(np.float64)


def events(rows: NDArray[np.void], names: Mapping[int, str] = NAMES) -> list[tuple[int, str, str, str]]:
    """Return NMT, EMCY and boot-up frames as events in words."""
    can_id, dlc = rows["can_id"], rows["dlc"]
    plain = rows["flags"] == 0
    emcy = plain & (can_id >= EMCY_FIRST) & (can_id <= EMCY_LAST) & (dlc >= 3)
    boot = plain & (can_id > 0x700) & (can_id < 0x780) & (dlc == 1) & (rows["data"][:, 0] == 0)
    commands = plain & (can_id == NMT) & (dlc >= 2)
    return [_event(row, names) for row in rows[emcy | boot | commands].tolist()]


def _event(row: tuple[Any, ...], names: Mapping[int, str]) -> tuple[int, str, str, str]:
    time_ns, can_id, data = row[0], row[1], bytes(row[6])
    if can_id == NMT:
        command = NMT_WORDS.get(data[0], f"command {data[0]}")
        return time_ns, "nmt", "master", f"{command}: {'all nodes' if data[1] == 0 else f'node {data[1]}'}"
    node = can_id & 0x7F
    source = names.get(node, f"node {node}")
    if can_id > EMCY_LAST:
        return time_ns, "nmt", source, "boot-up"
    return time_ns, "emcy", source, f"error code 0x{data[1] << 8 | data[0]:04X}, error register 0x{data[2]:02X}"


def decoded_events_and_cycles(
    rows: NDArray[np.void], wire: WireLayout
) -> tuple[list[tuple[int, str, str, str]], DecodedCycles]:
    """Return events and cycles of the bench's channel."""
    ours = rows[rows["channel"] == bench_channel(rows, wire)]
    return events(ours, {node: entry.name for node, entry in wire.nodes.items()}), cycles(ours, wire)


RowPlace = tuple[int, int, float, float, float, bool]  # in the PDO, in the row, scale, divisor, offset, optional


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
) -> dict[int, list[tuple[PdoSource, tuple[RowPlace, ...], int | None]]]:
    found: dict[int, list[tuple[PdoSource, tuple[RowPlace, ...], int | None]]] = {}
    for source in layout(wire):
        order = {bit: at for at, (_, bit) in enumerate(offsets(source.plan))}
        places = tuple((order[one.bit], columns[one.signal], one.scale, one.divisor, one.offset, one.optional)
                       for one in source.places)
        found.setdefault(source.plan.cob_id, []).append(
            (source, places, None if source.arrival is None else columns[source.arrival]))
    return found
