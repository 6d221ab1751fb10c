"""An MCAP file's summary, and its chunks through it.

The rule of this file: offsets and sizes in the summary are checked against the file before they are used;
whatever does not hold raises `InputError` with the file's name, the reason and what to do.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from parameters import InputError
from parameters.files import most_unpacked
from trial.mcap_file import container as mcap
from trial.mcap_file.records import (
    SPAN,
    Channel,
    Cursor,
    CutError,
    View,
    checksum,
    magic,
    read_attachment,
    read_channel,
    read_schema,
    records,
    release,
    unpack,
)

DATA_END_BYTES = 9 + 4
FOOTER_BYTES = 9 + 20 + len(mcap.MAGIC)
_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last time, offset, length, bytes of the map that follows
_CHANNEL_PLACE = struct.Struct("<HQ")
_PLACE = struct.Struct("<QQ")  # offset and length


class ChunkAt(NamedTuple):
    """Position of a chunk record, the channels in it (empty: any), and its size unpacked."""

    offset: int
    length: int
    channels: tuple[int, ...]
    unpacked: int


class Summary(NamedTuple):
    """Summary section at the end of a file; `checked` if the bytes before it match its checksum."""

    channels: dict[int, Channel]
    chunks: list[ChunkAt]
    attachments: list[tuple[int, int]]
    metadata: list[tuple[int, int]]
    checked: bool


def summary(view: View, path: str | Path) -> Summary:
    """Read a file's summary and compare both checksums; the file must have been closed by its writer."""
    magic(view, path)
    start, footer = _bounds(view, path)
    try:
        return _parse_summary(view, start, footer, _data_checked(view, start, path))
    except CutError:
        raise InputError(f"{path}: the summary is damaged; say bowden recover {path} -o FILE.") from None


def described(view: View, path: str | Path) -> dict[int, Channel]:
    """Return the channels by the summary alone, whatever became of the data; none where it is torn or damaged."""
    try:
        return _parse_summary(view, *_bounds(view, path), checked=False).channels
    except (CutError, InputError):
        return {}


def _bounds(view: View, path: str | Path) -> tuple[int, int]:
    """Return where the summary begins and the footer; `InputError` where they are not there as written."""
    torn = InputError(f"{path}: the recording was cut off before its end; say bowden recover {path} -o FILE.")
    size = len(view)
    if size < len(mcap.MAGIC) + FOOTER_BYTES or view[-len(mcap.MAGIC):] != mcap.MAGIC:
        raise torn
    footer = size - FOOTER_BYTES
    opcode, length = _HEAD.unpack_from(view, footer)
    start, _offsets, crc = _FOOTER.unpack_from(view, footer + 9)
    if (opcode, length) != (mcap.FOOTER, 20) or not 0 < start <= footer:
        raise torn
    if crc and zlib.crc32(view[start:footer + 25]) != crc:
        raise InputError(f"{path}: the summary's bits were changed (checksum); say bowden recover {path} -o FILE.")
    return start, footer


def _data_checked(view: View, start: int, path: str | Path) -> bool:
    """Compare the checksum of everything before the summary; False where the writer left none."""
    end = start - DATA_END_BYTES
    opcode, length = _HEAD.unpack_from(view, max(end, 0))
    if end < 0 or (opcode, length) != (mcap.DATA_END, 4):
        raise CutError
    stated = int.from_bytes(view[start - 4:start], "little")
    if stated and checksum(view, end) != stated:
        raise InputError(f"{path}: bits were changed (checksum); say bowden recover {path} -o FILE.")
    return stated != 0


def _parse_summary(view: View, start: int, footer: int, checked: bool) -> Summary:
    schemas: dict[int, tuple[str, str, str]] = {}
    found = Summary({}, [], [], [], checked)
    for opcode, at, end in records(view, start, footer):
        cursor = Cursor(view, at, end)
        if opcode == mcap.SCHEMA:
            number, parts = read_schema(cursor)
            schemas[number] = parts
        elif opcode == mcap.CHANNEL:
            channel = read_channel(cursor, schemas)
            found.channels[channel.number] = channel
        elif opcode == mcap.CHUNK_INDEX:
            found.chunks.append(_read_chunk_index(cursor, start))
        elif opcode in (mcap.ATTACHMENT_INDEX, mcap.METADATA_INDEX):
            offset, length = cursor.unpack(_PLACE)
            if offset + length > start:
                raise CutError
            (found.attachments if opcode == mcap.ATTACHMENT_INDEX else found.metadata).append((offset, length))
    return found


