"""Declaration of a bench: its devices, its joints and its force paths, read from `bench.toml`.

A declaration states how devices, joints and ropes are connected. `eds.bench.bench_network` derives the wire from it:
COB-IDs, PDO plans, shared frames, set-up. Without `[[device]]` tables the packaged `bench.toml` holds, the bench of
the paper.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeVar

from eds import cia402
from eds.device_mapping import DeviceMapping, EncoderMapping, KneeMapping, SensorMapping, ServoMapping
from parameters import InputError, declarations, from_table, read_toml
from parameters.plugins import load

T = TypeVar("T")
TABLES: Final = ("device", "joint", "force_path")
"""Arrays of tables that declare a bench; a file has all of them or none."""
SHAPES: Final = ("bench", "bench_start_only", "bench_no_knee_drive", "bench_antagonists", "bench_two_legs")
"""Packaged declarations; `bowden init --shape` writes them."""
FLEXES, EXTENDS = "flexes", "extends"
"""Values of `acts`: a rope that shortens when the joint flexes, or its antagonist."""
LAST_NODE_ID: Final = 126
"""Largest node id of a device; 127 is the master's."""


@dataclass(frozen=True)
class ObservedPart:
    """Signal of an observer: the part that carries it, and its column `<device>_<ending>` in `/cycle` with its unit."""

    part: str
    ending: str
    unit: str
    text: str


@dataclass(frozen=True)
class DeviceType:
    """Kind of device: its EDS, its mapping table, the parts that it sends and takes, its safe stop.

    `file`: name of a packaged EDS, or the path of a plug-in's.  `safe_stop` lists (object, code) pairs that bring-up
    writes; a type that takes a target is a drive.  A type with `observed` signals is an observer: its parts are
    recorded and move nothing.  `application` makes what stands behind its simulated device, see docs/devices.md.
    """

    name: str
    file: str
    mapping: Callable[[], Any]
    sent: tuple[str, ...]
    taken: tuple[str, ...] = ()
    safe_stop: tuple[tuple[int, int], ...] = ()
    observed: tuple[ObservedPart, ...] = ()
    application: Callable[[], Any] | None = None


ROPE_DRIVE: Final = DeviceType(
    "rope_drive", "servo_drive", ServoMapping, ("statusword", "position", "torque"), ("target", "controlword"),
    ((0x6007, cia402.AbortConnection.DISABLE_VOLTAGE), (0x605A, cia402.Stop.QUICK_STOP_RAMP),
     (0x605E, cia402.Stop.DISABLE)))
"""Drive of a rope, in m. It never ends a stop by holding the rope, because the joint would load the rope."""
JOINT_DRIVE: Final = DeviceType(
    "joint_drive", "knee_drive", KneeMapping, ("statusword", "position"), ("target", "controlword"),
    ((0x6007, cia402.AbortConnection.QUICK_STOP), (0x605A, cia402.Stop.QUICK_STOP_RAMP),
     (0x605E, cia402.Stop.DISABLE)))
"""Drive of a joint, positions in rad. If the master fails, it brakes along the quick-stop ramp, then the torque is off.
After a fault of the drive the torque is off at once, since the ramp would rely on feedback that may have
failed; only a mechanical brake or stop can hold the joint then."""
LOAD_CELL: Final = DeviceType("load_cell", "tension_sensor", SensorMapping, ("value",))
"""Tension sensor, in N."""
JOINT_ENCODER: Final = DeviceType("joint_encoder", "joint_encoder", EncoderMapping, ("position",))
"""Encoder of a joint that no drive of the bench moves, in rad."""
TYPES: Final[Mapping[str, DeviceType]] = MappingProxyType(
    {one.name: one for one in (ROPE_DRIVE, JOINT_DRIVE, LOAD_CELL, JOINT_ENCODER)})
GROUP: Final = "bowden.devices"
"""Entry-point group of device types: a callable without arguments that returns a `DeviceType`."""


