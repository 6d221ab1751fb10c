"""A CANopen device joined to the wire.

A device receives frames, states and the time, nothing else. Its frames are transmitted after its stated response
time, and it is woken at the time that it requested.
"""

from collections import deque
from collections.abc import Callable
from typing import Protocol

from eds.cia301 import Frame
from virtual_bus.kernel import NEVER, TIMER, Kernel
from virtual_bus.wire.station import Confinement, Station


class BusDevice(Protocol):
    """Protocol of a sans-IO device on a bus; `nodes.core.device.Device` has it."""

    @property
    def node_id(self) -> int:
        """CANopen node id of the station's device."""

    @property
    def filters(self) -> frozenset[int]:
        """COB-IDs that the device receives now; a new object after every change."""

    @property
    def outbox(self) -> deque[Frame]:
        """Frames to send, oldest first."""

    def power_on(self, now_ns: int) -> None:
        """Boot the device."""

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Receive a frame at its end."""

    def poll(self, now_ns: int) -> None:
        """Run all actions that are due."""

    def next_ns(self) -> int | None:
        """Return the time of the next action of `poll`."""

    def bus_off(self, now_ns: int) -> None:
        """Process bus-off."""

    def bus_recovered(self, now_ns: int) -> None:
        """Process the end of bus-off."""


class NodeStation(Station):
    """The controller of one device; `turnaround_ns` passes between a cause and its frame's readiness."""

    def __init__(self, kernel: Kernel, device: BusDevice, turnaround_ns: int) -> None:
        super().__init__(f"node {device.node_id}", self.receive, node=device.node_id, filters=device.filters)
        self.device = device
        self._kernel = kernel
        self.turnaround_ns = turnaround_ns
        self.due_ns = NEVER
        self.on = False
        self.unpowered: Callable[[], None] = lambda: None
        """Called when the supply goes: outputs of the device that fall back without it."""

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Pass a frame to the device and its answers to the wire."""
        device = self.device
        device.receive(frame, now_ns)
        if device.outbox or device.filters is not self.filters:
            self.settle(now_ns)
            return
        due_ns = device.next_ns()
        if due_ns is not None and due_ns < self.due_ns:
            self._wake_at(due_ns, now_ns)

    def settle(self, now_ns: int) -> None:
        """Update after any call of the device: send its outbox, follow its filter, schedule its next wake-up."""
        device = self.device
        if device.outbox:
            ready_ns = now_ns + self.turnaround_ns
            outbox = device.outbox
            while outbox:
                self.submit(outbox.popleft(), ready_ns)
        if device.filters is not self.filters:
            self.filters = device.filters
            if self.wire is not None:
                self.wire.reroute()
        due_ns = device.next_ns()
        if due_ns is not None and due_ns < self.due_ns:
            self._wake_at(due_ns, now_ns)

    def look_again(self, now_ns: int) -> None:
        """Wake the device at its present next deadline in place of the one scheduled earlier."""
        self.due_ns = NEVER
        self.settle(now_ns)

    def _wake_at(self, due_ns: int, now_ns: int) -> None:
        self.due_ns = due_ns if due_ns > now_ns else now_ns
        self._kernel.at(self.due_ns, TIMER, self._wake)

    def _wake(self) -> None:
        now_ns = self._kernel.now_ns
        if now_ns != self.due_ns:
            return  # an earlier wake took its place
        self.due_ns = NEVER
        self.device.poll(now_ns)
        self.settle(now_ns)

    def confined(self, previous: Confinement, now_ns: int) -> None:
        """Report to the device that its controller has entered or left bus-off."""
        if not self.on:
            return
        if self.state is Confinement.BUS_OFF:
            self.device.bus_off(now_ns)
        elif previous is Confinement.BUS_OFF:
            self.device.bus_recovered(now_ns)
        self.settle(now_ns)

    def powered(self, on: bool, now_ns: int) -> None:
        """Boot the device or switch its supply off."""
        self.on = on
        if on:
            self.device.power_on(now_ns)
            self.settle(now_ns)
        else:
            self.due_ns = NEVER
            self.unpowered()
            self.device.outbox.clear()
