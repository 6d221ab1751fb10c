"""Whole control cycles at once: when they may be, and how the bench's objects hear of them.

The rule of this file: a cycle is computed by `steady_law.cycle` only if all that happens up to its end is known
beforehand; anything else runs event by event, as ever.  Between two such cycles the numbers live in the arrays alone
(`warm`); whoever asks the bench for anything has them written back first.
"""

from __future__ import annotations

import os
from typing import Any, Final, NamedTuple, cast

import numpy as np

from eds.cia301 import HEARTBEAT_BASE, NmtState
from eds.frame import Frame
from nodes import Device, Drive, TensionSensor, axis_law, channel_law
from nodes.core.receive_pdo import ReceivePdo
from physics.converter import RING, Converter
from physics.plant.bench_plant import BowdenPlant
from physics.plant.state_layout import SIZE as PLANT
from trial.mcap_file.cdr import FRAME_STRUCT
from virtual_bus import steady_law as law
from virtual_bus.bench import Bench
from virtual_bus.host import BowdenMessage, Socket, message_of
from virtual_bus.machine import Machine, State
from virtual_bus.node_station import NodeStation
from virtual_bus.periodic import PeriodicTask
from virtual_bus.steady_tables import Taking, sending, taking
from virtual_bus.wire import Wire

SWITCH: Final = "BOWDEN_STEADY"
"""The environment's variable that turns it off: 0."""
SPAN_NS: Final = 20_000
"""What a cycle may take longer than the last one before it is tried at all; it is only ever given up, never wrong."""
ROOM: Final = 32
"""Places that the computer's queues need for none of them ever to be full."""
WAITING: Final = 12
"""Frames that may wait at the tap when it begins."""
_ROW: Final = FRAME_STRUCT.size
_NOBODY: Final[frozenset[int]] = frozenset()


Whole = tuple[int, int, list[int], tuple[Any, ...], tuple[tuple[int, int, int], ...], Any, int]
"""One cycle: ends of SYNC and of the targets' frame, ns; of the inputs in the order asked for their ends, and their data;
identifier, time and state of each heartbeat heard, for the master's own one when it was sent; the frames that the tap
heard up to this SYNC, as bytes of `cdr.FRAME_ROW`s, and their number.  What is bytes here holds until the next call."""


class Heartbeat(NamedTuple):
    """A master's heartbeat: identifier, its one byte, period, ns."""

    can_id: int
    data: int
    period_ns: int


class Asked(NamedTuple):
    """What a master asks for: its socket, its tap's (None: none), its frame and its size, the inputs it waits for.

    They have to come within `budget_ns` of their SYNC.
    """

    socket: Socket
    tap: Socket | None
    targets_id: int
    size: int
    inputs: tuple[int, ...]
    budget_ns: int
    heartbeat: Heartbeat


def makes_sense(bench: Bench) -> bool:
    """Say whether a bench can have steady cycles at all: its plant is the compiled one, and they are not turned off."""
    machine = bench.machine
    return (os.environ.get(SWITCH, "1") != "0" and isinstance(machine, Machine) and type(machine.plant) is BowdenPlant
            and all(type(gauge.converter) is Converter for gauge in machine.gauges) and len(machine.gauges) == law.GAUGES
            and all(isinstance(axis.drive, Drive) for axis in machine.axes)
            and all(isinstance(gauge.sensor, TensionSensor) for gauge in machine.gauges)
            and isinstance(bench.wire, Wire) and len(bench.nodes) == law.NODES)


