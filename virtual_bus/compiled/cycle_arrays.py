"""The records of `cycle_code`, filled from the bench's objects and written back to them.

All that is read here is written back here. Plant, axes, channels and converters keep their numbers in the records
permanently; other numbers are copied. A PDO that the compiled cycle cannot process exactly as the device does gives no
row of the table.
"""

from collections.abc import Iterator
from ctypes import sizeof
from typing import Any, Final, NamedTuple, cast

import numpy as np

from eds.cia301 import HEARTBEAT_BASE, Frame
from nodes import Device, Drive, TensionSensor
from nodes.core.pdos import ReceivePdo, TransmitPdo
from nodes.drives.drive import RULES
from physics.plant.bench_plant import BowdenPlant
from trial.mcap_file.cdr import FRAME_STRUCT
from virtual_bus.bench import Bench
from virtual_bus.compiled import cycle_code as law
from virtual_bus.machine.machine import Machine, MachineState
from virtual_bus.wire.host import Socket, message_of
from virtual_bus.wire.node_station import NodeStation
from virtual_bus.wire.periodic import PeriodicTask

ROW: Final = FRAME_STRUCT.size
_WIDEST: Final = 32
"""Width of the widest field, bits."""


class Heartbeat(NamedTuple):
    """A master's heartbeat: identifier, its one byte, period, ns."""

    can_id: int
    data: int
    period_ns: int


class CycleRequest(NamedTuple):
    """A master's request: its socket, its monitor socket (None: none), its frame and its size, the expected inputs.

    The inputs have to arrive within `budget_ns` of their SYNC.
    """

    socket: Socket
    tap: Socket | None
    targets_id: int
    size: int
    inputs: tuple[int, ...]
    budget_ns: int
    heartbeat: Heartbeat


class Member(NamedTuple):
    """Objects of one node: its CAN controller on the wire, its CiA 301 device, and its drive or sensor application."""

    station: NodeStation
    device: Device
    application: Drive | TensionSensor


class Tables(NamedTuple):
    """The TPDOs of a SYNC, the RPDOs that a cycle's frames reach as rows of the table, and these RPDOs themselves."""

    sends: list[law.TpdoRecord]
    takes: list[law.RpdoRecord]
    rpdos: list[ReceivePdo]


