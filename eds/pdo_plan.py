"""PDO plans: a mapping compiled once into the fewest operations that pack and unpack its frames.

The rule of this file: what can be known before the first frame is worked out before the first frame.
Byte-aligned mappings become one `struct.Struct`; the rest (BOOLEAN bits, 24-bit integers) go bit by bit.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from eds.datatype import BY_CODE, DataType
from eds.dictionary import Dictionary, Entry, key
from parameters import InputError

MAX_BITS: Final = 64
FIRST_OBJECT: Final = 0x1000
"""Indices below it are data types: mapped, they are dummies (CiA 301, 7.4.7)."""


class Field(NamedTuple):
    """One mapped object; `code` is its struct letter, "" for a dummy or a width that struct lacks."""

    key: int
    name: str
    bits: int
    code: str
    scale: float
    signed: bool = False

    @property
    def dummy(self) -> bool:
        """A gap in the frame: these bits belong to another node."""
        return self.key >> 8 < FIRST_OBJECT

    @property
    def word(self) -> int:
        """PDO mapping entry, as 0x16xx and 0x1Axx contain it."""
        return self.key << 8 | self.bits


class PdoPlan:
    """A frame's layout, compiled: raw values are those of the dictionary, dummies left out of every tuple.

    `unpack(data)` takes a frame of at least `size` bytes (longer ones: the mapped part); `pack(*raw)` gives exactly
    `size` bytes with dummies zero. Both raise `struct.error` on a short frame, a wrong count or a value out of range.
    `unpack_si(data)` gives raw × scale; `pack_si(*values)` rounds to the nearest count and holds it at the ends of the
    type (ValueError on NaN). Both are written when the first of them is asked for: devices need neither. Keep them.
    """

    __slots__ = ("_si", "cob_id", "fields", "keys", "pack", "size", "struct", "unpack")

    def __init__(self, cob_id: int, fields: Sequence[Field]) -> None:
        self.cob_id = cob_id
        self.fields = tuple(fields)
        self.size = (sum(f.bits for f in self.fields) + 7) // 8
        self.keys = tuple(f.key for f in self.fields if not f.dummy)
        self.struct = _struct(self.fields)
        self.unpack: Callable[[bytes], tuple[int, ...]]
        self.pack: Callable[..., bytes]
        if self.struct is None:
            bits = _Bits(self.fields, self.size)
            self.unpack, self.pack = bits.unpack, bits.pack
        else:
            self.unpack, self.pack = self.struct.unpack_from, self.struct.pack
        self._si: tuple[Callable[[bytes], tuple[float, ...]], Callable[..., bytes]] | None = None

    @property
    def unpack_si(self) -> Callable[[bytes], tuple[float, ...]]:
        """Convert a frame to SI values."""
        return self._conversions()[0]

    @property
    def pack_si(self) -> Callable[..., bytes]:
        """Convert SI values to a frame."""
        return self._conversions()[1]

    def _conversions(self) -> tuple[Callable[[bytes], tuple[float, ...]], Callable[..., bytes]]:
        if self._si is None:
            self._si = _si([f for f in self.fields if not f.dummy], self.unpack, self.pack)
        return self._si

    def __repr__(self) -> str:
        words = " ".join(f"{f.key >> 8:04X}:{f.key & 0xFF:02X}/{f.bits}" for f in self.fields)
        return f"PdoPlan({self.cob_id:03X}h, {words})"


def compile_plan(
    dictionary: Dictionary, mapping: Sequence[int], cob_id: int, scales: Mapping[int, float] = {},
) -> PdoPlan:
    """Compile mapping words (index << 16 | subindex << 8 | bits) of one device into a plan.

    `scales` gives SI per raw count by key, 1 where it is silent. Raises `InputError` where an object is absent or not
    mappable, its length is wrong, or the frame would exceed 8 bytes.
    """
    fields = [_field(dictionary, word, scales) for word in mapping]
    bits = sum(f.bits for f in fields)
    if bits > MAX_BITS:
        raise InputError(f"{dictionary.path}: the map of {cob_id:03X}h has {bits} bits; map at most {MAX_BITS}.")
    return PdoPlan(cob_id, fields)


def overlay(plans: Sequence[PdoPlan], cob_id: int) -> PdoPlan:
    """Join what several receivers take from one frame: each bit is an object of one of them, a dummy of the others.

    Raises `InputError` where two claim the same bits or their layouts do not line up.
    """
    fields: list[Field] = []
    for row in zip(*(plan.fields for plan in plans), strict=True):
        claimed = [f for f in row if not f.dummy]
        if len({f.bits for f in row}) > 1 or len(claimed) > 1:
            names = ", ".join(f.name for f in row)
            raise InputError(f"PDO {cob_id:03X}h: {names} do not line up; map dummies where others' bits are.")
        fields.append(claimed[0] if claimed else row[0])
    return PdoPlan(cob_id, fields)


def _field(dictionary: Dictionary, word: int, scales: Mapping[int, float]) -> Field:
    index, sub, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
    where = f"{dictionary.path}: mapping {word:08X}h"
    if index < FIRST_OBJECT:
        if index not in dictionary.dummies or index not in BY_CODE or bits != BY_CODE[index].bits:
            raise InputError(f"{where}: no such dummy; [DummyUsage] of the EDS names those that may be mapped.")
        return Field(key(index, sub), f"Dummy{index:04X}", bits, "", 1.0)
    entry = dictionary.entries.get(key(index, sub))
    if entry is None:
        raise InputError(f"{where}: no object {index:04X}:{sub:02X}; map one that the EDS lists.")
    if not entry.mappable:
        raise InputError(f"{where}: {index:04X}:{sub:02X} {entry.name} has PDOMapping=0; map another object.")
    if bits not in _widths(entry):
        raise InputError(f"{where}: {entry.name} has {entry.data_type.bits} bits, not {bits}; mend the length.")
    code = entry.data_type.code or ("B" if bits == 8 else "")
    return Field(entry.key, entry.name, bits, code, scales.get(entry.key, 1.0), entry.data_type.signed)


def _widths(entry: Entry) -> tuple[int, ...]:
    """Lengths by which an object may be mapped: its own, and a BOOLEAN as a byte too; none where its length varies."""
    kind = entry.data_type
    return (1, 8) if kind is DataType.BOOLEAN else (kind.bits,) if kind.integer or kind.real else ()


def _range(field: Field) -> tuple[int, int] | tuple[None, int]:
    if field.code in ("f", "d"):
        return None, 0
    return (-(1 << field.bits - 1) if field.signed else 0), (1 << field.bits - field.signed) - 1


def _struct(fields: Sequence[Field]) -> struct.Struct | None:
    """One little-endian struct, or None where a field has no letter or a gap no whole bytes."""
    if any(f.bits % 8 or not (f.code or f.dummy) for f in fields):
        return None
    return struct.Struct("<" + "".join(f"{f.bits // 8}x" if f.dummy else f.code for f in fields))


class JoinedUnpacker:
    """One call for what several frames bring, from a buffer of `JOINED_BYTES` a frame, in the order of `plans`.

    Of each frame the buffer has a time stamp, ns (INTEGER64), and its data, padded to 8.  `unpack(buffer)` gives one
    tuple: of each frame its time stamp, then its raw values, or its 8 bytes where it has fields off the byte grid.
    `unpack_si(buffer)` gives the time stamps, and of each frame a tuple as its plan's `unpack_si` does.
    """

    __slots__ = ("unpack", "unpack_si")

    def __init__(self, plans: Sequence[PdoPlan]) -> None:
        codes, names, scaled = "<", [], []
        scope: dict[str, Any] = {}
        for n, plan in enumerate(plans):
            fields = [field for field in plan.fields if not field.dummy]
            own = [f"v{n}_{at}" for at in range(len(fields))] if plan.struct else [f"d{n}"]
            codes += f"q{plan.struct.format[1:]}{8 - plan.size}x" if plan.struct else "q8s"
            scaled.append(_scaled(own, fields) if plan.struct else f"unpack{n}(d{n})")
            names += [f"t{n}", *own]
            scope[f"unpack{n}"] = plan.unpack_si
        self.unpack: Callable[[Any], tuple[Any, ...]] = struct.Struct(codes).unpack_from
        scope["unpack"] = self.unpack
        times = [f"t{n}" for n in range(len(plans))]
        exec(_JOINED.format(names=_tuple(names), times=_tuple(times), scaled=_tuple(scaled)), scope)
        self.unpack_si: Callable[[Any], tuple[tuple[int, ...], tuple[tuple[float, ...], ...]]] = scope["unpack_joined"]


JOINED_BYTES: Final = 16
_JOINED: Final = """
def unpack_joined(buffer):
    {names} = unpack(buffer)
    return {times}, {scaled}
