"""The master's one connection to the bus: one thread, and waiting is receiving.

The rule of this file: time passes only inside `bus.recv`; whoever waits for something pumps every other
service meanwhile (own heartbeat, heartbeats and emergencies of the nodes, SDO responses).
"""

import errno
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import can

from eds.cia301 import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    NmtCommand,
)
from master.network.bus_watch import BusWatch
from master.network.bus_watch import stamp_ns as stamp_ns
from master.network.controller_errors import ControllerErrors
from master.network.sdo import Sdo

NS = 1_000_000_000
NEVER = 1 << 62
SEND_RETRY_NS = 1_000_000
SEND_RETRIES = 20
_TRANSIENT = (errno.ENOBUFS, errno.EAGAIN)
FAILURES = (can.CanError, OSError)
"""Exceptions of python-can's interfaces when they, or their connection, fail."""
BUS_OFF = "the CAN controller is bus-off; check termination, wiring and bit rate, then restart it"
_NODE_MASK = 0x7F
WANTED = [{"can_id": 0, "can_mask": 0}]
"""Filters for the master's socket: everything. A bus without faults carries nothing beyond the master's needs, and
foreign frames must be seen: another master's commands, SDO writes, identifiers without an owner."""


class LinkError(Exception):
    """The bus itself failed (interface down or gone, queue full for good); the text names the failure."""


class EmcyMessage(NamedTuple):
    """One EMCY: error code and register as CiA 301 has them; a frame shorter than 3 bytes reads as 0x1000, 0x01."""

    time_ns: int
    node_id: int
    code: int
    register: int
    vendor: bytes


class Beat(NamedTuple):
    """Last sign of life of a node: its NMT state byte."""

    time_ns: int
    state: int


