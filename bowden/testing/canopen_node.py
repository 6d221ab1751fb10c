"""One virtual CANopen node of a test: an EDS, the device core behind it, and the test's own behaviour.

The rule of this file: a fault of the EDS is listed in `eds_faults` and does not stop the node; only a file without any
object is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from bowden.testing.behaviour import Behaviour, Refusal, StateTable
from eds.cia301 import Abort, ErrorRegister, NmtState
from eds.datatype import DataType, Value, decode, encode
from eds.dictionary import PACKAGED, Dictionary, Entry, key, packaged, read
from eds.files import check
from eds.files.notation import object_section
from master.node_access import object_text
from nodes import Application, Device
from nodes.core.objects import fits
from parameters import InputError
from virtual_bus.kernel import TICK
from virtual_bus.wire.node_station import NodeStation

if TYPE_CHECKING:
    from bowden.testing.can_bus import CanBus
    from nodes import Drive

ObjectName = int | tuple[int, int] | str
"""An object: index, (index, sub-index), the EDS's name, or hexadecimal text such as "1018:01"."""

STRINGS: Final = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)


class DriveLoad(Protocol):
    """Load of a drive: torque in, position and velocity out, SI at the axis."""

    def step(self, torque: float, for_ns: int) -> tuple[float, float]:
        """Advance by `for_ns` under `torque` (N·m) and return position and velocity."""


