"""This bench's network: node ids, COB-IDs, PDO plans, and what bring-up writes into each node.

The rule of this file: one declaration of the wire, from which master, devices, checks and docs/wire.md
take theirs. A cycle is 590 bit times at worst: SYNC, four TPDOs, one frame of targets for both drives.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

from eds import cia301, cia402, dictionary
from eds.device_mapping import DeviceMapping, KneeMapping, MappedPart, SensorMapping, ServoMapping, part
from eds.dictionary import Dictionary, key
from eds.network import Network as Network
from eds.pdo_plan import PdoPlan, compile_plan, overlay
from eds.setup import RPDO, TPDO, Pdo, Write, interpolation_period, pdo_writes
from parameters import InputError

SERVO, KNEE, START, END, MASTER = 1, 2, 3, 4, 127
DRIVES: Final = (SERVO, KNEE)
SENSORS: Final = (START, END)
NAMES: Final = MappingProxyType({SERVO: "servo", KNEE: "knee", START: "start", END: "end", MASTER: "master"})
FILES: Final = MappingProxyType({
    SERVO: "servo_drive", KNEE: "knee_drive", START: "tension_sensor", END: "tension_sensor",
})
FITTINGS: Final[Mapping[int, DeviceMapping]] = MappingProxyType({
    SERVO: ServoMapping(), KNEE: KneeMapping(), START: SensorMapping(), END: SensorMapping(),
})

TARGETS_COB_ID: Final = 0x201
CONTROLWORDS_COB_ID: Final = 0x301
BITRATES: Final = (125_000, 250_000, 500_000, 800_000, 1_000_000)

_SENT: Final = MappingProxyType({
    SERVO: ("statusword", "position", "torque"), KNEE: ("statusword", "position"), START: ("value",), END: ("value",),
})
_TAKEN: Final = MappingProxyType({
    SERVO: ("target", "controlword"), KNEE: ("target", "controlword"), START: (), END: (),
})

_SAFE_STOP: Final = MappingProxyType({
    SERVO: ((0x6007, cia402.AbortConnection.DISABLE_VOLTAGE), (0x605A, cia402.Stop.QUICK_STOP_RAMP),
            (0x605E, cia402.Stop.DISABLE)),
    KNEE: ((0x6007, cia402.AbortConnection.QUICK_STOP), (0x605A, cia402.Stop.QUICK_STOP_RAMP_HOLD),
           (0x605E, cia402.Stop.QUICK_STOP_RAMP)),
})
"""The servo never ends a stop by holding the rope, for the knee would load it; the knee drive holds."""
STEP_LIMIT: Final = 0x2017
"""Greatest step of a drive's position target, in its position unit; 0: none."""
STEP_US: Final = 10_000
STEP_CYCLES: Final = 3
_IF_PRESENT: Final = frozenset({key(0x1006), key(0x1015), key(STEP_LIMIT)})
"""Written where the device has them; every other object of a set-up is needed."""


class NodeEntry(NamedTuple):
    """One device of the bench; without a fitting of its own the profile's objects play its parts."""

    node_id: int
    name: str
    dictionary: Dictionary
    fitting: DeviceMapping | None = None

    def part(self, name: str) -> MappedPart:
        """Find the object that plays a part; `InputError` where there is none."""
        return part(self.dictionary, self.fitting or FITTINGS[self.node_id], name)

    def lacks(self, names: Sequence[str]) -> Iterator[str]:
        """Say in a sentence each which of these parts nobody can play."""
        for name in names:
            try:
                self.part(name)
            except InputError as error:
                yield str(error)


