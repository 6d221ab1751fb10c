"""A node's parameters as DCF: read from the node, compared with it, written back to it.

Parameters are objects that an EDS marks rw and no PDO carries, less commands and history, and the settings of the PDOs.
A DCF is the device's own EDS with their values in it, so any CANopen tool reads it.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from eds.cia301 import COB_ID_INVALID, SIGNATURE_SAVE, Abort
from eds.datatype import DataType, Value, decode, encode
from eds.dictionary import NO_OCTETS, OCTETS, Dictionary, Entry, key
from eds.files import ini
from eds.files.notation import number, object_section, text_of
from eds.files.notation import value as value_of
from master.network.link import Link
from master.network.sdo import SdoError
from parameters import InputError

VERIFY: Final = 0x1020
SAVE: Final = 0x1010
_COMMANDS: Final = frozenset({0x1003, SAVE, 0x1011, VERIFY, 0x2020, 0x6040, 0x6060, 0x6125})
PDO_SETTINGS: Final = range(0x1400, 0x1600), range(0x1800, 0x1A00)
"""Communication parameters of RPDOs and TPDOs; each PDO's mapping is 0x200 above."""
PDO_MAPPING: Final = 0x200
_EPOCH: Final = datetime(1984, 1, 1)
_SECTION: Final = re.compile(r"^\s*\[([^\]]*)\]")
_STATED: Final = re.compile(rf"^\s*({OCTETS}|ParameterValue)\s*=", re.IGNORECASE)
_COMMISSIONING: Final = ("devicecomissioning", "devicecommissioning")


class DescribedNode(Protocol):
    """Interface of a node with its dictionary, such as `eds.bench.bench_network.NodeEntry`; `name` is for messages."""

    @property
    def node_id(self) -> int: ...

    @property
    def name(self) -> str: ...

    @property
    def dictionary(self) -> Dictionary: ...


class NamedNode(NamedTuple):
    """A node outside the bench's declaration, as a `DescribedNode`."""

    node_id: int
    name: str
    dictionary: Dictionary


class ParameterDifference(NamedTuple):
    """A parameter whose value on the node differs from the file."""

    object: int
    subindex: int
    name: str
    in_file: Value
    on_node: Value | None


class Download(NamedTuple):
    """One SDO download of a configuration."""

    object: int
    subindex: int
    data: bytes


def parameters(dictionary: Dictionary) -> Iterator[Entry]:
    """The entries that are a device's parameters, in the order of their indices."""
    for place in sorted(dictionary.entries):
        entry = dictionary.entries[place]
        if entry.access == "rw" and entry.index not in _COMMANDS and not entry.mappable:
            yield entry


def backup(link: Link, node: DescribedNode, unread: list[str] | None = None) -> dict[int, Value]:
    """Read every parameter of a node, by key; parameters that the node refuses are left out and named in `unread`.

    A string or domain without data (abort 0x08000024) is empty. Mapping words beyond the number of mapped objects are
    left out.
    """
    found: dict[int, Value] = {}
    for entry in parameters(node.dictionary):
        if _unused(entry, found):
            continue
        value = _value(link, node.node_id, entry)
        if value is not None:
            found[entry.key] = value
        elif unread is not None:
            unread.append(f"{entry.index:04X}h:{entry.subindex:02X} {entry.name}")
    return found


def _unused(entry: Entry, values: Mapping[int, Value | None]) -> bool:
    """Return whether an entry is a mapping word beyond the number of mapped objects."""
    count = values.get(key(entry.index))
    return _pdo_of(entry.index) not in (None, entry.index) and isinstance(count, int) and entry.subindex > count


def _pdo_of(index: int) -> int | None:
    """Return the communication parameter's index of a PDO that `index` belongs to; None for other objects."""
    return next((at for at in (index, index - PDO_MAPPING) for settings in PDO_SETTINGS if at in settings), None)


def _value(link: Link, node_id: int, entry: Entry) -> Value | None:
    try:
        data = link.sdo_read(node_id, entry.index, entry.subindex)
        value = decode(entry.data_type, data)
    except SdoError as error:
        return b"" if error.code == Abort.NO_DATA and not entry.data_type.size else None
    except ValueError:
        return None
    return value if entry.data_type is DataType.BOOLEAN or encode(entry.data_type, value) == data else None


IDENTITY: Final = ((0x1000, 0, "device type"), (0x1018, 1, "vendor"), (0x1018, 2, "product code"))


def refuse_other(link: Link, node: DescribedNode, dictionary: Dictionary, what: str) -> None:
    """Raise `InputError` if the node on the bus is another device than that of `dictionary`.

    Compares device type (0x1000), vendor and product (0x1018); an identity that the dictionary does not state is not
    read.
    """
    for index, subindex, name in IDENTITY:
        entry = dictionary.entries.get(key(index, subindex))
        expected = None if entry is None else entry.default if entry.value is None else entry.value
        if entry is None or not isinstance(expected, int) or not expected:
            continue
        found = _value(link, node.node_id, entry)
        if found != expected:
            told = f"says {found:#x}" if isinstance(found, int) else "does not tell it"
            raise InputError(f"{what}: is of another device than {node.name} (node {node.node_id}): its {name} "
                             f"({index:04X}h:{subindex:02X}) is {expected:#x}, the node {told}; "
                             "nothing was written.")


