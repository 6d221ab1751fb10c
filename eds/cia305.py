"""CiA 305 (LSS): command specifiers, identifiers and bit rates that master and slaves agree on."""

from __future__ import annotations

from enum import IntEnum
from types import MappingProxyType
from typing import Final, NamedTuple

LSS_REQUEST: Final = 0x7E5
"""COB-ID of the LSS master's requests (CiA 305)."""
LSS_RESPONSE: Final = 0x7E4
"""COB-ID of all LSS slaves' answers (CiA 305)."""
UNCONFIGURED: Final = 255
"""Node id of a device that has none yet (CiA 305)."""


class LssCommand(IntEnum):
    """Command specifiers, first byte of each LSS frame (CiA 305)."""

    text: str

    def __new__(cls, code: int, text: str) -> LssCommand:
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    SWITCH_GLOBAL = 0x04, "switch state"
    CONFIGURE_NODE_ID = 0x11, "configure node id"
    CONFIGURE_BIT_TIMING = 0x13, "configure bit timing"
    ACTIVATE_BIT_TIMING = 0x15, "activate bit timing"
    STORE = 0x17, "store configuration"
    SELECT_VENDOR = 0x40, "select vendor"
    SELECT_PRODUCT = 0x41, "select product"
    SELECT_REVISION = 0x42, "select revision"
    SELECT_SERIAL = 0x43, "select serial"
    SELECTED = 0x44, "selected"
    IDENTIFY_VENDOR = 0x46, "identify vendor"
    IDENTIFY_PRODUCT = 0x47, "identify product"
    IDENTIFY_REVISION_LOW = 0x48, "identify lowest revision"
    IDENTIFY_REVISION_HIGH = 0x49, "identify highest revision"
    IDENTIFY_SERIAL_LOW = 0x4A, "identify lowest serial"
    IDENTIFY_SERIAL_HIGH = 0x4B, "identify highest serial"
    IDENTIFY_UNCONFIGURED = 0x4C, "identify non-configured slave"
    IDENTIFIED = 0x4F, "identify slave"
    UNCONFIGURED_SLAVE = 0x50, "non-configured slave"
    FASTSCAN = 0x51, "fastscan"
    INQUIRE_VENDOR = 0x5A, "inquire vendor"
    INQUIRE_PRODUCT = 0x5B, "inquire product"
    INQUIRE_REVISION = 0x5C, "inquire revision"
    INQUIRE_SERIAL = 0x5D, "inquire serial"
    INQUIRE_NODE_ID = 0x5E, "inquire node id"


class LssAddress(NamedTuple):
    """128-bit address of a device: the four numbers of 0x1018."""

    vendor: int
    product: int
    revision: int
    serial: int

    def __str__(self) -> str:
        return ":".join(f"{number:X}" for number in self)


BIT_RATES: Final = MappingProxyType({
    0: 1_000_000, 1: 800_000, 2: 500_000, 3: 250_000, 4: 125_000, 6: 50_000, 7: 20_000, 8: 10_000,
})
"""Index of bit timing table 0 → bit/s (CiA 305; index 5 is reserved)."""

FASTSCAN_RESET: Final = 128
"""BitChecked of the first fastscan question: every unconfigured slave answers."""
