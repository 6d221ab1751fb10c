"""PDOs of a device (CiA 301, 7.2.2): reception, transmission, and their order at a SYNC.

At a SYNC the inputs are latched and the TPDOs packed before any RPDO is taken over; nothing moves outside OPERATIONAL.
A frame's data are in the values of every mapped object before the application is informed of any of them; a value
outside its object's limits is dropped for that object.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from eds.cia301 import COB_ID_NO_RTR, SYNC_MAX, Emcy, Frame, NmtState, Service
from eds.datatype import Value
from eds.dictionary import Entry, key
from eds.pdo_plan import PdoPlan, compile_plan
from nodes.core import cob_id
from nodes.core.objects import outside
from nodes.core.parts import FAR_NS, MS, US, Applied, Handler, Part
from nodes.core.pdo_parameters import mapping_refused, mapping_words, packer, rule

if TYPE_CHECKING:
    from nodes.core.device import Device

RECEIVE, TRANSMIT = range(0x1400, 0x1600), range(0x1800, 0x1A00)
"""Indices of the communication parameters of RPDOs and TPDOs; the mapping parameter of each is `MAPPING` further on
(CiA 301, 7.5.2.35 to 7.5.2.38)."""
MAPPING: Final = 0x200


class RpdoReception(NamedTuple):
    """Reception of an RPDO: plan, with SYNC or at once, deadline (0: none), keys that act, (key, least, greatest)."""

    pdo: ReceivePdo
    plan: PdoPlan
    synchronous: bool
    deadline_ns: int
    watched: tuple[int, ...]
    bounds: tuple[tuple[int, float | None, float | None], ...]


class ReceivePdo:
    """RPDO of the communication parameter `index` (0x1400 …); `can_id` is 0 while it does not exist."""

    __slots__ = ("_asked", "_deadline_ns", "_device", "_fault", "_judged", "_keys", "_late", "_pdos", "_size",
                 "_synchronous", "_unpack", "_watched", "can_id", "data", "due_ns", "index", "number", "plan")

    def __init__(self, pdos: Pdos, device: Device, index: int) -> None:
        self._pdos, self._device, self.index = pdos, device, index
        self.number = index - RECEIVE.start + 1
        self._fault: Emcy | None = None
        self._late = False
        self.stop()

    def compile(self, plan: PdoPlan) -> None:
        """Read the communication parameters again; monitoring begins with the next frame."""
        objects, index = self._device.objects, self.index
        self.can_id = cob_id.in_use(objects, key(index, 1))
        self._synchronous = objects.number(key(index, 2)) <= SYNC_MAX
        self._deadline_ns = objects.number(key(index, 5)) * MS
        self.plan = plan
        self._size, self._keys, self._unpack = plan.size, plan.keys, plan.unpack
        self._watched = tuple(at for at in plan.keys if at in self._device.watched)
        self._asked = frozenset(self._watched) if self._device.guarded else frozenset()
        entries = [(place, objects.entries[at]) for place, at in enumerate(plan.keys)]
        self._judged = tuple((entry.key, place, entry if _limited(entry) else None) for place, entry in entries
                             if _limited(entry) or entry.key in self._asked)
        self.stop()
        self._mended()
        self._in_time()

    def stop(self) -> None:
        """Drop received data and pending deadlines."""
        self.due_ns = FAR_NS
        self.data: bytes | None = None

    def receive(self, data: bytes, now_ns: int) -> None:
        """Receive a frame; an event-driven RPDO is applied at once, a synchronous one at the next SYNC."""
        if len(data) != self._size:
            if not self._usable(data):
                return
        elif self._fault is not None:
            self._mended()
        if self._late:
            self._in_time()
        if self._deadline_ns:
            self.due_ns = now_ns + self._deadline_ns
            if self.due_ns < self._device.wake_ns:
                self._device.wake_ns = self.due_ns
        if not self._synchronous:
            self.take(data, now_ns)
            self._pdos.look(now_ns)
        elif now_ns <= self._device.sync.window_end_ns:  # later ones would act a whole cycle late (0x1007)
            if self.data is None:
                self._pdos.arrived.append(self)
            self.data = data

    def take(self, data: bytes, now_ns: int) -> None:
        """Write the mapped objects, then inform the application of those it watches."""
        keys: tuple[int, ...] = self._keys
        raw: Sequence[Value] = self._unpack(data)
        # a field outside its limits keeps its object, the others apply: there is no EMCY for it (decision 11)
        for at, place, bounds in self._judged:
            if self._refused(at, raw[place], bounds):
                keys, raw = self._without_refused(raw)
                break
        # all values first: a controlword that acts beside the last cycle's target would move the axis there
        self._device.values.update(zip(keys, raw))  # noqa: B905 - a plan unpacks as many values as it has keys
        for at in self._watched:
            if keys is self._keys or at in keys:
                self._device.application.written(at, self._device.values[at], now_ns)

    def deadline(self, now_ns: int) -> None:
        """Report that no frame arrived before the deadline."""
        self.due_ns, self._late = FAR_NS, True
        self._device.communication_lost(Emcy.RPDO_TIMEOUT, now_ns, self.number)

    def steady(self) -> RpdoReception | None:
        """Return how a compiled cycle handles a frame; None after an error or before the first frame."""
        if self._fault is not None or self._late or (self._deadline_ns and self.due_ns == FAR_NS):
            return None
        bounds = tuple((at, entry.low, entry.high) for at, _, entry in self._judged if entry is not None)
        return RpdoReception(self, self.plan, self._synchronous, self._deadline_ns, self._watched, bounds)

    def taken(self, data: bytes | None, due_ns: int) -> None:
        """Take over the frames of compiled cycles: the last one's data, None for no frame, and the present deadline."""
        if data is not None:
            self._device.values.update(zip(self._keys, self._unpack(data)))  # noqa: B905 - as in `take`
        self.due_ns = due_ns
        if due_ns < self._device.wake_ns:
            self._device.wake_ns = due_ns

    def _refused(self, at: int, value: Value, bounds: Entry | None) -> bool:
        if bounds is not None and outside(bounds, value):
            return True
        return at in self._asked and bool(self._device.application.check_write(at, value))

    def _without_refused(self, raw: Sequence[Value]) -> tuple[tuple[int, ...], Sequence[Value]]:
        refused = {place for at, place, bounds in self._judged if self._refused(at, raw[place], bounds)}
        places = [place for place in range(len(raw)) if place not in refused]
        return tuple(self._keys[place] for place in places), [raw[place] for place in places]

    def _usable(self, data: bytes) -> bool:
        """Report a wrong length; a frame that is too long is used as far as it is mapped."""
        fault = Emcy.PDO_TOO_SHORT if len(data) < self._size else Emcy.PDO_TOO_LONG
        if self._fault is not fault:
            self._mended()
            self._fault = fault
            self._device.emcy.set(fault, fault.register, bytes((self.number & 0xFF,)), self.number)
        return fault is Emcy.PDO_TOO_LONG

    def _mended(self) -> None:
        if self._fault is not None:
            self._device.emcy.clear(self._fault, self.number)
            self._fault = None

    def _in_time(self) -> None:
        if self._late:
            self._late = False
            self._device.emcy.clear(Emcy.RPDO_TIMEOUT, self.number)