class Arrays:
    """State `m` and table `t` of one bench, and its frames `rows`; `call` is what `cycle_code.cycle` takes.

    `inputs` are the bytes of the inputs' ends and data, in the order asked for, `targets` those of the targets.
    """

    def __init__(self, bench: Bench) -> None:
        machine = cast(Machine, bench.machine)
        self._bench, self._machine, self._plant = bench, machine, cast(BowdenPlant, machine.plant)
        self.call = law.memory()
        state_bytes, table_bytes, _, frames, rings = self.call
        self.m: Any = law.CycleState.from_buffer(state_bytes)
        self.t: Any = law.CycleTable.from_buffer(table_bytes)
        self._state_bytes, self._table_bytes = memoryview(state_bytes), memoryview(table_bytes)
        self.rows: Any = memoryview(frames).cast("B")
        state, table = state_bytes.view(law.STATE)[0], table_bytes.view(law.TABLE)[0]
        self._truths, self._truth_ns = table["truths"], table["truth_ns"]
        self.inputs = self._state_bytes[:0]
        self.targets = self._table_bytes[:0]
        self.members = list(_members(machine))
        self._rpdos: list[ReceivePdo] = []
        self._adopt(state, table, rings)

    def _adopt(self, state: Any, table: Any, rings: Any) -> None:
        """Move the state of plant and devices into the records, of which they become views."""
        self._plant.adopt(state["plant"])
        for k, (_, _, drive) in enumerate(self.members[:law.AXES]):
            cast(Drive, drive).axis.adopt(state["axis"][k], state["setting"][k], state["counted"][k])
        for k, gauge in enumerate(self._machine.gauges):
            gauge.sensor.adopt(state["channel"][k])
            gauge.converter.adopt(state["converter"][k], rings[k], table["sensor"][k])
            table["seed"][k] = np.uint64(gauge.converter.seed).astype(np.int64)

    # ---- in ----

    def tables(self, asked: CycleRequest) -> Tables | None:
        """Return the table rows of all PDOs of a cycle; None if one cannot be compiled or others are sent."""
        sent: list[law.TpdoRecord | None] = []
        receivers: list[tuple[int, int, ReceivePdo]] = []
        sizes, cyclic = {asked.targets_id: asked.size}, {asked.targets_id, *asked.inputs}
        for place, (_, device, application) in enumerate(self.members):
            steady, mine = device.pdos.steady(), cyclic & device.filters
            if steady is None or law.SYNC_ID not in device.filters or not mine <= steady.receive.keys():
                return None
            for pdo in steady.transmit:
                sent.append(_tpdo(place, application, pdo))
                sizes[pdo.can_id] = pdo.plan.size
            receivers += [(place, can_id, steady.receive[can_id]) for can_id in sorted(mine)]
        received = [_rpdo(place, self.members[place].application, pdo, sizes.get(can_id, -1),
                          can_id == asked.targets_id) for place, can_id, pdo in receivers]
        sends, takes = [row for row in sent if row is not None], [row for row in received if row is not None]
        if len(sends) != len(sent) or len(takes) != len(received) or len(received) > law.TAKES:
            return None
        if sorted(row.can_id for row in sends) != sorted(asked.inputs):
            return None
        sends.sort(key=lambda row: asked.inputs.index(row.can_id))
        return Tables(sends, takes, [pdo for _, _, pdo in receivers])

    def fill(self, asked: CycleRequest, tables: Tables, sync: PeriodicTask) -> None:
        """Write the tables and the present state into the records, and take the events of machine, SYNC and nodes off
        the heap."""
        self._fill_tables(asked, tables)
        self._fill_nodes()
        m, t, bench, wire = self.m, self.t, self._bench, self._bench.wire
        t.bit_ns, t.master_ns = wire.bit_ns, bench.master_turnaround_ns
        t.node_ns, t.budget = self.members[0].station.turnaround_ns, asked.budget_ns
        t.period, m.sync_ns = sync.period_ns, sync.next_ns
        t.targets_id, t.targets_size, t.targets_data = asked.targets_id, asked.size, 0
        t.own_id, t.own_data, t.own_period = asked.heartbeat
        t.heard, t.truth = int(asked.tap is not None), int(self._machine.truth is not None)
        m.now, m.plant_ns, m.idle_ns = bench.kernel.now_ns, self._plant.now_ns, wire.idle_ns
        m.frames, m.busy = wire.frames, wire.busy_bits
        m.waiting = m.truth_rows = m.first_row = m.last_row = 0
        m.tick_ns, m.sample_ns[:], m.torque[:] = self._machine.state
        stations = (member.station for member in self.members)
        bench.kernel.withdraw({id(each) for each in (self._machine, sync, *stations)})
        if asked.tap is not None:
            self._fill_rows(asked.tap)

    def _fill_tables(self, asked: CycleRequest, tables: Tables) -> None:
        m, t = self.m, self.t
        t.sends, t.takes = len(tables.sends), len(tables.takes)
        t.send[:t.sends], t.take[:t.takes] = tables.sends, tables.takes
        self._rpdos = tables.rpdos
        for took, pdo in zip(m.took, tables.rpdos, strict=False):
            took.waiting, took.taken, took.due = 0, 0, pdo.due_ns
        self.inputs = _bytes_of(self._state_bytes, law.CycleState, "sent", sizeof(law.SentRecord) * t.sends)
        self.targets = _bytes_of(self._table_bytes, law.CycleTable, "targets_data", asked.size)

    def _fill_nodes(self) -> None:
        m, t = self.m, self.t
        for place, (_, device, application) in enumerate(self.members):
            node, own = m.node[place], t.node[place]
            node.called = device.now_ns
            node.beat, own.period = device.producer.due
            own.can_id, own.data = HEARTBEAT_BASE + device.node_id, int(device.state)
            node.watch, own.timeout = device.consumer.due
            if isinstance(application, Drive):
                t.words[place][:] = application.steady_words()
            else:
                t.interval[place - law.AXES] = application.interval_ns

    def _fill_rows(self, tap: Socket) -> None:
        for n, message in enumerate(tap.queue):
            FRAME_STRUCT.pack_into(self.rows, n * ROW, message.time_ns, message.arbitration_id, 0, len(message.data), 0,
                                   not message.is_rx, bytes(message.data))
        self.m.last_row = len(tap.queue)
        tap.queue.clear()

    # ---- back ----

    def hand_back(self, asked: CycleRequest, sync: PeriodicTask, ran: bool) -> None:
        """Write the state back to the objects and put the events of machine, SYNC and nodes on the heap; `ran`: a cycle
        has run."""
        m, bench = self.m, self._bench
        self._plant.now_ns = m.plant_ns
        bench.wire.carried(m.frames, m.busy, m.idle_ns)
        servo_nm, knee_nm = m.torque
        self._machine.go_on(MachineState(m.tick_ns, tuple(m.sample_ns), (servo_nm, knee_nm)))
        sync.go_on(m.sync_ns)
        self.write_truth()
        if asked.tap is not None:
            self._hand_back_rows(asked.tap)
        self._hand_back_nodes(ran)
        self._hand_back_waiting(asked.socket)

    def write_truth(self) -> None:
        """Write the collected rows of true signals to the truth file."""
        count, truth = self.m.truth_rows, self._machine.truth
        self.m.truth_rows = 0
        if truth is not None and count:
            truth.rows(self._truth_ns[:count], self._truths[:count])

    def _hand_back_rows(self, tap: Socket) -> None:
        for row in range(self.m.first_row, self.m.last_row):
            time_ns, can_id, _, size, _, sent, data = FRAME_STRUCT.unpack_from(self.rows, row * ROW)
            tap.queue.append(message_of(Frame(can_id, data[:size]), time_ns, not sent, self._bench.host.channel))

    def _hand_back_nodes(self, ran: bool) -> None:
        now_ns = self._bench.kernel.now_ns
        for took, pdo in zip(self.m.took, self._rpdos, strict=False):
            pdo.taken(_data(took.last, pdo.plan.size) if took.taken else None, took.due)
        for node, (station, device, application) in zip(self.m.node, self.members, strict=True):
            device.producer.sent(node.beat)
            device.consumer.watched_until(node.watch)
            device.now_ns = node.called
            if ran:
                application.show_latched()
            device.rearm(now_ns)
            station.look_again(now_ns)

    def _hand_back_waiting(self, socket: Socket) -> None:
        """Return the waiting frames to their queue: heartbeats, since everything else has been sent."""
        for waiting in self.m.pending[:self.m.waiting]:
            frame = Frame(waiting.can_id, _data(waiting.data, waiting.size))
            if waiting.sender <= law.FROM_NODE:
                self.members[law.FROM_NODE - waiting.sender].station.submit(frame, waiting.ready)
            else:
                self._bench.host.submit(frame, waiting.ready, socket)


