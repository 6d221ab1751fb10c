"""CiA 301 data types: width, sign, range, and the bytes of a value.

A value is an int, a float or bytes (strings and domains are bytes); each type converts its values to little-endian
bytes and back.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from types import MappingProxyType
from typing import Final

Value = int | float | bytes


class DataType(IntEnum):
    """Data type codes (CiA 301, table 44); `bits` is 0 where the length varies, `code` is the struct letter or ""."""

    bits: int
    code: str
    signed: bool

    def __new__(cls, number: int, bits: int, code: str = "", signed: bool = False) -> DataType:
        member = int.__new__(cls, number)
        member._value_ = number
        member.bits, member.code, member.signed = bits, code, signed
        return member

    BOOLEAN = 0x01, 1
    INTEGER8 = 0x02, 8, "b", True
    INTEGER16 = 0x03, 16, "h", True
    INTEGER32 = 0x04, 32, "i", True
    UNSIGNED8 = 0x05, 8, "B"
    UNSIGNED16 = 0x06, 16, "H"
    UNSIGNED32 = 0x07, 32, "I"
    REAL32 = 0x08, 32, "f", True
    VISIBLE_STRING = 0x09, 0
    OCTET_STRING = 0x0A, 0
    UNICODE_STRING = 0x0B, 0
    TIME_OF_DAY = 0x0C, 48
    TIME_DIFFERENCE = 0x0D, 48
    DOMAIN = 0x0F, 0
    INTEGER24 = 0x10, 24, "", True
    REAL64 = 0x11, 64, "d", True
    INTEGER40 = 0x12, 40, "", True
    INTEGER48 = 0x13, 48, "", True
    INTEGER56 = 0x14, 56, "", True
    INTEGER64 = 0x15, 64, "q", True
    UNSIGNED24 = 0x16, 24
    UNSIGNED40 = 0x18, 40
    UNSIGNED48 = 0x19, 48
    UNSIGNED56 = 0x1A, 56
    UNSIGNED64 = 0x1B, 64, "Q"

    @property
    def real(self) -> bool:
        """True for REAL32 and REAL64."""
        return self in (DataType.REAL32, DataType.REAL64)

    @property
    def integer(self) -> bool:
        """True for BOOLEAN, INTEGERn and UNSIGNEDn."""
        return self.bits > 0 and not self.real and self not in (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)

    @property
    def size(self) -> int:
        """Bytes on the wire, 0 where the length varies."""
        return (self.bits + 7) // 8

    @property
    def low(self) -> int:
        """Least integer of the type."""
        return -(1 << (self.bits - 1)) if self.signed else 0

    @property
    def high(self) -> int:
        """Greatest integer of the type."""
        return (1 << (self.bits - self.signed)) - 1

    @property
    def zero(self) -> Value:
        """Value of an object without a default in its file."""
        return 0 if self.integer else 0.0 if self.real else bytes(self.size)


BY_CODE: Final = MappingProxyType({int(kind): kind for kind in DataType})
"""Data types by their CiA 301 code."""
_REALS: Final = {DataType.REAL32: struct.Struct("<f"), DataType.REAL64: struct.Struct("<d")}


def encode(data_type: DataType, value: Value) -> bytes:
    """Return the bytes of `value`; OverflowError where an integer does not fit, TypeError where the kind is wrong."""
    if data_type.integer:
        if not isinstance(value, int):
            raise TypeError(f"{data_type.name} holds a whole number, not {value!r}")
        if data_type is DataType.BOOLEAN:
            return b"\x01" if value else b"\x00"
        return value.to_bytes(data_type.size, "little", signed=data_type.signed)
    if data_type.real:
        if isinstance(value, bytes):
            raise TypeError(f"{data_type.name} holds a number, not bytes")
        return _REALS[data_type].pack(value)
    if not isinstance(value, bytes):
        raise TypeError(f"{data_type.name} holds bytes, not {value!r}")
    return value


def decode(data_type: DataType, data: bytes) -> Value:
    """Read a value from exactly its bytes; ValueError where a type of fixed size is given another length."""
    if data_type.size and len(data) != data_type.size:
        raise ValueError(f"{data_type.name} takes {data_type.size} bytes, not {len(data)}")
    if data_type is DataType.BOOLEAN:
        return data[0] & 1
    if data_type.integer:
        return int.from_bytes(data, "little", signed=data_type.signed)
    if data_type.real:
        return float(_REALS[data_type].unpack(data)[0])
    return bytes(data)
