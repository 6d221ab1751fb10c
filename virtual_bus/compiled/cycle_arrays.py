"""The arrays of `cycle_code`, filled from the bench's objects and written back to them.

All that is read here is written back here. Plant, axes, channels and converters keep their numbers in the arrays
permanently; other numbers are copied.
"""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple, cast

import numpy as np

from eds.cia301 import HEARTBEAT_BASE, Frame
from nodes import Device, Drive, TensionSensor
from nodes.core.pdos import ReceivePdo
from nodes.drives import axis_law
from nodes.sensors import channel_law
from physics.converter import RING
from physics.plant.bench_plant import BowdenPlant
from physics.plant.state_layout import SIZE as PLANT
from trial.mcap_file.cdr import FRAME_STRUCT
from virtual_bus.bench import Bench
from virtual_bus.compiled import cycle_code as law
from virtual_bus.compiled.cycle_tables import RpdoRow, rpdo_row, tpdo_row
from virtual_bus.machine.machine import Machine, MachineState
from virtual_bus.wire.host import Socket, message_of
from virtual_bus.wire.node_station import NodeStation
from virtual_bus.wire.periodic import PeriodicTask

ROW: Final = FRAME_STRUCT.size


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
    """A node of the bench, as station of the wire, as device and as profile."""

    station: NodeStation
    device: Device
    application: Drive | TensionSensor


class Tables(NamedTuple):
    """Rows of the TPDOs of a SYNC, rows of the RPDOs that a cycle's frames reach, and these RPDOs."""

    tpdo_rows: list[list[int]]
    rpdo_rows: list[RpdoRow]
    rpdos: list[ReceivePdo]


