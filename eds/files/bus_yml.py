"""`bus.yml`, the bus configuration of ros2_canopen and Lely's dcfgen: devices, node ids, EDS files, PDOs, SDO list.

Unknown entries are kept: a file that is read and written again has the same content. Comments are not content.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from eds.cia305 import UNCONFIGURED
from parameters import InputError
from parameters.files import content as file_content
from parameters.files import write_whole

LONGEST: Final = 1 << 18
"""Bytes of a file: a bus of 127 devices with every PDO has fewer. PyYAML reads them in about three seconds."""
MOST_NODES: Final = 1 << 17
"""Values of a file with every alias written out: more than `LONGEST` bytes hold without aliases."""
_SECTIONS: Final = ("options", "master", "defaults", "nodes")
_PDO_KEYS: Final = ("enabled", "cob_id", "transmission", "inhibit_time", "event_timer", "mapping")
_HEX: Final = ("index", "cob_id", "vendor_id", "product_code", "revision_number", "serial_number", "error_behavior")
"""Keys whose numbers are written in hexadecimal."""


@dataclass(frozen=True)
class BusPdo:
    """One PDO of a device: `name` such as tpdo1, mapping as (index, sub); None for values that the EDS gives.

    `cob_id` "auto" is the identifier of CiA 301's default connection set; `inhibit` in 100 µs, `event_timer` in ms.
    """

    name: str
    enabled: bool = True
    cob_id: int | str | None = None
    transmission: int | None = None
    inhibit: int | None = None
    event_timer: int | None = None
    mapping: tuple[tuple[int, int], ...] | None = None
    other: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class BusYmlDevice:
    """One device: name, node id (255: that of its DCF), EDS as the file names it, PDOs, writes at start, other keys.

    A write is (index, sub, value).
    """

    name: str
    node_id: int
    eds: str
    pdos: tuple[BusPdo, ...] = ()
    writes: tuple[tuple[int, int, Any], ...] = ()
    other: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class BusYml:
    """One bus.yml file; `path` names it in messages, `content` is its parsed content."""

    path: str
    content: Mapping[str, Any]

    @property
    def master(self) -> Mapping[str, Any]:
        """The master's section."""
        return dict(self.content.get("master") or {})

    @property
    def devices(self) -> tuple[BusYmlDevice, ...]:
        """The devices, with the file's defaults; raises `InputError` where one makes no sense."""
        defaults = _mapping(self.path, "defaults", self.content.get("defaults"))
        found = tuple(_device(self.path, name, {**defaults, **keys}) for name, keys in self._named())
        for what in ("name", "node_id"):
            given = [getattr(one, what) for one in found]
            if twice := [one for one in given if given.count(one) > 1 and one != UNCONFIGURED]:
                raise InputError(f"{self.path}: {what} = {twice[0]} is given twice; give each device its own.")
        return found

    def _named(self) -> Iterable[tuple[str, Mapping[str, Any]]]:
        """Yield the devices' sections: below `nodes`, as a mapping or a list of them, or beside `master`."""
        nodes = self.content.get("nodes") or {}
        listed = nodes if isinstance(nodes, list) else [nodes]
        for group in (*listed, {key: value for key, value in self.content.items() if key not in _SECTIONS}):
            if not isinstance(group, Mapping):
                raise InputError(f"{self.path}: nodes: {group!r} is no device; write its name, and its keys below.")
            for name, keys in group.items():
                if not isinstance(keys, Mapping):
                    raise InputError(f"{self.path}: {name}: {keys!r} are no keys of a device; write node_id and dcf.")
                yield str(name), keys


def read(path: Path) -> BusYml:
    """Read a file; raises `InputError` where it cannot be read or is no bus configuration."""
    yaml = _yaml()
    raw = file_content(path, "a bus.yml", limit=LONGEST)
    try:
        text = raw.decode("utf-8")
        if _size(yaml.compose(text, Loader=yaml.SafeLoader), yaml, {}) > MOST_NODES:
            raise InputError(f"{path}: its aliases stand for more than {MOST_NODES} values; it is no bus.yml.")
        content = yaml.load(text, Loader=yaml.SafeLoader)
    except InputError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no YAML ({' '.join(str(error).split())}); give a bus.yml.") from None
    if not isinstance(content, Mapping) or not isinstance(content.get("master"), Mapping):
        raise InputError(f"{path}: has no section `master`; give a bus.yml of ros2_canopen.")
    return BusYml(str(path), content)


