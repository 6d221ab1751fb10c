"""Frames of a CANopen bus in words: one line a frame, SDO transfers put together.

The rule of this file: frames and times in, lines out; it opens no bus and no file.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from eds.bench.bench_network import WireLayout
from eds.cia301 import (
    COB_ID_INVALID,
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    Abort,
    NmtCommand,
)
from eds.cia305 import LSS_REQUEST, LSS_RESPONSE, LssCommand
from eds.cia402 import text_of
from eds.dictionary import Dictionary, key
from eds.emcy_codes import emcy_text
from eds.pdo_plan import PdoPlan, compile_plan
from eds.scale_factors import units
from master.node_access import object_text
from master.node_access.remote_node import state_name
from parameters import InputError

TIME_COB_ID: Final = 0x100
_LSS: Final = {int(command): command.text for command in LssCommand}
_PDOS: Final = ((0x1400, 0x200, 0x1600), (0x1800, 0x180, 0x1A00))


class FrameWords(NamedTuple):
    """One frame: its kind (nmt, sync, time, emcy, pdo, sdo, heartbeat, lss or other), node (0: none) and words."""

    kind: str
    node_id: int
    text: str


@dataclass
class SdoTransfer:
    """An SDO transfer under way: object, direction, bytes so far, and its block segments."""

    at: int
    download: bool
    data: bytearray = field(default_factory=bytearray)
    block: bool = False
    segments: bool = False
    sequence: int = 0

    def acknowledged(self, data: bytes) -> str:
        """Take the end of a block: drop the segments that the receiver did not confirm, and expect them again."""
        if data[0] & 3 != 2:
            return "SDO block transfer goes on"
        if data[1] < self.sequence:
            del self.data[-7 * (self.sequence - data[1]):]
            self.segments = True
        self.sequence = 0
        return f"SDO block acknowledged up to segment {data[1]}"


class KnownPdo(NamedTuple):
    """A PDO with known objects: producer or consumer (0: the master, to several), its name and its plan.

    `objects`: name of each object, value of a count and its unit, or None.
    """

    node_id: int
    name: str
    plan: PdoPlan
    objects: tuple[tuple[str, tuple[float, str] | None], ...]


class FrameReader:
    """Gives frames their words; `dictionaries` by node id give names, types, units and PDO mappings.

    A PDO is read by `known`, by COB-ID, else by the mapping that its EDS or DCF states at start.
    """

    def __init__(self, dictionaries: Mapping[int, Dictionary], known: Iterable[KnownPdo] = ()) -> None:
        self.dictionaries = dictionaries
        self.plans = {one.plan.cob_id: one for one in known}
        self.units = {node: units(one) for node, one in dictionaries.items()}
        self._transfers: dict[int, SdoTransfer] = {}
        for node, one in dictionaries.items():
            self._plan(node, one)

    def _plan(self, node: int, one: Dictionary) -> None:
        for base, _, maps in _PDOS:
            for index in range(base, base + 0x200):
                entry = one.entries.get(key(index, 1))
                if entry is None or not isinstance(entry.initial, int) or entry.initial & COB_ID_INVALID:
                    continue
                name = f"{'r' if base == 0x1400 else 't'}pdo{index - base + 1}"
                try:
                    plan = compile_plan(one, one.mapping(index - base + maps), entry.initial & 0x7FF)
                except InputError:
                    continue
                self.plans.setdefault(plan.cob_id, KnownPdo(node, name, plan, tuple(
                    (field.name, self.units[node].get(field.key)) for field in plan.fields if not field.dummy)))

    def read(self, can_id: int, data: bytes) -> FrameWords:
        """Return a data frame of an 11-bit identifier in words."""
        known = self.plans.get(can_id)
        if known is not None:
            return self._pdo(known, data)
        if can_id == SYNC_COB_ID:
            return FrameWords("sync", 0, f"SYNC {data[0]}" if data else "SYNC")
        node = can_id & 0x7F
        if can_id == NMT_COB_ID:
            return _nmt(data)
        if EMCY_BASE < can_id < TIME_COB_ID:
            return self._emcy(node, data)
        if SDO_RESPONSE_BASE < can_id < SDO_RESPONSE_BASE + 128 or SDO_REQUEST_BASE < can_id < SDO_REQUEST_BASE + 128:
            return FrameWords("sdo", node, self._sdo(node, data, can_id > SDO_REQUEST_BASE))
        if HEARTBEAT_BASE < can_id < HEARTBEAT_BASE + 128:
            state = state_name(data[0] & 0x7F) if data else "empty"
            return FrameWords("heartbeat", node, "boot-up" if state == "booted" else f"heartbeat {state}")
        if can_id in (LSS_REQUEST, LSS_RESPONSE):
            command = _LSS.get(data[0], f"command {data[0]}") if data else "empty"
            who = "LSS" if can_id == LSS_REQUEST else "LSS answer"
            return FrameWords("lss", 0, f"{who}: {command} {data[1:].hex(' ')}".rstrip())
        if can_id == TIME_COB_ID:
            return FrameWords("time", 0, "TIME " + data.hex(" "))
        if 0x180 <= can_id < SDO_RESPONSE_BASE:
            return FrameWords("pdo", node, f"PDO without an EDS: {data.hex(' ')}")
        return FrameWords("other", 0, data.hex(" "))

    def _pdo(self, known: KnownPdo, data: bytes) -> FrameWords:
        plan = known.plan
        try:
            values = plan.unpack(data)
        except struct.error:
            return FrameWords("pdo", known.node_id,
                              f"{known.name}: {len(data)} bytes in place of {plan.size}: {data.hex(' ')}")
        fields = [field for field in plan.fields if not field.dummy]
        shown = [_value(name, value, unit, field.key)
                 for (name, unit), field, value in zip(known.objects, fields, values, strict=True)]
        return FrameWords("pdo", known.node_id, f"{known.name}: {', '.join(shown)}")

    def _emcy(self, node: int, data: bytes) -> FrameWords:
        if len(data) < 3:
            return FrameWords("emcy", node, f"EMCY of {len(data)} bytes: {data.hex(' ')}")
        code, one = int.from_bytes(data[:2], "little"), self.dictionaries.get(node)
        profile = None if one is None else _initial(one, 0x1000) & 0xFFFF
        text = emcy_text(code, profile, {} if one is None else one.emergencies)
        more = f", manufacturer {data[3:].hex(' ')}" if any(data[3:]) else ""
        return FrameWords("emcy", node, f"EMCY {code:04X} {text}, register {data[2]:02X}{more}")

    # ---- SDO ----

    def _sdo(self, node: int, data: bytes, request: bool) -> str:
        if len(data) < 8:
            return f"SDO frame of {len(data)} bytes: {data.hex(' ')}"
        under_way = self._transfers.get(node)
        if under_way is not None and under_way.block and request != (not under_way.download) \
                and under_way.segments and data[0] != 0x80:
            return self._segment_of_block(node, under_way, data)
        if data[0] == 0x80:
            self._transfers.pop(node, None)
            return f"SDO abort of {self._named(node, _place(data))}: {_abort(data)}"
        return (self._request if request else self._response)(node, under_way, data)

    def _request(self, node: int, under_way: SdoTransfer | None, data: bytes) -> str:
        command = data[0] >> 5
        if command == 1:
            return self._begin(node, data, True, data[0] & 2 > 0, 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4)
        if command == 2:
            self._transfers[node] = SdoTransfer(_place(data), False)
            return f"SDO read of {self._named(node, _place(data))}"
        if command == 6 and not data[0] & 1:
            self._transfers[node] = SdoTransfer(_place(data), True, block=True)
            return f"SDO block write of {self._named(node, _place(data))}"
        if command == 5 and data[0] & 3 == 0:
            self._transfers[node] = SdoTransfer(_place(data), False, block=True)
            return f"SDO block read of {self._named(node, _place(data))}"
        if under_way is None:
            return f"SDO request {data.hex(' ')}"
        if command == 0:
            under_way.data += data[1:8 - (data[0] >> 1 & 7)]
            return self._done(node, under_way) if data[0] & 1 else "SDO segment to the node"
        if command == 6:
            if unused := data[0] >> 2 & 7:
                del under_way.data[-unused:]
            return self._done(node, under_way)
        if command == 5:
            if data[0] & 3 == 3:
                under_way.segments = True
            return under_way.acknowledged(data)
        return "SDO segment asked for"

    def _response(self, node: int, under_way: SdoTransfer | None, data: bytes) -> str:
        command = data[0] >> 5
        if command == 3:
            return f"SDO write of {self._named(node, _place(data))} confirmed"
        if command == 2:
            return self._begin(node, data, False, data[0] & 2 > 0, 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4)
        if under_way is None:
            return f"SDO answer {data.hex(' ')}"
        if command == 0:
            under_way.data += data[1:8 - (data[0] >> 1 & 7)]
            return self._done(node, under_way) if data[0] & 1 else "SDO segment from the node"
        if command == 6 and under_way.block and data[0] & 1:
            if unused := data[0] >> 2 & 7:
                del under_way.data[-unused:]
            return self._done(node, under_way)
        if command == 5:
            if data[0] & 3 == 0:
                under_way.segments = True
            return under_way.acknowledged(data)
        return "SDO block read granted" if command == 6 else "SDO segment confirmed"

    def _begin(self, node: int, data: bytes, download: bool, expedited: bool, size: int) -> str:
        transfer = SdoTransfer(_place(data), download)
        if expedited:
            transfer.data += data[4:4 + size]
            self._transfers.pop(node, None)
            return self._text(node, transfer)
        self._transfers[node] = transfer
        return f"SDO {'write' if download else 'read'} of {self._named(node, transfer.at)} in segments begins"

    def _segment_of_block(self, node: int, transfer: SdoTransfer, data: bytes) -> str:
        sequence = data[0] & 0x7F
        if sequence == transfer.sequence + 1:
            transfer.sequence = sequence
            transfer.data += data[1:8]
        if data[0] & 0x80:
            transfer.segments = False
        return f"SDO block segment {sequence}"

    def _done(self, node: int, transfer: SdoTransfer) -> str:
        self._transfers.pop(node, None)
        return self._text(node, transfer)

    def _text(self, node: int, transfer: SdoTransfer) -> str:
        one = self.dictionaries.get(node)
        entry = None if one is None else one.entries.get(transfer.at)
        kind = None if entry is None else entry.data_type
        value = object_text.value_of(kind, bytes(transfer.data))
        shown = object_text.shown(value, kind, self.units.get(node, {}).get(transfer.at), transfer.at)
        return f"SDO {'write' if transfer.download else 'read'} {self._named(node, transfer.at)} = {shown}"

    def _named(self, node: int, at: int) -> str:
        one = self.dictionaries.get(node)
        name = "" if one is None else object_text.full_name(one, at)
        return f"{object_text.shown_key(at)} {name}".rstrip()


def _place(data: bytes) -> int:
    return int.from_bytes(data[1:3], "little") << 8 | data[3]


def _abort(data: bytes) -> str:
    code = int.from_bytes(data[4:8], "little")
    text = next((one.text for one in Abort if one == code), "no code of CiA 301")
    return f"0x{code:08X} {text}"


def _initial(one: Dictionary, index: int) -> int:
    entry = one.entries.get(key(index))
    return entry.initial if entry is not None and isinstance(entry.initial, int) else 0


def of_wire(layout: WireLayout) -> FrameReader:
    """Return a reader of a bench's bus: its PDOs have the mapping that bring-up writes, not that of the EDS."""
    dictionaries = {node: entry.dictionary for node, entry in layout.nodes.items()}
    scaled = {node: units(one) for node, one in dictionaries.items()}

    def objects(plan: PdoPlan, nodes: Sequence[int]) -> Iterator[tuple[str, tuple[float, str] | None]]:
        fields = [one for one in plan.fields if not one.dummy]
        for node, mapped in zip(nodes, fields, strict=True):
            unit = scaled[node].get(mapped.key)
            name = mapped.name if len(set(nodes)) == 1 else f"{mapped.name} of {node}"
            yield name, (mapped.scale, unit[1] if unit else "") if mapped.scale != 1.0 else unit

    known = [KnownPdo(cob_id & 0x7F, "tpdo1", plan, tuple(objects(plan, [cob_id & 0x7F] * len(plan.keys))))
             for cob_id, plan in layout.tpdo.items()]
    for name, plan, nodes in layout.master_frames():
        kept = [node for node, field in zip(nodes, plan.fields, strict=True) if not field.dummy]
        known.append(KnownPdo(0, f"{name}s", plan, tuple(objects(plan, kept))))
    return FrameReader(dictionaries, known)


def _value(name: str, value: float, scaled: tuple[float, str] | None, at: int) -> str:
    if words := text_of(at >> 8, value):
        return f"{name} {value:#06x} ({words})"
    return f"{name} {value:g}" if scaled is None else f"{name} {value * scaled[0]:.6g} {scaled[1]}".rstrip()


def _nmt(data: bytes) -> FrameWords:
    if len(data) != 2:
        return FrameWords("nmt", 0, f"NMT of {len(data)} bytes: {data.hex(' ')}")
    name = next((one.name.lower().replace("_", " ") for one in NmtCommand if one == data[0]), f"command {data[0]}")
    return FrameWords("nmt", data[1], f"NMT {name}, {f'node {data[1]}' if data[1] else 'all nodes'}")
