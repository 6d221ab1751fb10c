"""Reader of MCAP files: records, and the summary with the chunks that it names.

Every length and count in a file is checked against the bytes present before it is used, and nothing is unpacked
beyond its stated, bounded size. A record that ends too early raises `CutError`, an inconsistent one ValueError; the
caller adds the file's name. Functions that take the file's path raise `InputError` with the reason and what to do.
"""

import io
import mmap
import struct
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.records import Attachment, Header, Metadata, Schema
from mcap.records import Channel as ChannelRecord
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import most_unpacked, refuse_special
from trial.mcap_file import container as mcap
from trial.mcap_file.cdr import MESSAGE_HEAD

CHUNK_LIMIT = 64 << 20  # one chunk, unpacked; writers in use make chunks of 64 KiB to 16 MiB
SPAN = 4 << 20
"""Bytes of a file that stay mapped behind a reader from front to back."""
_HEAD = struct.Struct("<BQ")

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


class Content(io.BytesIO):
    """Content of one record as the package mcap reads it; raises `CutError` at its end."""

    def read(self, size: int | None = -1) -> bytes:
        """Return the next `size` bytes."""
        if size is None or size > len(self.getbuffer()) - self.tell():
            raise CutError
        return super().read(size)


def read(kind: Any, view: View, at: int, end: int) -> Any:
    """Return the record, of a class of `mcap.records`, in `view[at:end]`; `CutError` if its fields are longer."""
    try:
        return kind.read(ReadDataStream(Content(view[at:end])))
    except UnicodeDecodeError:
        raise CutError from None


class Descriptions:
    """Channels by number, joined with their schemas (empty strings for a channel without one); the first of a number
    stays."""

    def __init__(self) -> None:
        self.channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {0: Schema(0, b"", "", "")}

    def take(self, opcode: int, view: View, at: int, end: int) -> None:
        """Store the schema or channel that a record describes, if it does; raises `CutError`."""
        if opcode == mcap.SCHEMA:
            schema = read(Schema, view, at, end)
            self._schemas.setdefault(schema.id, schema)
        elif opcode == mcap.CHANNEL:
            found = read(ChannelRecord, view, at, end)
            schema = self._schemas.get(found.schema_id, self._schemas[0])
            self.channels.setdefault(found.id, Channel(
                found.id, found.topic, found.message_encoding, schema.name, schema.encoding,
                schema.data.decode(errors="replace"), found.metadata))


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
        raise InputError(f"{path}: not an MCAP file; give a recorded trial, or make one: bowden import {path} "
                         "-o trial.mcap.")


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


def chunk_head(view: View, at: int, end: int) -> tuple[int, int, str, int, int]:
    """Return size unpacked, checksum, compression, and begin and end of the packed bytes; raises `CutError`.

    A chunk and its index are read by structures, for the package mcap takes twice the time, and a file has thousands.
    """
    _first, _last, size, crc, length = _unpacked(_CHUNK, view, at, end)
    begin = at + _CHUNK.size + length + 8
    if begin > end:
        raise CutError
    name, packed = view[begin - 8 - length:begin - 8], int.from_bytes(view[begin - 8:begin], "little")
    return size, crc, name.decode(errors="replace"), begin, begin + packed


def _unpacked(shape: struct.Struct, view: View, at: int, end: int) -> tuple[int, ...]:
    if at + shape.size > end:
        raise CutError
    return shape.unpack_from(view, at)


def unpack(view: View, at: int, end: int, checked: bool = False) -> tuple[bytes, int]:
    """Unpack a chunk record: its content and stated size; ValueError or `CutError` where they disagree."""
    size, crc, compression, begin, stop = chunk_head(view, at, end)
    if stop > end:
        raise CutError
    if size > CHUNK_LIMIT:
        raise ValueError(f"it would unpack to {size} bytes, more than {CHUNK_LIMIT}")
    data = _decompress(compression, view[begin:stop], size)
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