def _read_chunk_index(cursor: Cursor, data_end: int) -> ChunkAt:
    _first, _last, offset, length, indexes = cursor.unpack(_CHUNK_INDEX)
    if offset + length > data_end or indexes % 10:
        raise CutError
    channels = tuple(number for number, _ in _CHANNEL_PLACE.iter_unpack(cursor.take(indexes)))
    cursor.take(8)
    cursor.string()
    _packed, unpacked = cursor.unpack(_PLACE)
    return ChunkAt(offset, length, channels, unpacked)


def chunks_of(found: Summary, channel: int, path: str | Path, file_bytes: int) -> list[ChunkAt]:
    """Return the chunks that may hold `channel`; raises where they would unpack to more than is believable."""
    chunks = [chunk for chunk in found.chunks if not chunk.channels or channel in chunk.channels]
    unpacked = sum(chunk.unpacked for chunk in chunks)
    if unpacked > most_unpacked(file_bytes):
        raise InputError(
            f"{path}: {file_bytes} bytes would unpack to {unpacked}, expected at most "
            f"{most_unpacked(file_bytes)}; it is no recording, do not open it.")
    return chunks


def content(view: View, chunk: ChunkAt, path: str | Path, checked: bool) -> bytes:
    """Return the records in a chunk, unpacked; its own checksum is compared unless the file's has been."""
    damaged = f"{path}: the chunk at byte {chunk.offset} is damaged"
    try:
        opcode, at, end = next(records(view, chunk.offset, chunk.offset + chunk.length))
        if opcode != mcap.CHUNK:
            raise CutError
        data, unpacked = unpack(Cursor(view, at, end), checked)
    except (CutError, StopIteration, ValueError) as error:
        reason = f" ({error})" if str(error) else ""
        raise InputError(f"{damaged}{reason}; say bowden recover {path} -o FILE.") from None
    if unpacked != chunk.unpacked:
        raise InputError(f"{damaged} (its index states another size); say bowden recover {path} -o FILE.")
    return data


def contents(view: View, chunks: Iterable[ChunkAt], path: str | Path, checked: bool) -> Iterator[bytes]:
    """Yield what `content` returns of each chunk; at most `SPAN` bytes of the file and a chunk stay mapped."""
    mapped = 0
    for chunk in chunks:
        yield content(view, chunk, path, checked)
        if chunk.offset - mapped > SPAN:
            release(view, chunk.offset)
            mapped = chunk.offset


def attachments(view: View, found: Summary, path: str | Path) -> dict[str, bytes]:
    """Return every attachment, its checksum compared."""
    attached: dict[str, bytes] = {}
    for offset, length in found.attachments:
        cursor = _record(view, mcap.ATTACHMENT, offset, length, path)
        try:
            attached.update([read_attachment(cursor)])
        except (CutError, ValueError):
            raise InputError(f"{path}: the attachment at byte {offset} is damaged; say bowden recover.") from None
    return attached


def metadata(view: View, found: Summary, path: str | Path) -> dict[str, dict[str, str]]:
    """Return every metadata record by its name."""
    named = {}
    for offset, length in found.metadata:
        cursor = _record(view, mcap.METADATA, offset, length, path)
        try:
            name = cursor.string()
            named[name] = cursor.string_map()
        except CutError:
            raise InputError(f"{path}: the metadata at byte {offset} is damaged; say bowden recover.") from None
    return named


def _record(view: View, opcode: int, offset: int, length: int, path: str | Path) -> Cursor:
    try:
        found, at, end = next(records(view, offset, offset + length))
        if found != opcode:
            raise CutError
    except (CutError, StopIteration):
        raise InputError(f"{path}: the record at byte {offset} is damaged; say bowden recover.") from None
    return Cursor(view, at, end)
