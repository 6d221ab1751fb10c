"""SYNC consumer and producer (CiA 301, 7.2.5): 0x1005 COB-ID, 0x1006 period, 0x1007 window (7.5.2.5 to 7.5.2.7), 0x1019
counter overflow (7.5.2.22).

The rule of this file: a SYNC of another length than 0x1019 announces is reported (EMCY 0x8240) and not obeyed.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from eds.cia301 import COB_ID_NO_RTR, SERVICES, SYNC_MAX, Abort, Emcy, Frame, NmtState, Service
from eds.datatype import Value
from eds.dictionary import key
from nodes.core import cob_id
from nodes.core.parts import FAR_NS, US, Handler, Part

if TYPE_CHECKING:
    from nodes.core.device import Device

COB_ID: Final = 0x1005
PERIOD: Final = 0x1006
WINDOW: Final = 0x1007
OVERFLOW: Final = 0x1019

SHORTEST_PERIOD_US: Final = 100
"""Least period but 0 that 0x1006 takes: a SYNC of 55 bits and one PDO fit into it at 1 Mbit/s, little more does."""


class Sync(Part):
    """One device's SYNC; `window_end_ns` is when synchronous RPDOs cease to be taken."""

    service = Service.SYNC

    def __init__(self, device: Device) -> None:
        self._device = device
        self._fault = False
        self._counter = 0
        self._due_ns = FAR_NS
        self.checks = {COB_ID: lambda _, value: cob_id.check_sync(device, key(COB_ID), int(value)),
                       OVERFLOW: self._check_overflow, PERIOD: lambda _, value: (
                           Abort.TOO_LOW if 0 < int(value) < SHORTEST_PERIOD_US else None)}
        self.applied = dict.fromkeys((COB_ID, PERIOD, WINDOW, OVERFLOW), self._applied)
        self._configure()

    def reset(self, now_ns: int) -> None:
        """Read the SYNC objects again."""
        self._fault = False
        self._due_ns = FAR_NS
        self._configure()

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of SYNC frames, unless this device produces them."""
        if self.can_id and not self._making:
            yield self.can_id, self.receive

    def cob_ids(self) -> Iterator[tuple[int, int]]:
        """Yield the COB-ID in use with its object."""
        yield key(COB_ID), self.can_id

    def receive(self, data: bytes, now_ns: int) -> None:
        """Process a received SYNC."""
        # the counter that a SYNC of another length lacks decides who acts: it is not obeyed (decision 11)
        if (len(data) != self._length or self._fault) and not self._right_length(data):
            return
        if self._window_ns:
            self.window_end_ns = now_ns + self._window_ns
        self._device.pdos.synchronise(data[0] if data else 0, now_ns)

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Start or stop the SYNC producer; the counter begins at 1 (CiA 301, 7.2.5)."""
        if Service.SYNC not in SERVICES[state]:
            self._counter = 0
        if Service.SYNC not in SERVICES[state] or self._due_ns == FAR_NS:
            self._start(now_ns)

    def poll(self, now_ns: int) -> int:
        """Produce the SYNC that is due."""
        if self._due_ns <= now_ns:
            self._counter = self._counter % self._overflow + 1 if self._overflow else 0
            data = bytes((self._counter,)) if self._overflow else b""
            self._device.outbox.append(Frame(self.can_id, data))
            # late calls skip periods and keep the raster: two SYNCs in a burst would be one cycle too many
            self._due_ns += (1 + (now_ns - self._due_ns) // self._period_ns) * self._period_ns
            self.receive(data, now_ns)
        return self._due_ns

    @property
    def steady(self) -> bool:
        """Return whether a SYNC triggers the PDOs only: no data, no window, no fault, not produced here."""
        return not (self._length or self._fault or self._window_ns or self._making)

    def _right_length(self, data: bytes) -> bool:
        """Report the first SYNC of a wrong length, and the first right one after it."""
        self._fault = len(data) != self._length
        if self._fault:
            self._device.emcy.set(Emcy.SYNC_LENGTH, Emcy.SYNC_LENGTH.register, bytes((len(data) & 0xFF,)))
        else:
            self._device.emcy.clear(Emcy.SYNC_LENGTH)
        return not self._fault

    def _configure(self) -> None:
        objects = self._device.objects
        word = objects.number(key(COB_ID))
        self.can_id = word & cob_id.CAN_ID
        self._overflow = objects.number(key(OVERFLOW))
        self._length = 1 if self._overflow else 0
        self._window_ns = objects.number(key(WINDOW)) * US
        self.window_end_ns = FAR_NS
        self._period_ns = objects.number(key(PERIOD)) * US
        self._making = bool(word & COB_ID_NO_RTR)

    def _applied(self, _subindex: int, _value: Value, now_ns: int) -> None:
        self._configure()
        self._start(now_ns)
        self._device.pdos.counter_changed(now_ns)
        self._device.listen()

    def _start(self, now_ns: int) -> None:
        making = self._making and self._period_ns and Service.SYNC in SERVICES[self._device.nmt.state]
        self._due_ns = now_ns + self._period_ns if making else FAR_NS
        self._device.wake(self._due_ns)

    @property
    def counted(self) -> bool:
        """True if SYNC frames carry a counter (0x1019)."""
        return self._overflow > 0

    def _check_overflow(self, _subindex: int, value: Value) -> Abort | None:
        """Check a write to 0x1019: 0 or 2 … 240, and not while 0x1006 holds a period (CiA 301, 7.5.2.22)."""
        if value == 1 or int(value) > SYNC_MAX:
            return Abort.INVALID_VALUE
        return Abort.DEVICE_STATE if self._device.objects.number(key(PERIOD)) else None
