"""Wire of a declared bench: node ids, COB-IDs, PDO plans, and the SDO writes that set each node up.

Master, devices, checks and docs/wire.md read the wire here. It follows from `eds.declaration` alone. A cycle of the
paper's bench is 590 bit times at worst: SYNC, four TPDOs, one frame of targets for both drives. The order of the writes
is the standard's: a PDO is invalid while its map changes, its map is empty while its entries change (CiA 301, 7.5.2.36
and 7.5.2.38), and unused PDOs end invalid.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

from eds import cia301, cia402, dictionary
from eds.bench.network import Network as Network
from eds.datatype import DataType
from eds.declaration import LOAD_CELL, DeclaredDevice, PathNodes, packaged
from eds.device_mapping import DeviceMapping, MappedPart, ServoMapping, part
from eds.dictionary import Dictionary, key
from eds.pdo_plan import Field, PdoPlan, compile_plan, overlay
from parameters import InputError

Write = tuple[int, int, int | bytes]
"""(index, sub-index, value) of one SDO download; the object's data type gives its length."""

RPDO, TPDO = 0x1400, 0x1800
_MAPPING: Final = 0x200
PDOS: Final = 4
"""Number of PDOs of each direction in the pre-defined connection set; the setup writes only these."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One PDO as a node is to hold it; `base` is `RPDO` or `TPDO`, `number` from 1; `deadline_ms` is sub-index 5."""

    base: int
    number: int
    cob_id: int
    mapping: Sequence[int]
    transmission_type: int
    deadline_ms: int = 0

    def writes(self, dictionary: Dictionary) -> Iterator[Write]:
        """Yield the writes in the standard's order, whether the device has the objects or not."""
        communication = self.base + self.number - 1
        mapping = communication + _MAPPING
        flags = cia301.COB_ID_NO_RTR if self.base == TPDO else 0
        yield communication, 1, self.cob_id | flags | cia301.COB_ID_INVALID
        yield communication, 2, self.transmission_type
        if self.deadline_ms or key(communication, 5) in dictionary.entries:
            yield communication, 5, self.deadline_ms
        yield mapping, 0, 0
        for sub, word in enumerate(self.mapping, 1):
            yield mapping, sub, word
        yield mapping, 0, len(self.mapping)
        yield communication, 1, self.cob_id | flags


def pdo_writes(dictionary: Dictionary, pdos: Sequence[Pdo]) -> Iterator[Write]:
    """Yield the writes after which a node has exactly these PDOs: every other one is made invalid first."""
    used = {(pdo.base, pdo.number) for pdo in pdos}
    for base in (RPDO, TPDO):
        for number in range(1, PDOS + 1):
            entry = dictionary.entries.get(key(base + number - 1, 1))
            if entry is not None and (base, number) not in used:
                yield base + number - 1, 1, dictionary.initial(base + number - 1, 1) | cia301.COB_ID_INVALID
    for pdo in pdos:
        yield from pdo.writes(dictionary)


def interpolation_period(period_us: int) -> tuple[int, int]:
    """Return 0x60C2:01 and :02 for a period: value × 10^index seconds; `InputError` where one byte cannot hold it."""
    value, index = _decimal(period_us)
    if not fits_one_byte(period_us):
        raise InputError(f"rate_hz: a cycle of {period_us} µs does not fit 0x60C2; choose 1000, 500, 250 or 100 Hz.")
    return value, index


def fits_one_byte(period_us: int) -> bool:
    """Return whether 0x60C2:01, one byte, can express a period."""
    return 1 <= _decimal(period_us)[0] <= 255


def _decimal(period_us: int) -> tuple[int, int]:
    """Return the period as value and power of ten, in seconds, with the smallest value."""
    value, index = period_us, -6
    while value % 10 == 0 and index < 0:
        value, index = value // 10, index + 1
    return value, index


MASTER: Final = 127
MONITOR: Final = 126
"""Node id of the safety monitor, on a bench that has one."""
_PAPER: Final = packaged()
SERVO, KNEE, START, END = (_PAPER.named(name).node_id for name in ("servo", "knee", "start", "end"))
DRIVES: Final = tuple(device.node_id for device in _PAPER.devices if device.type.taken)
SENSORS: Final = tuple(device.node_id for device in _PAPER.devices if not device.type.taken)
NAMES: Final = MappingProxyType({**{device.node_id: device.name for device in _PAPER.devices}, MASTER: "master"})
FILES: Final = MappingProxyType({device.node_id: device.type.file for device in _PAPER.devices})
"""Node ids, names and packaged EDS of the paper's bench, for modules that run this shape only."""