def attachment(view: View, at: int, end: int) -> tuple[str, bytes]:
    """Return name and content of an attachment record; ValueError where its checksum is wrong."""
    found = read(Attachment, view, at, end)
    stated = int.from_bytes(view[end - 4:end], "little")
    if stated and stated != zlib.crc32(view[at:end - 4]):
        raise ValueError("its checksum is wrong")
    return found.name, found.data


def messages(data: bytes, channel: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield (sequence, log time, payload) of each message of `channel` in a chunk's content."""
    for opcode, at, end in records(data, 0, len(data)):
        if opcode == mcap.MESSAGE and end - at >= 22:
            _op, _length, number, sequence, log_time, _published = MESSAGE_HEAD.unpack_from(data, at - 9)
            if number == channel:
                yield sequence, log_time, data[at + 22:end]


DATA_END_BYTES = 9 + 4
FOOTER_BYTES = 9 + 20 + len(mcap.MAGIC)
_CHUNK = struct.Struct("<QQQII")  # first and last time, size unpacked, checksum, bytes of the compression's name
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last time, offset, length, bytes of the map that follows
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, checksum
_CHANNEL_PLACE = struct.Struct("<HQ")
_NAME = struct.Struct("<QI")  # bytes of the message indexes, and of the compression's name
_PLACE = struct.Struct("<QQ")  # offset and length, or two lengths


class ChunkAt(NamedTuple):
    """Position of a chunk record, the channels in it (empty: any), and its size unpacked."""

    offset: int
    length: int
    channels: tuple[int, ...]
    unpacked: int


def header(view: View, path: str | Path) -> tuple[str, str]:
    """Return the profile of a file and the library that wrote it."""
    try:
        opcode, at, end = next(records(view, len(mcap.MAGIC), len(view)))
        if opcode != mcap.HEADER:
            raise CutError
        found = read(Header, view, at, end)
    except (CutError, StopIteration):
        raise InputError(f"{path}: the header is damaged; say bowden recover {path} -o FILE.") from None
    return found.profile, found.library


class Chunks:
    """Positions of a file's chunks, 32 bytes each; an hour at 1 kHz has 73,000."""

    def __init__(self) -> None:
        self._numbers = array("Q")
        self._channels: dict[tuple[int, ...], int] = {}

    def append(self, chunk: ChunkAt) -> None:
        """Store the position of the next chunk."""
        number = self._channels.setdefault(chunk.channels, len(self._channels))
        self._numbers.extend((chunk.offset, chunk.length, number, chunk.unpacked))

    def __iter__(self) -> Iterator[ChunkAt]:
        """Yield the positions in the order of the summary."""
        channels = list(self._channels)
        for offset, length, number, unpacked in zip(*[iter(self._numbers)] * 4, strict=True):
            yield ChunkAt(offset, length, channels[number], unpacked)


class Summary(NamedTuple):
    """Summary section at the end of a file; `checked` if the bytes before it match its checksum."""

    channels: dict[int, Channel]
    chunks: Chunks
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
    described = Descriptions()
    found = Summary(described.channels, Chunks(), [], [], checked)
    for opcode, at, end in records(view, start, footer):
        described.take(opcode, view, at, end)
        if opcode == mcap.CHUNK_INDEX:
            found.chunks.append(_chunk_at(view, at, end, start))
        elif opcode in (mcap.ATTACHMENT_INDEX, mcap.METADATA_INDEX):
            offset, length = _unpacked(_PLACE, view, at, end)
            if offset + length > start:
                raise CutError
            (found.attachments if opcode == mcap.ATTACHMENT_INDEX else found.metadata).append((offset, length))
    return found


def _chunk_at(view: View, at: int, end: int, data_end: int) -> ChunkAt:
    _first, _last, offset, length, indexes = _unpacked(_CHUNK_INDEX, view, at, end)
    after = at + _CHUNK_INDEX.size + indexes
    _index_length, name = _unpacked(_NAME, view, after, end)
    _packed, unpacked = _unpacked(_PLACE, view, after + _NAME.size + name, end)
    if offset + length > data_end or indexes % _CHANNEL_PLACE.size:
        raise CutError
    channels = _CHANNEL_PLACE.iter_unpack(view[after - indexes:after])
    return ChunkAt(offset, length, tuple(number for number, _ in channels), unpacked)


def chunks_of(found: Summary, channel: int, path: str | Path, file_bytes: int) -> Iterator[ChunkAt]:
    """Return the chunks that may hold `channel`; raises where they would unpack to more than is believable."""
    unpacked = unpacked_bytes(found, channel)
    if unpacked > most_unpacked(file_bytes):
        raise InputError(
            f"{path}: {file_bytes} bytes would unpack to {unpacked}, expected at most "
            f"{most_unpacked(file_bytes)}; it is no recording, do not open it.")
    return (chunk for chunk in found.chunks if not chunk.channels or channel in chunk.channels)


def unpacked_bytes(found: Summary, channel: int) -> int:
    """Return the size of the chunks that may hold `channel`, unpacked."""
    return sum(chunk.unpacked for chunk in found.chunks if not chunk.channels or channel in chunk.channels)


def message_times(view: View, path: str | Path) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """Yield channel and times, ns, of each message index, by the first time of its chunk; no chunk is unpacked.

    Raises `InputError` where an index is damaged.
    """
    start, footer = _bounds(view, path)
    mapped = 0
    try:
        places = np.fromiter((view[at:at + 8] + at.to_bytes(8, "little") for opcode, at, _ in records(
            view, start, footer) if opcode == mcap.CHUNK_INDEX), "V16").view([("first", "<u8"), ("at", "<u8")])
        for place in map(int, places["at"][np.argsort(places["first"], kind="stable")]):
            *_, offset, _length, indexes = _unpacked(_CHUNK_INDEX, view, place, footer)
            begin = place + _CHUNK_INDEX.size
            for channel, at in _CHANNEL_PLACE.iter_unpack(view[begin:begin + indexes]):
                opcode, head, end = next(records(view, at, start))
                if opcode != mcap.MESSAGE_INDEX:
                    raise CutError
                yield channel, np.frombuffer(view[head + 6:end], "<i8")[::2]
            if offset - mapped > SPAN:
                release(view, offset)
                mapped = offset
    except (CutError, StopIteration, ValueError, struct.error):
        raise InputError(f"{path}: an index of messages is damaged; say bowden recover {path} -o FILE.") from None


def content(view: View, chunk: ChunkAt, path: str | Path, checked: bool) -> bytes:
    """Return the records in a chunk, unpacked; its own checksum is compared unless the file's has been."""
    damaged = f"{path}: the chunk at byte {chunk.offset} is damaged"
    try:
        opcode, at, end = next(records(view, chunk.offset, chunk.offset + chunk.length))
        if opcode != mcap.CHUNK:
            raise CutError
        data, unpacked = unpack(view, at, end, checked)
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
    return dict(_named(view, mcap.ATTACHMENT, found.attachments, path, attachment))


def metadata(view: View, found: Summary, path: str | Path) -> dict[str, dict[str, str]]:
    """Return every metadata record by its name."""
    return dict(_named(view, mcap.METADATA, found.metadata, path, note))


def note(view: View, at: int, end: int) -> tuple[str, dict[str, str]]:
    """Return name and mapping of a metadata record."""
    found = read(Metadata, view, at, end)
    return found.name, found.metadata


def _named(view: View, opcode: int, places: Iterable[tuple[int, int]], path: str | Path,
           reader: Callable[[View, int, int], tuple[str, Any]]) -> Iterator[tuple[str, Any]]:
    for offset, length in places:
        what = "record"
        try:
            found, at, end = next(records(view, offset, offset + length))
            if found != opcode:
                raise CutError
            what = "attachment" if opcode == mcap.ATTACHMENT else "metadata"
            yield reader(view, at, end)
        except (CutError, StopIteration, ValueError):
            raise InputError(f"{path}: the {what} at byte {offset} is damaged; say bowden recover.") from None
