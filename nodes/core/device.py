"""A CANopen device, sans-IO: frames and times in, frames out.

This module joins the parts and implements no protocol itself. The NMT state determines which COB-IDs are received, so
a service that the state forbids cannot be reached.
"""

from collections import deque
from pathlib import Path

from eds.cia301 import NMT_COB_ID, SERVICES, Abort, Emcy, Frame, NmtState, Service
from eds.cia305 import UNCONFIGURED
from eds.datatype import Value
from eds.dictionary import Dictionary, read
from nodes.core.application import Application
from nodes.core.emergency import Emergency
from nodes.core.lss_slave import LssSlave
from nodes.core.nmt import Guarding, HeartbeatConsumer, HeartbeatProducer, Nmt
from nodes.core.objects import Objects, outside
from nodes.core.parts import FAR_NS, Applied, Check, Command, Handler, Part
from nodes.core.pdos import Pdos
from nodes.core.sdo_server import SdoServer
from nodes.core.store import Store
from nodes.core.sync import Sync
from parameters import InputError

__all__ = ["Application", "Device"]


class Device:
    """A CiA 301 device with an `Application` behind it; silent until `power_on`.

    `values` holds object values by key. `filters` holds the COB-IDs to receive now (a new object when they change).
    `outbox` has the frames to send, oldest first; `now_ns` is the time of the last call. Raises `InputError` for an
    unusable dictionary or node id.
    """

    def __init__(
        self, dictionary: Dictionary | Path, node_id: int, application: Application, *, store: Path | None = None
    ) -> None:
        if not (1 <= node_id <= 127 or node_id == UNCONFIGURED):
            raise InputError(f"node id {node_id} is outside 1 … 127 and not 255 (unconfigured); give each device its "
                             "own.")
        self.node_id = node_id
        self.objects = Objects(read(dictionary, node_id) if isinstance(dictionary, Path) else dictionary)
        self.values = self.objects.values
        self.outbox: deque[Frame] = deque()
        self.filters: frozenset[int] = frozenset()
        self.now_ns = 0
        self.application = application
        self.watched: frozenset[int] = frozenset()
        self.guarded = False
        self._handlers: dict[int, Handler] = {}
        self.wake_ns = FAR_NS
        self._join(store)
        application.attach(self)
        self.watched = frozenset(application.watched)
        kind, base = type(application), Application
        self.guarded = kind.check_write is not base.check_write
        self._refreshed = kind.refresh is not base.refresh
        self._polled = kind.poll is not base.poll or kind.next_ns is not base.next_ns

    def _join(self, store: Path | None) -> None:
        self.nmt = Nmt(self)
        self.emcy = Emergency(self)
        self.store = Store(self, store)
        self.sync = Sync(self)
        self.pdos = Pdos(self)
        self.consumer = HeartbeatConsumer(self)
        self.producer = HeartbeatProducer(self)
        self.guarding = Guarding(self)
        self.sdo = SdoServer(self)
        self.lss = LssSlave(self, store)
        self._parts: tuple[Part, ...] = (
            self.emcy, self.store, self.sync, self.pdos, self.consumer, self.producer, self.guarding, self.sdo,
            self.lss)
        self._checks: dict[int, Check] = {}
        self._applied: dict[int, Applied] = {}
        self._commands: dict[int, Command] = {}
        for part in self._parts:
            self._checks.update(part.checks)
            self._applied.update(part.applied)
            self._commands.update(part.commands)

    @property
    def state(self) -> NmtState:
        """The NMT state."""
        return self.nmt.state

    def power_on(self, now_ns: int) -> None:
        """Initialise from stored or default values, send the boot-up, enter PRE-OPERATIONAL."""
        self.now_ns = now_ns
        self.lss.load()
        self._renumber()
        self.store.load()
        self.nmt.initialise(True, now_ns)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Process a frame from the bus; a frame for another device, or one that the NMT state forbids, changes nothing.
        """
        self.now_ns = now_ns
        can_id, data, remote, extended, error, _dlc = frame
        if remote or extended or error:
            if remote and not extended and not error and can_id in self.filters:
                if can_id == self.guarding.cob_id:
                    self.guarding.requested(now_ns)
                else:
                    self.pdos.requested(can_id, now_ns)
            return
        handler = self._handlers.get(can_id)
        if handler is not None:
            handler(data, now_ns)

    def poll(self, now_ns: int) -> None:
        """Run all actions that are due: heartbeats, timers, deadlines, the application."""
        self.now_ns = now_ns
        if self._polled and self.state is not NmtState.INITIALISING:
            self.application.poll(now_ns)
            self.pdos.look(now_ns)
        if self.wake_ns <= now_ns:
            self.rearm(now_ns)

    def next_ns(self) -> int | None:
        """Return the time of the next action of `poll`; None for never."""
        due_ns = self.wake_ns
        if self._polled and self.state is not NmtState.INITIALISING:
            application_ns = self.application.next_ns()
            if application_ns is not None and application_ns < due_ns:
                return application_ns
        return due_ns if due_ns < FAR_NS else None

    def changed(self, now_ns: int) -> None:
        """Send event-driven TPDOs that are due after the application changed values outside `receive` and `poll`."""
        self.now_ns = now_ns
        self.pdos.look(now_ns)

    def rearm(self, now_ns: int) -> None:
        """Recompute the time of the next action over all parts of the device."""
        self.wake_ns = FAR_NS
        for part in self._parts if self.state is not NmtState.INITIALISING else (self.lss,):
            self.wake(part.poll(now_ns))

    def emergency(self, code: int, register: int, vendor: bytes = b"") -> None:
        """Report an error of the application: EMCY, 0x1001, 0x1003; once while it lasts."""
        self.emcy.set(code, register, vendor)

    def recover(self, code: int) -> None:
        """Report that an error is gone."""
        self.emcy.clear(code)

    def bus_off(self, now_ns: int) -> None:
        """Process bus-off of the CAN controller: the queue is discarded; 0x1029 and the application react."""
        self.now_ns = now_ns
        self.outbox.clear()  # inputs that wait for the bus to recover would be old ones of later SYNCs
        self.application.communication_lost(Emcy.BUS_OFF_RECOVERED, now_ns)
        self.nmt.communication_error(now_ns)

    def bus_recovered(self, now_ns: int) -> None:
        """Process the end of bus-off: EMCY 0x8140 (CiA 301, table 26)."""
        self.now_ns = now_ns
        self.emcy.set(Emcy.BUS_OFF_RECOVERED, Emcy.BUS_OFF_RECOVERED.register)
        self.emcy.clear(Emcy.BUS_OFF_RECOVERED)

    # ---- what the parts ask of their device ----

    def wake(self, due_ns: int) -> None:
        """Make `poll` run its parts at `due_ns` at the latest; too early is harmless."""
        if due_ns < self.wake_ns:
            self.wake_ns = due_ns

    def listen(self) -> None:
        """Rebuild the table of handlers from the NMT state and the COB-IDs in force."""
        allowed = SERVICES[self.state]
        self._handlers = {NMT_COB_ID: self.nmt.receive} if Service.NMT in allowed else {}
        for part in self._parts:
            if part.service in allowed:
                self._handlers.update(part.handlers())
        wanted = frozenset(self._handlers) | self.pdos.requestable()
        if Service.ERROR_CONTROL in allowed and (guarded := self.guarding.cob_id) is not None:
            wanted |= {guarded}
        if wanted != self.filters:
            self.filters = wanted

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Report a new NMT state to parts and application."""
        for part in self._parts:
            part.state_entered(state, now_ns)
        self.listen()
        self.application.nmt_changed(state, now_ns)
        self.pdos.look(now_ns)

    def restart(self, whole_node: bool, now_ns: int) -> None:
        """Set objects to their power-on values (all of them, or 0x1000–0x1FFF) and begin anew with them."""
        if whole_node:
            self.emcy.forget_all()
            self.lss.recall()
        self._renumber()
        self.store.restore(whole_node)
        for part in self._parts:
            part.reset(now_ns)
        if whole_node:
            self.application.reset(now_ns)

    def _renumber(self) -> None:
        """Activate the node id that LSS configured."""
        if self.lss.pending != self.node_id:
            self.objects.renumber(self.lss.pending - self.node_id)
            self.node_id = self.lss.pending
            self.store.renumber()

    def refresh(self, now_ns: int) -> None:
        """Let the application bring its process values up to date."""
        if self._refreshed:
            self.application.refresh(now_ns)

    def communication_lost(self, reason: Emcy, now_ns: int, source: int) -> None:
        """Report a lost heartbeat or RPDO; only the heartbeat acts on the NMT state (CiA 301, 7.5.2.32)."""
        self.emcy.set(reason, reason.register, bytes((source & 0xFF,)), source)
        self.application.communication_lost(reason, now_ns)
        if reason is Emcy.HEARTBEAT:
            self.nmt.communication_error(now_ns)

    def taken(self, key: int, can_id: int) -> bool:
        """Return whether a COB-ID object other than `key` already uses `can_id`."""
        return any(at != key and used == can_id for part in self._parts for at, used in part.cob_ids())

    def upload(self, key: int, now_ns: int) -> bytes | Abort:
        """Read an object as an SDO client does."""
        self.refresh(now_ns)
        return self.objects.upload(key)

    def download(self, key: int, data: bytes, now_ns: int) -> int:
        """Write an object as an SDO client does; return 0 or the abort code."""
        refusal = self.objects.may_download(key, len(data))
        if refusal:
            return refusal
        value = self.objects.decode(key, data)
        if isinstance(value, Abort):
            return value
        index, subindex = key >> 8, key & 0xFF
        command = self._commands.get(index)
        if command is not None:
            return command(subindex, value, now_ns) or 0
        check = self._checks.get(index)
        refusal = (check and check(subindex, value)) or outside(self.objects.entries[key], value)
        if refusal:
            return refusal
        if self.guarded and index > 0x1FFF and (code := self.application.check_write(key, value)):
            return code
        self._write(key, value, now_ns)
        return 0

    def _write(self, key: int, value: Value, now_ns: int) -> None:
        self.store.wrote(key, value)
        self.values[key] = value
        applied = self._applied.get(key >> 8)
        if applied is not None:
            applied(key & 0xFF, value, now_ns)
        if key in self.watched:
            self.application.written(key, value, now_ns)
        self.pdos.look(now_ns)
