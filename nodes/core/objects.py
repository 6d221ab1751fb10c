"""Object values: contents of a dictionary's entries, and rules for reading and writing them.

A refusal is an SDO abort code, never an exception; every entry of `values` can be encoded.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from eds.cia301 import Abort
from eds.datatype import DataType, Value, decode, encode
from eds.dictionary import Dictionary, Entry
from parameters import InputError

MAX_BYTES: Final = 1 << 16
"""Greatest length of a string or domain, bytes, that a device stores."""


class Objects:
    """The entries of one dictionary and their present values; an entry whose key is not in `values` has no data now."""

    __slots__ = ("_indices", "dictionary", "entries", "values")

    def __init__(self, dictionary: Dictionary) -> None:
        self.dictionary = dictionary
        self.entries: Mapping[int, Entry] = dictionary.entries
        self._indices = frozenset(key >> 8 for key in dictionary.entries)
        self.values: dict[int, Value] = {}
        for key, entry in self.entries.items():
            if not fits(entry, entry.initial):
                where = f"{dictionary.path}: {entry.index:04X}:{entry.subindex:02X}"
                raise InputError(f"{where} DefaultValue {entry.initial!r} is no {entry.data_type.name}; mend the EDS.")
            self.values[key] = entry.initial

    def renumber(self, shift: int) -> None:
        """Add `shift` to the defaults that depend on the node id, because that has changed."""
        self.entries = {
            at: replace(entry, default=entry.default + shift)
            if entry.relative and isinstance(entry.default, int) else entry
            for at, entry in self.entries.items()}

    def number(self, key: int, missing: int = 0) -> int:
        """Return the value of an integer object; `missing` where the dictionary has none."""
        value = self.values.get(key, missing)
        return value if isinstance(value, int) else missing

    def missing(self, key: int) -> Abort | None:
        """Return None if `key` exists, else the abort: object or sub-index missing."""
        if key in self.entries:
            return None
        return Abort.NO_SUBINDEX if key >> 8 in self._indices else Abort.NO_OBJECT

    def upload(self, key: int) -> bytes | Abort:
        """Return the bytes that a read of `key` gives, or the abort that refuses it; no data is one too."""
        refusal = self.missing(key)
        if refusal:
            return refusal
        entry = self.entries[key]
        if not entry.readable:
            return Abort.WRITE_ONLY
        value = self.values.get(key)
        # an empty string or domain is refused: a segmented upload of nothing breaks stock masters (decision 11)
        return (b"" if value is None else encode(entry.data_type, value)) or Abort.NO_DATA

    def may_download(self, key: int, size: int | None) -> Abort | None:
        """Return None if a write of `size` bytes (None: size not given) to `key` may begin, else the abort."""
        refusal = self.missing(key)
        if refusal:
            return refusal
        entry = self.entries[key]
        if not entry.writable:
            return Abort.READ_ONLY
        return None if size is None else _length(entry.data_type, size)

    def decode(self, key: int, data: bytes) -> Value | Abort:
        """Return the value that `data` writes to `key`, or the abort that refuses its length."""
        entry = self.entries[key]
        refusal = _length(entry.data_type, len(data))
        return refusal or decode(entry.data_type, data)


def outside(entry: Entry, value: Value) -> Abort | None:
    """Return the abort for a value beyond LowLimit or HighLimit, else None."""
    if isinstance(value, bytes):
        return None
    if entry.high is not None and not value <= entry.high:
        return Abort.TOO_HIGH
    if entry.low is not None and not value >= entry.low:
        return Abort.TOO_LOW
    return None


def fits(entry: Entry, value: Value) -> bool:
    """Return whether `value` is of the entry's type."""
    try:
        data = encode(entry.data_type, value)
    except (TypeError, OverflowError):
        return False
    return not _length(entry.data_type, len(data))


def _length(data_type: DataType, size: int) -> Abort | None:
    if not data_type.size:
        return Abort.MEMORY if size > MAX_BYTES else None
    if size > data_type.size:
        return Abort.TOO_LONG
    return Abort.TOO_SHORT if size < data_type.size else None
