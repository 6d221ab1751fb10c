"""One RPDO: length, deadline, SYNC window, take-over into the values (CiA 301, 7.2.2; parameters 7.5.2.35).

A frame's data are in the values of every mapped object before the application is informed of any of them; a value
outside its object's limits is dropped for that object.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from eds.cia301 import SYNC_MAX, Emcy
from eds.datatype import Value
from eds.dictionary import Entry, key
from eds.pdo_plan import PdoPlan
from nodes.core import cob_id
from nodes.core.objects import outside
from nodes.core.parts import FAR_NS, MS

if TYPE_CHECKING:
    from nodes.core.device import Device
    from nodes.core.pdo.pdos import Pdos


class RpdoReception(NamedTuple):
    """Reception of an RPDO: plan, with SYNC or at once, deadline (0: none), keys that act, (key, least, greatest)."""

    pdo: ReceivePdo
    plan: PdoPlan
    synchronous: bool
    deadline_ns: int
    watched: tuple[int, ...]
    bounds: tuple[tuple[int, float | None, float | None], ...]


class ReceivePdo:
    """RPDO `number` (from 1), compiled from 0x1400 + number − 1; `can_id` is 0 while it does not exist."""

    __slots__ = ("_asked", "_deadline_ns", "_device", "_fault", "_judged", "_keys", "_late", "_pdos", "_size",
                 "_synchronous", "_unpack", "_watched", "can_id", "data", "due_ns", "number",
                 "plan")

    def __init__(self, pdos: Pdos, device: Device, number: int) -> None:
        self._pdos, self._device, self.number = pdos, device, number
        self._fault: Emcy | None = None
        self._late = False
        self.stop()

    def compile(self, plan: PdoPlan) -> None:
        """Read the communication parameters again; monitoring begins with the next frame."""
        objects, index = self._device.objects, 0x13FF + self.number
        word = objects.number(key(index, 1), cob_id.INVALID)
        self.can_id = word & cob_id.CAN_ID if cob_id.exists(word) else 0
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
        elif now_ns <= self._device.sync.window_end_ns:
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
