"""Interfaces of the device towards the parts of its core, in pieces that a part combines.

Protocols only. A part names the pieces that it uses, so that its signature shows its dependencies; `device.Device`
has them all, and no part imports it.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from eds.cia301 import Abort, Emcy, Frame, NmtState
from eds.datatype import Value
from nodes.core.objects import Objects


class HasObjects(Protocol):
    """The object dictionary and its present values by key."""

    @property
    def objects(self) -> Objects: ...

    @property
    def values(self) -> dict[int, Value]: ...


class CanSend(Protocol):
    """The node id and the frames to send, oldest first."""

    @property
    def node_id(self) -> int: ...

    @property
    def outbox(self) -> deque[Frame]: ...


class CanWake(Protocol):
    """Timers: `poll` runs the parts at `due_ns` at the latest."""

    def wake(self, due_ns: int) -> None: ...


class CanListen(Protocol):
    """COB-IDs in force: rebuild the table of handlers, and ask whether an identifier is in use."""

    def listen(self) -> None: ...

    def taken(self, key: int, can_id: int) -> bool: ...


class NmtStateOf(Protocol):
    """Interface of the NMT part towards the other parts."""

    @property
    def state(self) -> NmtState: ...


class HasState(Protocol):
    """The device's NMT state."""

    @property
    def nmt(self) -> NmtStateOf: ...


class ErrorReports(Protocol):
    """EMCY: report an error once while it lasts, and that it is gone (of every source where none is named)."""

    def set(self, code: int, register: int, vendor: bytes = b"", source: int = 0) -> None: ...

    def clear(self, code: int, source: int | None = None) -> None: ...


class HasErrors(Protocol):
    """The device's error reports."""

    @property
    def emcy(self) -> ErrorReports: ...


class ReportsLoss(Protocol):
    """A lost heartbeat or RPDO: EMCY, the application, and for a heartbeat the NMT state by 0x1029."""

    def communication_lost(self, reason: Emcy, now_ns: int, source: int) -> None: ...


class SyncWindow(Protocol):
    """The SYNC part, as far as PDOs read it: whether SYNC counts, and when synchronous RPDOs cease to be taken."""

    @property
    def counted(self) -> bool: ...

    @property
    def window_end_ns(self) -> int: ...


class HasSync(Protocol):
    """The device's SYNC."""

    @property
    def sync(self) -> SyncWindow: ...


class SyncListener(Protocol):
    """Interface of the PDO part towards SYNC."""

    def synchronise(self, counter: int, now_ns: int) -> None: ...

    def counter_changed(self, now_ns: int) -> None: ...


class HasPdos(Protocol):
    """The device's PDOs."""

    @property
    def pdos(self) -> SyncListener: ...


class Profile(Protocol):
    """Interface of the application towards the core's parts (`application.Application`)."""

    @property
    def unstored(self) -> frozenset[int]: ...

    def check_write(self, key: int, value: Value) -> int: ...

    def written(self, key: int, value: Value, now_ns: int) -> None: ...

    def latch(self, now_ns: int) -> None: ...


class HasProfile(Protocol):
    """A device with an application whose process values `refresh` updates."""

    @property
    def application(self) -> Profile: ...

    def refresh(self, now_ns: int) -> None: ...


class HeartbeatWatch(Protocol):
    """Interface of the heartbeat consumer towards a profile."""

    def all_live(self) -> bool: ...


class ProfileHost(HasObjects, Protocol):
    """Interface of a device towards its profile."""

    now_ns: int

    @property
    def consumer(self) -> HeartbeatWatch: ...

    def emergency(self, code: int, register: int, vendor: bytes = b"") -> None: ...

    def recover(self, code: int) -> None: ...


class NmtHost(HasObjects, CanSend, Protocol):
    """Interface of the device towards its NMT part: restart the node, and report a new state."""

    def state_entered(self, state: NmtState, now_ns: int) -> None: ...

    def restart(self, whole_node: bool, now_ns: int) -> None: ...


class EmergencyHost(HasObjects, CanSend, CanWake, CanListen, HasState, Protocol):
    """Interface of the device towards its EMCY part."""

    @property
    def now_ns(self) -> int: ...


class HeartbeatHost(HasObjects, CanSend, CanWake, CanListen, HasState, HasErrors, ReportsLoss, Protocol):
    """Interface of the device towards heartbeat producer and consumer."""


class SyncHost(HasObjects, CanSend, CanWake, CanListen, HasState, HasErrors, HasPdos, Protocol):
    """Interface of the device towards its SYNC part."""


class StoreHost(HasObjects, CanSend, HasErrors, HasProfile, Protocol):
    """Interface of the device towards the storage of parameters."""


class NmtRestart(NmtStateOf, Protocol):
    """Interface of the NMT part towards LSS."""

    def initialise(self, whole_node: bool, now_ns: int) -> None: ...


class LssHost(HasObjects, CanSend, CanWake, Protocol):
    """Interface of the device towards its LSS slave."""

    @property
    def nmt(self) -> NmtRestart: ...


class SdoHost(HasObjects, CanSend, CanWake, Protocol):
    """Needs of the SDO server: read and write an object as a client does."""

    def upload(self, key: int, now_ns: int) -> bytes | Abort: ...

    def download(self, key: int, data: bytes, now_ns: int) -> int: ...


class PdoHost(HasObjects, CanSend, CanWake, CanListen, HasState, HasErrors, ReportsLoss, HasSync, HasProfile, Protocol):
    """Interface of the device towards its PDO part.

    `watched`: keys whose writes are reported to the application; `guarded`: keys whose writes it may refuse.
    """

    wake_ns: int

    @property
    def watched(self) -> frozenset[int]: ...

    @property
    def guarded(self) -> bool: ...
