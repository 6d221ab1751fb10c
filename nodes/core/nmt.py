"""NMT slave (CiA 301, 7.2.8 and 7.3.2): states, commands, boot-up; error control by heartbeat or node guarding.

The state changes only by `eds.cia301.NMT_TRANSITIONS`, by a boot-up, or by 0x1029. The heartbeat producer keeps its
period without drift; the consumer starts at the first heartbeat of a node and reports each loss once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from eds.cia301 import HEARTBEAT_BASE, NMT_TRANSITIONS, Abort, Emcy, Frame, NmtCommand, NmtState, Service
from eds.cia305 import UNCONFIGURED
from eds.datatype import Value
from eds.dictionary import key
from nodes.core.parts import FAR_NS, MS, Handler, Part

if TYPE_CHECKING:
    from nodes.core.device import Device

_COMMANDS: Final = frozenset(int(command) for command in NmtCommand)

ERROR_BEHAVIOUR: Final = 0x102901
"""0x1029:01, the effect of a communication error on the NMT state (CiA 301, 7.5.2.32)."""

ON_ERROR: Final = {
    (NmtState.OPERATIONAL, 0): NmtState.PRE_OPERATIONAL,
    (NmtState.OPERATIONAL, 2): NmtState.STOPPED,
    (NmtState.PRE_OPERATIONAL, 2): NmtState.STOPPED,
}
"""(state, 0x1029:01) → state after a communication error; every other pair changes nothing."""


class Nmt:
    """One device's NMT slave."""

    __slots__ = ("_device", "state")

    def __init__(self, device: Device) -> None:
        self._device = device
        self.state = NmtState.INITIALISING

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey a command for this node or for all; anything else is not for us."""
        if len(data) != 2 or data[1] not in (0, self._device.node_id) or data[0] not in _COMMANDS:
            return
        command = NmtCommand(data[0])
        target = NMT_TRANSITIONS[self.state, command]
        if target is NmtState.INITIALISING:
            self.initialise(command is NmtCommand.RESET_NODE, now_ns)
        elif target is not self.state:
            self.enter(target, now_ns)

    def initialise(self, whole_node: bool, now_ns: int) -> None:
        """Restore power-on values (all, or 0x1000–0x1FFF), send the boot-up, enter PRE-OPERATIONAL.

        A node without a node id stays in INITIALISING, where only LSS reaches it (CiA 305).
        """
        device = self._device
        device.outbox.clear()  # a frame from before the reset must not follow the boot-up, which begins a new life
        self.enter(NmtState.INITIALISING, now_ns)
        device.restart(whole_node, now_ns)
        if device.node_id == UNCONFIGURED:
            return
        device.outbox.append(Frame(HEARTBEAT_BASE + device.node_id, b"\x00"))
        self.enter(NmtState.PRE_OPERATIONAL, now_ns)

    def enter(self, state: NmtState, now_ns: int) -> None:
        """Change the state and report it to every part that acts on it."""
        self.state = state
        self._device.state_entered(state, now_ns)

    def communication_error(self, now_ns: int) -> None:
        """Change to the state that 0x1029:01 selects after a lost heartbeat or a bus-off."""
        target = ON_ERROR.get((self.state, self._device.objects.number(ERROR_BEHAVIOUR)))
        if target is not None:
            self.enter(target, now_ns)


PRODUCER: Final = 0x1017
CONSUMER: Final = 0x1016


class HeartbeatProducer(Part):
    """Producer of the heartbeat: the NMT state every 0x1017 ms; a boot-up is the first heartbeat."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._due_ns = FAR_NS
        self.applied = {PRODUCER: self._configured}

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Start the heartbeat period at the boot-up."""
        if state is NmtState.INITIALISING:
            self._due_ns = FAR_NS
        elif self._due_ns == FAR_NS:
            self._restart(now_ns + self._period_ns())

    @property
    def due(self) -> tuple[int, int]:
        """Time of the next heartbeat, and the period, ns."""
        return self._due_ns, self._period_ns()

    def sent(self, due_ns: int) -> None:
        """Advance the period beyond the heartbeats up to `due_ns`, which a compiled cycle sent."""
        self._due_ns = due_ns

    def poll(self, now_ns: int) -> int:
        """Send the heartbeat if it is due."""
        if self._due_ns <= now_ns:
            device = self._device
            device.outbox.append(Frame(HEARTBEAT_BASE + device.node_id, bytes((device.nmt.state,))))
            late = (now_ns - self._due_ns) // self._period_ns()
            self._due_ns += (1 + late) * self._period_ns()
        return self._due_ns

    def _configured(self, _subindex: int, _value: Value, now_ns: int) -> None:
        self._restart(now_ns)
        self._device.listen()  # a device without a heartbeat may be guarded

    def _restart(self, first_ns: int) -> None:
        self._due_ns = first_ns if self._period_ns() else FAR_NS
        self._device.wake(self._due_ns)

    def _period_ns(self) -> int:
        return self._device.objects.number(key(PRODUCER)) * MS


class _MonitoredNode:
    """State of the consumer for one node in 0x1016."""

    __slots__ = ("_consumer", "due_ns", "lost", "node_id", "timeout_ns")

    def __init__(self, consumer: HeartbeatConsumer, node_id: int, timeout_ns: int) -> None:
        self._consumer = consumer
        self.node_id, self.timeout_ns = node_id, timeout_ns
        self.due_ns, self.lost = FAR_NS, False

    def receive(self, data: bytes, now_ns: int) -> None:
        if len(data) == 1:
            self.due_ns = now_ns + self.timeout_ns
            self._consumer.heard(self)


class HeartbeatConsumer(Part):
    """Consumer of the heartbeats that 0x1016 lists; a loss is EMCY 0x8130, then 0x1029 and the application."""

    service = Service.ERROR_CONTROL

    def __init__(self, device: Device) -> None:
        self._device = device
        self._watched: list[_MonitoredNode] = []
        self.checks = {CONSUMER: self._check}
        self.applied = {CONSUMER: lambda _sub, _value, _now: self._read()}

    def reset(self, now_ns: int) -> None:
        """Start anew with the entries of 0x1016; supervision of a node starts with its first heartbeat."""
        self._watched.clear()
        self._read()

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of each heartbeat in 0x1016."""
        for watched in self._watched:
            yield HEARTBEAT_BASE + watched.node_id, watched.receive

    def heard(self, watched: _MonitoredNode) -> None:
        """Process a received heartbeat: restart the consumer time, end a loss."""
        self._device.wake(watched.due_ns)
        if watched.lost:
            watched.lost = False
            self._device.emcy.clear(Emcy.HEARTBEAT, watched.node_id)

    def watches_only(self, node_id: int) -> bool:
        """Return whether nobody but this node is watched, and nobody is lost."""
        return all(watched.node_id == node_id and not watched.lost for watched in self._watched)

    @property
    def due(self) -> tuple[int, int]:
        """Time when the first watched node is overdue (`FAR_NS`: not awaited) and its timeout, ns; 0 for none."""
        return (self._watched[0].due_ns, self._watched[0].timeout_ns) if self._watched else (FAR_NS, 0)

    def watched_until(self, due_ns: int) -> None:
        """Set the time when the first watched node is overdue: a compiled cycle has received its heartbeats."""
        if self._watched:
            self._watched[0].due_ns = due_ns

    def all_live(self) -> bool:
        """Return whether every node that 0x1016 lists has been heard and is not overdue; true where it lists none."""
        return all(watched.due_ns != FAR_NS for watched in self._watched)

    def poll(self, now_ns: int) -> int:
        """Report the nodes whose heartbeat is overdue."""
        for watched in [w for w in self._watched if w.due_ns <= now_ns]:
            watched.due_ns, watched.lost = FAR_NS, True
            self._device.communication_lost(Emcy.HEARTBEAT, now_ns, watched.node_id)
        return min((watched.due_ns for watched in self._watched), default=FAR_NS)

    def _read(self) -> None:
        """Read 0x1016: unchanged entries stay monitored, changed ones restart."""
        before = {(w.node_id, w.timeout_ns): w for w in self._watched}
        wanted = [_entry(word) for word in self._words().values()]
        self._watched = [before.pop(w) if w in before else _MonitoredNode(self, *w) for w in wanted if _active(*w)]
        for gone in before.values():
            if gone.lost:
                self._device.emcy.clear(Emcy.HEARTBEAT, gone.node_id)
        self._device.listen()

    def _check(self, subindex: int, value: Value) -> Abort | None:
        """Refuse a second entry for a node that is already watched (CiA 301, 7.5.2.19)."""
        node_id, timeout_ns = _entry(int(value))
        others = [_entry(word) for sub, word in self._words().items() if sub != subindex]
        taken = any(_active(*other) and other[0] == node_id for other in others)
        return Abort.INCOMPATIBLE if taken and _active(node_id, timeout_ns) else None

    def _words(self) -> dict[int, int]:
        objects = self._device.objects
        return {sub: objects.number(at) for sub in range(1, 128) if (at := key(CONSUMER, sub)) in objects.entries}


def _entry(word: int) -> tuple[int, int]:
    """Split an entry of 0x1016 into node id and time in ns."""
    return word >> 16 & 0xFF, (word & 0xFFFF) * MS


def _active(node_id: int, timeout_ns: int) -> bool:
    return 1 <= node_id <= 127 and timeout_ns > 0


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
        self._live(now_ns)

    def poll(self, now_ns: int) -> int:
        """Report a master whose life time is over."""
        if self._due_ns <= now_ns:
            self._due_ns, self._lost = FAR_NS, True
            self._device.communication_lost(Emcy.HEARTBEAT, now_ns, 0)
        return self._due_ns

    def _configured(self, _subindex: int, _value: Value, now_ns: int) -> None:
        if self._due_ns != FAR_NS:
            self._live(now_ns)

    def _live(self, now_ns: int) -> None:
        """Start the life time, guard time × life time factor, anew; 0 means without limit (CiA 301, 7.5.2.11 f.)."""
        objects = self._device.objects
        life_ns = objects.number(key(GUARD_TIME)) * objects.number(key(LIFE_TIME_FACTOR)) * MS
        self._due_ns = now_ns + life_ns if life_ns else FAR_NS
        self._device.wake(self._due_ns)