"""
_SI: Final = """
def unpack_si(data):
    {names} = unpack(data)
    return {scaled}

def pack_si({arguments}):
    return pack({held})
"""


def _si(fields: Sequence[Field], unpack: Any, pack: Any) -> tuple[Any, Any]:
    """Write both conversions out as code with their numbers in place: a loop would cost three times as much."""
    names = [f"v{at}" for at in range(len(fields))]
    held = [_held(name, f) for name, f in zip(names, fields, strict=True)]
    source = _SI.format(
        names=_tuple(names), scaled=_scaled(names, fields), arguments=", ".join(names), held=", ".join(held))
    scope = {"unpack": unpack, "pack": pack}
    exec(source, scope)
    return scope["unpack_si"], scope["pack_si"]


def _scaled(names: Sequence[str], fields: Sequence[Field]) -> str:
    return _tuple([name if f.scale == 1.0 else f"{name} * {f.scale!r}" for name, f in zip(names, fields, strict=True)])


def _held(name: str, field: Field) -> str:
    counts = name if field.scale == 1.0 else f"{name} / {field.scale!r}"
    low, high = _range(field)
    return counts if low is None else f"round({low} if (c := {counts}) < {low} else {high} if c > {high} else c)"


def _tuple(items: Sequence[str]) -> str:
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"


class _Bits:
    """The slow path: fields at any bit, least significant bit first (CiA 301, 7.1)."""

    def __init__(self, fields: Sequence[Field], size: int) -> None:
        self.size = size
        self.places: list[tuple[int, Field]] = []
        shift = 0
        for field in fields:
            if not field.dummy:
                self.places.append((shift, field))
            shift += field.bits

    def unpack(self, data: bytes) -> tuple[int, ...]:
        if len(data) < self.size:
            raise struct.error(f"a frame of at least {self.size} bytes is needed, not {len(data)}")
        word = int.from_bytes(data[:self.size], "little")
        return tuple(_value(word >> shift & (1 << field.bits) - 1, field) for shift, field in self.places)

    def pack(self, *raw: int) -> bytes:
        if len(raw) != len(self.places):
            raise struct.error(f"{len(self.places)} values are needed, not {len(raw)}")
        word = 0
        for value, (shift, field) in zip(raw, self.places, strict=True):
            word |= _pattern(value, field) << shift
        return word.to_bytes(self.size, "little")


def _value(pattern: int, field: Field) -> int:
    """Read a field's bits as its type does; a REAL that lies off the byte grid is read by its own struct."""
    if field.code in ("f", "d"):
        data = pattern.to_bytes(field.bits // 8, "little")
        return struct.unpack("<" + field.code, data)[0]  # type: ignore[no-any-return]
    return pattern - (1 << field.bits) if field.signed and pattern >> field.bits - 1 else pattern


def _pattern(value: int, field: Field) -> int:
    if field.code in ("f", "d"):
        return int.from_bytes(struct.pack("<" + field.code, value), "little")
    low, high = _range(field)
    if low is None or not low <= value <= high:
        raise struct.error(f"{field.name}: {value} is outside {low} … {high}")
    return value & (1 << field.bits) - 1