@dataclass(frozen=True)
class DeclaredDevice:
    """One node of the bench; `mapping` names the objects that play its parts."""

    name: str
    node_id: int
    type: DeviceType
    mapping: DeviceMapping


@dataclass(frozen=True)
class Joint:
    """One joint: the name of the drive that moves and measures it, or of the encoder that measures it.

    One of the two is empty. A joint without a drive is moved from outside, by hand or by another machine.
    """

    name: str
    driven_by: str = ""
    measured_by: str = ""

    @property
    def device(self) -> str:
        """Name of the device that measures the joint's angle."""
        return self.driven_by or self.measured_by


@dataclass(frozen=True)
class ForcePath:
    """One rope: names of its actuator, its joint and its load cells; an empty name means no such load cell.

    `acts` is `flexes`, or `extends` for an antagonist: its rope has the joint's angle mirrored, see `mirrored_rad`.
    """

    name: str
    actuator: str
    joint: str
    start: str = ""
    end: str = ""
    acts: str = FLEXES


MIRROR_RAD: Final = -1.1345
"""Sum of a joint's angle and of the angle by which an antagonist's path counts it, rad: -65 degrees, the flexion of the
paper's gait.  A rope that extends the joint is so a path like the paper's, taut where the flexor's rope is slack."""


def mirrored_rad(path: ForcePath, angle_rad: float) -> float:
    """Return a joint's angle, rad, in the sign convention of a force path; the same call converts it back."""
    return MIRROR_RAD - angle_rad if path.acts == EXTENDS else angle_rad


class PathNodes(NamedTuple):
    """Node ids of the devices of one force path; 0 where it has no such load cell."""

    servo: int
    knee: int
    start: int
    end: int


