"""The virtual bus of one test: nodes, faults, recorded frames and its own time.

The rule of this file: everything happens in the thread of the test, in virtual time; the same test gives the same
frames at the same nanoseconds on every run.
"""

import itertools
import random
from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import can

from bowden.testing import golden
from bowden.testing.canopen_node import CanopenNode, DriveLoad
from bowden.testing.counted_faults import CountedFaults
from eds.cia301 import Frame
from eds.cia305 import UNCONFIGURED
from eds.dictionary import Dictionary
from nodes import Application
from parameters import InputError
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.kernel import TIMER
from virtual_bus.serve import ServeFigures, serve
from virtual_bus.wire.bits import BITRATES
from virtual_bus.wire.station import ErrorKind, Station

QUEUE = 1000
"""Frames that wait in the computer and in the test's sender, as `ip link set vcan0 txqueuelen 1000`."""

_CHANNELS = itertools.count(1)


class BusFrame(NamedTuple):
    """One frame as the recorder of a `CanBus` received it; `time_ns` is the end of the frame."""

    time_ns: int
    cob_id: int
    data: bytes
    remote: bool = False

    def __str__(self) -> str:
        data = "remote" if self.remote else self.data.hex(" ")
        return f"{self.time_ns / 1e9:.9f} {self.cob_id:03X} [{len(self.data)}] {data}".rstrip()


class FrameRecorder(Station):
    """A bus analyser: acknowledges and keeps every frame, and counts error frames."""

    def __init__(self) -> None:
        super().__init__("recorder", self.keep, limit=QUEUE)
        self.frames: list[BusFrame] = []
        self.errors: list[tuple[int, ErrorKind]] = []

    def keep(self, frame: Frame, now_ns: int) -> None:
        """Record a frame of another station."""
        self.frames.append(BusFrame(now_ns, frame.can_id, frame.data, frame.remote))

    def sent(self, frame: Frame, origin: object, now_ns: int) -> None:
        """Record a frame that `CanBus.send` made."""
        self.keep(frame, now_ns)

    def errs(self, kind: ErrorKind, sending: bool, now_ns: int) -> None:
        """Record an error frame."""
        self.errors.append((now_ns, kind))


