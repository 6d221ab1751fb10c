"""A simulated bench in wall time, on any python-can bus: `bowden bench`, and single nodes: `bowden node serve`.

The bench's own time follows a clock that is handed in. Due events run in their order and at their own time before any
frame reaches a device; waiting is receiving.
"""

import errno
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import can

from eds.cia301 import Frame
from parameters import InputError
from virtual_bus.bench import Bench
from virtual_bus.kernel import TIMER, Kernel
from virtual_bus.wire.faults import COPY, OF_A_NODE, Fault, declared
from virtual_bus.wire.host import frame_of, message_of
from virtual_bus.wire.station import EXTENDED, Deliver, ErrorKind, Station, Waiting
from virtual_bus.wire.wire import FrameFaults

PATIENCE_NS: Final = 1_000_000
"""Largest delay of a drive's tick while no frame arrives from outside."""
GONE: Final = frozenset({errno.ENODEV, errno.ENXIO, errno.EBADF})


@dataclass
class ServeFigures:
    """Figures of a served bench: frames either way, frames the bus refused, largest lag ever."""

    received: int = 0
    sent: int = 0
    lost: int = 0
    behind_ns: int = 0


class Outside:
    """Medium that joins the bench's stations to a python-can bus; stations receive each other directly.

    A bus that `echoes` brings their frames back besides, in their order: those are passed over. `judge` decides on
    faults of single frames, either way; an error frame cannot be sent, so a frame that it asks one for is not sent.
    """

    def __init__(self, kernel: Kernel, bus: can.BusABC, echoes: bool, judge: FrameFaults | None = None) -> None:
        self._judge = judge
        self._others = Station("other stations", lambda _frame, _now_ns: None)
        self.served = ServeFigures()
        self._echoes = echoes
        self._sent: deque[Frame] = deque(maxlen=1024)
        self._kernel = kernel
        self._bus = bus
        self._stations: list[Station] = []
        self._routes: dict[tuple[Station | None, int], tuple[Deliver, ...]] = {}

    def attach(self, station: Station) -> None:
        """Join a station."""
        station.wire = self
        self._stations.append(station)
        self.reroute()

    def detach(self, station: Station) -> list[Waiting]:
        """Remove a station; it has no queue here."""
        self._stations.remove(station)
        station.wire = None
        self.reroute()
        return []

    def flush(self, station: Station) -> None:
        """Do nothing: a station has no queue here."""

    def reroute(self) -> None:
        """Clear the cached routes from COB-IDs to stations."""
        self._routes.clear()

    def submit(self, station: Station, frame: Frame, ready_ns: int, origin: object = None) -> bool:
        """Send at once, or when a fault releases the frame: in wall time the turnaround is the computer's own."""
        now_ns = self._kernel.now_ns
        if self._judge is None:
            return self._send(station, frame)
        due_ns = now_ns if origin is COPY else self._judge.ready(station, frame, now_ns)
        if due_ns > now_ns:
            self._kernel.at(due_ns, TIMER, lambda: self._pass_on(station, frame, origin))
        else:
            self._pass_on(station, frame, origin)
        return True

    def _pass_on(self, station: Station, frame: Frame, origin: object) -> None:
        """Send a frame as the faults change it: once, twice, altered or not at all."""
        left = self._judged(station, frame, origin)
        if left is not None:
            self._send(station, left)

    def _judged(self, station: Station, frame: Frame, origin: object = None) -> Frame | None:
        left = frame if self._judge is None else self._judge.heard((0, 0, station, frame, origin), self._kernel.now_ns)
        return None if isinstance(left, ErrorKind) else left

    def _send(self, station: Station, frame: Frame) -> bool:
        message = message_of(frame, 0, False, "")
        try:
            self._bus.send(message)
        except can.CanOperationError:
            self.served.lost += 1
            station.lost += 1
            return False
        self.served.sent += 1
        if self._echoes:
            self._sent.append(frame)
        self.hear(station, frame)
        return True

    def take(self, frame: Frame) -> None:
        """Pass a frame of the bus to every station that accepts it, unless it is an echo of the bench's own."""
        if frame in self._sent:
            while self._sent.popleft() != frame:
                pass
            return
        self.served.received += 1
        left = self._judged(self._others, frame)
        if left is not None:
            self.hear(None, left)

    def hear(self, sender: Station | None, frame: Frame) -> None:
        """Pass a frame at once to every station but its sender whose filter accepts it."""
        route = frame.can_id | EXTENDED if frame.extended else frame.can_id
        receivers = self._routes.get((sender, route))
        if receivers is None:
            receivers = self._routes[sender, route] = tuple(
                station.deliver for station in self._stations if station is not sender and station.accepts(route)
            )
        for deliver in receivers:
            deliver(frame, self._kernel.now_ns)


def serve(
    bus: can.BusABC, bench: Bench, clock: Callable[[], int], stop: Callable[[], bool] = lambda: False, *,
    echoes: bool = False, judge: FrameFaults | None = None,
) -> ServeFigures:
    """Run `bench` on `bus` at the pace of `clock`, ns, until `stop` returns True, and return its figures.

    `echoes`: the bus receives its own frames, as python-can's `udp_multicast` does. The computer of the bench stays
    outside: masters are on `bus`. `judge` decides on faults of single frames. Raises `can.CanOperationError` when the
    interface is gone; while it is down, frames are lost and counted, as in a real node.
    """
    bench.medium = outside = Outside(bench.kernel, bus, echoes, judge)
    for station in list(bench.wire.stations):
        bench.wire.detach(station)
        if station is not bench.host:
            outside.attach(station)
    _run(bus, bench, outside, clock, stop)
    return outside.served


def _run(
    bus: can.BusABC, bench: Bench, outside: Outside, clock: Callable[[], int], stop: Callable[[], bool]
) -> None:
    kernel = bench.kernel
    began_ns = clock() - kernel.now_ns
    while not stop():
        now_ns = clock() - began_ns
        outside.served.behind_ns = max(outside.served.behind_ns, now_ns - kernel.next_ns() - PATIENCE_NS)
        kernel.run(now_ns)
        frame = _receive(bus, bench, clock() - began_ns)
        kernel.run(max(kernel.now_ns, clock() - began_ns))
        if frame is not None:
            outside.take(frame)


def servable(path: Path) -> tuple[Fault, ...]:
    """Read the faults of a served bench: those of whole nodes and of their wiring.

    Raises `InputError` for a fault of the wire: a real bus has its own.
    """
    faults = declared(path)
    for place, fault in enumerate(faults, start=1):
        if fault.kind not in OF_A_NODE:
            raise InputError(f"{path} [[fault]] {place}: {fault.kind} is a fault of the virtual bus's wire; a served "
                             f"bench has {', '.join(sorted(OF_A_NODE))}: leave it out, or give a Linux interface one "
                             "(tc qdisc … netem, cangw).")
    return faults


def _receive(bus: can.BusABC, bench: Bench, now_ns: int) -> Frame | None:
    due_ns = min([now_ns + PATIENCE_NS, *(station.due_ns for station in bench.nodes.values())])
    try:
        message = bus.recv(max(0, due_ns - now_ns) / 1e9)
    except can.CanOperationError as error:
        if error.error_code in GONE:
            raise
        return None
    if message is None or message.is_error_frame or message.is_fd:
        return None
    return frame_of(message)
