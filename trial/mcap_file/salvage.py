"""Recovery of records from the bytes of a torn or damaged MCAP file.

Bytes are accepted if records follow one another or a checksum holds; after malformed bytes the search goes on at the
next chunk. Nothing here writes.
"""

import mmap
import zlib
from collections.abc import Iterator

import zstandard

from trial.mcap_file import container as mcap
from trial.mcap_file import records

ZSTD_CHUNK = b"\x04\0\0\0zstd"  # after 9 + 28 bytes of every zstd chunk record
LONGEST_OTHER = 4 << 20  # bytes of a record that is neither chunk nor attachment: what claims more is damage


def walk(view: mmap.mmap, skipped: list[int]) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, begin, end) of every record; appends to `skipped` the bytes that belong to none.

    A record counts where another begins after it, or the file ends.  One that the file's end cuts is yielded as
    far as it goes; behind it, as behind bytes that make no sense, the next chunk is looked for.
    """
    at, size = len(mcap.MAGIC), len(view)
    while at + 9 <= size:
        end = at + 9 + int.from_bytes(view[at + 1:at + 9], "little")
        if begins(view, at) and (end > size or begins(view, end)):
            yield view[at], at + 9, min(end, size)
            if end <= size:
                at = end
                continue
        found = view.find(ZSTD_CHUNK, at + 38)
        resumed = size if found < 0 else found - 37
        skipped.append(resumed - at)
        at = resumed


def begins(view: mmap.mmap, at: int) -> bool:
    """Return whether a record may begin here, or the file end."""
    head = view[at:at + 9]
    if len(head) < 9:
        return head in (b"", mcap.MAGIC)
    limit = records.CHUNK_LIMIT if head[0] in (mcap.CHUNK, mcap.ATTACHMENT) else LONGEST_OTHER
    return 1 <= head[0] <= 15 and int.from_bytes(head[1:], "little") <= limit


def surviving(cursor: records.Cursor) -> tuple[bytes, bool]:
    """Return a chunk's content and True, or the front of it where the file ends in it, else nothing, and False."""
    begin = cursor.at
    try:
        return records.unpack(cursor)[0], True
    except records.CutError:
        cursor.at = begin
        return _front(cursor), False
    except ValueError:
        return b"", False


def _front(cursor: records.Cursor) -> bytes:
    """Return the bytes that a chunk cut by the end of the file still unpacks to."""
    try:
        _first, _last, size, crc = cursor.unpack(records.CHUNK_FIELDS)
        compression = cursor.string()
        cursor.take(8)
    except records.CutError:
        return b""
    rest = cursor.view[cursor.at:cursor.end]
    if compression == "zstd" and size <= records.CHUNK_LIMIT:
        try:
            rest = zstandard.ZstdDecompressor().stream_reader(rest).read(size + 1)
        except zstandard.ZstdError:
            return b""
    elif compression != "":
        return b""
    return b"" if len(rest) > size or (len(rest) == size and crc not in (0, zlib.crc32(rest))) else rest


def whole_records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield the records of a chunk's content up to the first that is cut."""
    try:
        yield from records.records(content, 0, len(content))
    except records.CutError:
        return


def channels(view: mmap.mmap) -> dict[int, records.Channel]:
    """Return the channels of a file without a summary, wherever they survived: in front or in chunks."""
    described = _Descriptions()
    for opcode, at, end in walk(view, []):
        described.take(opcode, records.Cursor(view, at, end))
        if opcode == mcap.CHUNK and not described.channels:
            content, _ = surviving(records.Cursor(view, at, end))
            for inner, begin, stop in whole_records(content):
                described.take(inner, records.Cursor(content, begin, stop))
    return described.channels


class _Descriptions:
    def __init__(self) -> None:
        self.schemas: dict[int, tuple[str, str, str]] = {}
        self.channels: dict[int, records.Channel] = {}

    def take(self, opcode: int, cursor: records.Cursor) -> None:
        """Store the schema, channel or other description in a record, if it has one."""
        try:
            if opcode == mcap.SCHEMA:
                number, parts = records.read_schema(cursor)
                self.schemas.setdefault(number, parts)
            elif opcode == mcap.CHANNEL:
                channel = records.read_channel(cursor, self.schemas)
                self.channels.setdefault(channel.number, channel)
        except records.CutError:
            return
