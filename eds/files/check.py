"""Checks of EDS and DCF files, listed by `bowden check eds`: `findings` returns the faults of one file.

A fault has a place (file, section, key, line) and a remedy. There are three groups of checks: the text (sections, keys,
numbers, limits); the PDOs (a mapping that a device would refuse, a COB-ID used twice); and the objects that the profile
in 0x1000 requires, by the tables of `eds.profiles`. A file that cannot be parsed is a fault too, never an exception.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eds import cia301
from eds.datatype import BY_CODE, DataType
from eds.dictionary import ARRAY, DOMAIN_OBJECT, RECORD, VAR, Dictionary, Entry, build, key
from eds.files import ini
from eds.files.ini import Section
from eds.files.notation import limit, number, object_section, value
from eds.pdo_plan import FIRST_OBJECT, MAX_BITS
from eds.profiles import CIA301, MODE_OBJECTS, PROFILES, Rule


@dataclass(frozen=True, slots=True)
class SheetFault:
    """One fault: `text` describes it, `remedy` is the remedy; `key` is "" if it concerns a whole section."""

    file: str
    section: str
    key: str
    text: str
    remedy: str
    line: int

    def __str__(self) -> str:
        key = f" {self.key}" if self.key else ""
        return f"{self.file}:{self.line}: [{self.section}]{key}: {self.text}; {self.remedy}."


class EdsSheet:
    """Parsed text of an EDS and its dictionary; of two sections of one name the first counts, whatever their case."""

    def __init__(self, path: str, sections: Sequence[Section], dictionary: Dictionary) -> None:
        self.path = path
        self.sections = sections
        self.dictionary = dictionary
        self.by_name: dict[str, Section] = {}
        self.objects: dict[tuple[int, int | None], Section] = {}
        for section in sections:
            self.by_name.setdefault(section.name.lower(), section)
            place = object_section(section.name)
            if place is not None:
                self.objects.setdefault(place, section)

    def section(self, index: int, subindex: int | None = None) -> Section:
        """Return the section of an object, or the nearest section for a report on it."""
        for place in ((index, subindex), (index, None), (index, 0)):
            if place in self.objects:
                return self.objects[place]
        return self.sections[0]

    def finding(self, section: Section, key: str, text: str, remedy: str) -> SheetFault:
        """Make a finding at a key of a section ("" for the section itself)."""
        return SheetFault(self.path, section.name, key, text, remedy, section.line_of(key) if key else section.line)

    def subsections(self, index: int) -> Iterator[tuple[int, Section]]:
        """Yield (sub-index, section) of an object's sub-objects."""
        for (at, sub), section in self.objects.items():
            if at == index and sub is not None:
                yield sub, section


ACCESS: Final = ("ro", "wo", "rw", "rwr", "rww", "const")
_LISTS: Final = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
_MANDATORY: Final = (0x1000, 0x1001, 0x1018)


