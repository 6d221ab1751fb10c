"""One CANopen node by its id: objects, PDOs, errors, identity, NMT by heartbeat or guarding (CiA 301, 7.2.8.3.2).

A method answers with data; the words of a command line are the command's.
"""

import dataclasses
from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property
from typing import Final, NamedTuple

import can

from eds.cia301 import HEARTBEAT_BASE, ErrorRegister, NmtCommand, NmtState
from eds.cia402 import Mode, state_of
from eds.datatype import DataType, Value
from eds.dictionary import Dictionary, Entry, key
from eds.emcy_codes import emcy_text
from eds.scale_factors import UNIT_OBJECTS, units
from master.network.doctor import LISTEN_NS
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access import object_text, pdo_settings
from parameters import InputError

ANSWER_NS: Final = 100_000_000
"""Time for the answer to a remote frame: many times the turnaround of a slow node, less than a usual guard time."""
_STATE: Final = 0x7F


class GuardAnswer(NamedTuple):
    """Answer to one remote frame: NMT state byte, toggle bit (0 or 1)."""

    state: int
    toggle: int


def guard(link: Link, node_id: int, answer_ns: int = ANSWER_NS) -> GuardAnswer | None:
    """Ask a node's state by a remote frame; None without an answer in time. The answer counts as a heartbeat, too."""
    can_id = HEARTBEAT_BASE + node_id
    link.wait(0)
    if not link.try_send(can.Message(arbitration_id=can_id, is_remote_frame=True, dlc=1, is_extended_id=False)):
        return None
    deadline = link.clock() + answer_ns
    while (message := link.receive(deadline)) is not None:
        if message.arbitration_id == can_id and message.dlc:
            return GuardAnswer(message.data[0] & _STATE, message.data[0] >> 7)
    return None


class NodeGuard:
    """Guarding of one node: `poll` asks it every `period_ns`; `life` missed answers are a loss.

    `state` is the last state byte, None before the first answer; `lost` is True from a loss to the next answer.
    `asked` and `unanswered` count remote frames; `asked_ns` is the time of the last one.
    """

    def __init__(self, link: Link, node_id: int, period_ns: int, life: int = 3) -> None:
        self.link, self.node_id, self.period_ns, self.life = link, node_id, period_ns, life
        self.state: int | None = None
        self.lost = self.ever_lost = False
        self.asked = self.unanswered = self.asked_ns = 0
        self._missed = 0
        self._toggle: int | None = None
        self._due_ns = link.clock()

    def poll(self) -> str | None:
        """Wait for the next guard time and ask; return in words what is wrong or has changed, None where nothing."""
        if (wait_ns := self._due_ns - self.link.clock()) > 0:
            self.link.wait(wait_ns)
        self._due_ns += self.period_ns
        self.asked, self.asked_ns = self.asked + 1, self.link.clock()
        answer = guard(self.link, self.node_id, min(self.period_ns, ANSWER_NS))
        if answer is None:
            self._missed, self.unanswered = self._missed + 1, self.unanswered + 1
            if self._missed != self.life:
                return None
            self.lost, self._toggle = True, None
            return f"lost: {self.life} remote frames without an answer"
        repeated = answer.toggle == self._toggle
        changed, self.state = answer.state != self.state, answer.state
        self._toggle, self._missed, self.lost = answer.toggle, 0, False
        if repeated:
            return "the toggle bit did not change: the node booted, or another master guards it, too"
        return state_name(answer.state) if changed else None

    def events(self, seconds: float) -> Iterator[tuple[float, str]]:
        """Guard for so many seconds; yield the time since the beginning, s, and what is wrong or has changed."""
        began_ns = self.link.clock()
        while self.link.clock() - began_ns < seconds * 1e9:
            event = self.poll()
            self.ever_lost = self.ever_lost or self.lost
            if event is not None:
                yield (self.asked_ns - began_ns) / 1e9, event