class Arrays:
    """Floats `f`, integers `i` and frames `rows` of one bench; `call` is what `cycle_code.cycle` takes.

    `inputs` are the bytes of the inputs' ends and data, in the order asked for, `targets` those of the targets.
    """

    def __init__(self, bench: Bench) -> None:
        machine = cast(Machine, bench.machine)
        self._bench, self._machine, self._plant = bench, machine, cast(BowdenPlant, machine.plant)
        self.f: Any = np.zeros(law.F_SIZE)
        self._integers: Any = np.zeros(law.I_SIZE, np.int64)
        frames: Any = np.zeros((law.ROWS, 3), np.uint64)
        self._rings: Any = np.zeros((law.GAUGES, RING, 2))
        self.call = (self.f, self._integers, frames, self._rings)
        self.i: Any = memoryview(cast(Any, self._integers))
        self._bytes: Any = self.i.cast("B")
        self.rows: Any = memoryview(frames).cast("B")
        self._truth = self.f[law.F_TRUTH:law.F_ACTION].reshape(law.TRUTHS, law.TRUTH_WIDTH)
        self.inputs: Any = self._bytes[:0]
        self.targets = self._bytes[:0]
        self.members = list(_members(machine))
        self._rpdos: list[ReceivePdo] = []
        self._adopt()

    def _adopt(self) -> None:
        """Move the state of plant and devices into the shared arrays, of which they become views."""
        f, i = self.f, self._integers
        self._plant.adopt(f[law.F_PLANT:law.F_PLANT + PLANT])
        for k, (_, _, drive) in enumerate(self.members[:law.AXES]):
            cast(Drive, drive).adopt(
                _part(f, law.F_STATE, k, axis_law.STATES), _part(f, law.F_SET, k, axis_law.SETTINGS),
                _part(i, law.COUNTED, k, axis_law.COUNTS))
        for k, gauge in enumerate(self._machine.gauges):
            gauge.sensor.adopt(_part(f, law.F_CHANNEL, k, channel_law.SIZE))
            converter = gauge.converter
            converter.adopt(_part(f, law.F_CONVERTER, k, law.CONVERTER), self._rings[k],
                            _part(f, law.F_SENSOR, k, law.SENSOR))
            i[law.SEED + k] = np.uint64(converter.seed).astype(np.int64)

    # ---- in ----

    def tables(self, asked: CycleRequest) -> Tables | None:
        """Return the rows of all PDOs in a cycle; None where one has none, or nodes send other ones than asked for."""
        sent: list[list[int] | None] = []
        receivers: list[tuple[int, int, ReceivePdo]] = []
        sizes, cyclic = {asked.targets_id: asked.size}, {asked.targets_id, *asked.inputs}
        for place, (_, device, application) in enumerate(self.members):
            steady, mine = device.pdos.steady(), cyclic & device.filters
            if steady is None or law.SYNC_ID not in device.filters or not mine <= steady.receive.keys():
                return None
            for pdo in steady.transmit:
                sent.append(tpdo_row(place, application, pdo))
                sizes[pdo.can_id] = pdo.plan.size
            receivers += [(place, can_id, steady.receive[can_id]) for can_id in sorted(mine)]
        received = [rpdo_row(place, self.members[place].application, pdo, sizes.get(can_id, -1),
                             can_id == asked.targets_id) for place, can_id, pdo in receivers]
        rows, known = [row for row in sent if row is not None], [row for row in received if row is not None]
        if len(rows) != len(sent) or len(known) != len(received) or len(received) > law.TAKES:
            return None
        if sorted(row[1] for row in rows) != sorted(asked.inputs):
            return None
        rows.sort(key=lambda row: asked.inputs.index(row[1]))
        return Tables(rows, known, [pdo for _, _, pdo in receivers])

    def fill(self, asked: CycleRequest, tables: Tables, sync: PeriodicTask) -> None:
        """Write the tables and the present state into the arrays, and take the events of machine, SYNC and nodes off
        the heap."""
        self._fill_tables(asked, tables)
        self._fill_nodes()
        i, bench, wire = self.i, self._bench, self._bench.wire
        i[law.BIT_NS], i[law.MASTER_NS] = wire.bit_ns, bench.master_turnaround_ns
        i[law.NODE_NS], i[law.BUDGET] = self.members[0].station.turnaround_ns, asked.budget_ns
        i[law.TARGETS_ID], i[law.TARGETS_SIZE], i[law.TARGETS_DATA] = asked.targets_id, asked.size, 0
        i[law.OWN_ID], i[law.OWN_DATA], i[law.OWN_PERIOD] = asked.heartbeat
        i[law.HEARD], i[law.TRUTH] = int(asked.tap is not None), int(self._machine.truth is not None)
        i[law.NOW], i[law.PLANT_NS], i[law.IDLE_NS] = bench.kernel.now_ns, self._plant.now_ns, wire.idle_ns
        i[law.FRAMES], i[law.BUSY] = wire.frames, wire.busy_bits
        i[law.WAITING] = i[law.TRUTH_ROWS] = i[law.FIRST_ROW] = i[law.LAST_ROW] = 0
        i[law.SYNC_NS], i[law.PERIOD] = sync.next_ns, sync.period_ns
        i[law.TICK_NS], sample_ns, self.f[law.F_TORQUE:law.F_KEPT] = self._machine.state
        for k, due_ns in enumerate(sample_ns):
            i[law.SAMPLE_NS + k] = due_ns
        stations = (member.station for member in self.members)
        bench.kernel.withdraw({id(each) for each in (self._machine, sync, *stations)})
        if asked.tap is not None:
            self._fill_rows(asked.tap)

    def _fill_tables(self, asked: CycleRequest, tables: Tables) -> None:
        i, table = self.i, self._integers
        i[law.SEND_COUNT], i[law.TAKE_COUNT] = len(tables.tpdo_rows), len(tables.rpdo_rows)
        for n, row in enumerate(tables.tpdo_rows):
            _part(table, law.SEND, n, law.SEND_WIDTH)[:] = row
        self._rpdos = tables.rpdos
        for n, (received, pdo) in enumerate(zip(tables.rpdo_rows, tables.rpdos, strict=True)):
            _part(table, law.TAKE, n, law.TAKE_WIDTH)[:] = received.row
            _part(self.f, law.F_ACTION, n, law.ACTION_WIDTH)[:] = received.effect[1:]
            at = law.TOOK + law.TOOK_WIDTH * n
            i[at], i[at + 2], i[at + 4] = 0, 0, pdo.due_ns
        self.inputs = self._bytes[8 * law.SENT:8 * (law.SENT + 2 * len(tables.tpdo_rows))]
        self.targets = self._bytes[8 * law.TARGETS_DATA:8 * law.TARGETS_DATA + asked.size]

    def _fill_nodes(self) -> None:
        i = self.i
        for place, (_, device, application) in enumerate(self.members):
            beat = law.BEAT + 4 * place
            i[law.TOLD + place] = device.now_ns
            i[law.BEAT_NS + 2 * place], i[beat + 2] = device.producer.due
            i[beat], i[beat + 1] = HEARTBEAT_BASE + device.node_id, int(device.state)
            i[law.WATCH_NS + place], i[beat + 3] = device.consumer.due
            if isinstance(application, Drive):
                _part(self._integers, law.WORDS, place, 16)[:] = application.steady_words()
            else:
                i[law.INTERVAL + place - law.AXES] = application.interval_ns

    def _fill_rows(self, tap: Socket) -> None:
        for n, message in enumerate(tap.queue):
            FRAME_STRUCT.pack_into(self.rows, n * ROW, message.time_ns, message.arbitration_id, 0, len(message.data), 0,
                                   not message.is_rx, bytes(message.data))
        self.i[law.LAST_ROW] = len(tap.queue)
        tap.queue.clear()

    # ---- back ----

    def hand_back(self, asked: CycleRequest, sync: PeriodicTask, ran: bool) -> None:
        """Write the state back to the objects and put the events of machine, SYNC and nodes on the heap; `ran`: a cycle
        has run."""
        i, bench = self.i, self._bench
        self._plant.now_ns = i[law.PLANT_NS]
        bench.wire.carried(i[law.FRAMES], i[law.BUSY], i[law.IDLE_NS])
        sample_ns = tuple(i[law.SAMPLE_NS + k] for k in range(law.GAUGES))
        servo_nm, knee_nm = self.f[law.F_TORQUE:law.F_KEPT].tolist()
        self._machine.go_on(MachineState(i[law.TICK_NS], sample_ns, (servo_nm, knee_nm)))
        sync.go_on(i[law.SYNC_NS])
        self.write_truth()
        if asked.tap is not None:
            self._hand_back_rows(asked.tap)
        self._hand_back_nodes(ran)
        self._hand_back_waiting(asked.socket)

    def write_truth(self) -> None:
        """Write the collected rows of true signals to the truth file."""
        count, truth = self.i[law.TRUTH_ROWS], self._machine.truth
        self.i[law.TRUTH_ROWS] = 0
        if truth is not None and count:
            truth.rows(self._integers[law.TRUTH_NS:law.TRUTH_NS + count], self._truth[:count])

    def _hand_back_rows(self, tap: Socket) -> None:
        for row in range(self.i[law.FIRST_ROW], self.i[law.LAST_ROW]):
            time_ns, can_id, _, size, _, sent, data = FRAME_STRUCT.unpack_from(self.rows, row * ROW)
            tap.queue.append(message_of(Frame(can_id, data[:size]), time_ns, not sent, self._bench.host.channel))

    def _hand_back_nodes(self, ran: bool) -> None:
        i, now_ns = self.i, self._bench.kernel.now_ns
        for n, pdo in enumerate(self._rpdos):
            at = law.TOOK + law.TOOK_WIDTH * n
            pdo.taken(bytes(self._bytes[8 * (at + 3):8 * (at + 3) + pdo.plan.size]) if i[at + 2] else None, i[at + 4])
        for place, (station, device, application) in enumerate(self.members):
            device.producer.sent(i[law.BEAT_NS + 2 * place])
            device.consumer.watched_until(i[law.WATCH_NS + place])
            device.now_ns = i[law.TOLD + place]
            if ran:
                application.show_latched()
            device.rearm(now_ns)
            station.look_again(now_ns)

    def _hand_back_waiting(self, socket: Socket) -> None:
        """Return the waiting frames to their queue: heartbeats, since everything else has been sent."""
        i = self.i
        for n in range(i[law.WAITING]):
            at = law.PENDING + n * law.PENDING_WIDTH
            frame = Frame(i[at + 1], bytes(self._bytes[8 * (at + 3):8 * (at + 3) + i[at + 2]]))
            if i[at + 4] <= law.FROM_NODE:
                self.members[law.FROM_NODE - i[at + 4]].station.submit(frame, i[at])
            else:
                self._bench.host.submit(frame, i[at], socket)


def _members(machine: Machine) -> Iterator[Member]:
    for station, application in (*machine.axes, *((gauge.station, gauge.sensor) for gauge in machine.gauges)):
        yield Member(station, cast(Device, station.device), cast(Drive | TensionSensor, application))


def _part(array: Any, first: int, place: int, size: int) -> Any:
    """Return the view of the `place`-th of several parts of one size."""
    return array[first + place * size:first + (place + 1) * size]
