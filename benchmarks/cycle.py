"""One whole simulated control cycle, and a stock canopen cycle beside it: two works of `benchmarks.performance`.

Ours: `bowden trial` as it runs: controller, safety, exchange, recorder, the wire with its exact bits, four devices,
plant at 10 µs, the truth file.  The peer: canopen as its manual says, one Network for the master and one for each of
four devices, on python-can's `virtual` interface, the same frames read and written by `PdoVariable.raw`; no plant, no
control, no log, no time.  A second peer is the least that canopen can do: all devices on one Network, pumped by hand
without its threads.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import can
import canopen

from benchmarks.frame import Turn, repeated
from eds.bench.bench_network import DRIVES, FILES, RPDO, Network, Pdo, wire
from eds.cia301 import SYNC_COB_ID
from eds.dictionary import packaged
from master.motion.experiment_run import ExperimentSetup, run
from master.network.link import WANTED, Link
from master.settings import Gait
from physics.reference import paper_reference
from trial.record import Recorder
from virtual_bus.bus import BowdenBus

UNITS = 200
PEAK_N, PERIOD_S = 40.0, 2.0
SKIP = 4000
"""Cycles before the first turn: bring-up, homing, approach."""


class Paced:
    """A recorder that ends a turn every `UNITS` rows of the walk."""

    def __init__(self, recorder: Recorder, turn: Turn) -> None:
        self.frame, self.event = recorder.frame, recorder.event
        self.frames = recorder.frames
        self._record, self._turn, self._left = recorder.cycle, turn, SKIP

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle."""
        self._record(time_ns, values)
        self._left -= 1
        if not self._left:
            self._left = UNITS
            self._turn()


def ours(turn: Turn, **options: Any) -> None:
    """A trial on the virtual bench, as `bowden trial` runs it."""
    network, reference = Network(), paper_reference(PEAK_N, PERIOD_S)
    experiment = ExperimentSetup(reference, network, gait=Gait(peak_n=PEAK_N, period_s=PERIOD_S, cycles=200, settle=0))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bus = BowdenBus("cycle", rate_hz=network.rate_hz, truth=str(folder / "truth.mcap"), **options)
        tap = BowdenBus("cycle")
        bus.set_filters(WANTED)
        recorder = Recorder(folder / "trial.mcap", metadata={}, attachments={}, threaded=False)
        try:
            result = run(Link(bus, bus.time_ns), tap, Paced(recorder, turn), experiment)  # type: ignore[arg-type]
            raise RuntimeError(f"the trial ended before enough was measured: {result.stop_reason}")
        finally:
            tap.shutdown()
            bus.shutdown()


def stock(turn: Turn) -> None:
    """canopen as its manual says: SYNC, four TPDOs, one frame of targets, a notifier's thread for each network."""
    with Stock() as peer:
        repeated(turn, peer.cycle, UNITS)


def pumped(turn: Turn) -> None:
    """Run a stock cycle with two networks that one thread pumps by hand."""
    with Stock(threads=False) as peer:
        repeated(turn, peer.cycle, UNITS)


class Stock:
    """A canopen master and four devices on `virtual`."""

    def __init__(self, *, threads: bool = True) -> None:
        described = wire(Network())
        self._master = self._network(threads)
        together = self._network(False)
        self._benches = [self._network(True) for _ in FILES] if threads else [together] * len(FILES)
        self._threads, self._there, self._count = threads, threading.Semaphore(0), 0
        remote, self._taken = [], []
        for (node_id, file), bench in zip(FILES.items(), self._benches, strict=True):
            near, far = self._master.add_node(node_id, str(packaged(file))), canopen.LocalNode(
                node_id, str(packaged(file)))
            bench.add_node(far)
            for pdo in described.pdos(node_id):
                if pdo.number == 1:
                    map_pdo((far.rpdo if pdo.base == RPDO else far.tpdo)[1], pdo)
                    map_pdo((near.rpdo if pdo.base == RPDO else near.tpdo)[1], pdo)
            near.tpdo[1].add_callback(lambda _pdo: self._there.release())
            bench.subscribe(SYNC_COB_ID, partial(self._answer, far.tpdo[1]))
            if node_id in DRIVES:
                far.rpdo[1].add_callback(self._take)
            remote.append(near)
        self._inputs, self._targets = [node.tpdo[1] for node in remote], remote[0].rpdo[1]

    def __enter__(self) -> Stock:
        return self

    def __exit__(self, *_: object) -> None:
        for network in {id(each): each for each in (self._master, *self._benches)}.values():
            network.disconnect()

    @staticmethod
    def _network(threads: bool) -> Any:
        network = canopen.Network()
        if threads:
            return network.connect(interface="virtual", channel="stock")
        network.bus = can.Bus(interface="virtual", channel="stock")
        return network

    def _answer(self, pdo: Any, _can_id: int, _data: bytearray, _timestamp: float) -> None:
        self._count += 1
        for variable in pdo.map:
            variable.raw = self._count & 0x3FFF
        pdo.transmit()

    @staticmethod
    def _take(pdo: Any) -> None:
        for variable in pdo.map:
            _ = variable.raw

    def cycle(self) -> None:
        """SYNC, inputs read, targets sent."""
        self._master.sync.transmit()
        if not self._threads:
            _pump(self._benches[0])
            _pump(self._master)
        for _ in self._inputs:
            if not self._there.acquire(timeout=1.0):
                raise RuntimeError("a device of canopen's does not answer")
        values = [[variable.raw for variable in pdo.map] for pdo in self._inputs]
        self._targets.map[0].raw, self._targets.map[1].raw = values[0][1], values[1][1]
        self._targets.transmit()
        if not self._threads:
            _pump(self._benches[0])


def _pump(network: Any) -> None:
    while (message := network.bus.recv(0)) is not None:
        network.notify(message.arbitration_id, message.data, message.timestamp)


def map_pdo(pdo: Any, planned: Pdo) -> None:
    """Give canopen's PDO the bench's mapping."""
    pdo.clear()
    for word in planned.mapping:
        pdo.add_variable(word >> 16, word >> 8 & 0xFF, word & 0xFF)
    pdo.cob_id, pdo.enabled = planned.cob_id, True
    pdo.subscribe()