class Steady:
    """The steady cycles of one bench; `cycles` counts them.  `warm`: the arrays know more than the objects do."""

    def __init__(self, bench: Bench) -> None:
        machine = bench.machine
        assert isinstance(machine, Machine) and isinstance(machine.plant, BowdenPlant)
        law.prepare()
        self.warm = False
        self.cycles = 0
        self._bench, self._machine, self._plant = bench, machine, machine.plant
        self._f, self._i = np.zeros(law.F_SIZE), np.zeros(law.I_SIZE, np.int64)
        self._rows = np.zeros((law.ROWS, 3), np.uint64)
        self._before = np.zeros(law.F_KEPT), np.zeros(law.I_KEPT, np.int64)
        self._arguments = (self._f, self._i, self._rows, *self._before)
        self.i: Any = memoryview(self._i)
        self._bytes: Any = memoryview(self._i).cast("B")
        self.rows: Any = memoryview(self._rows).cast("B")
        self._truth = self._f[law.F_TRUTH:law.F_ACTION].reshape(law.TRUTHS, law.TRUTH_WIDTH)
        self._kernel = bench.kernel
        self._axes = [(axis.station, cast(Drive, axis.drive)) for axis in machine.axes]
        self._gauges = [(gauge.station, cast(TensionSensor, gauge.sensor)) for gauge in machine.gauges]
        self._stations: list[NodeStation] = [station for station, _ in (*self._axes, *self._gauges)]
        self._devices = [device for _, device in (*self._axes, *self._gauges)]
        self._sizes: dict[int, int] = {}
        self._taken: list[ReceivePdo] = []
        self._foreign_ns = self._span_ns = 0
        self._asked: Asked | None = None
        self._ends: list[int] = []
        self._data: tuple[Any, ...] = ()
        self._targets = self._bytes[:0]
        self._sync: PeriodicTask | None = None
        self._run = 0
        self._adopted = False

    # ---- one cycle ----

    def cycle(self, asked: Asked, data: bytes, beat_ns: int) -> Whole | None:
        """Send the targets `data` and run to the last input of the next SYNC; None where that is not for here.

        `beat_ns` is when the master's heartbeat is due.
        """
        i = self.i
        if not self.warm:
            if not self._enter(asked):
                return None
        elif asked is not self._asked:
            self.leave()
            return None
        if i[law.SYNC_NS] + self._span_ns >= self._foreign_ns:
            self.leave()
            return None
        self._targets[:] = data
        i[law.LIMIT], i[law.OWN_NS] = self._foreign_ns, beat_ns
        if law.cycle(*self._arguments) != law.DONE:
            self.leave()
            return None
        self._run += 1
        self._kernel.now_ns = now_ns = i[law.NOW]
        sync_ns, first, end = i[law.SYNC_AT], i[law.FIRST_ROW], i[law.SYNC_ROW]
        self._span_ns = now_ns - sync_ns + SPAN_NS
        i[law.FIRST_ROW] = end
        if i[law.TRUTH_ROWS] == law.TRUTHS:
            self._write_truth()
        return (sync_ns, i[law.TARGETS_AT], [i[at] for at in self._ends], self._data,
                self._beats() if i[law.BEATS] or i[law.OWN_AT] >= 0 else (), self.rows[_ROW * first:_ROW * end], end - first)

    def _write_truth(self) -> None:
        i, count = self.i, self.i[law.TRUTH_ROWS]
        i[law.TRUTH_ROWS] = 0
        truth = self._machine.truth
        if truth is not None and count:
            truth.rows(self._i[law.TRUTH_NS:law.TRUTH_NS + count], self._truth[:count])

    def _beats(self) -> tuple[tuple[int, int, int], ...]:
        """Give the heartbeats of the last cycle."""
        i, found = self.i, []
        if i[law.OWN_AT] >= 0:
            found.append((i[law.OWN_ID], i[law.OWN_AT], i[law.OWN_DATA]))
        for place in range(law.NODES):
            ended_ns = i[law.BEAT_NS + 2 * place + 1]
            if ended_ns >= 0:
                found.append((i[law.BEAT + 4 * place], ended_ns, i[law.BEAT + 4 * place + 1]))
        return tuple(found)

    # ---- when ----

    def _enter(self, asked: Asked) -> bool:
        if not (self._quiet(asked) and self._scan()):
            return False
        tables = self._tables(asked)
        if tables is None:
            return False
        self._adopt()
        self._lay_out(asked, *tables)
        self._stand_in(asked.tap)
        self._asked, self._run, self.warm = asked, 0, True
        return True

    def _quiet(self, asked: Asked) -> bool:
        """Nothing is on the wire, nobody else listens, every device is at work and undisturbed."""
        bench, machine = self._bench, self._machine
        host, wire, truth = bench.host, bench.wire, machine.truth
        known = [asked.socket] if asked.tap is None else [asked.socket, asked.tap]
        stations = {id(host), *map(id, self._stations), *([id(truth)] if truth is not None else ())}
        return (
            wire.steady and bench.medium is wire and not asked.socket.queue and machine.steady
            and len(host.sockets) == len(known) and all(socket in host.sockets for socket in known)
            and min(host.limit, *(socket.limit for socket in known)) >= ROOM
            and not asked.socket.own and (asked.tap is None or not asked.tap.filters)
            and (asked.tap is None or len(asked.tap.queue) <= WAITING and all(map(_plain, asked.tap.queue)))
            and all(map(asked.socket.accepts, (law.SYNC_ID, *asked.inputs)))
            and all(asked.socket.accepts(HEARTBEAT_BASE + station.device.node_id) for station in self._stations)
            and all(station.due_ns > bench.kernel.now_ns for station in self._stations)
            and {id(station) for station in wire.stations} == stations
            and all(station.deaf_to == _NOBODY for station in wire.stations)
            and all(station.on and _at_work(station.device, asked.heartbeat.can_id) for station in self._stations)
            and all(drive.steady for _, drive in self._axes) and all(sensor.steady for _, sensor in self._gauges)
        )

    def _scan(self) -> bool:
        """Find SYNC's task and the first event that is not for here; False where no SYNC runs."""
        bench, machine = self._bench, self._machine
        now_ns = bench.kernel.now_ns
        foreign_ns, sync = bench.wire.quiet_until(now_ns), None
        for time_ns, _, _, callback in bench.kernel.events():
            owner = getattr(callback, "__self__", None)
            if owner is machine or owner is bench.wire:
                continue
            if isinstance(owner, PeriodicTask):
                if owner.next_ns != time_ns:
                    continue
                if sync is None and owner.sync:
                    sync = owner
                    continue
            elif isinstance(owner, NodeStation) and owner in self._stations:
                continue
            if time_ns < foreign_ns:
                foreign_ns = time_ns
        self._sync, self._foreign_ns = sync, foreign_ns
        return sync is not None

    # ---- what ----

    def _tables(self, asked: Asked) -> tuple[list[list[int]], list[Taking]] | None:
        """Give a row for each TPDO of a SYNC, and for each RPDO that a cycle's frames reach; None where one has none."""
        sends: list[list[int] | None] = []
        takes: list[Taking | None] = []
        self._taken, self._sizes = [], {asked.targets_id: asked.size}
        cyclic = {asked.targets_id, *asked.inputs}
        receivers: list[tuple[int, int, ReceivePdo]] = []
        for place, station in enumerate(self._stations):
            steady = station.device.pdos.steady()
            mine = cyclic & station.filters
            if steady is None or law.SYNC_ID not in station.filters or not mine <= steady.receive.keys():
                return None
            for pdo in steady.transmit:
                sends.append(sending(place, self._devices[place], pdo))
                self._sizes[pdo.can_id] = pdo.plan.size
            receivers += [(place, can_id, steady.receive[can_id]) for can_id in sorted(mine)]
        for place, can_id, receive in receivers:
            size = self._sizes.get(can_id, -1)
            takes.append(taking(place, self._devices[place], receive, size, can_id == asked.targets_id))
            self._taken.append(receive)
        rows, taken = [row for row in sends if row is not None], [one for one in takes if one is not None]
        whole = len(rows) == len(sends) and len(taken) == len(takes) <= law.TAKES
        return (rows, taken) if whole and sorted(row[1] for row in rows) == sorted(asked.inputs) else None

    def _adopt(self) -> None:
        """Let the objects keep their numbers in the arrays from now on."""
        if self._adopted:
            return
        self._adopted = True
        f, i = self._f, self._i
        self._plant.adopt(f[law.F_PLANT:law.F_PLANT + PLANT])
        for k, (_, drive) in enumerate(self._axes):
            drive.adopt(_part(f, law.F_STATE, k, axis_law.STATES), _part(f, law.F_SET, k, axis_law.SETTINGS),
                        _part(i, law.COUNTED, k, axis_law.COUNTS))
        for k, gauge in enumerate(self._machine.gauges):
            sensor, converter = self._gauges[k][1], gauge.converter
            assert isinstance(converter, Converter)
            sensor.adopt(_part(f, law.F_CHANNEL, k, channel_law.SIZE))
            converter.adopt(_part(f, law.F_CONVERTER, k, law.CONVERTER),
                            _part(f, law.F_RING, k, 2 * RING).reshape(RING, 2), _part(f, law.F_SENSOR, k, law.SENSOR))
            i[law.SEED + k] = np.uint64(converter.seed).astype(np.int64)

    def _lay_out(self, asked: Asked, sends: list[list[int]], takes: list[Taking]) -> None:
        """Write the tables, and where everything stands."""
        i, f, bench = self.i, self._f, self._bench
        host, wire = bench.host, bench.wire
        i[law.SEND_COUNT], i[law.TAKE_COUNT] = len(sends), len(takes)
        for n, row in enumerate(sends):
            self._i[law.SEND + n * law.SEND_WIDTH:law.SEND + (n + 1) * law.SEND_WIDTH] = row
        for n, (taken, pdo) in enumerate(zip(takes, self._taken, strict=True)):
            self._i[law.TAKE + n * law.TAKE_WIDTH:law.TAKE + (n + 1) * law.TAKE_WIDTH] = taken.row
            f[law.F_ACTION + 2 * n:law.F_ACTION + 2 * n + 2] = taken.numbers
            at = law.TOOK + 5 * n
            i[at], i[at + 2], i[at + 4] = 0, 0, pdo.due_ns
        for k, (_, drive) in enumerate(self._axes):
            self._i[law.WORDS + 16 * k:law.WORDS + 16 * (k + 1)] = drive.steady_words()
        for place, station in enumerate(self._stations):
            device, beat = station.device, law.BEAT + 4 * place
            i[law.TOLD + place] = device.now_ns
            i[law.BEAT_NS + 2 * place], i[beat + 2] = device.producer.due
            i[beat], i[beat + 1] = HEARTBEAT_BASE + device.node_id, int(device.state)
            i[law.WATCH_NS + place], i[beat + 3] = device.consumer.due
        for k, (_, sensor) in enumerate(self._gauges):
            i[law.INTERVAL + k] = sensor.interval_ns
        i[law.BIT_NS], i[law.MASTER_NS] = wire.bit_ns, bench.master_turnaround_ns
        i[law.NODE_NS], i[law.BUDGET] = self._stations[0].turnaround_ns, asked.budget_ns
        i[law.TARGETS_ID], i[law.TARGETS_SIZE], i[law.TARGETS_DATA] = asked.targets_id, asked.size, 0
        i[law.OWN_ID], i[law.OWN_DATA], i[law.OWN_PERIOD] = asked.heartbeat
        i[law.WAITING] = i[law.TRUTH_ROWS] = 0
        self._targets = self._bytes[8 * law.TARGETS_DATA:8 * law.TARGETS_DATA + asked.size]
        i[law.HEARD], i[law.TRUTH] = int(asked.tap is not None), int(self._machine.truth is not None)
        i[law.NOW], i[law.PLANT_NS], i[law.IDLE_NS] = bench.kernel.now_ns, self._plant.now_ns, wire.idle_ns
        i[law.FRAMES], i[law.BUSY] = wire.frames, wire.busy_bits
        places = {row[1]: n for n, row in enumerate(sends)}
        found = [law.SENT + 2 * places[can_id] for can_id in asked.inputs]
        self._ends, self._data = found, tuple([self._bytes[8 * at + 8:8 * at + 16] for at in found])

    def _stand_in(self, tap: Socket | None) -> None:
        """Take the place of the machine, of SYNC's task, and of the tap's queue."""
        i, sync = self.i, self._sync
        assert sync is not None
        self._bench.kernel.withdraw({id(each) for each in (self._machine, sync, *self._stations)})
        stands = self._machine.state
        i[law.TICK_NS] = stands.tick_ns
        for k, sample_ns in enumerate(stands.sample_ns):
            i[law.SAMPLE_NS + k] = sample_ns
        self._f[law.F_TORQUE:law.F_KEPT] = stands.torques_nm
        i[law.SYNC_NS], i[law.PERIOD] = sync.next_ns, sync.period_ns
        waiting = tap.queue if tap is not None else ()
        for n, message in enumerate(waiting):
            FRAME_STRUCT.pack_into(self.rows, n * _ROW, message.time_ns, message.arbitration_id, 0, len(message.data), 0,
                                   not message.is_rx, bytes(message.data))
        i[law.FIRST_ROW], i[law.LAST_ROW] = 0, len(waiting)
        if tap is not None:
            tap.queue.clear()

    # ---- back ----

    def leave(self) -> None:
        """Write everything back to the objects, which go on by themselves."""
        if not self.warm:
            return
        self.warm = False
        i, bench, sync = self.i, self._bench, self._sync
        assert sync is not None and self._asked is not None
        self._plant.now_ns = i[law.PLANT_NS]
        bench.wire.carried(i[law.FRAMES], i[law.BUSY], i[law.IDLE_NS])
        sample_ns = tuple(i[law.SAMPLE_NS + k] for k in range(law.GAUGES))
        servo_nm, knee_nm = self._f[law.F_TORQUE:law.F_KEPT].tolist()
        self._machine.go_on(State(i[law.TICK_NS], sample_ns, (servo_nm, knee_nm)))
        sync.go_on(i[law.SYNC_NS])
        self._write_truth()
        self._hand_back_frames(self._asked.tap)
        self._hand_back_deadlines()
        if self._run:
            self.cycles += self._run
            for device in self._devices:
                device.show_latched()
        for place, station in enumerate(self._stations):
            station.device.now_ns = i[law.TOLD + place]
            station.rearm(bench.kernel.now_ns)
        self._hand_back_waiting()

    def _hand_back_deadlines(self) -> None:
        """Tell RPDOs what they took last and their deadlines, heartbeats when they are due and awaited."""
        i = self.i
        for place, station in enumerate(self._stations):
            station.device.producer.sent(i[law.BEAT_NS + 2 * place])
            station.device.consumer.watched_until(i[law.WATCH_NS + place])
        for n, pdo in enumerate(self._taken):
            at = law.TOOK + 5 * n
            taken = bytes(self._bytes[8 * (at + 3):8 * (at + 3) + pdo.plan.size]) if i[at + 2] else None
            pdo.taken(taken, i[at + 4])

    def _hand_back_waiting(self) -> None:
        """Let the frames that wait for the wire wait there."""
        i, host = self.i, self._bench.host
        for n in range(i[law.WAITING]):
            at = law.PENDING + n * law.PENDING_WIDTH
            sender, data = i[at + 4], bytes(self._bytes[8 * (at + 3):8 * (at + 3) + i[at + 2]])
            if sender <= law.FROM_NODE:
                self._stations[law.FROM_NODE - sender].submit(Frame(i[at + 1], data), i[at])
            else:
                assert sender == law.FROM_OWN and self._asked is not None
                host.submit(Frame(i[at + 1], data), i[at], self._asked.socket)

    def _hand_back_frames(self, tap: Socket | None) -> None:
        if tap is None:
            return
        i = self.i
        for row in range(i[law.FIRST_ROW], i[law.LAST_ROW]):
            time_ns, can_id, _, size, _, sent, data = FRAME_STRUCT.unpack_from(self.rows, row * _ROW)
            tap.queue.append(message_of(Frame(can_id, data[:size]), time_ns, not sent, self._bench.host.channel))


def _plain(message: BowdenMessage) -> bool:
    return not (message.is_extended_id or message.is_remote_frame or message.is_error_frame)


def _at_work(device: Device, beat_id: int) -> bool:
    """OPERATIONAL, nothing to send or to say, no SDO under way, SYNC without a counter, no other heartbeat awaited."""
    return (device.state is NmtState.OPERATIONAL and not device.outbox and device.emcy.silent and device.sdo.idle
            and device.sync.steady and device.consumer.watches_only(beat_id - HEARTBEAT_BASE))


def _part(array: Any, first: int, place: int, size: int) -> Any:
    """Return the view of the `place`-th of several parts of one size."""
    return array[first + place * size:first + (place + 1) * size]