def repeated(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Yield sections and keys that occur twice: tools differ in which one they read."""
    seen: dict[str, int] = {}
    for section in sheet.sections:
        first = seen.setdefault(section.name.lower(), section.line)
        if first != section.line:
            yield sheet.finding(section, "", f"duplicate of the section in line {first}", "delete one of them")
        keys = Counter(item.key.lower() for item in section.items)
        for name, count in keys.items():
            if count > 1:
                yield sheet.finding(section, name, f"the key stands {count} times", "keep one")


def lists(sheet: EdsSheet) -> Iterator[SheetFault]:
    """MandatoryObjects, OptionalObjects and ManufacturerObjects against the object sections."""
    listed: dict[int, str] = {}
    for name in _LISTS:
        section = sheet.by_name.get(name.lower())
        if section is None:
            yield sheet.finding(sheet.sections[0], "", f"the section [{name}] is missing", "add it with its objects")
            continue
        rows = [(item.key, number(item.value)) for item in section.items if item.key.isdecimal()]
        count = number(section.get("SupportedObjects"))
        if count != len(rows):
            yield sheet.finding(section, "SupportedObjects", f"{len(rows)} objects are listed, the count says {count}",
                                f"write SupportedObjects={len(rows)}")
        for number_key, index in rows:
            yield from _listed(sheet, section, number_key, index, listed)
    for index, sub in sheet.objects:
        if sub is None and index not in listed and index >= 0x1000:
            yield sheet.finding(sheet.section(index), "", "the object is in none of the lists",
                                f"add it to [{_list_of(index)}] and its SupportedObjects")


def _listed(sheet: EdsSheet, section: Section, key: str, index: int | None,
            listed: dict[int, str]) -> Iterator[SheetFault]:
    if index is None:
        yield sheet.finding(section, key, "no object index", "write it as 0x and four hexadecimal digits")
        return
    if index in listed:
        yield sheet.finding(section, key, f"{index:04X} is listed already in [{listed[index]}]", "delete this entry")
    listed.setdefault(index, section.name)
    if (index, None) not in sheet.objects:
        yield sheet.finding(section, key, f"{index:04X} is listed, but has no section",
                            f"add [{index:04X}] or delete the entry")
    elif section.name.lower() != _list_of(index).lower():
        yield sheet.finding(section, key, f"{index:04X} stands in the wrong list", f"move it to [{_list_of(index)}]")


def _list_of(index: int) -> str:
    return _LISTS[0 if index in _MANDATORY else 2 if 0x2000 <= index < 0x6000 else 1]


def structure(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Arrays and records: sub-index 0, SubNumber, and the highest sub-index."""
    for (index, sub), section in sheet.objects.items():
        if sub is not None:
            if (index, None) not in sheet.objects:
                text = f"sub-object of {index:04X}, which has no section"
                yield sheet.finding(section, "", text, f"add [{index:04X}]")
            continue
        subs = dict(sheet.subsections(index))
        kind = number(section.get("ObjectType")) or VAR
        if kind in (ARRAY, RECORD) and not number(section.get("CompactSubObj")):
            yield from _compound(sheet, section, subs)
        elif subs and kind in (VAR, DOMAIN_OBJECT):
            yield sheet.finding(section, "ObjectType", "a single variable with sub-objects",
                                "write 0x8 (array) or 0x9 (record)")


def _compound(sheet: EdsSheet, section: Section, subs: dict[int, Section]) -> Iterator[SheetFault]:
    count = number(section.get("SubNumber"))
    if count != len(subs):
        yield sheet.finding(section, "SubNumber", f"{len(subs)} sub-objects follow, SubNumber says {count}",
                            f"write SubNumber={len(subs)}")
    if 0 not in subs:
        yield sheet.finding(section, "", "sub-index 0 is missing", f"add [{section.name}sub0], UNSIGNED8")
        return
    if number(subs[0].get("DataType")) != DataType.UNSIGNED8:
        yield sheet.finding(subs[0], "DataType", "sub-index 0 is no UNSIGNED8", "write DataType=0x0005")
    highest = number(subs[0].get("DefaultValue"))
    if highest and highest > max(subs) and (subs[0].get("AccessType") or "").lower() in ("ro", "const"):
        yield sheet.finding(subs[0], "DefaultValue", f"highest sub-index {highest}, but the last one is {max(subs)}",
                            f"write DefaultValue={max(subs)} or add the others")


def values(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Each variable: its keys are there, its numbers are numbers, its default lies in its limits."""
    for (_, sub), section in sheet.objects.items():
        kind = number(section.get("ObjectType")) or VAR
        compound = sub is None and (kind not in (VAR, DOMAIN_OBJECT) or number(section.get("CompactSubObj")))
        if section.get("ParameterName") is None:
            yield sheet.finding(section, "ParameterName", "the object has no name", "name it")
        if compound:
            continue
        if (section.get("AccessType") or "").lower() not in ACCESS:
            yield sheet.finding(section, "AccessType", f"{section.get('AccessType') or 'nothing'} is no access type",
                                f"write one of {', '.join(ACCESS)}")
        code = number(section.get("DataType"))
        if code is None and kind != DOMAIN_OBJECT:
            yield sheet.finding(section, "DataType", "the data type is missing or no number", "write its CiA 301 code")
        elif code is not None and code in BY_CODE:
            yield from _numbers(sheet, section, BY_CODE[code])


def _numbers(sheet: EdsSheet, section: Section, kind: DataType) -> Iterator[SheetFault]:
    if not (kind.integer or kind.real):
        return
    node = sheet.dictionary.node_id
    given: dict[str, float] = {}
    for name in ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue"):
        text = section.get(name)
        if text is None:
            continue
        read = limit(kind, text, node) if name.endswith("Limit") else value(kind, text, node)
        if isinstance(read, int | float):
            given[name] = read
        else:
            yield sheet.finding(section, name, f"{text} is no value of {kind.name}",
                                "write a number that fits the type" if kind.integer else "write a decimal number")
    low, high = given.pop("LowLimit", None), given.pop("HighLimit", None)
    if low is not None and high is not None and low > high:
        yield sheet.finding(section, "LowLimit", f"LowLimit {low:g} is above HighLimit {high:g}", "swap them")
        return
    for name, number_given in given.items():
        if (low is not None and number_given < low) or (high is not None and number_given > high):
            text = f"{number_given:g} is outside the object's limits"
            yield sheet.finding(section, name, text, "mend it or the limits")


def names(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Sections that look like objects but are none, so that every reader passes over them."""
    for section in sheet.sections:
        bare = section.name.lower().removeprefix("0x")
        looks = len(bare) >= 4 and all(c in "0123456789abcdef" for c in bare[:4]) and "sub" in bare
        if looks and object_section(section.name) is None:
            yield sheet.finding(section, "", "neither an object nor a known section", "name it like 1A00 or 1A00sub1")


_RPDO: Final = range(0x1400, 0x1600)
_TPDO: Final = range(0x1800, 0x1A00)
_MAPPING: Final = 0x200


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
        elif not wide and (cob_id > 0x7FF or (index >= 0x1400 and cia301.restricted(cob_id))):
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


def objects(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Wrong data type or access of a profile's object, and mandatory ones that are missing."""
    device = sheet.dictionary.entries.get(key(0x1000))
    profile = device.initial & 0xFFFF if device and isinstance(device.initial, int) else 0
    for title, rules in ((301, CIA301), (profile, PROFILES.get(profile, ()))):
        for rule in rules:
            found = list(_entries(sheet, rule))
            if not found and rule.mandatory:
                place = sheet.by_name.get("mandatoryobjects") or sheet.sections[0]
                yield sheet.finding(place, "", f"CiA {title} demands {rule.place}, which is missing",
                                    f"add it as {rule.data_type.name}")
            for entry in found:
                yield from _against(sheet, entry, rule, title)


def _entries(sheet: EdsSheet, rule: Rule) -> Iterator[Entry]:
    entries = sheet.dictionary.entries
    if rule.subindex is not None:
        if (entry := entries.get(key(rule.index, rule.subindex))) is not None:
            yield entry
    elif rule.index in sheet.dictionary.objects:
        subs = sheet.dictionary.objects[rule.index].subindices
        yield from (entries[key(rule.index, sub)] for sub in subs if 0 < sub < 0xFF)


def _against(sheet: EdsSheet, entry: Entry, rule: Rule, title: int) -> Iterator[SheetFault]:
    section = sheet.section(entry.index, entry.subindex)
    if entry.data_type is not rule.data_type:
        yield sheet.finding(section, "DataType", f"{entry.data_type.name}, but CiA {title} says {rule.data_type.name}",
                            f"write DataType=0x{rule.data_type:04X}")
    if entry.access not in rule.access:
        allowed = sorted(rule.access, key=lambda access: (len(access), access))
        yield sheet.finding(section, "AccessType", f"{entry.access}, but CiA {title} says {' or '.join(allowed)}",
                            f"write AccessType={allowed[0]}")


def modes(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Objects that a drive's own modes (0x6502) need."""
    supported = sheet.dictionary.entries.get(key(0x6502))
    bits = supported.initial if supported and isinstance(supported.initial, int) else 0
    for mode, needed in MODE_OBJECTS.items():
        for index in needed if bits & mode.supported_bit else ():
            if index not in sheet.dictionary.objects:
                text = f"mode {mode.name} is offered without {index:04X}"
                yield sheet.finding(sheet.section(0x6502), "DefaultValue", text, f"add [{index:04X}] or clear its bit")


def identity(sheet: EdsSheet) -> Iterator[SheetFault]:
    """VendorNumber, ProductNumber and RevisionNumber against 0x1018."""
    info = sheet.by_name.get("deviceinfo")
    if info is None:
        yield sheet.finding(sheet.sections[0], "", "the section [DeviceInfo] is missing", "add it")
        return
    for sub, name in enumerate(("VendorNumber", "ProductNumber", "RevisionNumber"), 1):
        entry = sheet.dictionary.entries.get(key(0x1018, sub))
        said, held = number(info.get(name)), entry.default if entry else None
        if said is not None and isinstance(held, int) and held and said != held:
            yield sheet.finding(info, name, f"{said:X}h, but 1018:{sub:02X} says {held:X}h", "make them agree")


_SEARCHES: Sequence[Callable[[EdsSheet], Iterator[SheetFault]]] = (
    repeated, lists, structure, values, names, counts, maps, transmission, identifiers, objects, modes, identity,
)
_ANY_NODE = 1
"""Node id for `$NODEID` where the file names none; no finding depends on which."""


def findings(path: str | Path) -> list[SheetFault]:
    """List everything found in an EDS or DCF, by line; `InputError` only where it cannot be read at all."""
    sections = ini.read(Path(path))
    own = build(str(path), sections)
    sheet = EdsSheet(str(path), sections, own if own.node_id else build(str(path), sections, _ANY_NODE))
    found = {finding for search in _SEARCHES for finding in search(sheet)}
    return sorted(found, key=lambda f: (f.line, f.section, f.key, f.text))