MASTER: Final = 127
SENT_NS: Final = 10_000_000
"""Time reserved for a frame's transmission before its bus is closed."""
BOOT_NS: Final = 3_000_000_000
COMMANDS: Final = {
    "start": NmtCommand.START, "stop": NmtCommand.STOP, "preop": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset": NmtCommand.RESET_NODE, "reset-comm": NmtCommand.RESET_COMMUNICATION,
}
"""NMT commands by the words of the command line."""
_BOOTED: Final = frozenset({0, NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL})
_AFTER: Final[dict[str, frozenset[int]]] = {
    "start": frozenset({NmtState.OPERATIONAL}), "stop": frozenset({NmtState.STOPPED}),
    "preop": frozenset({NmtState.PRE_OPERATIONAL}), "reset": _BOOTED, "reset-comm": _BOOTED,
}
"""State bytes that a node may show after each NMT command; a device may start by itself after a reset (0x1F80)."""
_KNOWN: Final = {key(0x1000): DataType.UNSIGNED32, key(0x1001): DataType.UNSIGNED8,
                 key(0x1008): DataType.VISIBLE_STRING, key(0x1009): DataType.VISIBLE_STRING,
                 key(0x100A): DataType.VISIBLE_STRING, key(0x1017): DataType.UNSIGNED16,
                 key(0x6041): DataType.UNSIGNED16, key(0x6061): DataType.INTEGER8,
                 **{key(0x1018, sub): DataType.UNSIGNED32 for sub in range(1, 5)}}
"""Types of objects that every device has by its profile, for a node without an EDS."""
_PROFILES: Final = {301: "generic", 401: "I/O module", 402: "drive", 404: "measuring device",
                    405: "programmable device", 406: "encoder", 408: "hydraulic drive",
                    410: "inclinometer", 418: "battery", 419: "charger"}


class LiveObject(NamedTuple):
    """One object: raw value or `refusal`, and whether the value is not the EDS's default (None: no default)."""

    entry: Entry
    value: Value | str | None
    refusal: str
    changed: bool | None


class NodeError(NamedTuple):
    """One line of the error history 0x1003: the code in words, and the manufacturer's word."""

    code: int
    text: str
    more: int


