"""PDO counts, maps, transmission types and COB-IDs of an EDS.

These faults would otherwise appear only when the device refuses a write, or when two frames collide.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from eds import cia301
from eds.datatype import BY_CODE, DataType
from eds.dictionary import Entry, key
from eds.files.notation import number
from eds.files.sheet import EdsSheet, SheetFault
from eds.pdo_plan import FIRST_OBJECT, MAX_BITS

_RPDO: Final = range(0x1400, 0x1600)
_TPDO: Final = range(0x1800, 0x1A00)
_MAPPING: Final = 0x200
_RESERVED: Final = ((0x001, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))
"""CAN identifiers that no PDO, SYNC or EMCY may take (CiA 301, table 40)."""


def counts(sheet: EdsSheet) -> Iterator[SheetFault]:
    """NrOfRXPDO and NrOfTXPDO against the PDOs, and each PDO's two records against each other."""
    info = sheet.by_name.get("deviceinfo")
    objects = sheet.dictionary.objects
    for name, block in (("NrOfRXPDO", _RPDO), ("NrOfTXPDO", _TPDO)):
        present = [index for index in block if index in objects]
        said = number(info.get(name)) if info else None
        if info and said != len(present):
            yield sheet.finding(info, name, f"{len(present)} PDOs are described, {name} says {said}",
                                f"write {name}={len(present)}")
        for index in block:
            if (index in objects) != (index + _MAPPING in objects):
                here, there = (index, index + _MAPPING) if index in objects else (index + _MAPPING, index)
                text = f"{here:04X} is there without {there:04X}"
                yield sheet.finding(sheet.section(here), "", text, f"add [{there:04X}]")


