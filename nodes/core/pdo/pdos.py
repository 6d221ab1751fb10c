"""All PDOs of a device: their parameters' rules, SYNC order, and which of them are active.

The rule of this file: at a SYNC the inputs are latched and the TPDOs packed before any RPDO is taken over; nothing
moves outside OPERATIONAL.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from eds.cia301 import Frame, NmtState, Service
from eds.datatype import Value
from eds.dictionary import key
from eds.pdo_plan import compile_plan
from nodes.core import cob_id
from nodes.core.parts import FAR_NS, Applied, Handler, Part
from nodes.core.pdo import pdo_parameters
from nodes.core.pdo.pdo_mapping import mapping_refused
from nodes.core.pdo.receive_pdo import ReceivePdo
from nodes.core.pdo.transmit_pdo import TransmitPdo

if TYPE_CHECKING:
    from nodes.core.device import Device

_frame: Final = tuple.__new__
"""Makes a Frame without the cost of its constructor, in the cyclic path only."""


class SteadyPdos(NamedTuple):
    """PDOs of a compiled cycle: the TPDOs in their order, each sent at every SYNC, and the RPDOs by identifier."""

    transmit: tuple[TransmitPdo, ...]
    receive: dict[int, ReceivePdo]


class Pdos(Part):
    """The PDOs of one device; the tuples of active ones are rebuilt when a parameter or the NMT state changes."""

    service = Service.PDO

    def __init__(self, device: Device) -> None:
        self._device = device
        indices = {at >> 8 for at in device.objects.entries}
        self._receive = {n: ReceivePdo(self, device, n) for n in range(1, 513) if 0x13FF + n in indices}
        self._transmit = {n: TransmitPdo(device, n) for n in range(1, 513) if 0x17FF + n in indices}
        self.arrived: list[ReceivePdo] = []
        self._cyclic: tuple[TransmitPdo, ...] = ()
        self._waiting: tuple[TransmitPdo, ...] = ()
        self._acyclic: tuple[TransmitPdo, ...] = ()
        self._running = False
        self._on_event: tuple[TransmitPdo, ...] = ()
        rules = pdo_parameters.Rules(device)
        owned = [base + n for base, group in ((0x13FF, self._receive), (0x15FF, self._receive),
                                              (0x17FF, self._transmit), (0x19FF, self._transmit)) for n in group]
        self.checks = {index: rules.check(index) for index in owned}
        self.applied = {index: self._recompile(index) for index in owned}
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        """Compile every PDO from its objects; one whose mapping is unusable does not exist."""
        for number in self._receive:
            self._compile(0x13FF + number)
        for number in self._transmit:
            self._compile(0x17FF + number)

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Start all PDOs on entering OPERATIONAL, stop them on leaving it."""
        self.arrived.clear()
        for receive in self._receive.values():
            receive.stop()
        for transmit in self._transmit.values():
            transmit.begin(self._device.sync.counted)
        self._sort(now_ns)

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of the valid RPDOs."""
        for pdo in self._receive.values():
            if pdo.can_id:
                yield pdo.can_id, pdo.receive

    def cob_ids(self) -> Iterator[tuple[int, int]]:
        """Yield the COB-IDs in use with their objects."""
        for number, receive in self._receive.items():
            yield key(0x13FF + number, 1), receive.can_id
        for number, transmit in self._transmit.items():
            yield key(0x17FF + number, 1), transmit.can_id

    def requestable(self) -> frozenset[int]:
        """Return the TPDO identifiers whose remote frames are answered now."""
        if self._device.nmt.state is not NmtState.OPERATIONAL:
            return frozenset()
        return frozenset(pdo.can_id for pdo in self._transmit.values() if pdo.requestable)

    def requested(self, can_id: int, now_ns: int) -> None:
        """Answer a remote frame with the TPDO of that COB-ID."""
        for pdo in self._transmit.values():
            if pdo.requestable and pdo.can_id == can_id:
                self._device.refresh(now_ns)
                pdo.send(now_ns)

    def synchronise(self, counter: int, now_ns: int) -> None:
        """Process a SYNC: latch the inputs, send the TPDOs, apply the RPDOs."""
        if not self._running:
            return
        device = self._device
        device.application.latch(now_ns)
        if self._waiting:
            self._start_counting(counter)
        for pdo in self._cyclic:
            if pdo.left > 1:
                pdo.left -= 1
            else:
                pdo.left = pdo.every
                device.outbox.append(_frame(Frame, (pdo.can_id, pdo.payload(device.values), False, False, False, None)))
        for pdo in self._acyclic:
            pdo.send_if_changed(now_ns)
        if self.arrived:
            self._take_over(now_ns)
        if self._on_event:
            self.look(now_ns)

    def _take_over(self, now_ns: int) -> None:
        """Take the RPDOs that arrived since the last SYNC, in the order of their first arrival."""
        arrived, self.arrived = self.arrived, []
        for pdo in arrived:
            data, pdo.data = pdo.data, None
            if data is not None:
                pdo.take(data, now_ns)

    def look(self, now_ns: int) -> None:
        """Check the event-driven TPDOs for changed content."""
        for pdo in self._on_event:
            pdo.look(now_ns)

    def counter_changed(self, now_ns: int) -> None:
        """Restart the SYNC counter after a write to 0x1019 or another SYNC object."""
        self.state_entered(self._device.nmt.state, now_ns)

    def poll(self, now_ns: int) -> int:
        """Report missed RPDO deadlines; send the TPDOs whose timers are due."""
        due_ns = FAR_NS
        for receive in self._receive.values():
            if receive.due_ns <= now_ns:
                receive.deadline(now_ns)
            due_ns = min(due_ns, receive.due_ns)
        for pdo in self._on_event:
            due_ns = min(due_ns, pdo.poll(now_ns))
        return due_ns

    def steady(self) -> SteadyPdos | None:
        """Return the actions of every SYNC; None while any PDO waits, counts, or is event-driven."""
        if not self._running or self._waiting or self._acyclic or self._on_event or self.arrived:
            return None
        if any(pdo.every != 1 or pdo.left > 1 for pdo in self._cyclic):
            return None
        return SteadyPdos(self._cyclic, {pdo.can_id: pdo for pdo in self._receive.values() if pdo.can_id})

    def _start_counting(self, counter: int) -> None:
        """Start the TPDOs whose SYNC start value equals this counter value."""
        ready = tuple(pdo for pdo in self._waiting if pdo.start == counter)
        for pdo in ready:
            pdo.left = 1
        self._waiting = tuple(pdo for pdo in self._waiting if pdo not in ready)
        self._cyclic = (*self._cyclic, *ready)

    def _sort(self, now_ns: int) -> None:
        """Rebuild the tuples of PDOs that every SYNC iterates over."""
        self._running = self._device.nmt.state is NmtState.OPERATIONAL
        active = [pdo for pdo in self._transmit.values() if self._running and pdo.can_id]
        self._acyclic = tuple(pdo for pdo in active if pdo.every == 0)
        self._on_event = tuple(pdo for pdo in active if pdo.event_driven)
        cyclic = [pdo for pdo in active if pdo.every and not pdo.event_driven]
        self._cyclic = tuple(pdo for pdo in cyclic if pdo.left)
        self._waiting = tuple(pdo for pdo in cyclic if not pdo.left)
        self._device.wake(now_ns)

    def _recompile(self, index: int) -> Applied:
        def applied(_subindex: int, _value: Value, now_ns: int) -> None:
            pdo = self._compile(index if index & 0x200 == 0 else index - 0x200)
            if isinstance(pdo, TransmitPdo):
                pdo.begin(self._device.sync.counted)
            self._sort(now_ns)
            self._device.listen()
        return applied

    def _compile(self, index: int) -> ReceivePdo | TransmitPdo:
        receive = index < 0x1800
        number = index - (0x13FF if receive else 0x17FF)
        objects = self._device.objects
        words = pdo_parameters.words(objects, index + 0x200)
        if mapping_refused(objects, words, receive):
            words = ()
            at = key(index, 1)
            self._device.values[at] = objects.number(at) | cob_id.INVALID
        pdo = self._receive[number] if receive else self._transmit[number]
        pdo.compile(compile_plan(objects.dictionary, words, 0))
        return pdo