TARGETS_COB_ID: Final = cia301.RPDO_BASE + DRIVES[0]
FRAME_BITS: Final = 64
"""Bits that one frame carries; targets beyond it go into a further frame."""
BITRATES: Final = (125_000, 250_000, 500_000, 800_000, 1_000_000)

ASKED: Final = Field(key(0x607A), "Asked angle", 32, "i", math.pi / 180_000.0, signed=True)
"""Target angle of a joint without a drive, which a person moves: 1/1000 degree, in the frame of targets."""
STEP_LIMIT: Final = 0x2017
"""Greatest step of a drive's position target, in its position unit; 0: none."""
STEP_US: Final = 10_000
STEP_CYCLES: Final = 3
_IF_PRESENT: Final = frozenset({key(0x1006), key(0x1015), key(STEP_LIMIT)})
"""Written where the device has them; every other object of a set-up is needed."""


class NodeEntry(NamedTuple):
    """One device of the bench: its dictionary, and the mapping that names the objects of its parts."""

    node_id: int
    name: str
    dictionary: Dictionary
    fitting: DeviceMapping

    def part(self, name: str) -> MappedPart:
        """Find the object that plays a part; raises `InputError` if the device has none."""
        return part(self.dictionary, self.fitting, name)

    def lacks(self, names: Sequence[str]) -> Iterator[str]:
        """Yield one sentence for each of these parts that the device's dictionary lacks."""
        for name in names:
            try:
                self.part(name)
            except InputError as error:
                yield str(error)