# ---- the file ----


def as_dcf(dictionary: Dictionary, node_id: int, values: Mapping[int, Value]) -> str:
    """Return a device's EDS as text, with `values` as ParameterValue and the node's id in [DeviceComissioning].

    A string that text cannot hold is given by its octets (`eds.dictionary.OCTETS`). Elements of a CompactSubObj array
    stand in [xxxxValue] (CiA 306).
    """
    source = ini.decode(Path(dictionary.path).read_bytes()).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    sections = {place for line in source if (match := _SECTION.match(line)) and (place := object_section(match[1]))}
    compact = {at >> 8 for at in values if at & 0xFF and (at >> 8, at & 0xFF) not in sections}
    lines: list[str] = []
    name = ""
    for line in source:
        section = _SECTION.match(line)
        if section:
            name = section[1].strip().lower()
        elif _replaced(line, name):
            continue
        if _elements_of(name) not in compact:
            lines.append(line)
        if section and name in _COMMISSIONING:
            lines.append(f"NodeID={node_id}")
        elif section and (place := object_section(name)) is not None:
            at = _stated_at(place, sections)
            if at in values:
                lines += _stated(dictionary.entries[at], values[at])
    for index in sorted(compact):
        lines += _compact_values(dictionary, index, values)
    if not any(line.strip().lower().strip("[]") in _COMMISSIONING for line in lines):
        lines += ["", "[DeviceComissioning]", f"NodeID={node_id}"]
    return "\n".join([*lines, ""])


def _replaced(line: str, section: str) -> bool:
    """Return whether a line of the source gives way to this backup: an object's value, or the node id."""
    if section in _COMMISSIONING:
        return line.partition("=")[0].strip().lower() == "nodeid"
    return _STATED.match(line) is not None and object_section(section) is not None


def _elements_of(name: str) -> int | None:
    """Return the index of a section that lists the elements of a compact array, such as [2000Value]; else None."""
    return number(f"0x{name[:4]}") if len(name) == 9 and name.endswith("value") else None


def _stated_at(place: tuple[int, int | None], sections: set[tuple[int, int | None]]) -> int:
    """Return the key whose value a section states: a sub-object's, or sub-object 0 if that has no section; else -1."""
    index, subindex = place
    if subindex is None and any(at == index and sub is not None for at, sub in sections):
        return -1
    return key(index, subindex or 0)


def _stated(entry: Entry, value: Value, where: str = "") -> Iterator[str]:
    """Yield the line of a value; `where` is the element's number in a compact array."""
    text = text_of(entry.data_type, value)
    if text is not None and _read_back(text) == (text or None):
        if text:
            yield f"{where or 'ParameterValue'}={text}"
        elif not entry.data_type.size:
            yield f"{OCTETS}{where}={NO_OCTETS}"
        return
    assert isinstance(value, bytes)
    yield f"{OCTETS}{where}={value.hex(' ').upper()}"


def _read_back(text: str) -> str | None:
    """Return the value that a file with `text` gives."""
    return next(ini.parse(f"[x]\nParameterValue={text}\n")).get("ParameterValue")


def _compact_values(dictionary: Dictionary, index: int, values: Mapping[int, Value]) -> Iterator[str]:
    """Yield the section [xxxxValue] of a compact array."""
    elements = {at & 0xFF: value for at, value in values.items() if at >> 8 == index and at & 0xFF}
    yield from ("", f"[{index:04X}Value]", f"NrOfEntries={len(elements)}")
    for sub, value in sorted(elements.items()):
        yield from _stated(dictionary.entries[key(index, sub)], value, str(sub))


def refuse_unreadable(file: Dictionary) -> None:
    """Raise `InputError` for a file with a value that cannot be read, or that a backup would not write alike."""
    for section in ini.read(Path(file.path)):
        place = object_section(section.name)
        text = section.get(OCTETS) or section.get("ParameterValue")
        entry = None if place is None else file.entries.get(key(place[0], place[1] or 0))
        if entry is None or text is None:
            continue
        held = entry.value
        if held is None or not _holds(entry, held):
            raise InputError(f"{file.path}:{section.line_of('ParameterValue')}: [{section.name}] {text!r} is no "
                             f"{entry.data_type.name}; mend it or leave it out; nothing was written.")


def _holds(entry: Entry, held: Value) -> bool:
    try:
        data = encode(entry.data_type, held)
    except (OverflowError, TypeError):
        return False
    text = text_of(entry.data_type, held)
    again = held if text is None or not text else value_of(entry.data_type, text)
    return again is not None and encode(entry.data_type, again) == data and len(data) == (
        entry.data_type.size or len(data))


# ---- the node ----