class NodeAccess:
    """A node on a link; `dictionary` gives its objects names and types; without one (None) the caller gives both."""

    def __init__(self, link: Link, node_id: int, dictionary: Dictionary | None = None) -> None:
        if not 1 <= node_id <= 127:
            raise InputError(f"node id {node_id}: is outside 1 … 127; give the id of a node, or scan for it.")
        self.link, self.node_id, self.dictionary = link, node_id, dictionary

    # ---- objects ----

    def find(self, name: str) -> int:
        """Return index << 8 | sub-index of an object given by place or name."""
        return object_text.find(self.dictionary, name)

    def kind(self, at: int, given: str | None = None) -> DataType | None:
        """Return an object's data type: the given one, the EDS's, or that of CiA 301; None where it is not known."""
        if given is not None:
            return object_text.data_type(given)
        entry = self.dictionary.entries.get(at) if self.dictionary is not None else None
        return entry.data_type if entry is not None else _KNOWN.get(at)

    def name(self, at: int) -> str:
        """Return an object's name; empty without an EDS."""
        return "" if self.dictionary is None else object_text.full_name(self.dictionary, at)

    def label(self, at: int) -> str:
        """Return place and name of an object, such as "6041:00 Statusword"."""
        return " ".join(filter(None, (object_text.shown_key(at), self.name(at))))

    @cached_property
    def units(self) -> dict[int, tuple[float, str]]:
        """SI per raw count and unit by key, from the unit objects that the node holds now."""
        if self.dictionary is None:
            return {}
        entries = dict(self.dictionary.entries)
        for index, sub in UNIT_OBJECTS:
            entry = entries.get(key(index, sub))
            if entry is not None:
                with suppress(SdoError):
                    value = object_text.value_of(entry.data_type, self.link.sdo_read(self.node_id, index, sub))
                    if isinstance(value, int):
                        entries[entry.key] = dataclasses.replace(entry, value=value)
        return units(dataclasses.replace(self.dictionary, entries=entries))

    def read_bytes(self, at: int, *, block: bool = False) -> bytes:
        """Read an object's bytes, expedited or segmented, or by block transfer; raises `SdoError`."""
        return self.link.sdo_read(self.node_id, at >> 8, at & 0xFF, block=block)

    def value(self, at: int, kind: DataType | None, *, block: bool = False) -> Value | str | None:
        """Read an object of this type; None if the node refuses to be read."""
        try:
            return object_text.value_of(kind, self.read_bytes(at, block=block))
        except SdoError:
            return None

    def read(self, name: str, kind: str | None = None) -> Value | str:
        """Read an object: a number, text, or bytes where its type is not known; raises `SdoError`, `InputError`."""
        at = self.find(name)
        return object_text.value_of(self.kind(at, kind), self.read_bytes(at))

    def write_bytes(self, at: int, data: bytes, *, block: bool = False) -> None:
        """Write an object's bytes; raises `SdoError`."""
        self.link.sdo_write(self.node_id, at >> 8, at & 0xFF, data, block=block)

    def write(self, name: str, value: str | float | bytes, kind: str | None = None) -> None:
        """Write an object; raises `SdoError`, and `InputError` for a value that its type or limits exclude."""
        at = self.find(name)
        self.write_bytes(at, value if isinstance(value, bytes) else self.encoded(at, str(value), kind))

    def encoded(self, at: int, text: str, kind: str | None = None) -> bytes:
        """Return the bytes of a value; raises `InputError` for one that type, access or limits of the EDS exclude."""
        where = f"node {self.node_id}, {self.label(at)}"
        data = object_text.encoded(self.kind(at, kind), text, where)
        entry = self.dictionary.entries.get(at) if self.dictionary is not None else None
        if entry is not None and kind is None:
            if not entry.writable:
                raise InputError(f"{where}: the EDS has AccessType={entry.access}; write another object.")
            object_text.refuse_outside(entry, data, where)
        return data

    def objects(self) -> Iterator[LiveObject]:
        """Read every object of the EDS; raises `InputError` without one."""
        if self.dictionary is None:
            raise InputError(f"node {self.node_id}: without its EDS its objects are not known; give --eds FILE.")
        for entry in self.dictionary.entries.values():
            if not entry.readable:
                yield LiveObject(entry, None, "write-only", None)
                continue
            try:
                value = object_text.value_of(entry.data_type, self.read_bytes(entry.key))
            except SdoError as error:
                yield LiveObject(entry, None, str(error).rpartition(": ")[2], None)
                continue
            default = entry.default
            if isinstance(default, bytes) and isinstance(value, str):
                default = object_text.value_of(entry.data_type, default)  # type: ignore[assignment]
            yield LiveObject(entry, value, "", None if default is None else value != default)

    # ---- PDOs, errors, identity ----

    def pdos(self) -> list[pdo_settings.PdoState]:
        """Read the settings of all PDOs."""
        return list(pdo_settings.read_all(self.link, self.node_id, self.dictionary))

    def map_pdo(self, name: str, objects: str) -> pdo_settings.PdoState:
        """Map objects, such as `6041,6064`, into `tpdo1`; return the PDO as it is now."""
        return pdo_settings.configure(self.link, self.node_id, pdo_settings.index_of(name),
                                      pdo_settings.words(objects, self.dictionary))

    def number(self, index: int, sub: int = 0) -> int | None:
        """Read an unsigned number; None if the node lacks the object."""
        try:
            return int.from_bytes(self.link.sdo_read(self.node_id, index, sub), "little")
        except SdoError:
            return None

    def errors(self) -> tuple[list[str], list[NodeError]]:
        """Return the bits of 0x1001 in words, and the history 0x1003, newest first; raises `SdoError`."""
        register = self.link.sdo_read(self.node_id, 0x1001)[0]
        bits = [bit.name.lower() for bit in ErrorRegister if register & bit and bit.name]
        own = {} if self.dictionary is None else self.dictionary.emergencies
        profile = (self.number(0x1000) or 0) & 0xFFFF
        found = [self.number(0x1003, sub) or 0 for sub in range(1, (self.number(0x1003) or 0) + 1)]
        return bits, [NodeError(word & 0xFFFF, emcy_text(word & 0xFFFF, profile, own), word >> 16)
                      for word in found if word]

    def clear_errors(self) -> None:
        """Clear the history by writing 0 to 0x1003:00; raises `SdoError`."""
        self.link.sdo_write(self.node_id, 0x1003, 0, b"\0")

    def identity(self) -> dict[str, int]:
        """Read 0x1000 and 0x1018; raises `SdoError` without an answer."""
        found = {"device_type": int.from_bytes(self.link.sdo_read(self.node_id, 0x1000), "little")}
        for sub, name in enumerate(("vendor", "product", "revision", "serial"), 1):
            value = self.number(0x1018, sub)
            if value is None:
                break
            found[name] = value
        return found

    def info(self) -> dict[str, object]:
        """Return identity, profile, versions, NMT state and drive state; raises `SdoError` for a silent node."""
        told: dict[str, object] = dict(self.identity())
        profile = int(str(told["device_type"])) & 0xFFFF
        told["profile"] = f"CiA {profile} {_PROFILES.get(profile, '')}".strip() if profile else "no profile"
        for index, name in ((0x1008, "name"), (0x1009, "hardware"), (0x100A, "software")):
            with suppress(SdoError):
                told[name] = self.link.sdo_read(self.node_id, index).rstrip(b"\0").decode("latin-1")
        told["heartbeat_ms"] = self.number(0x1017)
        told["nmt_state"] = self.nmt_state()
        with suppress(SdoError):
            told["errors"] = self.errors()[0]
        if profile == 402:
            word, mode = self.number(0x6041), self.number(0x6061)
            state = None if word is None else state_of(word)
            told["drive_state"] = None if state is None else state.title
            told["mode"] = None if mode is None else next((one.name for one in Mode if one == mode), str(mode))
        told["eds"] = None if self.dictionary is None else self.dictionary.path
        return told

    # ---- NMT ----

    def nmt_state(self) -> str | None:
        """Return the NMT state by a heartbeat received before or within 1.2 s, else by node guarding; else None."""
        if self.node_id not in self.link.beats:
            for message in self.link.listen(LISTEN_NS):
                if message.arbitration_id == HEARTBEAT_BASE + self.node_id:
                    break
        if self.node_id not in self.link.beats:
            guard(self.link, self.node_id)
        beat = self.link.beats.get(self.node_id)
        return None if beat is None else state_name(beat.state)

    def nmt(self, command: str) -> str | None:
        """Command the node's NMT state and return the state that it shows; None where it shows none."""
        return nmt(self.link, self.node_id, command).states.get(self.node_id)


