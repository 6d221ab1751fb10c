"""Small sans-IO devices and listeners, so that the bus is tested without the stack above it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

from eds.cia301 import Frame
from virtual_bus.kernel import Kernel
from virtual_bus.wire.station import Station
from virtual_bus.wire.wire import Wire


class Echo:
    """A device that boots, answers SYNC with a count, beats every `heartbeat_ns`, and keeps what it hears."""

    def __init__(self, node_id: int, *listens: int, size: int = 2, heartbeat_ns: int | None = None) -> None:
        self.node_id = node_id
        self.filters = frozenset({0x080, *listens})
        self.outbox: deque[Frame] = deque()
        self.heard: list[tuple[int, Frame]] = []
        self.log: list[str] = []
        self.count = 0
        self.size = size
        self.heartbeat_ns = heartbeat_ns
        self.beat_ns: int | None = None

    def power_on(self, now_ns: int) -> None:
        self.log.append("power on")
        self.outbox.append(Frame(0x700 + self.node_id, b"\x00"))
        if self.heartbeat_ns is not None:
            self.beat_ns = now_ns + self.heartbeat_ns

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.heard.append((now_ns, frame))
        if frame.can_id == 0x080:
            self.count += 1
            self.outbox.append(Frame(0x180 + self.node_id, (self.count * 7919).to_bytes(8, "little")[: self.size]))

    def poll(self, now_ns: int) -> None:
        if self.beat_ns is not None and now_ns >= self.beat_ns:
            assert self.heartbeat_ns is not None
            self.outbox.append(Frame(0x700 + self.node_id, b"\x05"))
            self.beat_ns += self.heartbeat_ns

    def next_ns(self) -> int | None:
        return self.beat_ns

    def bus_off(self, now_ns: int) -> None:
        self.log.append("bus-off")

    def bus_recovered(self, now_ns: int) -> None:
        self.log.append("recovered")


class Listeners:
    """A wire with stations that keep what they hear, as (time, identifier, data)."""

    def __init__(self, count: int, bitrate: int = 1_000_000) -> None:
        self.kernel = Kernel()
        self.wire = Wire(self.kernel, bitrate)
        self.heard: list[list[tuple[int, Frame]]] = [[] for _ in range(count)]
        self.stations = [Station(f"station {i}", self._keep(i)) for i in range(count)]
        for station in self.stations:
            self.wire.attach(station)

    def _keep(self, place: int) -> Callable[[Frame, int], None]:
        return lambda frame, now_ns: self.heard[place].append((now_ns, frame))


@pytest.fixture
def echo() -> type[Echo]:
    return Echo


@pytest.fixture
def listeners() -> type[Listeners]:
    return Listeners
