"""From whatever the nodes are doing to OPERATIONAL, configured, identified; never an enabled drive.

The rule of this file: a node that is not as expected is refused by name and reason before any drive may be
enabled, and a drive that is found enabled loses its torque first.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, Protocol

from eds.bench.bench_network import MASTER, NodeEntry, WireLayout
from eds.cia301 import SYNC_COB_ID, NmtCommand, NmtState
from eds.datatype import decode, encode
from eds.dictionary import key
from master.network.drive_limits import DriveLimit
from master.network.link import Link
from master.network.sdo import SdoError
from parameters import InputError

LISTEN_NS = 250_000_000
BOOT_NS = 3_000_000_000
START_NS = 1_000_000_000
_IDENTITY = {1: "vendor-ID", 2: "product code", 3: "revision number"}
_VERIFY_OBJECT = 0x1020
_CONFIGURED = {1: "configuration date", 2: "configuration time"}
_DEVICE_TYPE, _IDENTITY_OBJECT, _CONTROLWORD = 0x1000, 0x1018, 0x6040


_NO_LIMITS: Final[Mapping[int, Sequence[DriveLimit]]] = MappingProxyType({})


class BringUpError(Exception):
    """The bench cannot be brought up; the text names the node and the reason."""


class RivalError(BringUpError):
    """Another master runs this bench: nothing may be sent on its bus."""


class BringUpLog(Protocol):
    """Interface of `master.cycle.log.Log` that a bring-up uses."""

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Record an event at `time_ns` on the bus's clock."""

    def drain(self) -> None:
        """Record the frames that wait at the monitor socket."""


def bring_up(
    link: Link, wire: WireLayout, log: BringUpLog, limits: Mapping[int, Sequence[DriveLimit]] = _NO_LIMITS,
) -> dict[int, int]:
    """Bring every node of `wire` to OPERATIONAL with its set-up written; returns their serial numbers.

    `limits` are those that each drive is to hold itself, by node id: written, and read back.  Drives come out with
    their power stage off.  Raises `BringUpError` with the node's name and the reason.
    """
    refuse_rival(link)
    entries = [wire.nodes[node] for node in sorted(wire.nodes)]
    link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
    serials = {}
    for entry in entries:
        _await_node(link, entry)
        _disarm(link, entry, wire.drives)
        serials[entry.node_id] = identify(link, entry)
        log.event(link.clock(), "nmt", entry.name, f"identified, serial number {serials[entry.node_id]}.")
        log.drain()
    for entry in entries:
        _configure(link, wire, entry)
        for limit in limits.get(entry.node_id, ()):
            _limit(link, entry, limit)
        log.event(link.clock(), "nmt", entry.name, "configured.")
        log.drain()
    for entry in entries:
        _start(link, entry)
        log.event(link.clock(), "nmt", entry.name, "OPERATIONAL.")
    link.boots.clear()
    return serials


def leave(link: Link) -> None:
    """Return every node to PRE-OPERATIONAL: PDOs stop, SDO stays."""
    link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 0)


def refuse_rival(link: Link) -> None:
    """Listen for longer than two of a master's heartbeats before the first frame; raises `RivalError`."""
    link.rivals.clear()
    link.beats.pop(MASTER, None)
    heard = {message.arbitration_id for message in link.listen(LISTEN_NS)}
    if link.rivals or MASTER in link.beats:
        raise RivalError(f"another master (node {MASTER}) is on the bus; stop it first.")
    if SYNC_COB_ID in heard:
        raise RivalError("somebody sends SYNC already: another master, or what an aborted run left; stop it first.")


def _await_node(link: Link, entry: NodeEntry) -> None:
    """Wait for a node that boots late, sending it to PRE-OPERATIONAL as often as it needs."""
    deadline = link.clock() + BOOT_NS
    while True:
        try:
            link.sdo_read(entry.node_id, _DEVICE_TYPE)
            return
        except SdoError as error:
            if link.clock() >= deadline:
                raise BringUpError(f"{entry.name} (node {entry.node_id}) does not answer: {error}; "
                              "check its supply, its node id and the bit rate.") from None
            link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, entry.node_id)


def _disarm(link: Link, entry: NodeEntry, drives: Sequence[int]) -> None:
    """Take the voltage off a drive that a run before this one may have left enabled."""
    if entry.node_id in drives:
        try:
            link.sdo_write(entry.node_id, _CONTROLWORD, 0, b"\x00\x00")
        except SdoError as error:
            raise BringUpError(f"{entry.name}: its voltage cannot be disabled ({error}).") from None