def state_name(state: int) -> str:
    """Return the name of an NMT state byte."""
    known = {int(one): one.name.replace("_", "-") for one in NmtState}
    return "booted" if state == 0 else known.get(state, f"state {state}")


class NmtAnswer(NamedTuple):
    """States that nodes showed after an NMT command, by node id; `obeyed` if each is one that the command leads to."""

    states: dict[int, str]
    obeyed: bool


def nmt(link: Link, node_id: int, command: str, shown_by: int | None = None) -> NmtAnswer:
    """Send an NMT command (`COMMANDS`) to a node, 0 for all, and return the states that heartbeats show afterwards.

    After a reset the boot-up is awaited for 3 s, after another command a heartbeat for 1.2 s; then a node without a
    heartbeat is asked by node guarding. A single node that shows no state has not obeyed. `shown_by` is the node id
    after the command, if LSS gave the node another one.
    """
    if command not in COMMANDS:
        raise InputError(f"nmt {command}: is no command; give one of {', '.join(COMMANDS)}.")
    wanted = _AFTER[command]
    asked = [node_id] if node_id else [one for one in link.beats if one != MASTER]
    for one in asked:
        link.beats.pop(one, None)
    link.nmt(COMMANDS[command], node_id)
    node_id = shown_by or node_id
    deadline = link.clock() + (BOOT_NS if command.startswith("reset") else LISTEN_NS)
    while not node_id or not _shows(link, node_id, wanted):
        if link.receive(deadline) is None:
            break
    if node_id and node_id not in link.beats:
        guard(link, node_id)
    shown = [node_id] if node_id else sorted(one for one in link.beats if one != MASTER)
    states = {one: state_name(link.beats[one].state) for one in shown if one in link.beats}
    return NmtAnswer(states, all(_shows(link, one, wanted) for one in shown))


def _shows(link: Link, node_id: int, wanted: frozenset[int]) -> bool:
    beat = link.beats.get(node_id)
    return beat is not None and beat.state in wanted