@dataclass(frozen=True)
class DeclaredBench:
    """A declared bench, checked: every name resolves, and every device has exactly one place."""

    devices: tuple[DeclaredDevice, ...]
    joints: tuple[Joint, ...]
    force_paths: tuple[ForcePath, ...]

    def named(self, name: str) -> DeclaredDevice:
        """Return the device of a name."""
        return next(device for device in self.devices if device.name == name)

    def start_of(self, actuator: str) -> DeclaredDevice | None:
        """Return the START load cell of the path that a device actuates; None without one."""
        path = next((path for path in self.force_paths if path.actuator == actuator), None)
        return self.named(path.start) if path is not None and path.start else None

    def mapped(self, mappings: Mapping[int, DeviceMapping]) -> DeclaredBench:
        """Return this bench with other mappings of some devices, by node id."""
        return dataclasses.replace(self, devices=tuple(
            dataclasses.replace(device, mapping=mappings.get(device.node_id, device.mapping))
            for device in self.devices))

    @property
    def bare(self) -> DeclaredBench:
        """Return this bench with packaged devices in every place."""
        return self.mapped({device.node_id: device.type.mapping() for device in self.devices})

    @property
    def measures_end(self) -> bool:
        """Whether every force path has an END load cell."""
        return all(path.end for path in self.force_paths)

    @property
    def path_prefixes(self) -> tuple[str, ...]:
        """Names of the force paths, by which a bench of several records its signals; ("",) of a single one."""
        return tuple(path.name for path in self.force_paths) if len(self.force_paths) > 1 else ("",)

    @property
    def followed(self) -> tuple[DeclaredDevice, ...]:
        """Encoders of the joints without a drive."""
        return tuple(self.named(joint.measured_by) for joint in self.joints if not joint.driven_by)

    @property
    def observers(self) -> tuple[DeclaredDevice, ...]:
        """Devices that are recorded and move nothing."""
        return tuple(device for device in self.devices if device.type.observed)

    def nodes_of(self, path: ForcePath) -> PathNodes:
        """Return the node ids of a force path's devices."""
        joint = next(joint for joint in self.joints if joint.name == path.joint)
        return PathNodes(*(self.named(name).node_id if name else 0
                           for name in (path.actuator, joint.device, path.start, path.end)))

    def roles(self, device: str, path: str | None) -> list[tuple[str, str]]:
        """Return force path and role there (servo, knee, start, end) of a device, on one path or on all (None)."""
        joints = {joint.name: joint.driven_by for joint in self.joints}
        return [(one.name, role) for one in self.force_paths if path in (None, one.name) for role, name in (
            ("servo", one.actuator), ("knee", joints.get(one.joint)), ("start", one.start), ("end", one.end))
            if name and name == device]

    def path(self, name: str) -> DeclaredBench:
        """Return the bench of one force path: its devices with their node ids, its joint, and no other.

        The devices have the names of the packaged bench, so that their recordings read like its trials.
        Observers belong to the first path.  Raises `InputError` for a path that is not declared.
        """
        path = next((path for path in self.force_paths if path.name == name), None)
        if path is None:
            raise InputError(f"path {name}: not declared; expected one of "
                             f"{', '.join(path.name for path in self.force_paths)}.")
        joint = next(joint for joint in self.joints if joint.name == path.joint)
        own = {path.actuator: "servo", joint.device: "knee", path.start: "start", path.end: "end"}
        devices = [dataclasses.replace(self.named(old), name=new) for old, new in own.items() if old]
        observers = self.observers if path is self.force_paths[0] else ()
        moved = {"driven_by" if joint.driven_by else "measured_by": "knee"}
        return DeclaredBench(
            (*devices, *observers), (Joint("knee", **moved),),
            (dataclasses.replace(path, actuator="servo", joint="knee", start="start" if path.start else "",
                                 end="end" if path.end else "", acts=FLEXES),))

    def refusal(self) -> str | None:
        """Return why no command can run this bench, in half a sentence; None where commands run it."""
        for path in self.force_paths:
            driven = next(joint.driven_by for joint in self.joints if joint.name == path.joint)
            if not path.start:
                return f"force_path {path.name} has no start, by which its force is controlled"
            if not (path.end or driven):
                return (f"force_path {path.name} has no end, and no drive moves its joint: nothing contradicts the "
                        "encoder of the joint")
            if not driven and len(self.force_paths) > 1:
                return f"joint {path.joint} has no drive, on a bench of several force paths"
        for joint in self.joints:
            acts = [path.acts for path in self.force_paths if path.joint == joint.name]
            if acts not in ([FLEXES], [FLEXES, EXTENDS]):
                return (f"joint {joint.name}: its force paths act as {', '.join(acts) or 'none'}; commands run one "
                        f"that {FLEXES}, and behind it at most one that {EXTENDS}")
        return None

    @property
    def other_devices(self) -> dict[str, DeviceMapping]:
        """Mappings, by name, of the devices that are not those of this project."""
        return {device.name: device.mapping for device in self.devices if device.mapping != device.type.mapping()}

    @property
    def shape(self) -> tuple[object, ...]:
        """Everything but the mappings: two benches of one shape differ in their devices' files, objects and scales."""
        return tuple((d.name, d.node_id, d.type) for d in self.devices), self.joints, self.force_paths


@functools.cache
def packaged(name: str = "bench") -> DeclaredBench:
    """Read a declaration that ships with this project; `bench` is the paper's."""
    return declared(tomllib.loads(text_of(name)), where=name)


def text_of(name: str) -> str:
    """Return the text of a declaration that ships with this project."""
    return (resources.files("eds") / f"{name}.toml").read_text(encoding="utf-8")


def read(given: str | Path | Mapping[str, Any], *, where: str) -> DeclaredBench:
    """Read the declared bench of a TOML file or of its tables; `where` names tables in messages."""
    if isinstance(given, Mapping):
        return declared(given, where=where)
    tables = read_toml(Path(given))
    return declared({name: tables.get(name) for name in TABLES}, where=str(given), folder=Path(given).parent)