def maps(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Each default map: existing, mappable objects of the right length and direction, 64 bits at most, none twice."""
    for block in (_RPDO, _TPDO):
        for index in (i + _MAPPING for i in block if i + _MAPPING in sheet.dictionary.objects):
            yield from _map(sheet, index, receives=block is _RPDO)


def _map(sheet: EdsSheet, index: int, receives: bool) -> Iterator[SheetFault]:
    head = sheet.dictionary.entries.get(key(index))
    count = head.initial if head and head.data_type.integer else 0
    assert isinstance(count, int)
    words = [(sub, _word(sheet, index, sub)) for sub in range(1, min(count, MAX_BITS) + 1)]
    if count > MAX_BITS:
        yield sheet.finding(sheet.section(index, 0), "DefaultValue", f"{count} mapped objects", "map at most 64")
    missing = [sub for sub, word in words if word is None]
    if missing:
        yield sheet.finding(sheet.section(index, 0), "DefaultValue",
                            f"{count} objects are mapped, but sub-index {missing[0]} has no value",
                            f"write DefaultValue={missing[0] - 1} or fill the entry")
    mapped = [(sub, word) for sub, word in words if word is not None]
    bits = sum(word & 0xFF for _, word in mapped)
    if bits > MAX_BITS:
        yield sheet.finding(sheet.section(index, 0), "DefaultValue", f"the map has {bits} bits",
                            "map at most 64 bits, 8 bytes of a frame")
    twice = {word >> 8 for word, n in Counter(w for _, w in mapped).items() if n > 1 and word >> 16 >= FIRST_OBJECT}
    seen: set[int] = set()
    for sub, word in mapped:
        yield from _mapped(sheet, index, sub, word, receives)
        if word >> 8 in twice and word >> 8 in seen:
            section = sheet.section(index, sub)
            yield sheet.finding(section, "DefaultValue", f"{_name(word)} is mapped twice", "delete one")
        seen.add(word >> 8)


def _word(sheet: EdsSheet, index: int, sub: int) -> int | None:
    entry = sheet.dictionary.entries.get(key(index, sub))
    given = entry and (entry.default if entry.value is None else entry.value)
    return given if isinstance(given, int) else None


def _name(word: int) -> str:
    return f"{word >> 16:04X}:{word >> 8 & 0xFF:02X}"


def _mapped(sheet: EdsSheet, index: int, sub: int, word: int, receives: bool) -> Iterator[SheetFault]:
    section, bits = sheet.section(index, sub), word & 0xFF
    target = sheet.dictionary.entries.get(word >> 8)
    if word >> 16 < FIRST_OBJECT:
        kind = BY_CODE.get(word >> 16)
        if not receives or kind is None or kind not in sheet.dictionary.dummies or bits != kind.bits:
            yield sheet.finding(section, "DefaultValue", f"{word:08X}h is no dummy that this device takes",
                                "map a data type that [DummyUsage] allows, with its own length, in an RPDO")
    elif target is None:
        yield sheet.finding(section, "DefaultValue", f"{_name(word)} is mapped, but no such object is described",
                            "map an object of this file or describe it")
    else:
        yield from _target(sheet, index, sub, target, bits, receives)


def _target(sheet: EdsSheet, index: int, sub: int, target: Entry, bits: int, receives: bool) -> Iterator[SheetFault]:
    section, kind, name = sheet.section(index, sub), target.data_type, _name(target.key << 8)
    own = sheet.section(target.index, target.subindex).name
    if not target.mappable:
        yield sheet.finding(section, "DefaultValue", f"{name} {target.name} is mapped, but has PDOMapping=0",
                            f"write PDOMapping=1 in [{own}] or map another object")
    if kind.bits and bits not in ((1, 8) if kind is DataType.BOOLEAN else (kind.bits,)):
        yield sheet.finding(section, "DefaultValue", f"{name} is mapped with {bits} bits, {kind.name} has {kind.bits}",
                            f"write DefaultValue=0x{target.key << 8 | kind.bits:08X}")
    way, wrong, right = ("received", ("ro", "const", "rwr"), "rww") if receives else ("sent", ("wo", "rww"), "ro")
    if target.access in wrong:
        yield sheet.finding(section, "DefaultValue", f"{name} is {way} by a PDO, but its access is {target.access}",
                            f"map another object, or write AccessType={right} in [{own}] if that is true of the device")


def transmission(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Transmission types that CiA 301 reserves."""
    for index in (*_RPDO, *_TPDO):
        entry = sheet.dictionary.entries.get(key(index, 2))
        kind = entry.initial if entry else 0
        if isinstance(kind, int) and not cia301.pdo_type_allowed(kind) and not (index in _TPDO and kind in (252, 253)):
            yield sheet.finding(sheet.section(index, 2), "DefaultValue", f"transmission type {kind} is reserved",
                                "write 0 to 240, 254 or 255")


def identifiers(sheet: EdsSheet) -> Iterator[SheetFault]:
    """COB-IDs in use: none is zero or reserved, no two are the same."""
    users: dict[int, tuple[int, int]] = {}
    for index, sub in _cob_id_places(sheet):
        entry = sheet.dictionary.entries[key(index, sub)]
        word = entry.default if entry.value is None else entry.value
        if not isinstance(word, int) or word & cia301.COB_ID_INVALID:
            continue
        section, cob_id = sheet.section(index, sub if sub else None), word & 0x1FFFFFFF
        wide = bool(word & cia301.COB_ID_EXTENDED)
        if cob_id == 0:
            yield sheet.finding(section, "DefaultValue", "COB-ID 0 is the NMT's",
                                "write the COB-ID, with $NODEID in it, or set bit 31 (0x80000000) for an unused one")
        elif not wide and (cob_id > 0x7FF or (index >= 0x1400 and any(a <= cob_id <= b for a, b in _RESERVED))):
            yield sheet.finding(section, "DefaultValue", f"COB-ID {cob_id:X}h is reserved or too large",
                                "write one from 181h to 57Fh, such as the pre-defined one with $NODEID")
        elif (other := users.setdefault(cob_id, (index, sub))) != (index, sub):
            text = f"COB-ID {cob_id:X}h is that of {other[0]:04X}:{other[1]:02X} too"
            yield sheet.finding(section, "DefaultValue", text,
                                "give each its own, or set bit 31 (0x80000000) of an unused one")


def _cob_id_places(sheet: EdsSheet) -> Iterator[tuple[int, int]]:
    """Objects that hold COB-IDs; SYNC and TIME come first, so that a collision is reported at the later object."""
    places = [(0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1200, 1), (0x1200, 2)]
    places += [(index, 1) for index in (*_RPDO, *_TPDO)]
    return (place for place in places if key(*place) in sheet.dictionary.entries)


SEARCHES: Final = (counts, maps, transmission, identifiers)