def identify(link: Link, entry: NodeEntry) -> int:
    """Compare device type and identity with the EDS; returns the serial number."""
    expected = entry.dictionary.initial(_DEVICE_TYPE)
    found = _read(link, entry, _DEVICE_TYPE, 0)
    if found != expected:
        raise BringUpError(f"{entry.name} (node {entry.node_id}): device type is 0x{found:08X}, its EDS "
                      f"{entry.dictionary.path} says 0x{expected:08X}; connect that device or give its EDS.")
    for subindex, name in _IDENTITY.items():
        expected = entry.dictionary.initial(_IDENTITY_OBJECT, subindex)
        found = _read(link, entry, _IDENTITY_OBJECT, subindex)
        if expected and found != expected:
            raise BringUpError(f"{entry.name} (node {entry.node_id}): {name} is 0x{found:08X}, its EDS "
                          f"{entry.dictionary.path} says 0x{expected:08X}; connect that device or give its EDS.")
    _refuse_other_configuration(link, entry)
    if key(_IDENTITY_OBJECT, 4) not in entry.dictionary.entries:
        return 0
    return _read(link, entry, _IDENTITY_OBJECT, 4)


def _refuse_other_configuration(link: Link, entry: NodeEntry) -> None:
    """Require that a node holds the configuration that a DCF identifies by its date (0x1020)."""
    for subindex, name in _CONFIGURED.items():
        declared = entry.dictionary.entries.get(key(_VERIFY_OBJECT, subindex))
        if declared is None or not declared.value:
            continue
        found = _read(link, entry, _VERIFY_OBJECT, subindex)
        if found != declared.value:
            raise BringUpError(f"{entry.name} (node {entry.node_id}): {name} (0x1020) is {found!r}, "
                               f"{entry.dictionary.path} says {declared.value!r}; its parameters have changed since: "
                               f"bowden node compare, then restore.")


def _read(link: Link, entry: NodeEntry, index: int, subindex: int) -> int:
    try:
        return int.from_bytes(link.sdo_read(entry.node_id, index, subindex), "little")
    except SdoError as error:
        raise BringUpError(f"{entry.name}: {error}.") from None


def _configure(link: Link, wire: WireLayout, entry: NodeEntry) -> None:
    for index, subindex, value in wire.setup(entry.node_id):
        declared = entry.dictionary.entries[key(index, subindex)]
        try:
            link.sdo_write(entry.node_id, index, subindex, encode(declared.data_type, value))
        except SdoError as error:
            asked = f"{declared.name} = {value!r}"
            raise BringUpError(f"{entry.name} does not take its set-up: {error} ({asked}).") from None


def _limit(link: Link, entry: NodeEntry, limit: DriveLimit) -> None:
    """Write a limit into its drive and read it back; raises `BringUpError` for a drive that does not take it."""
    declared = entry.dictionary.entries[key(limit.index, limit.subindex)]
    where = f"{entry.name} (node {entry.node_id}): {declared.name} (0x{limit.index:04X}:{limit.subindex:02X})"
    try:
        link.sdo_write(entry.node_id, limit.index, limit.subindex, encode(declared.data_type, limit.value))
        found = decode(declared.data_type, link.sdo_read(entry.node_id, limit.index, limit.subindex))
    except InputError:  # of a plug-in behind a simulated bus
        raise
    except (SdoError, ValueError) as error:
        raise BringUpError(f"{where} does not take {limit.value} ({limit.text}), its limit of {limit.function}: "
                           f"{error}; raise the limit in [limits], or use a drive that takes it.") from None
    if found != limit.value:
        raise BringUpError(f"{where} reads {found!r} after {limit.value} ({limit.text}) was written, its limit of "
                           f"{limit.function}; a drive that does not keep its limits is not enabled.")


def _start(link: Link, entry: NodeEntry) -> None:
    link.nmt(NmtCommand.START, entry.node_id)
    if not link.await_state(entry.node_id, NmtState.OPERATIONAL, START_NS):
        raise BringUpError(f"{entry.name} (node {entry.node_id}) did not report OPERATIONAL within "
                      f"{START_NS / 1e9:g} s of its start; check its heartbeat (0x1017) and its error register.")