def declared(tables: Mapping[str, Any], *, where: str, folder: Path | None = None) -> DeclaredBench:
    """Build the bench that `[[device]]`, `[[joint]]` and `[[force_path]]` declare; `where` names the file in messages.

    Files of devices are looked up from `folder`. Raises `InputError` for a name that does not resolve, a device
    without a place or with two, and a path without a load cell.
    """
    lacking = [name for name in TABLES if not tables.get(name)]
    if lacking:
        raise InputError(f"{where}: no [[{lacking[0]}]]; a declared bench has [[device]], [[joint]] and "
                         "[[force_path]], or none of them for the packaged bench.")
    bench = DeclaredBench(
        tuple(_device(row, at, folder) for row, at in _rows(tables, "device", where)),
        tuple(_texts(Joint, row, at) for row, at in _rows(tables, "joint", where)),
        tuple(_texts(ForcePath, row, at) for row, at in _rows(tables, "force_path", where)))
    _check(bench, where)
    return bench


def as_tables(bench: DeclaredBench) -> dict[str, list[dict[str, Any]]]:
    """Return the tables that declare a bench, as `declared` reads them; keys that keep their default are left out."""
    devices = [{"name": one.name, "node_id": one.node_id, "type": one.type.name} | _given(one.mapping)
               for one in bench.devices]
    return {"device": devices, "joint": [_named(one) for one in bench.joints],
            "force_path": [_named(one) for one in bench.force_paths]}


def _named(one: Joint | ForcePath) -> dict[str, Any]:
    return {key: name for key, name in dataclasses.asdict(one).items() if name and (key, name) != ("acts", FLEXES)}


def _given(mapping: DeviceMapping) -> dict[str, Any]:
    return {name: getattr(mapping, name) for name, default, _ in declarations(type(mapping))
            if getattr(mapping, name) != default}


def as_json(bench: DeclaredBench) -> str:
    """Return the tables of a bench as one JSON text; empty for the packaged bench."""
    return "" if bench == packaged() else json.dumps(as_tables(bench))


def from_json(text: str, *, where: str) -> DeclaredBench:
    """Return the bench that `as_json` wrote; `where` names its source in messages."""
    return declared(json.loads(text), where=where) if text else packaged()


def _rows(tables: Mapping[str, Any], name: str, where: str) -> Iterable[tuple[dict[str, Any], str]]:
    rows = tables[name]
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{where}: {name} is no array of tables; write each as [[{name}]].")
    for number, row in enumerate(rows, 1):
        yield row, f"{where} [[{name}]] {number}"


def _device(row: dict[str, Any], where: str, folder: Path | None) -> DeclaredDevice:
    mapped = dict(row)
    name, node_id, kind = (mapped.pop(key, None) for key in ("name", "node_id", "type"))
    _refuse_name(name, where)
    if not isinstance(node_id, int) or isinstance(node_id, bool) or not 1 <= node_id <= LAST_NODE_ID:
        raise InputError(f"{where}: node_id = {node_id!r} is no whole number from 1 to {LAST_NODE_ID}; give the "
                         "device's node id.")
    found = _type(kind, where)
    if folder is not None and isinstance(mapped.get("file"), str) and mapped["file"]:
        mapped["file"] = str(folder / mapped["file"])
    mapping: Any = found.mapping
    return DeclaredDevice(str(name), node_id, found, from_table(mapping, mapped, where=where))


def _type(kind: object, where: str) -> DeviceType:
    """Return a device type of this project or of the entry-point group; raises `InputError`."""
    if kind in TYPES:
        return TYPES[str(kind)]
    installed = {entry.name for entry in entry_points(group=GROUP)}
    if kind not in installed:
        raise InputError(f"{where}: type = {kind!r} is unknown; expected one of {', '.join((*TYPES, *installed))}, or "
                         f"install what offers it as an entry point of {GROUP}.")
    found = load("device type", str(kind), GROUP, {})()
    if not isinstance(found, DeviceType) or not found.observed or found.taken:
        raise InputError(f"{where}: type = {kind!r}: its entry point returns no DeviceType that has observed signals "
                         "and takes nothing; mend the plug-in.")
    return found


