"""Checks of the text of an EDS: sections, keys, lists, numbers, limits.

One search per kind of fault; no profile is needed here.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Final

from eds.datatype import BY_CODE, DataType
from eds.dictionary import ARRAY, DOMAIN_OBJECT, RECORD, VAR
from eds.files.ini import Section
from eds.files.notation import limit, number, object_section, value
from eds.files.sheet import EdsSheet, SheetFault

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
        for key, count in keys.items():
            if count > 1:
                yield sheet.finding(section, key, f"the key stands {count} times", "keep one")


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
        for key, index in rows:
            yield from _listed(sheet, section, key, index, listed)
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
    for key in ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue"):
        text = section.get(key)
        if text is None:
            continue
        read = limit(kind, text, node) if key.endswith("Limit") else value(kind, text, node)
        if isinstance(read, int | float):
            given[key] = read
        else:
            yield sheet.finding(section, key, f"{text} is no value of {kind.name}",
                                "write a number that fits the type" if kind.integer else "write a decimal number")
    low, high = given.pop("LowLimit", None), given.pop("HighLimit", None)
    if low is not None and high is not None and low > high:
        yield sheet.finding(section, "LowLimit", f"LowLimit {low:g} is above HighLimit {high:g}", "swap them")
        return
    for key, number_given in given.items():
        if (low is not None and number_given < low) or (high is not None and number_given > high):
            text = f"{number_given:g} is outside the object's limits"
            yield sheet.finding(section, key, text, "mend it or the limits")


def names(sheet: EdsSheet) -> Iterator[SheetFault]:
    """Sections that look like objects but are none, so that every reader passes over them."""
    for section in sheet.sections:
        bare = section.name.lower().removeprefix("0x")
        looks = len(bare) >= 4 and all(c in "0123456789abcdef" for c in bare[:4]) and "sub" in bare
        if looks and object_section(section.name) is None:
            yield sheet.finding(section, "", "neither an object nor a known section", "name it like 1A00 or 1A00sub1")


SEARCHES: Final = (repeated, lists, structure, values, names)