def _limited(entry: Entry) -> bool:
    """Return whether the entry's limits are narrower than its type."""
    kind = entry.data_type
    low, high = entry.low, entry.high
    if kind.real:
        return low is not None or high is not None
    return (low is not None and low > kind.low) or (high is not None and high < kind.high)


class TransmitPdo:
    """TPDO of the communication parameter `index` (0x1800 …); `can_id` is 0 while it does not exist."""

    __slots__ = ("_device", "_event_ns", "_inhibit_ns", "_last", "_requested", "_timer_due_ns", "can_id", "every",
                 "free_ns", "index", "left", "payload", "plan", "requestable", "start")

    def __init__(self, device: Device, index: int) -> None:
        self._device, self.index = device, index
        self.free_ns = 0
        self.stop()

    def compile(self, plan: PdoPlan) -> None:
        """Read the communication parameters again."""
        objects, index = self._device.objects, self.index
        self.can_id = cob_id.in_use(objects, key(index, 1))
        self.requestable = bool(self.can_id) and not objects.number(key(index, 1)) & COB_ID_NO_RTR
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
        self._receive = [ReceivePdo(self, device, index) for index in RECEIVE if index in indices]
        self._transmit = [TransmitPdo(device, index) for index in TRANSMIT if index in indices]
        self._pdos: tuple[ReceivePdo | TransmitPdo, ...] = (*self._receive, *self._transmit)
        self.arrived: list[ReceivePdo] = []
        self._cyclic: tuple[TransmitPdo, ...] = ()
        self._waiting: tuple[TransmitPdo, ...] = ()
        self._acyclic: tuple[TransmitPdo, ...] = ()
        self._running = False
        self._on_event: tuple[TransmitPdo, ...] = ()
        owned = {pdo.index + part: pdo for pdo in self._pdos for part in (0, MAPPING)}
        self.checks = {index: rule(device, index) for index in owned}
        self.applied = {index: self._recompile(pdo) for index, pdo in owned.items()}
        self.reset(0)

    def reset(self, now_ns: int) -> None:
        """Compile every PDO from its objects; one whose mapping is unusable does not exist."""
        for pdo in self._pdos:
            self._compile(pdo)

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Start all PDOs on entering OPERATIONAL, stop them on leaving it."""
        self.arrived.clear()
        for receive in self._receive:
            receive.stop()
        for transmit in self._transmit:
            transmit.begin(self._device.sync.counted)
        self._sort(now_ns)

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of the valid RPDOs."""
        for pdo in self._receive:
            if pdo.can_id:
                yield pdo.can_id, pdo.receive

    def cob_ids(self) -> Iterator[tuple[int, int]]:
        """Yield the COB-IDs in use with their objects."""
        for pdo in self._pdos:
            yield key(pdo.index, 1), pdo.can_id

    def requestable(self) -> frozenset[int]:
        """Return the TPDO identifiers whose remote frames are answered now."""
        if self._device.nmt.state is not NmtState.OPERATIONAL:
            return frozenset()
        return frozenset(pdo.can_id for pdo in self._transmit if pdo.requestable)

    def requested(self, can_id: int, now_ns: int) -> None:
        """Answer a remote frame with the TPDO of that COB-ID."""
        for pdo in self._transmit:
            if pdo.requestable and pdo.can_id == can_id:
                self._device.refresh(now_ns)
                pdo.send(now_ns)

    def synchronise(self, counter: int, now_ns: int) -> None:
        """Process a SYNC: latch the inputs, send the TPDOs, apply the RPDOs."""
        if not self._running:
            return
        device = self._device
        # latched and sent before targets apply: inputs of all nodes are those of one instant, the SYNC's
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
        for receive in self._receive:
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
        return SteadyPdos(self._cyclic, {pdo.can_id: pdo for pdo in self._receive if pdo.can_id})

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
        active = [pdo for pdo in self._transmit if self._running and pdo.can_id]
        self._acyclic = tuple(pdo for pdo in active if pdo.every == 0)
        self._on_event = tuple(pdo for pdo in active if pdo.event_driven)
        cyclic = [pdo for pdo in active if pdo.every and not pdo.event_driven]
        self._cyclic = tuple(pdo for pdo in cyclic if pdo.left)
        self._waiting = tuple(pdo for pdo in cyclic if not pdo.left)
        self._device.wake(now_ns)

    def _recompile(self, pdo: ReceivePdo | TransmitPdo) -> Applied:
        def applied(_subindex: int, _value: Value, now_ns: int) -> None:
            self._compile(pdo)
            if isinstance(pdo, TransmitPdo):
                pdo.begin(self._device.sync.counted)
            self._sort(now_ns)
            self._device.listen()
        return applied

    def _compile(self, pdo: ReceivePdo | TransmitPdo) -> None:
        objects = self._device.objects
        words = mapping_words(objects, pdo.index + MAPPING)
        if mapping_refused(objects, words, isinstance(pdo, ReceivePdo)):
            words = ()
            at = key(pdo.index, 1)
            self._device.values[at] = objects.number(at) | cob_id.INVALID
        pdo.compile(compile_plan(objects.dictionary, words, 0))