def compare(link: Link, node: DescribedNode, file: Dictionary) -> list[ParameterDifference]:
    """The parameters that the file gives a value and the node holds another one for."""
    given = {entry.key: entry.value for entry in parameters(file)}
    return [
        ParameterDifference(entry.index, entry.subindex, entry.name, entry.value, found)
        for entry in parameters(file)
        if entry.value is not None and not _unused(entry, given)
        and not _equal(entry, found := _value(link, node.node_id, entry))
    ]


def _equal(entry: Entry, found: Value | None) -> bool:
    if found is None or entry.value is None:
        return False
    return encode(entry.data_type, found) == encode(entry.data_type, entry.value)


def restore(link: Link, node: DescribedNode, file: Dictionary) -> list[ParameterDifference]:
    """Write the differences and the file's date (0x1020), store them in the node (0x1010), and return the
    differences.

    Raises `InputError` for a file with unreadable values, before the first write, and if the node refuses a value.
    """
    refuse_unreadable(file)
    differences = compare(link, node, file)
    for download in downloads(file, differences):
        try:
            link.sdo_write(node.node_id, *download)
        except SdoError as error:
            entry = file.entries[key(download.object, download.subindex)]
            raise InputError(f"{file.path}: {entry.name} = {entry.value!r} is refused ({error}); "
                             "mend it or leave it out.") from None
    for subindex in (1, 2):
        told = file.entries.get(key(VERIFY, subindex))
        if told is not None and told.value:
            link.sdo_write(node.node_id, VERIFY, subindex, encode(told.data_type, told.value))
    if key(SAVE, 1) in node.dictionary.entries:
        link.sdo_write(node.node_id, SAVE, 1, SIGNATURE_SAVE.to_bytes(4, "little"))
    return differences


def downloads(file: Dictionary, differences: Iterable[ParameterDifference]) -> Iterator[Download]:
    """Yield the SDO downloads that make a node hold the file's values, in the order of CiA 301 (7.5.2.36).

    A PDO is made invalid, then its parameters, its mapping with the number of objects 0, the number, and its COB-ID.
    """
    changed: dict[int, ParameterDifference] = {key(one.object, one.subindex): one for one in differences}
    pdos = sorted({pdo for at in changed if (pdo := _pdo_of(at >> 8)) is not None})
    for at, one in sorted(changed.items()):
        if _pdo_of(at >> 8) is None:
            yield Download(one.object, one.subindex, encode(file.entries[at].data_type, one.in_file))
    for pdo in pdos:
        yield from _pdo_downloads(file, pdo, changed)


def _pdo_downloads(file: Dictionary, pdo: int, changed: Mapping[int, ParameterDifference]) -> Iterator[Download]:
    def raw(at: int) -> bytes:
        entry = file.entries[at]
        return encode(entry.data_type, entry.initial)

    cob_id = key(pdo, 1)
    entry = file.entries.get(cob_id)
    wanted = None if entry is None or not entry.writable else entry.initial
    if isinstance(wanted, int):
        held = changed[cob_id].on_node if cob_id in changed else wanted
        old = held if isinstance(held, int) else wanted
        yield Download(pdo, 1, (old | COB_ID_INVALID).to_bytes(4, "little"))
    for at in sorted(changed):
        if at >> 8 == pdo and at != cob_id:
            yield Download(pdo, at & 0xFF, raw(at))
    mapping = pdo + PDO_MAPPING
    if any(at >> 8 == mapping for at in changed):
        count = file.initial(mapping)
        yield Download(mapping, 0, b"\0")
        for sub in range(1, count + 1):
            if key(mapping, sub) in file.entries:
                yield Download(mapping, sub, raw(key(mapping, sub)))
        yield Download(mapping, 0, bytes((count,)))
    if isinstance(wanted, int):
        yield Download(pdo, 1, wanted.to_bytes(4, "little"))


def concise(file: Dictionary) -> bytes:
    """Return a DCF's values as concise DCF, the content of 0x1F22 (CiA 302-3): a configuration manager downloads it.

    32 bits with the number of downloads; then index, sub-index, 32 bits with the size, and the data of each.
    """
    refuse_unreadable(file)
    given = {entry.key: entry.value for entry in parameters(file)}
    stated = [ParameterDifference(entry.index, entry.subindex, entry.name, entry.value, None)
              for entry in parameters(file) if entry.value is not None and not _unused(entry, given)]
    found = list(downloads(file, stated))
    return len(found).to_bytes(4, "little") + b"".join(
        one.object.to_bytes(2, "little") + bytes((one.subindex,)) + len(one.data).to_bytes(4, "little") + one.data
        for one in found)


def stamp(dictionary: Dictionary, moment: datetime) -> dict[int, Value]:
    """0x1020 of a configuration made at `moment`: days since 1984-01-01, ms since midnight; empty without 0x1020."""
    midnight = moment.replace(hour=0, minute=0, second=0, microsecond=0)
    values = (moment - _EPOCH).days, (moment - midnight) // timedelta(milliseconds=1)
    return {key(VERIFY, sub): value for sub, value in enumerate(values, 1) if key(VERIFY, sub) in dictionary.entries}
