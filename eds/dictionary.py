"""Object dictionaries, read from EDS and DCF files (CiA 306).

The reader survives vendors' files: unreadable entries are left out and never guessed; `eds.files.check` is the module
that reports them.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Final

from eds.datatype import BY_CODE, DataType, Value
from eds.files import ini
from eds.files.notation import limit, number, object_section, value
from parameters import InputError

VAR, ARRAY, RECORD, DOMAIN_OBJECT = 0x7, 0x8, 0x9, 0x2
PACKAGED: Final = ("servo_drive", "knee_drive", "tension_sensor", "joint_encoder")
OCTETS: Final = "ParameterOctets"
"""Key of a string's octets in a backup, for strings that text in a DCF cannot hold (line ends, spaces at the ends)."""
NO_OCTETS: Final = "none"
"""Value of `OCTETS` for an empty string: the readers of EDS files take an empty value for an absent one."""
_EMERGENCIES: Final = re.compile(r"(emcy|emergency)[ _]?(error)?[ _]?codes?", re.IGNORECASE)
_DUMMY: Final = re.compile(r"dummy[0-9a-f]{4}", re.IGNORECASE)


def key(index: int, subindex: int = 0) -> int:
    """Return the key of a sub-object: index << 8 | subindex."""
    return index << 8 | subindex


@dataclass(frozen=True, slots=True)
class Entry:
    """One sub-object; `default` (EDS) and `value` (DCF) are None where the file gives none."""

    index: int
    subindex: int
    name: str
    data_type: DataType
    access: str
    default: Value | None
    low: int | None
    high: int | None
    mappable: bool
    value: Value | None = None
    relative: bool = False

    @property
    def key(self) -> int:
        """index << 8 | subindex."""
        return self.index << 8 | self.subindex

    @property
    def readable(self) -> bool:
        """True if SDO may read the object."""
        return self.access != "wo"

    @property
    def writable(self) -> bool:
        """True if SDO may write the object."""
        return self.access in ("wo", "rw", "rwr", "rww")

    @property
    def initial(self) -> Value:
        """The value at start: the DCF's, else the EDS's default, else zero or empty."""
        given = self.default if self.value is None else self.value
        return self.data_type.zero if given is None else given


@dataclass(frozen=True, slots=True)
class Object:
    """One index: its name, object type (VAR, ARRAY, RECORD, DOMAIN) and sub-indices in order."""

    index: int
    name: str
    object_type: int
    subindices: tuple[int, ...]


@dataclass(frozen=True)
class Dictionary:
    """Content of an EDS or DCF, `$NODEID` resolved.

    `info` is DeviceInfo with lower-case keys, `emergencies` the maker's own EMCY error codes in words.
    """

    path: str
    entries: Mapping[int, Entry]
    objects: Mapping[int, Object]
    dummies: frozenset[int] = frozenset()
    node_id: int | None = None
    info: Mapping[str, str] = field(default_factory=dict)
    emergencies: Mapping[int, str] = field(default_factory=dict)

    def initial(self, index: int, subindex: int = 0) -> int:
        """Return the start value of an integer object; `InputError` where the file has no such object."""
        entry = self.entries.get(key(index, subindex))
        if entry is None or not entry.data_type.integer:
            raise InputError(f"{self.path}: no integer object {index:04X}:{subindex:02X}; add it to the EDS.")
        value = entry.initial
        assert isinstance(value, int)
        return value

    def mapping(self, index: int) -> list[int]:
        """Return the mapping words that 0x16xx or 0x1Axx holds at the start; empty where it is absent."""
        if key(index) not in self.entries:
            return []
        count = self.initial(index)
        return [self.initial(index, sub) for sub in range(1, count + 1) if key(index, sub) in self.entries]


def read(path: str | Path, node_id: int | None = None) -> Dictionary:
    """Read an EDS or DCF; without `node_id` a DCF's own is taken.

    Raises `InputError` where the file cannot be read or describes no object.
    """
    return build(str(path), ini.read(Path(path)), node_id)


def build(path: str, found: list[ini.Section], node_id: int | None = None) -> Dictionary:
    """Make a dictionary of parsed sections; `path` names them in messages."""
    sections: dict[str, ini.Section] = {}
    for section in found:
        sections.setdefault(section.name.lower(), section)
    if node_id is None:
        commissioning = sections.get("devicecomissioning") or sections.get("devicecommissioning")
        node_id = number(commissioning.get("NodeID")) if commissioning else None
    entries: dict[int, Entry] = {}
    for section in sections.values():
        for entry in _entries(section, sections, node_id):
            entries.setdefault(entry.key, entry)
    objects = _objects(sections, entries)
    if not objects:
        raise InputError(f"{path}: no object section (like [1000]) in it; an EDS or DCF (CiA 306) was expected.")
    info = sections.get("deviceinfo")
    return Dictionary(path, dict(sorted(entries.items())), objects, _dummies(sections.get("dummyusage")), node_id,
                      {item.key.lower(): item.value for item in reversed(info.items)} if info else {},
                      _emergencies(sections.values()))


