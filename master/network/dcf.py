"""A node's parameters as DCF: read from the node, compared with it, written back to it.

Parameters are objects that an EDS marks rw and no PDO carries, less commands and history. A DCF is the device's own
EDS with their values in it, so any CANopen tool reads it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from eds.cia301 import SIGNATURE_SAVE
from eds.datatype import Value, decode, encode
from eds.dictionary import Dictionary, Entry, key
from eds.files import ini
from master.network.link import Link
from master.network.sdo import SdoError
from parameters import InputError

VERIFY: Final = 0x1020
SAVE: Final = 0x1010
_COMMANDS: Final = frozenset({0x1003, SAVE, 0x1011, VERIFY, 0x2020, 0x6040, 0x6060, 0x6125})
_PDOS: Final = range(0x1400, 0x1C00)
"""PDO objects, which bring-up writes in the order of the standard."""
_EPOCH: Final = datetime(1984, 1, 1)
_SECTION: Final = re.compile(r"^\s*\[([^\]]*)\]")
_GIVEN: Final = re.compile(r"^\s*ParameterValue\s*=", re.IGNORECASE)


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


def parameters(dictionary: Dictionary) -> Iterator[Entry]:
    """The entries that are a device's parameters, in the order of their indices."""
    for place in sorted(dictionary.entries):
        entry = dictionary.entries[place]
        if entry.access == "rw" and entry.index not in _COMMANDS and entry.index not in _PDOS and not entry.mappable:
            yield entry


def backup(link: Link, node: DescribedNode, unread: list[str] | None = None) -> dict[int, Value]:
    """Read every parameter of a node, by key; parameters that the node refuses are left out and named in `unread`."""
    found: dict[int, Value] = {}
    for entry in parameters(node.dictionary):
        value = _value(link, node.node_id, entry)
        if value is not None:
            found[entry.key] = value
        elif unread is not None:
            unread.append(f"{entry.index:04X}h:{entry.subindex:02X} {entry.name}")
    return found


def _value(link: Link, node_id: int, entry: Entry) -> Value | None:
    try:
        return decode(entry.data_type, link.sdo_read(node_id, entry.index, entry.subindex))
    except (SdoError, ValueError):
        return None


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


def as_dcf(dictionary: Dictionary, node_id: int, values: Mapping[int, Value]) -> str:
    """Return a device's EDS as text, with `values` as ParameterValue and the node's id in [DeviceComissioning]."""
    names = {}
    for place, value in values.items():
        entry = dictionary.entries[place]
        short, full = f"{entry.index:04x}", f"{entry.index:04x}sub{entry.subindex:x}"
        names[full] = value
        if not entry.subindex:
            names.setdefault(short, value)
    lines: list[str] = []
    for line in ini.decode(Path(dictionary.path).read_bytes()).splitlines():
        if _GIVEN.match(line):
            continue
        lines.append(line)
        section = _SECTION.match(line)
        if section and (found := names.get(section[1].strip().lower())) is not None:
            lines.append(f"ParameterValue={_shown(found)}")
    return "\n".join([*lines, "", "[DeviceComissioning]", f"NodeID={node_id}", ""])


def _shown(value: Value) -> str:
    if isinstance(value, bytes):
        return value.decode("ascii", "replace") if value.isascii() else value.hex()
    return repr(value)


def compare(link: Link, node: DescribedNode, file: Dictionary) -> list[ParameterDifference]:
    """The parameters that the file gives a value and the node holds another one for."""
    return [
        ParameterDifference(entry.index, entry.subindex, entry.name, entry.value, found)
        for entry in parameters(file)
        if entry.value is not None and (found := _value(link, node.node_id, entry)) != entry.value
    ]


def restore(link: Link, node: DescribedNode, file: Dictionary) -> list[ParameterDifference]:
    """Write the differences and the file's date (0x1020), store them in the node (0x1010), and return the
    differences.

    Raises `InputError` if the node refuses a value.
    """
    differences = compare(link, node, file)
    for difference in differences:
        entry = file.entries[key(difference.object, difference.subindex)]
        try:
            link.sdo_write(node.node_id, entry.index, entry.subindex, encode(entry.data_type, difference.in_file))
        except SdoError as error:
            raise InputError(f"{file.path}: {entry.name} = {difference.in_file!r} is refused ({error}); "
                             "mend it or leave it out.") from None
    for subindex in (1, 2):
        told = file.entries.get(key(VERIFY, subindex))
        if told is not None and told.value:
            link.sdo_write(node.node_id, VERIFY, subindex, encode(told.data_type, told.value))
    if key(SAVE, 1) in node.dictionary.entries:
        link.sdo_write(node.node_id, SAVE, 1, SIGNATURE_SAVE.to_bytes(4, "little"))
    return differences


def stamp(dictionary: Dictionary, moment: datetime) -> dict[int, Value]:
    """0x1020 of a configuration made at `moment`: days since 1984-01-01, ms since midnight; empty without 0x1020."""
    midnight = moment.replace(hour=0, minute=0, second=0, microsecond=0)
    values = (moment - _EPOCH).days, (moment - midnight) // timedelta(milliseconds=1)
    return {key(VERIFY, sub): value for sub, value in enumerate(values, 1) if key(VERIFY, sub) in dictionary.entries}