class WireLayout:
    """Everything that both ends of the wire must know, built once; treat it as read-only.

    `tpdo` maps COB-ID to plan (181h servo, 182h knee, 183h START, 184h END), `targets` and `controlwords` are the
    master's frames to both drives, servo first. Plans carry SI scales: m, rad, N·m at the motor shaft, N.
    """

    def __init__(self, network: Network, nodes: Mapping[int, NodeEntry]) -> None:
        self.network = network
        self.period_ns = network.period_us * 1000
        self.nodes = MappingProxyType(dict(nodes))
        self.tpdo: Mapping[int, PdoPlan] = MappingProxyType(
            {tpdo_cob_id(n): self._plan(n, self._sent(n), tpdo_cob_id(n)) for n in _SENT})
        self.targets = self._overlay("target", TARGETS_COB_ID)
        self.controlwords = self._overlay("controlword", CONTROLWORDS_COB_ID)

    def setup(self, node_id: int) -> list[Write]:
        """List the SDO writes that bring-up makes in PRE-OPERATIONAL, in order, as (index, sub-index, value).

        Raises `InputError` where the device lacks an object that the bench cannot do without.
        """
        if (sentence := next(self.missing(node_id), None)) is not None:
            raise InputError(sentence)
        entries = self.nodes[node_id].dictionary.entries
        return [write for write in self._writes(node_id) if key(write[0], write[1]) in entries]

    def missing(self, node_id: int) -> Iterator[str]:
        """Say in a sentence each which objects a set-up needs and the device has not."""
        device = self.nodes[node_id].dictionary
        for index, sub in dict.fromkeys((index, sub) for index, sub, _ in self._writes(node_id)):
            if key(index, sub) not in device.entries and key(index, sub) not in _IF_PRESENT:
                yield (f"{device.path}: no object {index:04X}:{sub:02X}, which the bench writes at start-up; "
                       "use a device that has it.")

    def pdos(self, node_id: int) -> Sequence[Pdo]:
        """List the PDOs that a node is to hold."""
        sent = Pdo(TPDO, 1, tpdo_cob_id(node_id), self._sent(node_id), 1)
        if node_id in SENSORS:
            return (sent,)
        network = self.network
        targets = Pdo(RPDO, 1, TARGETS_COB_ID, self._shared(node_id, "target"), 1, network.targets_deadline_ms)
        words = Pdo(RPDO, 2, CONTROLWORDS_COB_ID, self._shared(node_id, "controlword"), cia301.EVENT_PROFILE)
        return sent, targets, words, *self._tension(node_id)

    def _tension(self, node_id: int) -> Iterator[Pdo]:
        """The servo's own watch over START's tension, taken straight from START's frame."""
        fitting = self.nodes[node_id].fitting or FITTINGS[node_id]
        if not isinstance(fitting, ServoMapping) or not fitting.tension:
            return
        mine, told = self.nodes[node_id].part("tension"), self.nodes[START].part("value")
        if (mine.entry.data_type, mine.scale) != (told.entry.data_type, told.scale):
            raise InputError(f"{self.nodes[node_id].dictionary.path}: {fitting.tension} (tension) counts "
                             f"{mine.unit('N')}, START sends {told.unit('N')}; make them agree.")
        yield Pdo(RPDO, 3, tpdo_cob_id(START), (mine.word,), cia301.EVENT_PROFILE, self.network.start_deadline_ms)

    def _sent(self, node_id: int) -> tuple[int, ...]:
        return tuple(self.nodes[node_id].part(name).word for name in _SENT[node_id])

    def _shared(self, node_id: int, name: str) -> tuple[int, ...]:
        """One drive's map of a frame for both: its own object, and a dummy of the other's type."""
        parts = {n: self.nodes[n].part(name) for n in DRIVES}
        return tuple(p.word if n == node_id else p.dummy for n, p in parts.items())

    def _overlay(self, name: str, cob_id: int) -> PdoPlan:
        return overlay([self._plan(n, self._shared(n, name), cob_id) for n in DRIVES], cob_id)

    def _plan(self, node_id: int, mapping: Sequence[int], cob_id: int) -> PdoPlan:
        entry = self.nodes[node_id]
        parts = (entry.part(name) for name in (*_SENT[node_id], *_TAKEN[node_id]))
        return compile_plan(entry.dictionary, mapping, cob_id, {p.entry.key: p.scale for p in parts})

    def _writes(self, node_id: int) -> Iterator[Write]:
        network = self.network
        yield 0x1006, 0, network.period_us
        yield 0x1015, 0, network.emcy_inhibit_ms * 10
        yield 0x1016, 1, MASTER << 16 | network.heartbeat_timeout_ms
        yield 0x1017, 0, network.heartbeat_ms
        yield from pdo_writes(self.nodes[node_id].dictionary, self.pdos(node_id))
        if node_id in SENSORS:
            yield 0x6114, 1, network.sampling_us
            return
        value, index = interpolation_period(network.period_us)
        yield 0x60C2, 1, value
        yield 0x60C2, 2, index
        if key(0x607F) in self.nodes[node_id].dictionary.entries:
            yield STEP_LIMIT, 0, self._step_limit(node_id)
        yield 0x6060, 0, int(cia402.Mode.CSP)
        for option, code in _SAFE_STOP[node_id]:
            yield option, 0, int(code)

    def _step_limit(self, node_id: int) -> int:
        """What the drive's greatest speed (0x607F) makes of `STEP_US`, or of `STEP_CYCLES` where that is longer."""
        for_us = max(STEP_US, STEP_CYCLES * self.network.period_us)
        return max(1, self.nodes[node_id].dictionary.initial(0x607F) * for_us // 1_000_000)


def tpdo_cob_id(node_id: int) -> int:
    """COB-ID of a node's first TPDO in the pre-defined connection set."""
    return cia301.TPDO_BASE + node_id


def wire(network: Network, device_mappings: Mapping[int, DeviceMapping] | None = None) -> WireLayout:
    """Build the wire of a network; `device_mappings` (else the network's own) put other devices in a node's place.

    Raises `InputError` for a bit rate or cycle that the objects cannot express, or a device that cannot play its part.
    """
    if network.bitrate not in BITRATES:
        known = ", ".join(map(str, BITRATES))
        raise InputError(f"bitrate = {network.bitrate} bit/s is none of {known}; choose one of them.")
    if 1_000_000 % network.rate_hz:
        raise InputError(f"rate_hz = {network.rate_hz} makes no whole number of microseconds a cycle; choose a divisor "
                         "of 1000000 such as 1000, 500, 250 or 100.")
    interpolation_period(network.period_us)
    device_mappings = dict(network.device_mappings) if device_mappings is None else device_mappings
    return WireLayout(network, {node: _entry(node, device_mappings.get(node, FITTINGS[node])) for node in FILES})


def lacks(network: Network, device_mappings: Mapping[int, DeviceMapping] | None = None) -> list[str]:
    """Say in a sentence each what the devices lack for their places; empty where all of them fit."""
    device_mappings = dict(network.device_mappings) if device_mappings is None else device_mappings
    entries = [_entry(node, device_mappings.get(node, FITTINGS[node])) for node in FILES]
    unfit = [said for entry in entries for said in entry.lacks((*_SENT[entry.node_id], *_TAKEN[entry.node_id]))]
    return unfit or [said for node in FILES for said in wire(network, device_mappings).missing(node)]


def _entry(node_id: int, fitting: DeviceMapping) -> NodeEntry:
    device = dictionary.read(fitting.file, node_id) if fitting.file else _packaged(node_id)
    return NodeEntry(node_id, NAMES[node_id], device, fitting)


@functools.cache
def _packaged(node_id: int) -> Dictionary:
    return dictionary.read(dictionary.packaged(FILES[node_id]), node_id)
