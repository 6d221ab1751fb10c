"""Rules for the values of a drive's objects beyond their limits in the EDS.

A rule reads the value and the objects as they are, and returns 0 or an abort code.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, Protocol

from eds.cia301 import Abort
from eds.cia402 import Mode, State, Stop
from eds.datatype import Value
from eds.dictionary import key


class RuledDrive(Protocol):
    """Inputs of a rule: the objects' numbers of a drive, its state, and a homing or stop in progress."""

    @property
    def seeking(self) -> bool: ...

    @property
    def state(self) -> State | None: ...

    @property
    def emergency_stopped(self) -> bool: ...

    def number(self, index: int, subindex: int = 0) -> int: ...


RELEASE: Final = 0x736C6572
"""Signature "rels", written to 0x2020: the operator's release."""

_MODES: Final = frozenset(int(mode) for mode in Mode)
_STOPS: Final = frozenset(int(stop) for stop in Stop)
_POLARITY: Final = 0xC0
"""Bits of 0x607E in use: position and velocity, which here are turned together."""


def _mode(drive: RuledDrive, value: int) -> int:
    supported = drive.number(0x6502)
    known = value in _MODES and (value == Mode.NONE or supported & Mode(value).supported_bit)
    return 0 if known else Abort.INVALID_VALUE


def _quick_stop(_drive: RuledDrive, value: int) -> int:
    return 0 if value in _STOPS else Abort.INVALID_VALUE


def _method(drive: RuledDrive, value: int) -> int:
    listed = {drive.number(0x60E3, sub) for sub in range(1, drive.number(0x60E3) + 1)}
    if value not in listed:
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.seeking else 0


def _least(drive: RuledDrive, value: int) -> int:
    return Abort.MAX_BELOW_MIN if value > drive.number(0x607D, 2) else 0


def _greatest(drive: RuledDrive, value: int) -> int:
    return Abort.MAX_BELOW_MIN if value < drive.number(0x607D, 1) else 0


def _polarity(drive: RuledDrive, value: int) -> int:
    if value not in (0, _POLARITY):
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.state is State.OPERATION_ENABLED else 0


def _release(drive: RuledDrive, value: int) -> int:
    if value != RELEASE:
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.emergency_stopped else 0


RULES: Final[Mapping[int, Callable[[RuledDrive, int], int]]] = MappingProxyType({
    key(0x2020): _release,
    key(0x605A): _quick_stop,
    key(0x6060): _mode,
    key(0x607D, 1): _least,
    key(0x607D, 2): _greatest,
    key(0x607E): _polarity,
    key(0x6098): _method,
})
"""By key: (drive, value) → 0 or an SDO abort code."""


def refused(drive: RuledDrive, at: int, value: Value) -> int:
    """Return 0 or the abort code for a write of `value` to the object `at`."""
    rule = RULES.get(at)
    return rule(drive, int(value)) if rule is not None else 0