def _members(machine: Machine) -> Iterator[Member]:
    for station, application in (*machine.axes, *((gauge.station, gauge.sensor) for gauge in machine.gauges)):
        yield Member(station, cast(Device, station.device), cast(Drive | TensionSensor, application))


def _data(word: int, size: int) -> bytes:
    """Return the data of a frame, the first `size` bytes of an integer of the records."""
    return (word & (1 << 64) - 1).to_bytes(8, "little")[:size]


def _bytes_of(memory: Any, record: Any, name: str, size: int) -> Any:
    """Return the view of the first `size` bytes of a record's field."""
    begin = getattr(record, name).offset
    return memory[begin:begin + size]


def _tpdo(place: int, device: Drive | TensionSensor, pdo: TransmitPdo) -> law.TpdoRecord | None:
    """Return the row of a TPDO of the node at `place`."""
    fields: list[law.FieldRecord] = []
    for field in pdo.plan.fields:
        source = device.steady_sources.get(field.key)
        if source is None or field.code in ("", "f", "d") or field.bits > _WIDEST:
            return None
        fields.append(law.FieldRecord(source, field.bits, field.signed))
    if len(fields) > law.FIELDS:
        return None
    return law.TpdoRecord(place, pdo.can_id, pdo.plan.size, len(fields), (law.FieldRecord * law.FIELDS)(*fields))


def _rpdo(place: int, device: Drive | TensionSensor, pdo: ReceivePdo, size: int, waits: bool) -> law.RpdoRecord | None:
    """Return the table row of an RPDO of node `place` for frames of `size` bytes; None if it cannot be compiled.

    `waits`: whether a synchronous RPDO can be handled, which takes effect at the next SYNC.
    """
    reception = pdo.steady()
    if reception is None or not isinstance(device, Drive) or reception.plan.size != size or len(reception.watched) > 1:
        return None
    if reception.synchronous and not waits:
        return None
    shift, mapped, begins = 0, None, 0
    for field in reception.plan.fields:
        if not field.dummy:
            if mapped is not None or field.code in ("", "f", "d") or field.bits > _WIDEST:
                return None
            mapped, begins = field, shift
        shift += field.bits
    if mapped is None or mapped.key in RULES or reception.watched != (mapped.key,):
        return None
    effect = device.rpdo_effect(mapped.key)
    if effect is None or any(at != mapped.key for at, _, _ in reception.bounds):
        return None
    _, low, high = reception.bounds[0] if reception.bounds else (0, None, None)
    least = -(1 << _WIDEST) if low is None else int(low)
    greatest = (1 << _WIDEST) if high is None else int(high)
    return law.RpdoRecord(place, pdo.can_id, size, reception.synchronous, reception.deadline_ns, begins, mapped.bits,
                    mapped.signed, bool(reception.bounds), least, greatest, *effect)