class Inertia:
    """A pure inertia, kg·m², at rest at 0: the default mechanics of a drive; steps of at most 25 µs."""

    def __init__(self, inertia: float = 0.04, arm: float = 1.0) -> None:
        self.inertia, self.arm = inertia, arm
        self.position = self.velocity = 0.0

    def step(self, torque: float, for_ns: int) -> tuple[float, float]:
        """Advance by `for_ns` under `torque`."""
        steps = max(1, for_ns // 25_000)
        for _ in range(steps):
            self.velocity += for_ns / steps * 1e-9 * torque / self.arm / self.inertia
            self.position += for_ns / steps * 1e-9 * self.velocity
        return self.position, self.velocity


class SwitchedStation(NodeStation):
    """A node's CAN controller, off the bus while its bit timing is not that of the wire or is being switched."""

    def __init__(self, bus: CanBus, device: Device, turnaround_ns: int) -> None:
        super().__init__(bus.kernel, device, turnaround_ns)
        self._bus, self._lss = bus, device.lss

    def settle(self, now_ns: int) -> None:
        """Send and receive if the bit rates agree; frames sent at another bit rate are lost."""
        off = self._lss.muted or self._lss.bitrate not in (None, self._bus.bitrate)
        if off:
            self.device.outbox.clear()
        if off is (self.deaf_to is not None):
            self.deaf_to = None if off else frozenset()
            if self.wire is not None:
                self.wire.reroute()
        super().settle(now_ns)


class CanopenNode:
    """A node on a `CanBus`; made by the fixture `canopen_node` or by `CanBus.add_node`.

    `eds_faults` lists the faults of the EDS, one sentence each. `node[object]` reads and sets raw values: numbers,
    text for strings, bytes for domains. Setting a value sends the event-driven TPDOs that carry it.
    """

    def __init__(self, bus: CanBus, eds: str | Path | Dictionary, node_id: int | None, profile: Application | None,
                 store: Path | None, mechanics: DriveLoad | None, turnaround_ns: int, serial: int | None) -> None:
        dictionary, self._mended = _read(eds, node_id)
        if serial is not None:
            dictionary = _numbered(dictionary, serial)
        node_id = node_id if node_id is not None else dictionary.node_id
        if node_id is None:
            raise InputError(f"{dictionary.path}: no node id in it; give node_id = 1 … 127.")
        self.bus = bus
        self.dictionary = dictionary
        self._behaviour = Behaviour(profile or Application())
        try:
            self.device = Device(dictionary, node_id, self._behaviour, store=store)
        except InputError as error:
            if not hasattr(profile, "tick"):
                raise
            raise InputError(f"{str(error).rstrip('.')}; for any EDS there is nodes.GenericDrive().") from None
        self.station = SwitchedStation(bus, self.device, turnaround_ns)
        self._names = {entry.name.lower(): at for at, entry in reversed([*dictionary.entries.items()])}
        self._mechanics = mechanics
        if hasattr(profile, "tick"):
            from physics.drive_loops import DRIVE_TICK_NS

            self._tick_ns = DRIVE_TICK_NS
            self._mechanics = mechanics or Inertia()
            self._drive, self._torque = cast("Drive", profile), 0.0
            bus.kernel.at(bus.now_ns, TICK, self._tick)

    def __repr__(self) -> str:
        return f"CanopenNode({self.dictionary.path!r}, node_id={self.node_id}, {self.state.name})"

    # ---- what it is ----

    @cached_property
    def eds_faults(self) -> list[str]:
        """Faults of the EDS, one sentence each, as `bowden check eds` lists them."""
        path = Path(self.dictionary.path)
        found = [str(fault) for fault in check.findings(path)] if path.exists() else []
        return [*found, *self._mended]

    @property
    def node_id(self) -> int:
        """Present CANopen node id."""
        return self.device.node_id

    @property
    def state(self) -> NmtState:
        """Present NMT state."""
        return self.device.state

    def key(self, name: ObjectName) -> int:
        """Return index << 8 | sub-index of an object; `InputError` where the dictionary has none such."""
        found = self._key(name)
        if found is None or found not in self.dictionary.entries:
            shown = f"{name:04X}" if isinstance(name, int) else ":".join(f"{n:X}" for n in name) \
                if isinstance(name, tuple) else repr(name)
            raise InputError(f"{self.dictionary.path}: no object {shown}; give an index, (index, sub-index), or a name "
                             "of the EDS.")
        return found

    def _key(self, name: ObjectName) -> int | None:
        if isinstance(name, int):
            return name << 8
        if isinstance(name, tuple):
            index_number, sub_number = name
            return index_number << 8 | sub_number
        index, _, sub = name.partition(":")
        place = object_section(index)
        if name.lower() in self._names:
            return self._names[name.lower()]
        if place is None or place[1] is not None:
            return None
        try:
            return place[0] << 8 | int(sub or "0", 16)
        except ValueError:
            return None

    def __getitem__(self, name: ObjectName) -> Any:
        at = self.key(name)
        self.device.refresh(self.bus.now_ns)
        value = self.device.values.get(at, b"")
        if isinstance(value, bytes) and self.dictionary.entries[at].data_type in STRINGS:
            return value.decode("latin-1")
        return value

    def __setitem__(self, name: ObjectName, value: float | bytes | str) -> None:
        at = self.key(name)
        self.device.values[at] = self._value(self.dictionary.entries[at], value)
        if not self._behaviour.busy and self.station.on:
            self.device.changed(self.bus.now_ns)
            self.station.settle(self.bus.now_ns)

    def set_text(self, place: str, text: str) -> None:
        """Set an object from text, as an option --set OBJECT=VALUE gives it; raises `InputError`."""
        at, where = object_text.find(self.dictionary, place), f"--set {place}={text}"
        if at not in self.dictionary.entries:
            raise InputError(f"{where}: {self.dictionary.path} has no such object; give one of its own.")
        kind = self.dictionary.entries[at].data_type
        self[at >> 8, at & 0xFF] = decode(kind, object_text.encoded(kind, text, where))

    def _value(self, entry: Entry, value: float | bytes | str) -> Value:
        given: Value = value.encode("latin-1") if isinstance(value, str) else value
        if not fits(entry, given):
            kind = entry.data_type
            raise InputError(f"{self.dictionary.path}: {entry.index:04X}:{entry.subindex:02X} {entry.name} is "
                             f"{kind.name} and cannot hold {value!r}; give a value of that type.")
        return decode(entry.data_type, encode(entry.data_type, given))

    # ---- what it does ----

    def on_write(self, name: ObjectName, function: Callable[[Any], object]) -> None:
        """Call `function(value)` after every write of an object, by SDO or RPDO; `value` is raw."""
        at = self.key(name)
        if not self.dictionary.entries[at].writable:
            raise InputError(f"{self.dictionary.path}: {at >> 8:04X}:{at & 0xFF:02X} has AccessType="
                             f"{self.dictionary.entries[at].access}, so nobody writes it; name a writable object.")
        self._behaviour.writers.setdefault(at, []).append(function)

    def on_read(self, name: ObjectName, function: Callable[[], float | bytes | str]) -> None:
        """Read an object's value from `function()` before every upload and every TPDO."""
        at = self.key(name)
        entry = self.dictionary.entries[at]
        self._behaviour.readers[at] = lambda: self._value(entry, function())

    def refuse(self, name: ObjectName, code: int = Abort.DEVICE_STATE, count: int | None = None) -> None:
        """Answer the next `count` writes of an object (above 0x1FFF; None: all) with an SDO abort code."""
        at = self.key(name)
        if at >> 8 < 0x2000:
            raise InputError(f"refuse: {at >> 8:04X} has CiA 301's own rules; name an object "
                             "above 1FFF.")
        self._behaviour.refusals[at] = Refusal(int(code), count)

    def state_machine(
        self, start: Hashable, table: Mapping[tuple[Hashable, ObjectName, Value | None],
                                              tuple[Hashable, Mapping[ObjectName, Value]]],
    ) -> StateTable:
        """Follow a table {(state, object, value written or None): (next state, {object: value})}; return it."""
        rows = {(state, self.key(name), value): (after, {self.key(at): to for at, to in changes.items()})
                for (state, name, value), (after, changes) in table.items()}
        machine = StateTable(start, rows)
        self._behaviour.machines.append(machine)
        return machine

    def emergency(self, code: int, register: int = ErrorRegister.GENERIC, vendor: bytes = b"") -> None:
        """Send an EMCY and set 0x1001 and 0x1003, once while the error lasts."""
        self.device.now_ns = self.bus.now_ns
        self.device.emergency(code, register, vendor)
        self._settle()

    def recover(self, code: int) -> None:
        """Send the EMCY for the end of an error."""
        self.device.now_ns = self.bus.now_ns
        self.device.recover(code)
        self._settle()

    def sample(self, counts: int, status: int = 0) -> None:
        """Pass the next converter value, −2²³ … 2²³ − 1, to a `nodes.TensionSensor` profile."""
        sensor = self._behaviour.profile
        if not hasattr(sensor, "sample"):
            raise InputError(f"node {self.node_id}: sample() needs "
                             "profile=nodes.TensionSensor(); give the node that profile.")
        sensor.sample(self.bus.now_ns, counts, status)
        self._settle()

    def power_off(self) -> None:
        """Switch the node's supply off: it leaves the wire, and its pending frames are discarded."""
        if self.station.wire is not None:
            self.station.wire.detach(self.station)
        self.station.powered(False, self.bus.now_ns)

    def power_on(self) -> None:
        """Switch the node's supply on: the node boots."""
        if self.station.wire is None:
            self.station.waiting = self.station.contending = 0
            self.bus.wire.attach(self.station)
        self.station.powered(True, self.bus.now_ns)

    def _settle(self) -> None:
        if not self._behaviour.busy and self.station.on:
            self.station.settle(self.bus.now_ns)

    def _tick(self) -> None:
        now_ns = self.bus.now_ns
        if self._mechanics is not None and self.station.on:
            position, velocity = self._mechanics.step(self._torque, self._tick_ns)
            self._torque = self._drive.tick(now_ns, position, velocity)
            self.station.settle(now_ns)
        self.bus.kernel.at(now_ns + self._tick_ns, TICK, self._tick)


def _read(given: str | Path | Dictionary, node_id: int | None) -> tuple[Dictionary, tuple[str, ...]]:
    """Return the dictionary of an EDS and the faults of its values; an unchanged file is read once."""
    if isinstance(given, Dictionary):
        return given, ()
    path = packaged(str(given)) if str(given) in PACKAGED else Path(given)
    stamp = path.stat() if path.exists() else None
    return _mended(path, node_id, stamp and (stamp.st_mtime_ns, stamp.st_size))


def _numbered(dictionary: Dictionary, serial: int) -> Dictionary:
    """Return a dictionary whose serial number, 0x1018:04, is `serial`; `InputError` where it has none."""
    at = key(0x1018, 4)
    if at not in dictionary.entries:
        raise InputError(f"{dictionary.path}: no object 1018:04; leave serial away, or add it to the EDS.")
    entries = {**dictionary.entries, at: dataclasses.replace(dictionary.entries[at], default=serial, value=None)}
    return dataclasses.replace(dictionary, entries=entries)


@lru_cache(maxsize=64)
def _mended(path: Path, node_id: int | None, _stamp: tuple[int, int] | None) -> tuple[Dictionary, tuple[str, ...]]:
    """Read an EDS; a start value that its type cannot hold becomes zero, and is named."""
    dictionary = read(path, node_id)
    entries, faults = dict(dictionary.entries), []
    for at, entry in entries.items():
        if not fits(entry, entry.initial):
            entries[at] = dataclasses.replace(entry, default=None, value=None)
            faults.append(f"{path}: {entry.index:04X}:{entry.subindex:02X} {entry.name}: {entry.initial!r} is no "
                          f"{entry.data_type.name}; the node starts with {cast(object, entry.data_type.zero)!r}.")
    return dataclasses.replace(dictionary, entries=entries), tuple(faults)