def of_devices(devices: Iterable[BusYmlDevice], master: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a file that has these devices."""
    return {"master": dict(master), "nodes": {one.name: _keys(one) for one in devices}}


def text_of(content: Mapping[str, Any]) -> str:
    """Return the text of a file; indices and identities are hexadecimal."""
    yaml = _yaml()

    class Dumper(yaml.SafeDumper):  # type: ignore[name-defined,misc]
        def ignore_aliases(self, data: Any) -> bool:
            return True

    Dumper.add_representer(_HexNumber, lambda dumper, number: dumper.represent_scalar(
        "tag:yaml.org,2002:int", f"0x{number:X}"))
    return str(yaml.dump(_with_hex(content), Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120))


def write(path: Path, content: Mapping[str, Any], *, overwrite: bool = False) -> None:
    """Write a file whole."""
    write_whole(path, text_of(content), overwrite=overwrite)


def _size(node: Any, yaml: Any, known: dict[int, int]) -> int:
    """Return the number of values that a node of a YAML file stands for, each alias counted as a copy.

    A node that contains itself counts as more than `MOST_NODES`.
    """
    if id(node) not in known:
        known[id(node)] = MOST_NODES
        below = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else (
            node.value if isinstance(node, yaml.SequenceNode) else [])
        known[id(node)] = 1 + sum(_size(part, yaml, known) for part in below)
    return known[id(node)]


class _HexNumber(int):
    """A number that is written in hexadecimal."""


def _with_hex(value: Any, key: str = "") -> Any:
    if isinstance(value, Mapping):
        return {name: _with_hex(one, str(name)) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_with_hex(one, key) for one in value]
    return _HexNumber(value) if key in _HEX and type(value) is int and value >= 0 else value


def _device(path: str, name: str, keys: Mapping[str, Any]) -> BusYmlDevice:
    own = dict(keys)
    where = f"{path}: {name}"
    node_id = _number(where, "node_id", own.pop("node_id", UNCONFIGURED))
    pdos = [_pdo(where, kind, number, one)
            for kind in ("rpdo", "tpdo") for number, one in _mapping(where, kind, own.pop(kind, None)).items()]
    writes = own.pop("sdo", None) or []
    if not isinstance(writes, list) or not all(isinstance(one, Mapping) and "value" in one for one in writes):
        raise InputError(f"{where}: sdo: expected a list of {{index, sub_index, value}}; write it so.")
    return BusYmlDevice(name, node_id, str(own.pop("dcf", "")), tuple(pdos), tuple(
        (*_place(f"{where}: sdo", one), one["value"]) for one in writes), own)


def _pdo(device: str, kind: str, number: Any, keys: Any) -> BusPdo:
    name, where = f"{kind}{number}", f"{device}: {kind}: {number}"
    if type(number) is not int or not 1 <= number <= 512:
        raise InputError(f"{where}: is no number of a PDO; write 1 to 512.")
    own = _mapping(where, name, keys)
    known = {key: own.pop(key) for key in _PDO_KEYS if key in own}
    mapped = known.get("mapping")
    if mapped is not None and not (isinstance(mapped, list) and all(isinstance(one, Mapping) for one in mapped)):
        raise InputError(f"{where}: mapping = {mapped!r}: expected a list of {{index, sub_index}}; write it so.")
    cob_id = known.get("cob_id")
    transmission, inhibit, timer = (
        None if known.get(key) is None else _number(where, key, known[key])
        for key in ("transmission", "inhibit_time", "event_timer"))
    return BusPdo(name, bool(known.get("enabled", True)),
                  cob_id if cob_id in (None, "auto") else _number(where, "cob_id", cob_id),
                  transmission, inhibit, timer,
                  None if mapped is None else tuple(_place(where, one) for one in mapped), own)


def _keys(device: BusYmlDevice) -> dict[str, Any]:
    """Return the keys of a device's section."""
    keys: dict[str, Any] = {"node_id": device.node_id, **({"dcf": device.eds} if device.eds else {}), **device.other}
    for pdo in device.pdos:
        keys.setdefault(pdo.name[:4], {})[int(pdo.name[4:])] = _pdo_keys(pdo)
    if device.writes:
        keys["sdo"] = [{"index": index, "sub_index": sub, "value": value} for index, sub, value in device.writes]
    return keys


def _pdo_keys(pdo: BusPdo) -> dict[str, Any]:
    given = {"enabled": pdo.enabled, "cob_id": pdo.cob_id, "transmission": pdo.transmission,
             "inhibit_time": pdo.inhibit, "event_timer": pdo.event_timer}
    mapped = {} if pdo.mapping is None else {
        "mapping": [{"index": index, "sub_index": sub} for index, sub in pdo.mapping]}
    return {**{key: value for key, value in given.items() if value is not None}, **pdo.other, **mapped}


def _place(where: str, keys: Mapping[str, Any]) -> tuple[int, int]:
    return _number(where, "index", keys.get("index")), _number(where, "sub_index", keys.get("sub_index", 0))


def _mapping(where: str, key: str, given: Any) -> dict[Any, Any]:
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: {key} = {given!r}: expected keys below it; write them so.")
    return dict(given)


def _number(where: str, key: str, given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, int) or given < 0:
        raise InputError(f"{where}: {key} = {given!r} is no number; write one, such as 0x6041.")
    return given


def _yaml() -> Any:
    try:
        import yaml
    except ImportError:
        raise InputError("bus.yml needs PyYAML; pip install 'bowden-bench[ros]'.") from None
    return yaml
