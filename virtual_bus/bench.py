"""The bench: one heap, one wire, the computer, the devices, and what moves behind them.

The rule of this file: it joins and decides nothing; who acts when is in the heap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from eds.bench.bench_network import MASTER
from virtual_bus.kernel import TIMER, Kernel
from virtual_bus.wire.faults import OF_A_FRAME, OF_TIME, Fault, InjectedFaults, arrange
from virtual_bus.wire.host import Host
from virtual_bus.wire.node_station import BusDevice, NodeStation
from virtual_bus.wire.station import Medium
from virtual_bus.wire.wire import FrameFaults, Wire

US = 1_000
MS = 1_000_000


class Mechanics(Protocol):
    """Protocol of plant and measurement behind the devices; see `machine.py`."""

    def start(self) -> None:
        """Schedule the first tick."""

    def close(self) -> None:
        """Finish all files."""


class Bench:
    """A simulated bench, from power-on at 0 ns; `machine` is made once kernel, wire and stations are there.

    `medium` is what joins the stations: the bench's own wire, unless it is served on another bus. `judge` decides
    on the faults of single frames; None applies those in `faults`.
    """

    def __init__(
        self,
        devices: Iterable[BusDevice] = (),
        *,
        channel: str = "bench",
        bitrate: int = 1_000_000,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        master_turnaround_ns: int = 100 * US,
        node_turnaround_ns: int = 10 * US,
        tx_queue: int = 64,
        restart_ns: int = 100 * MS,
        machine: Callable[[Bench], Mechanics] | None = None,
        judge: FrameFaults | None = None,
    ) -> None:
        faults = tuple(faults)
        if judge is None and any(fault.kind in OF_A_FRAME | OF_TIME for fault in faults):
            judge = InjectedFaults(faults, seed)
        self.kernel = Kernel()
        self.wire = Wire(self.kernel, bitrate, judge)
        self.medium: Medium = self.wire
        self.master_turnaround_ns = master_turnaround_ns
        self.host = Host(channel, MASTER, limit=tx_queue, restart_ns=restart_ns)
        self.nodes = {
            device.node_id: NodeStation(self.kernel, device, node_turnaround_ns) for device in devices
        }
        for station in (self.host, *self.nodes.values()):
            self.wire.attach(station)
        arrange(self.kernel, lambda: self.medium, (self.host, *self.nodes.values()), faults, self.wire.bit_ns)
        self.machine = machine(self) if machine is not None else None
        self.kernel.at(0, TIMER, self._power_on)

    def _power_on(self) -> None:
        for station in self.nodes.values():
            if station.wire is not None:
                station.powered(True, self.kernel.now_ns)
        if self.machine is not None:
            self.machine.start()

    def close(self) -> None:
        """Finish the machine's files."""
        if self.machine is not None:
            self.machine.close()