class Link:
    """The master on a python-can bus; `clock` gives ns on the scale of the bus's time stamps.

    `beats` holds every node's last heartbeat, `emergencies` the EMCYs that wait to be processed, `boots` the nodes
    that booted meanwhile. `controller` holds what error frames report, `rivals` the time stamps of another master's
    NMT. `returned`: the interface returns the master's own frames to it, as seen during bring-up. `watch`, if there is
    one, receives every frame that a running bench has no use for. `heartbeat_ms` None is for programs that only read:
    nodes would supervise a master after its first heartbeat. `pump(deadline_ns)` is the wait of an SDO: by receiving,
    or by control cycles once they run.
    """

    def __init__(
        self, bus: can.BusABC, clock: Callable[[], int], *, node_id: int = 127, heartbeat_ms: int | None = 100
    ) -> None:
        self.bus = bus
        self.clock = clock
        self.beats: dict[int, Beat] = {}
        self.emergencies: deque[EmcyMessage] = deque()
        self.boots: deque[int] = deque()
        self.rivals: deque[int] = deque()
        self.responses: dict[int, bytes] = {}
        self.pump: Callable[[int], object] = self.receive
        self.controller = ControllerErrors()
        self.send_failures = 0
        self.watch: BusWatch | None = None
        self.returned = False
        self._last_sent: tuple[int, bytes] | None = None
        self._heartbeat = can.Message(
            arbitration_id=HEARTBEAT_BASE + node_id, data=b"\x05", is_extended_id=False
        )
        self._heartbeat_ns = None if heartbeat_ms is None else heartbeat_ms * 1_000_000
        self._beat_due_ns = NEVER if heartbeat_ms is None else clock()
        self._sync: Any = None
        self._pace_ns = self._sync_due_ns = 0
        self._due_ns = self._beat_due_ns
        self._clients: dict[int, Sdo] = {}

    def receive(self, deadline_ns: int) -> can.Message | None:
        """Return the next data frame, or None at `deadline_ns`; a deadline in the past returns only a frame that
        waits.

        Raises `LinkError` when the interface is down or gone.
        """
        clock = self.clock
        while True:
            now = clock()
            if now >= self._due_ns and (paced := self._serve(now)) is not None:
                return paced
            until = min(deadline_ns, self._due_ns)
            try:
                message = self.bus.recv((until - now) / NS if until > now else 0.0)
            except FAILURES as error:
                raise LinkError(f"receiving failed: {error}") from error
            if message is None:
                if clock() >= deadline_ns:
                    return None
            elif message.is_error_frame:
                if self.controller.hear(message):
                    raise LinkError(BUS_OFF)
            else:
                if self.watch is not None:
                    self.watch.hear(message, self._pace_ns > 0)
                if not (message.is_extended_id or message.is_remote_frame):
                    if self.watch is None and self._last_sent is not None:
                        self._notice_return(message)
                    self._notice(message)
                    return message

    @property
    def heartbeat(self) -> tuple[int, int, int]:
        """This master's heartbeat: COB-ID, state byte, period in ns (`NEVER` for none)."""
        message, period_ns = self._heartbeat, self._heartbeat_ns
        return message.arbitration_id, message.data[0], NEVER if period_ns is None else period_ns

    @property
    def due_ns(self) -> int:
        """Time of the master's next heartbeat; 0 if the link itself must also send SYNC."""
        return self._beat_due_ns if not self._pace_ns else 0

    def heed(self, beats: Iterable[tuple[int, int, int]]) -> None:
        """Process heartbeats of compiled cycles: identifier, time, state; that of the master at its time of sending."""
        for can_id, time_ns, state in beats:
            if can_id == self._heartbeat.arbitration_id:
                self._beat_due_ns = self._due_ns = time_ns + (self._heartbeat_ns or NEVER)
            else:
                self.beats[can_id - HEARTBEAT_BASE] = Beat(time_ns, state & _NODE_MASK)

    def _serve(self, now_ns: int) -> can.Message | None:
        """Send due frames: the heartbeat, and SYNC if the master paces itself; that SYNC is returned as received."""
        paced = None
        if self._heartbeat_ns is not None and now_ns >= self._beat_due_ns:
            self._beat_due_ns = now_ns + self._heartbeat_ns
            self.try_send(self._heartbeat)
        if self._pace_ns and now_ns >= self._sync_due_ns:
            self._sync_due_ns += self._pace_ns * max(1, (now_ns - self._sync_due_ns) // self._pace_ns + 1)
            paced = can.Message(now_ns / NS, SYNC_COB_ID, is_extended_id=False)
            self.try_send(paced)
        self._due_ns = min(self._beat_due_ns, self._sync_due_ns) if self._pace_ns else self._beat_due_ns
        return paced

    def _notice(self, message: can.Message) -> None:
        can_id = message.arbitration_id
        if can_id > EMCY_BASE + _NODE_MASK and can_id < SDO_RESPONSE_BASE:
            return
        if can_id >= HEARTBEAT_BASE:
            if message.dlc and HEARTBEAT_BASE < can_id <= HEARTBEAT_BASE + _NODE_MASK:
                node, state = can_id - HEARTBEAT_BASE, message.data[0] & _NODE_MASK
                self.beats[node] = Beat(stamp_ns(message), state)
                if state == 0:
                    self.boots.append(node)
        elif can_id >= SDO_RESPONSE_BASE:
            self.responses[can_id] = bytes(message.data)
        elif can_id > SYNC_COB_ID:
            self._notice_emergency(message, can_id - EMCY_BASE)
        elif can_id == NMT_COB_ID and message.is_rx:
            self.rivals.append(stamp_ns(message))

    def _notice_emergency(self, message: can.Message, node: int) -> None:
        data = bytes(message.data)
        code, register = (int.from_bytes(data[:2], "little"), data[2]) if len(data) >= 3 else (0x1000, 0x01)
        self.emergencies.append(EmcyMessage(stamp_ns(message), node, code, register, data[3:]))

    def try_send(self, message: can.Message) -> bool:
        """Send once, without waiting; False (and counted) where the bus did not take it."""
        try:
            self.bus.send(message)
        except FAILURES:
            self.send_failures += 1
            return False
        return True

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame, waiting for a full queue by receiving; raises `LinkError` when the bus takes none."""
        if self.watch is not None:
            self.watch.sent(can_id, data)
        elif not self.returned:
            self._last_sent = can_id, bytes(data)
        message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        for _attempt in range(SEND_RETRIES):
            try:
                return self.bus.send(message)
            except FAILURES as error:
                failure = error
                if getattr(error, "error_code", None) not in (None, *_TRANSIENT):
                    break
                self.wait(SEND_RETRY_NS)
        raise LinkError(f"sending failed: {failure}") from failure

    def wait(self, duration_ns: int) -> None:
        """Process the bus for `duration_ns`; frames without a handler are discarded."""
        deadline = self.clock() + duration_ns
        while self.receive(deadline) is not None:
            pass

    def _notice_return(self, message: can.Message) -> None:
        """Detect during bring-up that the interface returns the master's own frames."""
        if message.is_rx and (message.arbitration_id, bytes(message.data)) == self._last_sent:
            self.returned, self._last_sent = True, None

    def listen(self, duration_ns: int) -> Iterator[can.Message]:
        """Return every data frame of the next `duration_ns`; nothing is sent, not even a heartbeat."""
        deadline = self.clock() + duration_ns
        if self._heartbeat_ns is not None:
            self._beat_due_ns = self._due_ns = NEVER  # on a busy bus the last look is after the deadline
        try:
            while (message := self.receive(deadline)) is not None:
                yield message
        finally:
            if self._heartbeat_ns is not None:
                self._beat_due_ns = self._due_ns = deadline

    def forget_response(self, can_id: int) -> None:
        """Discard an SDO response that arrived before its request."""
        self.responses.pop(can_id, None)

    def await_response(self, can_id: int, timeout_ns: int) -> bytes | None:
        """Return the data of an SDO response, or None after `timeout_ns`; `pump` continues the other services
        meanwhile."""
        deadline = self.clock() + timeout_ns
        while can_id not in self.responses:
            if self.clock() >= deadline:
                return None
            self.pump(deadline)
        return self.responses.pop(can_id)

    def await_state(self, node_id: int, state: int, timeout_ns: int) -> bool:
        """Return whether a heartbeat with `state` arrives from the node within `timeout_ns`."""
        deadline = self.clock() + timeout_ns
        since = self.clock()
        while True:
            beat = self.beats.get(node_id)
            if beat is not None and beat.time_ns >= since and beat.state == state:
                return True
            if self.receive(deadline) is None:
                return False

    def nmt(self, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command to one node (0: all)."""
        self.send(NMT_COB_ID, bytes((command, node_id)))

    def sync_start(self, period_ns: int) -> None:
        """Let the bus send SYNC every `period_ns` (the kernel's broadcast manager on SocketCAN).

        Raises `LinkError` when the interface is down or gone.
        """
        self.sync_stop()
        message = can.Message(arbitration_id=SYNC_COB_ID, is_extended_id=False)
        try:
            self._sync = self.bus.send_periodic(message, period_ns / NS)
        except FAILURES as error:
            raise LinkError(f"SYNC cannot be started: {error}") from error

    def sync_pace(self, period_ns: int) -> None:
        """Send SYNC from `receive` itself, for a bus that does not show its periodic messages to their sender."""
        self.sync_stop()
        self._pace_ns, self._sync_due_ns = period_ns, self.clock()
        self._due_ns = min(self._due_ns, self._sync_due_ns)

    def sync_stop(self) -> None:
        """Stop SYNC; harmless when none runs, or when it ended with its interface."""
        self._pace_ns = 0
        task, self._sync = self._sync, None
        if task is not None:
            with suppress(*FAILURES):
                task.stop()

    def sdo_read(self, node_id: int, index: int, subindex: int = 0, *, block: bool = False) -> bytes:
        """Upload an object, by block transfer if asked; raises `SdoError` with node, object and reason."""
        return self._client(node_id).read(index, subindex, block)

    def sdo_write(self, node_id: int, index: int, subindex: int, data: bytes, *, block: bool = False) -> None:
        """Download an object, by block transfer if asked; raises `SdoError` with node, object and reason."""
        self._client(node_id).write(index, subindex, data, block)

    def _client(self, node_id: int) -> Sdo:
        client = self._clients.get(node_id)
        if client is None:
            client = self._clients[node_id] = Sdo(self, node_id)
        return client
