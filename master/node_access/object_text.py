"""Objects and their values as text: names and indices of a dictionary, raw values, units.

The rule of this file: an index is hexadecimal, with or without 0x; so is a sub-index.
"""

import re
from types import MappingProxyType
from typing import Final

from eds.cia402 import text_of
from eds.datatype import DataType, Value, decode, encode
from eds.dictionary import Dictionary, Entry
from parameters import InputError

_PLACE: Final = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:(?::|sub|\.)(?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE)
TEXTS: Final = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_SHORT: Final = MappingProxyType({
    "bool": DataType.BOOLEAN, "f32": DataType.REAL32, "f64": DataType.REAL64, "str": DataType.VISIBLE_STRING,
    "hex": DataType.OCTET_STRING,
    **{f"{letter}{bits}": DataType[f"{name}{bits}"] for letter, name in (("u", "UNSIGNED"), ("i", "INTEGER"))
       for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
})
"""Short names of data types: u8 … u64, i8 … i64, f32, f64, bool, str, hex."""


def shown_key(key: int) -> str:
    """Return an object's place as `6041:00`."""
    return f"{key >> 8:04X}:{key & 0xFF:02X}"


def full_name(dictionary: Dictionary, key: int) -> str:
    """Return the names of an object and of its sub-object; empty if the dictionary has neither."""
    entry, whole = dictionary.entries.get(key), dictionary.objects.get(key >> 8)
    if entry is None:
        return "" if whole is None else whole.name
    return entry.name if whole is None or whole.name == entry.name else f"{whole.name}: {entry.name}"


def find(dictionary: Dictionary | None, text: str) -> int:
    """Return index << 8 | sub-index of an object given as `1018:01`, `0x6041`, or by a name of the dictionary.

    Raises `InputError` for a name that no object or several objects have.
    """
    match = _PLACE.fullmatch(text.strip())
    if match is not None:
        return int(match[1], 16) << 8 | int(match[2] or "0", 16)
    if dictionary is None:
        raise InputError(f"object {text!r}: is no index such as 6041; a name needs the device's EDS (--eds).")
    wanted = text.strip().lower()
    found = [at for at, entry in dictionary.entries.items()
             if wanted in (entry.name.lower(), full_name(dictionary, at).lower())]
    if not found:
        near = [full_name(dictionary, at) for at in dictionary.entries if wanted in full_name(dictionary, at).lower()]
        raise InputError(f"object {text!r}: no such name in {dictionary.path}; "
                         + (f"there is {', '.join(near[:5])}." if near else "give an index such as 6041 or 1018:01."))
    if len(found) > 1:
        raise InputError(f"object {text!r}: {len(found)} objects of {dictionary.path} have this name; give one of "
                         f"{', '.join(map(shown_key, found[:8]))}.")
    return found[0]


def data_type(name: str) -> DataType:
    """Return a data type by its short name (u16) or CiA 301's (UNSIGNED16); `InputError` for another word."""
    found = _SHORT.get(name.lower()) or DataType.__members__.get(name.upper())
    if found is None:
        raise InputError(f"--type {name}: is no data type; give one of {', '.join(_SHORT)} or a name of CiA 301 such "
                         "as UNSIGNED16.")
    return found


def encoded(kind: DataType | None, text: str, where: str) -> bytes:
    """Return the bytes of a value given as text; `InputError` where it does not fit the type.

    Integers are decimal, 0x…, 0o… or 0b…; octet strings and domains are hexadecimal.
    """
    if kind is None:
        raise InputError(f"{where}: its type is not known; give --type (u16, i32, str, hex …) or its EDS.")
    try:
        if kind.integer:
            return encode(kind, int(text, 0))
        if kind.real:
            return encode(kind, float(text))
        if kind in TEXTS:
            return text.encode("latin-1" if kind is DataType.VISIBLE_STRING else "utf-16-le")
        return encode(kind, bytes.fromhex(text.removeprefix("0x")))
    except (ValueError, OverflowError):
        span = f" from {kind.low} to {kind.high}" if kind.integer else ""
        raise InputError(f"{where}: {text!r} is no {kind.name}; give a value{span} of that type.") from None


def refuse_outside(entry: Entry, data: bytes, where: str) -> None:
    """Raise `InputError` for a value outside LowLimit and HighLimit of the EDS."""
    if not entry.data_type.integer:
        return
    value = decode(entry.data_type, data)
    assert isinstance(value, int)
    if (entry.low is not None and value < entry.low) or (entry.high is not None and value > entry.high):
        raise InputError(f"{where}: {value} is outside {entry.low} … {entry.high} of the EDS; give a value within.")


def value_of(kind: DataType | None, data: bytes) -> Value | str:
    """Return what bytes from a node hold: a number, text, or the bytes themselves where the type does not fit them."""
    if kind is DataType.VISIBLE_STRING:
        return data.rstrip(b"\0").decode("latin-1")
    if kind is DataType.UNICODE_STRING:
        return data.decode("utf-16-le", "replace").rstrip("\0")
    if kind is None:
        return data
    try:
        return decode(kind, data)
    except ValueError:
        return data


def shown(value: Value | str | None, kind: DataType | None, scaled: tuple[float, str] | None = None,
          at: int = 0) -> str:
    """Return a value as a line shows it: decimal, hexadecimal for unsigned integers, SI with its unit, words of CiA
    402 for the object `at` (index << 8 | sub-index).
    """
    if value is None:
        return "–"
    if isinstance(value, bytes):
        return f"{len(value)} bytes: {value[:32].hex(' ')}{' …' if len(value) > 32 else ''}" if value else "0 bytes"
    if isinstance(value, str):
        return repr(value)
    text = f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value, int) and kind is not None and kind.size > 0 and not kind.signed and kind.bits > 1:
        text += f" (0x{value:0{kind.size * 2}X})"
    if words := text_of(at >> 8, value):
        text += f" = {words}"
    return text if scaled is None else f"{text} = {value * scaled[0]:.6g} {scaled[1]}".rstrip()


def plain(value: Value | str | None) -> object:
    """Return a value as JSON holds it: bytes as hexadecimal text."""
    return value.hex() if isinstance(value, bytes) else value


