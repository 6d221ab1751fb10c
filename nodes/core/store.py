"""Stored parameters: 0x1010 save, 0x1011 load, 0x1020 verify configuration (CiA 301, 7.5.2.13, 7.5.2.14, 7.5.2.23).

Only parameters are stored, never process data or computed values. The file is replaced whole or not at all; a damaged
or foreign file is not used, with EMCY 0x6320.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eds.cia301 import SIGNATURE_LOAD, SIGNATURE_SAVE, Abort, Emcy
from eds.datatype import Value, encode
from eds.dictionary import key
from nodes.core.objects import outside
from nodes.core.parts import Part
from nodes.core.pdo_parameters import process_output
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    from nodes.core.device import Device

SAVE: Final = 0x1010
LOAD: Final = 0x1011
VERIFY: Final = 0x1020
IDENTITY: Final = (key(0x1018, 1), key(0x1018, 2))

_NEVER: Final = frozenset({0x1003, SAVE, LOAD})

GROUPS: Final[dict[int, Callable[[int], bool]]] = {
    1: lambda index: True,
    2: lambda index: index < 0x2000,
    3: lambda index: 0x6000 <= index < 0xA000,
    4: lambda index: 0x2000 <= index < 0x6000,
}
"""Sub-index of 0x1010 and 0x1011 → the indices it means (CiA 301, 7.5.2.13): all, communication, application; 4 is
this device's own: manufacturer."""


class Store(Part):
    """Parameters that survive a reset; with a path, also a power cycle."""

    def __init__(self, device: Device, path: Path | None) -> None:
        self._device, self._path = device, path
        self._defaults = dict(device.values)
        self._stored: dict[int, Value] = {}
        self._changed = self._damaged = False
        self.commands = {SAVE: self._save, LOAD: self._load}

    def load(self) -> None:
        """Read the stored parameters at power-on, if a file exists."""
        if self._path is None or not self._path.exists():
            return
        try:
            self._stored = self._parse(json.loads(self._path.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            self._stored, self._damaged = {}, True

    def renumber(self) -> None:
        """Take the defaults of a new node id; stored values that depend on the old one are dropped."""
        relative = {at: entry for at, entry in self._device.objects.entries.items() if entry.relative}
        self._defaults.update((at, entry.initial) for at, entry in relative.items())
        self._stored = {at: value for at, value in self._stored.items() if at not in relative}
        if self._stored and self._path is not None:
            self._replace(self._stored)

    def restore(self, whole_node: bool) -> None:
        """Set objects to their stored or default values: all of them, or 0x1000–0x1FFF."""
        for at, value in self._defaults.items():
            if whole_node or at >> 8 < 0x2000:
                self._device.values[at] = self._stored.get(at, value)
        self._changed = False

    def reset(self, now_ns: int) -> None:
        """Report once that the stored values were corrupt."""
        if self._damaged:
            self._damaged = False
            self._device.emcy.set(Emcy.DATA_SET, Emcy.DATA_SET.register)

    def wrote(self, at: int, value: Value) -> None:
        """Set 0x1020 to zero before a parameter is written: it no longer verifies the configuration (CiA 301,
        7.5.2.23)."""
        if at >> 8 == VERIFY:
            self._changed = False
        elif self._device.values.get(at) != value and self._storable(at):
            self._changed = True

    def _save(self, subindex: int, value: Value, now_ns: int) -> Abort | None:
        group = GROUPS.get(subindex)
        if value != SIGNATURE_SAVE or group is None:
            return Abort.NOT_STORED
        values = self._device.values
        if self._changed:
            values.update((at, 0) for at in self._device.objects.entries if at >> 8 == VERIFY and at & 0xFF)
            self._changed = False
        kept = {at: v for at, v in self._stored.items() if not group(at >> 8)}
        new = {at: values[at] for at in self._device.objects.entries if group(at >> 8) and self._storable(at)}
        return self._replace({**kept, **new})

    def _load(self, subindex: int, value: Value, now_ns: int) -> Abort | None:
        group = GROUPS.get(subindex)
        if value != SIGNATURE_LOAD or group is None:
            return Abort.NOT_STORED
        return self._replace({at: v for at, v in self._stored.items() if not group(at >> 8)})

    def _replace(self, stored: dict[int, Value]) -> Abort | None:
        if self._path is not None:
            try:
                write_whole(self._path, self._text(stored), overwrite=True)
            except InputError:
                return Abort.HARDWARE
        self._stored = stored
        return None

    def _text(self, stored: dict[int, Value]) -> str:
        entries = self._device.objects.entries
        values = {f"{at:06X}": encode(entries[at].data_type, value).hex() for at, value in sorted(stored.items())}
        return json.dumps({"device": self._identity(), "values": values}, indent=1) + "\n"

    def _parse(self, found: Mapping[str, Any]) -> dict[int, Value]:
        """Read the text of `_text`; raises ValueError if it belongs to another device or a value does not fit its
        object."""
        if found["device"] != self._identity():
            raise ValueError("stored by another device")
        stored: dict[int, Value] = {}
        for name, text in found["values"].items():
            at = int(name, 16)
            if not self._storable(at):
                raise ValueError(f"{name} is no parameter of this device")
            value = self._device.objects.decode(at, bytes.fromhex(text))
            if isinstance(value, Abort) or outside(self._device.objects.entries[at], value):
                raise ValueError(f"{name} refuses {text}")
            stored[at] = value
        return stored

    def _identity(self) -> list[int]:
        return [self._device.node_id, *(self._device.objects.number(at) for at in IDENTITY)]

    def _storable(self, at: int) -> bool:
        entry = self._device.objects.entries.get(at)
        if entry is None or not (entry.writable and entry.readable) or at >> 8 in _NEVER:
            return False
        return not process_output(entry) and at not in self._device.application.unstored