class WireLayout:
    """The agreement between both ends of the wire, built once; treat it as read-only.

    A joint without a drive has a place in the frame of targets, too: the desired angle, for whoever moves the joint.

    `tpdo` maps COB-ID to plan, in the order of the declaration (paper's bench: 181h servo, 182h knee, 183h START,
    184h END). `target_frames` and `controlword_frames` are the master's frames to the drives, as many drives in each
    as 8 bytes hold. Plans carry SI scales: m, rad, N·m at the motor shaft, N.
    """

    def __init__(self, network: Network, nodes: Mapping[int, NodeEntry]) -> None:
        self.network = network
        self.period_ns = network.period_us * 1000
        self.nodes = MappingProxyType(dict(nodes))
        self._devices = {device.node_id: device for device in network.bench.devices}
        self.tpdo: Mapping[int, PdoPlan] = MappingProxyType(
            {tpdo_cob_id(n): self._plan(n, self._sent(n), tpdo_cob_id(n)) for n in self._devices})
        self.drives = tuple(node for node, device in self._devices.items() if device.type.taken)
        self.followed = tuple(device.node_id for device in network.bench.followed)
        self.target_frames = self._frames("target", cia301.RPDO_BASE)
        self.controlword_frames = self._frames("controlword", cia301.RPDO_BASE + 0x100)

    @functools.cached_property
    def paths(self) -> tuple[PathNodes, ...]:
        """Node ids of each force path's devices, in declared order."""
        return tuple(self.network.bench.nodes_of(path) for path in self.network.bench.force_paths)

    @property
    def path(self) -> PathNodes:
        """Node ids of the only force path."""
        (path,) = self.paths
        return path

    def of_path(self, name: str) -> WireLayout:
        """Return the wire of one force path: its devices where they are on this wire."""
        bench = self.network.bench.path(name)
        return WireLayout(dataclasses.replace(self.network, bench=bench),
                          {device.node_id: self.nodes[device.node_id] for device in bench.devices})

    @functools.cached_property
    def targets(self) -> PdoPlan:
        """The only frame of targets, on a bench of one rope drive and one joint; the rope drive first."""
        (plan,) = self.target_frames
        return plan

    @functools.cached_property
    def controlwords(self) -> PdoPlan:
        """The only frame of controlwords, on a bench of up to four drives."""
        (plan,) = self.controlword_frames
        return plan

    def setup(self, node_id: int) -> list[Write]:
        """List the SDO writes that bring-up makes in PRE-OPERATIONAL, in order, as (index, sub-index, value).

        Raises `InputError` where the device lacks an object that the bench cannot do without.
        """
        if (sentence := next(self.missing(node_id), None)) is not None:
            raise InputError(sentence)
        entries = self.nodes[node_id].dictionary.entries
        return [write for write in self._writes(node_id) if key(write[0], write[1]) in entries]

    def missing(self, node_id: int) -> Iterator[str]:
        """Yield a sentence for each object that a set-up needs and the device lacks."""
        device = self.nodes[node_id].dictionary
        for index, sub in dict.fromkeys((index, sub) for index, sub, _ in self._writes(node_id)):
            if key(index, sub) not in device.entries and key(index, sub) not in _IF_PRESENT:
                yield (f"{device.path}: no object {index:04X}:{sub:02X}, which the bench writes at start-up; "
                       "use a device that has it.")

    def pdos(self, node_id: int) -> Sequence[Pdo]:
        """List the PDOs that a node is to hold."""
        sent = Pdo(TPDO, 1, tpdo_cob_id(node_id), self._sent(node_id), 1)
        if node_id not in self.drives:
            return (sent,)
        targets_group, words_group = self._group(node_id, "target"), self._group(node_id, "controlword")
        targets = Pdo(RPDO, 1, cia301.RPDO_BASE + targets_group[0], self._shared(node_id, "target", targets_group), 1,
                      self.network.targets_deadline_ms)
        words = Pdo(RPDO, 2, cia301.RPDO_BASE + 0x100 + words_group[0],
                    self._shared(node_id, "controlword", words_group), cia301.EVENT_PROFILE)
        return sent, targets, words, *self._tension(node_id)

    def _tension(self, node_id: int) -> Iterator[Pdo]:
        """Yield the RPDO by which a rope drive watches its path's START, straight from START's frame."""
        fitting, cell = self.nodes[node_id].fitting, self.network.bench.start_of(self._devices[node_id].name)
        if not isinstance(fitting, ServoMapping) or not fitting.tension or cell is None:
            return
        mine, told = self.nodes[node_id].part("tension"), self.nodes[cell.node_id].part("value")
        if (mine.entry.data_type, mine.scale) != (told.entry.data_type, told.scale):
            raise InputError(f"{self.nodes[node_id].dictionary.path}: {fitting.tension} (tension) counts "
                             f"{mine.unit('N')}, START sends {told.unit('N')}; make them agree.")
        yield Pdo(RPDO, 3, tpdo_cob_id(cell.node_id), (mine.word,), cia301.EVENT_PROFILE,
                  self.network.start_deadline_ms)

    def _sent(self, node_id: int) -> tuple[int, ...]:
        return tuple(self.nodes[node_id].part(name).word for name in self._devices[node_id].type.sent)

    def _groups(self, name: str) -> Iterator[tuple[int, ...]]:
        """Yield the nodes that share a frame of this part: in declared order, as many as `FRAME_BITS` hold.

        They are the drives; for targets also the encoders of joints without one.
        """
        group: list[int] = []
        free = FRAME_BITS
        for node in (*self.drives, *(self.followed if name == "target" else ())):
            bits = ASKED.bits if node in self.followed else self.nodes[node].part(name).entry.data_type.bits
            if group and bits > free:
                yield tuple(group)
                group, free = [], FRAME_BITS
            group.append(node)
            free -= bits
        yield tuple(group)

    def _group(self, node_id: int, name: str) -> tuple[int, ...]:
        return next(group for group in self._groups(name) if node_id in group)

    def _shared(self, node_id: int, name: str, group: Sequence[int]) -> tuple[int, ...]:
        """Return one drive's map of a shared frame: its own object, and a dummy of each other drive's type."""
        parts = {n: self.nodes[n].part(name) for n in group if n not in self.followed}
        asked = DataType.INTEGER32 << 16 | ASKED.bits
        return tuple(asked if n not in parts else parts[n].word if n == node_id else parts[n].dummy for n in group)

    def _frames(self, name: str, base: int) -> tuple[PdoPlan, ...]:
        """Return the frames of a part; each has the COB-ID of its first node."""
        return tuple(self._frame(name, base + group[0], group) for group in self._groups(name))

    def master_frames(self) -> Iterator[tuple[str, PdoPlan, Sequence[int]]]:
        """Yield the master's frames to the drives: the frame's content, its plan, and the node of each object in it."""
        for name, frames in (("target", self.target_frames), ("controlword", self.controlword_frames)):
            yield from ((name, plan, group) for plan, group in zip(frames, self._groups(name), strict=True))

    def _frame(self, name: str, cob_id: int, group: Sequence[int]) -> PdoPlan:
        """Return one frame: objects of the drives, and angles that joints without a drive are asked for."""
        plans = [self._plan(n, self._shared(n, name, group), cob_id) for n in group if n not in self.followed]
        fields = overlay(plans, cob_id).fields if plans else (ASKED,) * len(group)
        return PdoPlan(cob_id, [ASKED if node in self.followed else field
                                for node, field in zip(group, fields, strict=True)])

    def _plan(self, node_id: int, mapping: Sequence[int], cob_id: int) -> PdoPlan:
        entry = self.nodes[node_id]
        parts = (entry.part(name) for name in _parts(self._devices[node_id]))
        return compile_plan(entry.dictionary, mapping, cob_id, {p.entry.key: p.scale for p in parts})

    def _writes(self, node_id: int) -> Iterator[Write]:
        network = self.network
        yield 0x1006, 0, network.period_us
        yield 0x1015, 0, network.emcy_inhibit_ms * 10
        yield 0x1016, 1, MASTER << 16 | network.heartbeat_timeout_ms
        yield 0x1017, 0, network.heartbeat_ms
        yield from pdo_writes(self.nodes[node_id].dictionary, self.pdos(node_id))
        if self._devices[node_id].type.name == LOAD_CELL.name:
            yield 0x6114, 1, network.sampling_us
        if node_id not in self.drives:
            return
        value, index = interpolation_period(network.period_us)
        yield 0x60C2, 1, value
        yield 0x60C2, 2, index
        if key(0x607F) in self.nodes[node_id].dictionary.entries:
            yield STEP_LIMIT, 0, self._step_limit(node_id)
        yield 0x6060, 0, int(cia402.Mode.CSP)
        for option, code in self._devices[node_id].type.safe_stop:
            yield option, 0, int(code)

    def _step_limit(self, node_id: int) -> int:
        """Return the largest position step in `STEP_US`, or in `STEP_CYCLES` if longer, at the drive's maximum speed
        (0x607F)."""
        for_us = max(STEP_US, STEP_CYCLES * self.network.period_us)
        return max(1, self.nodes[node_id].dictionary.initial(0x607F) * for_us // 1_000_000)


def tpdo_cob_id(node_id: int) -> int:
    """COB-ID of a node's first TPDO in the pre-defined connection set."""
    return cia301.TPDO_BASE + node_id


def wire(network: Network, device_mappings: Mapping[int, DeviceMapping] | None = None) -> WireLayout:
    """Build the wire of a network; `device_mappings` put other devices than the declared ones in a node's place.

    Raises `InputError` for a bit rate or cycle that the objects cannot express, or a device that cannot play its part.
    """
    if network.bitrate not in BITRATES:
        known = ", ".join(map(str, BITRATES))
        raise InputError(f"bitrate = {network.bitrate} bit/s is none of {known}; choose one of them.")
    if 1_000_000 % network.rate_hz:
        raise InputError(f"rate_hz = {network.rate_hz} makes no whole number of microseconds a cycle; choose a divisor "
                         "of 1000000 such as 1000, 500, 250 or 100.")
    interpolation_period(network.period_us)
    return WireLayout(network, _entries(network, device_mappings))


def lacks(network: Network, device_mappings: Mapping[int, DeviceMapping] | None = None) -> list[str]:
    """List in a sentence each the objects that devices lack for their places; empty if all of them fit."""
    entries = _entries(network, device_mappings)
    unfit = [said for device in network.bench.devices for said in entries[device.node_id].lacks(_parts(device))]
    return unfit or [said for node in entries for said in wire(network, device_mappings).missing(node)]


def _parts(device: DeclaredDevice) -> tuple[str, ...]:
    return device.type.sent + device.type.taken


def _entries(network: Network, device_mappings: Mapping[int, DeviceMapping] | None) -> dict[int, NodeEntry]:
    bench = network.bench.mapped(device_mappings or {})
    return {device.node_id: _entry(device, device.mapping) for device in bench.devices}


def _entry(device: DeclaredDevice, fitting: DeviceMapping) -> NodeEntry:
    file = fitting.file or (device.type.file if device.type.observed else "")
    read = dictionary.read(file, device.node_id) if file else _packaged(device.type.file, device.node_id)
    return NodeEntry(device.node_id, device.name, read, fitting)


@functools.cache
def _packaged(file: str, node_id: int) -> Dictionary:
    return dictionary.read(dictionary.packaged(file), node_id)