def _texts(cls: type[T], row: dict[str, Any], where: str) -> T:
    for key, value in row.items():
        if not isinstance(value, str):
            raise InputError(f"{where}: {key} = {value!r} is not a text; give a name.")
    _refuse_name(row.get("name"), where)
    return from_table(cls, row, where=where)


def _refuse_name(name: object, where: str) -> None:
    if not isinstance(name, str) or not name.isidentifier() or name == "master":
        raise InputError(f"{where}: name = {name!r} is no name of letters, digits and _ (master is taken); give one.")


def _check(bench: DeclaredBench, where: str) -> None:
    for what, names in (("device", [d.name for d in bench.devices]), ("node_id", [d.node_id for d in bench.devices]),
                        ("joint", [j.name for j in bench.joints]), ("force_path", [p.name for p in bench.force_paths])):
        _refuse_twice(where, what, names)
    used = [device for joint in bench.joints for device in _moved(bench, where, joint)]
    for path in bench.force_paths:
        used += _of(bench, where, f"force_path {path.name}", ROPE_DRIVE, {"actuator": path.actuator})
        cells = {key: name for key, name in (("start", path.start), ("end", path.end)) if name}
        if not cells:
            raise InputError(f"{where}: force_path {path.name} has neither start nor end; name a load cell.")
        used += _of(bench, where, f"force_path {path.name}", LOAD_CELL, cells)
        if path.acts not in (FLEXES, EXTENDS):
            raise InputError(f"{where}: force_path {path.name} has acts = {path.acts!r}; expected {FLEXES} or "
                             f"{EXTENDS}.")
        if path.joint not in [joint.name for joint in bench.joints]:
            raise InputError(f"{where}: force_path {path.name} has joint = {path.joint!r}, which no [[joint]] "
                             "declares; name a declared joint.")
    _refuse_twice(where, "place of the device", used)
    for device in bench.devices:
        if device.name not in used and not device.type.observed:
            raise InputError(f"{where}: no joint and no force path names the device {device.name}; give it a place or "
                             "leave it out.")


def _moved(bench: DeclaredBench, where: str, joint: Joint) -> list[str]:
    """Return the drive or the encoder of a joint; raises `InputError` for a joint with both or neither."""
    if bool(joint.driven_by) == bool(joint.measured_by):
        raise InputError(f"{where}: joint {joint.name} has {'both' if joint.driven_by else 'neither'} driven_by "
                         f"{'and' if joint.driven_by else 'nor'} measured_by; give one of them: a drive, or the "
                         "encoder of a joint that is moved by hand.")
    if joint.driven_by:
        return _of(bench, where, f"joint {joint.name}", JOINT_DRIVE, {"driven_by": joint.driven_by})
    return _of(bench, where, f"joint {joint.name}", JOINT_ENCODER, {"measured_by": joint.measured_by})


def _of(bench: DeclaredBench, where: str, place: str, kind: DeviceType, named: Mapping[str, str]) -> list[str]:
    """Return the names of devices that a place names; refuse a name that is no device of that type."""
    fit = [device.name for device in bench.devices if device.type is kind]
    for key, name in named.items():
        if name not in fit:
            raise InputError(f"{where}: {place} has {key} = {name!r}, which is no {kind.name}; expected one of "
                             f"{', '.join(fit) or 'none declared'}.")
    return list(named.values())


def _refuse_twice(where: str, what: str, names: Iterable[object]) -> None:
    seen: set[object] = set()
    for name in names:
        if name in seen:
            raise InputError(f"{where}: {what} {name} is given twice; each has one.")
        seen.add(name)
