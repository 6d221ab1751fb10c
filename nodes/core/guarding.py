"""Node and life guarding of a device (CiA 301, 7.2.8.3.2.1): 0x100C guard time, 0x100D life time factor.

A device with a heartbeat (0x1017 not 0), or without 0x100C in its dictionary, is not guarded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from eds.cia301 import HEARTBEAT_BASE, Emcy, Frame, NmtState, Service
from eds.datatype import Value
from eds.dictionary import key
from nodes.core.heartbeat import PRODUCER
from nodes.core.parts import FAR_NS, MS, Part

if TYPE_CHECKING:
    from nodes.core.device import Device

GUARD_TIME: Final = 0x100C
LIFE_TIME_FACTOR: Final = 0x100D


class Guarding(Part):
    """Node guarding: answers the master's remote frames with the NMT state; EMCY 0x8130 if the master stops asking."""

    service = Service.ERROR_CONTROL

    def __init__(self, device: Device) -> None:
        self._device = device
        self._toggle = 0
        self._due_ns = FAR_NS
        self._lost = False
        self.applied = {GUARD_TIME: self._configured, LIFE_TIME_FACTOR: self._configured}

    @property
    def cob_id(self) -> int | None:
        """Identifier of the remote frames that are answered; None if the device is not guarded."""
        objects = self._device.objects
        guarded = key(GUARD_TIME) in objects.entries and not objects.number(key(PRODUCER))
        return HEARTBEAT_BASE + self._device.node_id if guarded else None

    def reset(self, now_ns: int) -> None:
        """Restart: the first answer after a boot-up has the toggle bit 0, and the first question starts the life time.
        """
        self._toggle, self._due_ns, self._lost = 0, FAR_NS, False

    def requested(self, now_ns: int) -> None:
        """Answer a remote frame and restart the life time."""
        device = self._device
        device.outbox.append(Frame(HEARTBEAT_BASE + device.node_id, bytes((self._toggle | device.nmt.state,))))
        self._toggle ^= 0x80
        if self._lost:
            self._lost = False
            device.emcy.clear(Emcy.HEARTBEAT, 0)
        life_ns = self._life_ns()
        self._due_ns = now_ns + life_ns if life_ns else FAR_NS
        device.wake(self._due_ns)

    def poll(self, now_ns: int) -> int:
        """Report a master whose life time is over."""
        if self._due_ns <= now_ns:
            self._due_ns, self._lost = FAR_NS, True
            self._device.communication_lost(Emcy.HEARTBEAT, now_ns, 0)
        return self._due_ns

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Restart at the boot-up."""
        if state is NmtState.INITIALISING:
            self.reset(now_ns)

    def _configured(self, _subindex: int, _value: Value, now_ns: int) -> None:
        if self._due_ns != FAR_NS:
            life_ns = self._life_ns()
            self._due_ns = now_ns + life_ns if life_ns else FAR_NS
            self._device.wake(self._due_ns)

    def _life_ns(self) -> int:
        objects = self._device.objects
        return objects.number(key(GUARD_TIME)) * objects.number(key(LIFE_TIME_FACTOR)) * MS