class CanBus:
    """A virtual CAN bus; time starts at 0 ns and passes only while somebody waits.

    `bitrate` in bit/s; turnarounds in ns pass between a frame at a node (or the computer) and its answer. `seed`
    seeds `random`. Raises `InputError` for a bit rate that the wire does not have.
    """

    def __init__(self, *, bitrate: int = 1_000_000, seed: int = 0, node_turnaround_ns: int = 0,
                 master_turnaround_ns: int = 0) -> None:
        self._bitrate = _known(bitrate)
        self.faults = CountedFaults()
        self.seed = seed
        self.random = random.Random(seed)
        self._nodes: list[CanopenNode] = []
        self.channel = f"testing-{next(_CHANNELS)}"
        self._bench = Bench(channel=self.channel, bitrate=bitrate, judge=self.faults, tx_queue=QUEUE,
                            master_turnaround_ns=master_turnaround_ns)
        self._turnaround_ns = node_turnaround_ns
        self._recorder = FrameRecorder()
        self._opened: list[BowdenBus] = []
        self.kernel, self.wire = self._bench.kernel, self._bench.wire
        self.wire.attach(self._recorder)
        self.kernel.run(0)

    def __repr__(self) -> str:
        return f"CanBus({self.now_ns} ns, nodes {sorted(self.nodes)}, {len(self._recorder.frames)} frames)"

    # ---- who is on it ----

    def add_node(
        self, eds: str | Path | Dictionary, node_id: int | None = None, *, profile: Application | None = None,
        store: Path | None = None, mechanics: DriveLoad | None = None, serial: int | None = None,
    ) -> CanopenNode:
        """Add a node that boots now, by its EDS or DCF; `profile` puts `nodes.Drive` or the like behind it.

        `node_id` 255 is a node without one, which only LSS reaches. `store` is the file of 0x1010 and of LSS;
        `mechanics` is the load of a drive; `serial` is the serial number, 0x1018:04. Raises `InputError` for an
        unusable file or a node id that is taken.
        """
        node = CanopenNode(self, eds, node_id, profile, store, mechanics, self._turnaround_ns, serial)
        if node.node_id in self.nodes and node.node_id != UNCONFIGURED:
            raise InputError(f"can_bus: node id {node.node_id} is on the bus already; give each node its own.")
        self._nodes.append(node)
        node.power_on()
        return node

    @property
    def nodes(self) -> dict[int, CanopenNode]:
        """The nodes by their present node ids."""
        return {node.node_id: node for node in self._nodes}

    @property
    def bitrate(self) -> int:
        """Bit rate of the wire, bit/s; once set, a node whose bit timing LSS has switched elsewhere is off the bus."""
        return self._bitrate

    @bitrate.setter
    def bitrate(self, bitrate: int) -> None:
        self._bitrate = _known(bitrate)
        self.wire.retime(bitrate)
        for node in self._nodes:
            node.station.settle(self.now_ns)

    def open(self, **options: Any) -> BowdenBus:
        """Open a python-can bus on this virtual bus, for any python-can or canopen program."""
        bus = BowdenBus(self.channel, bench=self._bench, **options)
        self._opened.append(bus)
        return bus

    def send(self, cob_id: int, data: bytes = b"", *, remote: bool = False) -> None:
        """Send a frame from a further station of the bus, ready now."""
        self._recorder.submit(Frame(cob_id, bytes(data), remote), self.now_ns)

    def serve(self, bus: can.BusABC, clock: Callable[[], int], stop: Callable[[], bool], *,
              echoes: bool = False) -> ServeFigures:
        """Boot the nodes on another python-can bus, in wall time by `clock` (ns), until `stop()`; return the figures.

        The virtual wire ends with it; `faults` act on the frames of that bus. `echoes`: the bus returns its own frames.
        """
        self.wire.detach(self._recorder)
        for node in self._nodes:
            node.station.powered(False, self.now_ns)
            self._bench.nodes[node.node_id] = node.station
            self.kernel.at(self.now_ns, TIMER, partial(node.station.powered, True, self.now_ns))
        return serve(bus, self._bench, clock, stop, echoes=echoes, judge=self.faults)

    def close(self) -> None:
        """Shut down every python-can bus that `open` gave."""
        for bus in self._opened:
            bus.shutdown()
        self._opened.clear()

    # ---- time ----

    @property
    def now_ns(self) -> int:
        """Bus time, ns."""
        return self.kernel.now_ns

    def run(self, seconds: float) -> None:
        """Let bus time pass; an open python-can bus keeps the frames that it receives."""
        self.kernel.run(self.now_ns + round(seconds * 1e9))

    def after(self, seconds: float, function: Callable[[], object]) -> None:
        """Call `function()` when bus time has advanced by `seconds`."""
        self.kernel.at(self.now_ns + round(seconds * 1e9), TIMER, lambda: (function(), None)[1])

    @contextmanager
    def virtual_time(self) -> Iterator[None]:
        """Make this thread wait in bus time: `time.sleep`, `time.monotonic`, `Condition.wait`, `Queue.get`, Notifier.

        `canopen.Network(can_bus.open())` then works with or without `connect()`, and no thread is started. Raises
        `RuntimeError` where a wait without time-out can never end.
        """
        from bowden.testing.virtual_time import VirtualTime

        current = VirtualTime.current
        if current is not None and current.mine and current.kernel is self.kernel:
            yield
            return
        with VirtualTime(self.kernel, self.channel):
            yield

    # ---- what was on it ----

    def frames(self, cob_id: int | None = None, *, since_ns: int = 0) -> list[BusFrame]:
        """Return the frames received on the bus so far, of one COB-ID or all, from `since_ns` on."""
        received = self._recorder.frames
        first = bisect_left(received, since_ns, key=lambda frame: frame.time_ns)
        return [frame for frame in received[first:] if cob_id in (None, frame.cob_id)]

    @property
    def error_frames(self) -> list[tuple[int, ErrorKind]]:
        """Time (ns) and kind of every error frame so far."""
        return list(self._recorder.errors)

    def assert_golden(self, path: str | Path, *, update: bool = False) -> None:
        """Compare all frames with a golden text file, or write it; raise `AssertionError` with the differences."""
        golden.assert_same_frames(self.frames(), Path(path), update=update)


def _known(bitrate: int) -> int:
    if bitrate not in BITRATES:
        raise InputError(f"can_bus: bitrate = {bitrate} is none of {', '.join(map(str, BITRATES))}; choose one.")
    return bitrate
