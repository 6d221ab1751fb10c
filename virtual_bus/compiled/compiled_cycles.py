"""Complete control cycles in one compiled call: conditions for it, and when the bench's objects are updated.

The rule of this file: a cycle is computed by `cycle_code.cycle` only if all that happens up to its end is known
beforehand; anything else runs event by event, as ever.  Between two such cycles the numbers live in the arrays alone
(`warm`); whoever asks the bench for anything has them written back first.
"""

import os
from typing import Final, cast

from eds.bench.complete_cycle import CompleteCycle
from eds.cia301 import HEARTBEAT_BASE, NmtState
from nodes import Device, Drive, TensionSensor
from physics.converter import Converter
from physics.plant.bench_plant import BowdenPlant
from virtual_bus.bench import Bench
from virtual_bus.compiled import cycle_code as law
from virtual_bus.compiled.cycle_arrays import ROW, Arrays, CycleRequest
from virtual_bus.machine.machine import Machine
from virtual_bus.wire.node_station import NodeStation
from virtual_bus.wire.periodic import PeriodicTask
from virtual_bus.wire.wire import Wire

SWITCH: Final = "BOWDEN_STEADY"
"""Environment variable that turns compiled cycles off if it is 0."""
SPAN_NS: Final = 20_000
"""Margin over the duration of the last cycle, ns, within which a compiled cycle is tried.

Too small: a cycle is given up and run event by event; the result is the same.
"""
ROOM: Final = 32
"""Free places in every transmit queue of the computer that a compiled cycle requires."""
WAITING: Final = 12
"""Greatest number of frames waiting at the monitor socket when a compiled cycle begins."""
_NOBODY: Final[frozenset[int]] = frozenset()


def possible(bench: Bench) -> bool:
    """Return whether a bench can run compiled cycles: its plant is the packaged one, and they are not turned off."""
    machine = bench.machine
    if os.environ.get(SWITCH, "1") == "0" or not isinstance(machine, Machine) or type(machine.plant) is not BowdenPlant:
        return False
    axes, gauges = machine.axes, machine.gauges
    return (len(gauges) == law.GAUGES and len(bench.nodes) == law.NODES and type(bench.wire) is Wire
            and len(axes) == law.AXES and all(isinstance(axis.drive, Drive) for axis in axes)
            and all(type(gauge.converter) is Converter and type(gauge.sensor) is TensionSensor for gauge in gauges))


