"""Notation of EDS and DCF files for numbers, limits, values and section names.

Every notation met in the field is read, nothing is guessed; text that is not a number gives None.
"""

import re
from typing import Final

from eds.datatype import DataType, Value

_OBJECT: Final = re.compile(r"(?:0x)?([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?", re.IGNORECASE)
_NUMBER: Final = re.compile(r"[+-]?(?:0x[+-]?([0-9a-f]+)|([0-9a-f]+)h|(0[0-7]+)|([0-9]+))", re.IGNORECASE)
_NODE_ID: Final = re.compile(r"\+?\$?NODEID\+?", re.IGNORECASE)


def object_section(name: str) -> tuple[int, int | None] | None:
    """Read a section name as (index, subindex or None); None where it names no object."""
    match = _OBJECT.fullmatch(name.strip())
    return None if match is None else (int(match[1], 16), int(match[2], 16) if match[2] else None)


def number(text: str | None, node_id: int | None = None) -> int | None:
    """Read a number as EDS files write it: decimal, 0x…, C octal, …h, signed hex, `$NODEID` forms; None for other
    text.

    A `$NODEID` form without a node id gives None, too.
    """
    word = (text or "").replace(" ", "")
    rest = _NODE_ID.sub("", word)
    if rest != word:
        offset = number(rest) if rest else 0
        return None if node_id is None or offset is None else node_id + offset
    match = _NUMBER.fullmatch(word)
    if match is None:
        return None
    hexadecimal, suffixed, octal, decimal = match.groups()
    base = 16 if hexadecimal or suffixed else 8 if octal else 10
    magnitude = int(hexadecimal or suffixed or octal or decimal, base)
    return -magnitude if "-" in word else magnitude


def value(data_type: DataType, text: str | None, node_id: int | None = None) -> Value | None:
    """Read a value of a type; None if the text is absent or not a value."""
    if text is None:
        return None
    if data_type.integer:
        return _wrapped(data_type, number(text, node_id))
    if data_type is DataType.VISIBLE_STRING:
        return _octets(text)
    if data_type is DataType.UNICODE_STRING:
        return text.encode("utf-16-le", "surrogatepass")
    try:
        return float(text) if data_type.real else bytes.fromhex(text)
    except ValueError:
        return None


def text_of(data_type: DataType, held: Value) -> str | None:
    """Return the text that `value` reads as `held`; None for octets that no text of the type gives.

    Strings are text; octet strings, times and domains are hexadecimal octets.
    """
    if data_type.integer:
        return str(held)
    if data_type.real:
        return repr(held)
    assert isinstance(held, bytes)
    if data_type is DataType.VISIBLE_STRING:
        codings: tuple[str, ...] = ("utf-8", "latin-1")
    elif data_type is DataType.UNICODE_STRING:
        codings = ("utf-16-le",)
    else:
        return held.hex(" ").upper()
    texts = (held.decode(coding, "ignore") for coding in codings)
    return next((text for text in texts if value(data_type, text) == held), None)


def _octets(text: str) -> bytes:
    """Return the octets of a VISIBLE_STRING: Latin-1, and UTF-8 for text beyond Latin-1."""
    try:
        return text.encode("latin-1")
    except UnicodeEncodeError:
        return text.encode("utf-8", "surrogatepass")


def limit(data_type: DataType, text: str | None, node_id: int | None = None) -> int | None:
    """Read a LowLimit or HighLimit; None if the type has no order or the text is not a number."""
    if data_type.real:
        try:
            return int(float(text or ""))
        except (ValueError, OverflowError):
            return None
    return _wrapped(data_type, number(text, node_id)) if data_type.integer else None


def _wrapped(data_type: DataType, given: int | None) -> int | None:
    """Return a limit in its type's range, also if written as two's complement or as -1; None if it does not fit."""
    if given is None or data_type.low <= given <= data_type.high:
        return given
    if not data_type.signed:
        turned = given + (1 << data_type.bits)
        return turned if given < 0 <= turned else None
    turns = (given - (1 << width) for width in (data_type.bits, 32, 64))
    return next((turned for turned in turns if data_type.low <= turned < 0), None)
