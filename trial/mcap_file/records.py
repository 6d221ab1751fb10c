"""Reader of MCAP records.

Every length and count in a file is checked against the bytes present before it is used, and nothing is unpacked
beyond its stated, bounded size. A record that ends too early raises `CutError`, an inconsistent one ValueError; the
caller adds the file's name.
"""

import mmap
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from parameters import InputError
from parameters.files import refuse_special
from trial.mcap_file import container as mcap
from trial.mcap_file.cdr import MESSAGE_HEAD

CHUNK_LIMIT = 64 << 20  # one chunk, unpacked; writers in use make chunks of 64 KiB to 16 MiB
SPAN = 4 << 20
"""Bytes of a file that a reader from front to back leaves mapped."""
_HEAD = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<HH")
CHUNK_FIELDS = struct.Struct("<QQQI")  # first and last time, size unpacked, checksum

View = bytes | mmap.mmap


class Channel(NamedTuple):
    """A topic: how its messages are encoded and described."""

    number: int
    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str
    metadata: dict[str, str]


class CutError(Exception):
    """A record that ends before it should."""


class Cursor:
    """Reads the fields of one record; raises `CutError` at its end."""

    __slots__ = ("at", "end", "view")

    def __init__(self, view: View, at: int, end: int) -> None:
        self.view, self.at, self.end = view, at, end

    def take(self, size: int) -> bytes:
        at = self.at
        if size > self.end - at:
            raise CutError
        self.at = at + size
        return self.view[at:self.at]

    def unpack(self, shape: struct.Struct) -> tuple[int, ...]:
        return shape.unpack(self.take(shape.size))

    def number(self) -> int:
        return int.from_bytes(self.take(4), "little")

    def string(self) -> str:
        return self.take(self.number()).decode(errors="replace")

    def string_map(self) -> dict[str, str]:
        end = self.at + 4 + self.number()
        if end > self.end:
            raise CutError
        mapping = {}
        while self.at < end:
            key = self.string()
            mapping[key] = self.string()
        return mapping


@contextmanager
def mapped(path: str | Path) -> Iterator[mmap.mmap]:
    """Map a file that begins as an MCAP file does."""
    refuse_special(path)
    try:
        with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            magic(view, path)
            yield view
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a recorded trial.") from None
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = "the file is empty" if isinstance(error, ValueError) else error.strerror
        raise InputError(f"{path}: cannot be read ({reason}); give a recorded trial.") from None


def release(view: View, end: int) -> None:
    """Drop the pages before `end` from this process's memory; a file that is read on maps them again."""
    if isinstance(view, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        view.madvise(mmap.MADV_DONTNEED, 0, end)


def checksum(view: View, end: int) -> int:
    """Return the CRC-32 of the front of a file."""
    crc = 0
    with memoryview(view) as whole:
        for at in range(0, end, SPAN):
            with whole[at:min(at + SPAN, end)] as part:
                crc = zlib.crc32(part, crc)
            release(view, min(at + SPAN, end))
    return crc


def magic(view: View, path: str | Path) -> None:
    """Raise `InputError` where a file does not begin as an MCAP file does."""
    if view[:len(mcap.MAGIC)] != mcap.MAGIC:
        raise InputError(f"{path}: not an MCAP file; give a recorded trial, or import the file first.")


def records(view: View, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, begin, end) of each record's content; raises `CutError` at a malformed or truncated record."""
    while at < end:
        if end - at < 9:
            raise CutError
        opcode, length = _HEAD.unpack_from(view, at)
        at += 9
        if opcode == 0 or length > end - at:
            raise CutError
        yield opcode, at, at + length
        at += length


def read_schema(cursor: Cursor) -> tuple[int, tuple[str, str, str]]:
    """Read a schema: its number, then name, encoding and text."""
    number = int.from_bytes(cursor.take(2), "little")
    name, encoding = cursor.string(), cursor.string()
    return number, (name, encoding, cursor.take(cursor.number()).decode(errors="replace"))


def read_channel(cursor: Cursor, schemas: dict[int, tuple[str, str, str]]) -> Channel:
    """Read a channel, joined with its schema (empty strings if it has no schema)."""
    number, schema = cursor.unpack(_CHANNEL)
    topic, encoding = cursor.string(), cursor.string()
    name, schema_encoding, text = schemas.get(schema, ("", "", ""))
    return Channel(number, topic, encoding, name, schema_encoding, text, cursor.string_map())


def unpack(cursor: Cursor, checked: bool = False) -> tuple[bytes, int]:
    """Unpack a chunk record: its content and stated size; ValueError or `CutError` where they disagree."""
    _first, _last, size, crc = cursor.unpack(CHUNK_FIELDS)
    compression = cursor.string()
    packed = cursor.take(int.from_bytes(cursor.take(8), "little"))
    if size > CHUNK_LIMIT:
        raise ValueError(f"it would unpack to {size} bytes, more than {CHUNK_LIMIT}")
    data = _decompress(compression, packed, size)
    if len(data) != size:
        raise ValueError("it unpacks to another size than it states")
    if crc and not checked and zlib.crc32(data) != crc:
        raise ValueError("its checksum is wrong, bits were changed")
    return data, size


def _decompress(compression: str, packed: bytes, size: int) -> bytes:
    if compression == "":
        return packed
    if compression == "zstd":
        try:
            stated = zstandard.frame_content_size(packed)
            if stated not in (-1, size):
                raise ValueError("it unpacks to another size than it states")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    if compression == "lz4":
        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size))
        except RuntimeError as error:
            raise ValueError(str(error)) from None
    raise ValueError(f"its compression {compression!r} is unknown")


def read_attachment(cursor: Cursor) -> tuple[str, bytes]:
    """Read an attachment: its name and content; ValueError where its checksum is wrong."""
    begin = cursor.at
    cursor.take(16)
    name, _media = cursor.string(), cursor.string()
    data = cursor.take(int.from_bytes(cursor.take(8), "little"))
    crc = zlib.crc32(cursor.view[begin:cursor.at])
    stated = cursor.number()
    if stated and stated != crc:
        raise ValueError("its checksum is wrong")
    return name, data


def messages(data: bytes, channel: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield (sequence, log time, payload) of each message of `channel` in a chunk's content."""
    for opcode, at, end in records(data, 0, len(data)):
        if opcode == mcap.MESSAGE and end - at >= 22:
            _op, _length, number, sequence, log_time, _published = MESSAGE_HEAD.unpack_from(data, at - 9)
            if number == channel:
                yield sequence, log_time, data[at + 22:end]