class Steady:
    """Compiled cycles of one bench; `cycles` is their number. `warm`: the arrays are newer than the objects."""

    def __init__(self, bench: Bench) -> None:
        law.prepare()
        self.warm = False
        self.cycles = 0
        self._bench, self._machine, self._kernel = bench, cast(Machine, bench.machine), bench.kernel
        self._arrays = Arrays(bench)
        self._foreign_ns = self._span_ns = self._ran = 0
        self._asked: CycleRequest | None = None
        self._sync: PeriodicTask | None = None

    def cycle(self, asked: CycleRequest, data: bytes, beat_ns: int, after_ns: int) -> CompleteCycle | None:
        """Send the targets `data` and run to the last input of the next SYNC; None if the cycle must run event by
        event.

        `beat_ns` is when the master's heartbeat is due; the SYNC has to end after `after_ns`.
        """
        arrays, m, t = self._arrays, self._arrays.m, self._arrays.t
        if not (self.warm or self._enter(asked)):
            return None
        if asked is not self._asked or m.sync_ns + self._span_ns >= self._foreign_ns:
            self.leave()
            return None
        arrays.targets[:] = data
        t.limit, m.own_ns, t.after = self._foreign_ns, beat_ns, after_ns
        if law.cycle(*arrays.call) != law.DONE:
            self.leave()
            return None
        self._ran += 1
        self._kernel.now_ns = now_ns = m.now
        sync_ns, first, end = m.sync_at, m.first_row, m.sync_row
        self._span_ns = now_ns - sync_ns + SPAN_NS
        m.first_row = end
        if m.truth_rows == law.TRUTHS:
            arrays.write_truth()
        beats = self._beats() if m.beats or m.own_at >= 0 else ()
        return CompleteCycle(sync_ns=sync_ns, target_ns=m.targets_at, inputs=arrays.inputs, heartbeats=beats,
                             frames=arrays.rows[ROW * first:ROW * end], frame_count=end - first)

    def _beats(self) -> tuple[tuple[int, int, int], ...]:
        """Return the heartbeats of the last cycle."""
        m, t = self._arrays.m, self._arrays.t
        own = [(t.own_id, m.own_at, t.own_data)] if m.own_at >= 0 else []
        return (*own, *((table.can_id, node.beat_end, table.data)
                        for node, table in zip(m.node, t.node, strict=True) if node.beat_end >= 0))

    def leave(self) -> None:
        """Copy the state back to the objects, which continue event by event."""
        if self.warm and self._asked is not None and self._sync is not None:
            self.warm = False
            self.cycles += self._ran
            self._arrays.hand_back(self._asked, self._sync, self._ran > 0)

    # ---- when ----

    def _enter(self, asked: CycleRequest) -> bool:
        if not (self._quiet(asked) and self._heard(asked) and self._scan()):
            return False
        tables = self._arrays.tables(asked)
        if tables is None or self._sync is None:
            return False
        self._arrays.fill(asked, tables, self._sync)
        self._asked, self._ran, self._span_ns, self.warm = asked, 0, 0, True
        return True

    def _quiet(self, asked: CycleRequest) -> bool:
        """Return whether the wire is idle and every device is operational without a fault."""
        bench, now_ns = self._bench, self._kernel.now_ns
        return (
            bench.wire.steady and bench.medium is bench.wire and self._machine.steady
            and all(station.on and station.due_ns > now_ns and application.steady and _at_work(device, asked)
                    for station, device, application in self._arrays.members)
        )

    def _heard(self, asked: CycleRequest) -> bool:
        """Return whether nodes, truth, master and monitor socket are the only listeners, each without a filter that
        drops frames."""
        bench, truth, tap = self._bench, self._machine.truth, asked.tap
        host, members = bench.host, self._arrays.members
        sockets = [asked.socket] if tap is None else [asked.socket, tap]
        stations = {id(each) for each in (host, truth, *(member.station for member in members)) if each is not None}
        wanted = (law.SYNC_ID, *asked.inputs, *(HEARTBEAT_BASE + member.device.node_id for member in members))
        return (
            len(host.sockets) == len(sockets) and all(socket in host.sockets for socket in sockets)
            and min(host.limit, *(socket.limit for socket in sockets)) >= ROOM
            and not asked.socket.queue and not asked.socket.own and all(map(asked.socket.accepts, wanted))
            and (tap is None or (not tap.filters and len(tap.queue) <= WAITING and not any(
                message.is_extended_id or message.is_remote_frame or message.is_error_frame for message in tap.queue)))
            and {id(station) for station in bench.wire.stations} == stations
            and all(station.deaf_to == _NOBODY for station in bench.wire.stations)
        )

    def _scan(self) -> bool:
        """Find SYNC's task and the first event outside the compiled cycle; False if no SYNC runs, or it comes too late.
        """
        bench, sync = self._bench, None
        foreign_ns = bench.wire.quiet_until(self._kernel.now_ns)
        stations = [member.station for member in self._arrays.members]
        for time_ns, _, _, callback in self._kernel.events():
            owner = getattr(callback, "__self__", None)
            if owner is self._machine or owner is bench.wire or (isinstance(owner, NodeStation) and owner in stations):
                continue
            if isinstance(owner, PeriodicTask):
                if owner.next_ns != time_ns:
                    continue
                if sync is None and owner.sync:
                    sync = owner
                    continue
            foreign_ns = min(foreign_ns, time_ns)
        self._sync, self._foreign_ns = sync, foreign_ns
        return sync is not None and sync.next_ns < foreign_ns


def _at_work(device: Device, asked: CycleRequest) -> bool:
    """Return whether a device is OPERATIONAL with nothing to send, no SDO, no SYNC counter, and one live master."""
    consumer = device.consumer
    return (device.state is NmtState.OPERATIONAL and not device.outbox and device.emcy.silent and device.sdo.idle
            and device.sync.steady and consumer.all_live()
            and consumer.watches_only(asked.heartbeat.can_id - HEARTBEAT_BASE))
