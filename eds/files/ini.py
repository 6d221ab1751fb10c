"""The text of an EDS or DCF, as sections of keys with their line numbers.

The rule of this file: nothing is refused that a human could read. Any encoding, any line end, any
case, sections and keys twice: all are kept, in order, and the first of two is the one that counts, as
in the Windows profile functions that EDS tools grew up with.
"""

import codecs
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from parameters import InputError


class Item(NamedTuple):
    """One `key=value`, with its line from 1."""

    key: str
    value: str
    line: int


class Section:
    """One `[name]` with its items; `get` ignores case and takes the first of two equal keys."""

    __slots__ = ("_first", "items", "line", "name")

    def __init__(self, name: str, line: int) -> None:
        self.name = name
        self.line = line
        self.items: list[Item] = []
        self._first: dict[str, str] = {}

    def add(self, key: str, value: str, line: int) -> None:
        """Append one item."""
        self.items.append(Item(key, value, line))
        self._first.setdefault(key.lower(), value)

    def get(self, key: str) -> str | None:
        """Return the value of `key`, None where it is absent or empty."""
        return self._first.get(key.lower()) or None

    def line_of(self, key: str) -> int:
        """Return the line of `key`, or the section's own."""
        return next((item.line for item in self.items if item.key.lower() == key.lower()), self.line)


def decode(raw: bytes) -> str:
    """Read text in the encoding its first bytes or its content show: UTF-16, UTF-8, else Windows-1252."""
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return raw.decode("utf-16", "replace")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


def parse(text: str) -> Iterator[Section]:
    """Yield the sections in file order; lines before the first section, and lines of neither form, are passed over."""
    section: Section | None = None
    for number, raw in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        line = raw.strip().strip("\0\ufeff\x1a")
        if not line or line[0] in ";#":
            continue
        if line[0] == "[" and "]" in line:
            if section is not None:
                yield section
            section = Section(line[1:line.index("]")].strip(), number)
        elif section is not None and "=" in line:
            key, _, value = line.partition("=")
            section.add(key.strip(), _without_comment(value), number)
    if section is not None:
        yield section


def _without_comment(value: str) -> str:
    """Cut an inline comment: a semicolon after white space, or at the start."""
    for at, letter in enumerate(value):
        if letter == ";" and (at == 0 or value[at - 1].isspace()):
            return value[:at].strip()
    return value.strip()


CONTROLS = bytes(set(range(1, 32)) - set(b"\t\n\f\r\x1a"))
"""Control characters that no text file contains. NUL is not among them, since UTF-16 contains it."""
BINARY_SHARE = 0.01
"""Share of such bytes from which a file is no text: 0.1 of random bytes, 0 of the texts of EDS tools."""


def read(path: Path) -> list[Section]:
    """Read the sections of a file; `InputError` where it cannot be opened, is no text or has none."""
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of an existing EDS or DCF.") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable EDS or DCF.") from None
    if len(raw) - len(raw.translate(None, CONTROLS)) > BINARY_SHARE * len(raw):
        raise InputError(f"{path}: is binary, no text; an EDS or DCF (CiA 306) was expected.")
    found = list(parse(decode(raw)))
    if not found:
        raise InputError(f"{path}: no section in it; an EDS or DCF (CiA 306) was expected.")
    return found
