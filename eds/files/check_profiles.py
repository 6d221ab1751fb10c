"""Objects of an EDS against the profile that the device names in 0x1000.

The rule of this file: every demand comes from a table in `eds.profiles`.
"""

from collections.abc import Iterator
from typing import Final

from eds.dictionary import Entry, key
from eds.files.notation import number
from eds.files.sheet import EdsSheet, SheetFault
from eds.profiles import CIA301, MODE_OBJECTS, PROFILES, Rule


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


SEARCHES: Final = (objects, modes, identity)