def packaged(name: str) -> Path:
    """Return the path of an EDS that ships with this project: one of `PACKAGED`."""
    if name not in PACKAGED:
        raise InputError(f"{name}: no packaged EDS; expected one of {', '.join(PACKAGED)}.")
    return Path(str(resources.files("eds") / f"{name}.eds"))


def _entries(section: ini.Section, sections: Mapping[str, ini.Section], node_id: int | None) -> Iterator[Entry]:
    place = object_section(section.name)
    if place is None:
        return
    index, subindex = place
    count = number(section.get("CompactSubObj")) if subindex is None else None
    if count:
        yield Entry(index, 0, "Number of entries", DataType.UNSIGNED8, "ro", count, None, None, False)
        for sub in range(1, min(count, 254) + 1):
            yield from _compact(section, sections, index, sub, node_id)
    elif subindex is not None or (number(section.get("ObjectType")) or VAR) in (VAR, DOMAIN_OBJECT):
        yield from _entry(section, sections, index, subindex or 0, node_id)


def _entry(section: ini.Section, sections: Mapping[str, ini.Section], index: int, subindex: int,
           node_id: int | None) -> Iterator[Entry]:
    data_type = _data_type(section, sections)
    if data_type is None:
        return
    default = section.get("DefaultValue")
    yield Entry(
        index, subindex,
        name=section.get("ParameterName") or f"{index:04X}:{subindex:02X}",
        data_type=data_type,
        access=(section.get("AccessType") or "rw").lower(),
        default=value(data_type, default, node_id),
        low=limit(data_type, section.get("LowLimit"), node_id),
        high=limit(data_type, section.get("HighLimit"), node_id),
        mappable=bool(number(section.get("PDOMapping"))),
        value=_value(data_type, section, node_id),
        relative=default is not None and "NODEID" in default.upper(),
    )


def _value(data_type: DataType, section: ini.Section, node_id: int | None) -> Value | None:
    """Return the DCF's value: the octets of `ParameterOctets`, a key of this project's backups, else ParameterValue."""
    octets = section.get(OCTETS)
    if octets is not None:
        return value(DataType.OCTET_STRING, octets.removeprefix(NO_OCTETS))
    return value(data_type, section.get("ParameterValue"), node_id)


def _compact(section: ini.Section, sections: Mapping[str, ini.Section], index: int, sub: int,
             node_id: int | None) -> Iterator[Entry]:
    """One element of a CompactSubObj array, its name and value from [xxxxName] and [xxxxValue] (CiA 306, 4.6.3.4)."""
    names, values = sections.get(f"{index:04x}name"), sections.get(f"{index:04x}value")
    own = ini.Section(section.name, section.line)
    for item in section.items:
        if item.key.lower() != "parametername":
            own.add(*item)
    name = names.get(str(sub)) if names else None
    own.add("ParameterName", name or f"{section.get('ParameterName') or ''}{sub}", section.line)
    if values is not None:
        for key, prefix in (("ParameterValue", ""), (OCTETS, OCTETS)):
            if given := values.get(f"{prefix}{sub}"):
                own.add(key, given, values.line)
    yield from _entry(own, sections, index, sub, node_id)


def _data_type(section: ini.Section, sections: Mapping[str, ini.Section]) -> DataType | None:
    """Return the section's type; a vendor-specific type (CANFestival's [A0] sections) is followed once, else a
    DOMAIN."""
    code = number(section.get("DataType"))
    if code is None:
        return DataType.DOMAIN if number(section.get("ObjectType")) == DOMAIN_OBJECT else None
    if code not in BY_CODE and (base := sections.get(f"{code:x}sub1")):
        code = number(base.get("DefaultValue")) or 0
    return BY_CODE.get(code, DataType.DOMAIN)


def _objects(sections: Mapping[str, ini.Section], entries: Mapping[int, Entry]) -> dict[int, Object]:
    subs: dict[int, list[int]] = {}
    for at in sorted(entries):
        subs.setdefault(at >> 8, []).append(at & 0xFF)
    heads = {place[0]: s for s in sections.values() if (place := object_section(s.name)) and place[1] is None}
    return {
        index: Object(index, (heads[index].get("ParameterName") if index in heads else None) or f"{index:04X}",
                      (number(heads[index].get("ObjectType")) if index in heads else RECORD) or VAR,
                      tuple(subs.get(index, ())))
        for index in sorted({*heads, *subs})
    }


def _emergencies(sections: Iterable[ini.Section]) -> dict[int, str]:
    """Read the maker's EMCY error codes, `0xFF01=text`, from sections such as [EmcyCodes] or [EmergencyErrorCodes].

    CiA 306 has no such section, so that its name is left to the maker.
    """
    return {code: item.value for section in sections if _EMERGENCIES.fullmatch(section.name)
            for item in section.items if (code := number(item.key)) is not None and 0 <= code <= 0xFFFF}


def _dummies(section: ini.Section | None) -> frozenset[int]:
    """Data types that may be mapped as dummies, from [DummyUsage] (CiA 306, 4.4.5)."""
    if section is None:
        return frozenset()
    used = (item for item in section.items if number(item.value))
    return frozenset(int(item.key[5:], 16) for item in used if _DUMMY.fullmatch(item.key))
