"""One TPDO: conditions of its transmission (CiA 301, 7.2.2; communication parameters 7.5.2.37).

Synchronous TPDOs are sent at a SYNC. Event-driven ones are sent when their content changes or the event timer ends,
never sooner than the inhibit time allows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eds.cia301 import COB_ID_NO_RTR, SYNC_MAX, Frame
from eds.dictionary import key
from eds.pdo_plan import PdoPlan
from nodes.core import cob_id
from nodes.core.parts import FAR_NS, MS, US
from nodes.core.pdo.pdo_mapping import packer

if TYPE_CHECKING:
    from nodes.core.device import Device


class TransmitPdo:
    """TPDO `number` (from 1), compiled from 0x1800 + number − 1; `can_id` is 0 while it does not exist."""

    __slots__ = ("_device", "_event_ns", "_inhibit_ns", "_last", "_requested", "_timer_due_ns", "can_id", "every",
                 "free_ns", "left", "number", "payload", "plan", "requestable", "start")

    def __init__(self, device: Device, number: int) -> None:
        self._device, self.number = device, number
        self.free_ns = 0
        self.stop()

    def compile(self, plan: PdoPlan) -> None:
        """Read the communication parameters again."""
        objects, index = self._device.objects, 0x17FF + self.number
        word = objects.number(key(index, 1), cob_id.INVALID)
        self.can_id = word & cob_id.CAN_ID if cob_id.exists(word) else 0
        self.requestable = bool(self.can_id) and not word & COB_ID_NO_RTR
        self.every = objects.number(key(index, 2))
        self.start = objects.number(key(index, 6))
        self._inhibit_ns = objects.number(key(index, 3)) * 100 * US
        self._event_ns = objects.number(key(index, 5)) * MS
        self.plan = plan
        self.payload = packer(plan)
        self.stop()

    @property
    def event_driven(self) -> bool:
        """Transmission type 254 or 255."""
        return self.every > SYNC_MAX

    def stop(self) -> None:
        """Drop the last content and pending transmissions."""
        self._last: bytes | None = None
        self._requested = False
        self._timer_due_ns = FAR_NS
        self.left = 0

    def begin(self, counted: bool) -> None:
        """Start at the begin of OPERATIONAL: count SYNCs from here, or from the one that sub-index 6 names (`left` = 0
        until then)."""
        self.stop()
        self.left = 0 if counted and self.start else self.every

    def send(self, now_ns: int) -> None:
        """Put the frame into the outbox, for every transmission type."""
        self._last = data = self.payload(self._device.values)
        self._device.outbox.append(Frame(self.can_id, data))
        if self.event_driven:
            self._requested = False
            self.free_ns = now_ns + self._inhibit_ns
            self._timer_due_ns = now_ns + self._event_ns if self._event_ns else FAR_NS

    def send_if_changed(self, now_ns: int) -> None:
        """Send an acyclic synchronous TPDO (type 0) whose content is new."""
        if self.payload(self._device.values) != self._last:
            self.send(now_ns)

    def look(self, now_ns: int) -> None:
        """Detect an event: content that differs from the last transmission."""
        # `stop` clears the last content, so that the state is sent once on entering OPERATIONAL (decision 11)
        if not self._requested and self.payload(self._device.values) != self._last:
            self._requested = True
            self._device.wake(self.poll(now_ns))

    def request(self) -> None:
        """Request one transmission, sent as soon as the inhibit time allows."""
        self._requested = True

    def poll(self, now_ns: int) -> int:
        """Send an event-driven TPDO that is due; return when the next may be."""
        if self._due_ns() <= now_ns:
            self._device.refresh(now_ns)
            self.send(now_ns)
        return self._due_ns()

    def _due_ns(self) -> int:
        timer_ns = max(self._timer_due_ns, self.free_ns)
        return self.free_ns if self._requested else timer_ns
