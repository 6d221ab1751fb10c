"""Repair of a torn or damaged recording.

Surviving messages are kept as they were, byte for byte and with their sequence numbers, so that gaps stay visible.
Bytes count as a record if records follow one another or a checksum holds; after other bytes the search goes on at the
next chunk. Data that do not match their checksum are left out and counted, never mended. The file is read once from
front to back, a chunk at a time.
"""

import mmap
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import replaced
from trial.mcap_file import cdr, records
from trial.mcap_file import container as mcap
from trial.mcap_file.cdr import MESSAGE_HEAD
from trial.record import Progress, silent

Index = dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]


@dataclass
class Recovery:
    """Result of a recovery: messages kept, chunks they came from, chunks left out, bytes that belong to no record."""

    messages: int = 0
    chunks: int = 0
    damaged: int = 0
    bytes_skipped: int = 0


def recover(
    torn: str | Path, whole: str | Path, *, overwrite: bool = False, progress: Progress = silent
) -> Recovery:
    """Write every surviving message of `torn` to `whole`, indexed; raises `InputError` if nothing survived.

    `whole` appears when it is complete; `progress` receives the share done, 0 … 1.
    """
    torn, whole = Path(torn), Path(whole)
    if whole.exists() and torn.exists() and whole.samefile(torn):
        raise InputError(f"{whole}: is the torn file itself; give another name.")
    with records.mapped(torn) as view:
        channels = records.described(view, torn) or surviving_channels(view)
        if not channels:
            raise InputError(f"{torn}: no topic survived; nothing can be recovered.")
        with replaced(whole, overwrite=overwrite) as part, open(part, "wb", buffering=0) as file:
            return _copy(view, mcap.Container(file, "bowden-bench recover"), channels, progress)


def _copy(
    view: mmap.mmap, made: mcap.Container, channels: dict[int, records.Channel], progress: Progress
) -> Recovery:
    numbers = _describe(made, channels)
    found, skipped = Recovery(), list[int]()
    loose, chunked = bytearray(), False  # messages outside of chunks: in a file of chunks, other records misread
    for opcode, at, end in walk(view, skipped):
        if opcode == mcap.CHUNK:
            chunked = True
            content, intact = surviving(view, at, end)
            found.chunks += _keep(made, content, numbers, found) > 0
            found.damaged += not intact
            progress(at / len(view))
        elif opcode == mcap.MESSAGE:
            loose += view[at - 9:end]
        elif opcode == mcap.ATTACHMENT:
            _attach(made, view, at, end, found)
        elif opcode == mcap.METADATA:
            with suppress(records.CutError):
                made.metadata(*records.note(view, at, end))
        elif opcode == mcap.DATA_END:
            break
        if len(loose) > 1 << 20 and not chunked:
            _keep(made, bytes(loose), numbers, found)
            loose.clear()
    if chunked:
        found.damaged += bool(loose)
    else:
        _keep(made, bytes(loose), numbers, found)
    found.bytes_skipped = sum(skipped)
    made.metadata("recovered", {name: str(count) for name, count in vars(found).items()})
    made.finish()
    return found


def _describe(made: mcap.Container, channels: dict[int, records.Channel]) -> dict[int, int]:
    """Describe every channel again; returns the new number of each old one."""
    schemas: dict[tuple[str, str, str], int] = {("", "", ""): 0}
    numbers = {}
    for channel in channels.values():
        parts = (channel.schema_name, channel.schema_encoding, channel.schema)
        if parts not in schemas:
            schemas[parts] = made.schema(*parts)
        numbers[channel.number] = made.channel(channel.topic, schemas[parts], channel.encoding, channel.metadata)
    return numbers


def _keep(made: mcap.Container, content: bytes, numbers: dict[int, int], found: Recovery) -> int:
    """Write the messages in `content` under their new channel numbers; returns how many."""
    messages, index = _in_bulk(content, numbers) or _one_by_one(content, numbers)
    if index:
        made.chunk(messages, index)
    count = sum(len(times) for times, _ in index.values())
    found.messages += count
    return count


def _in_bulk(content: bytes, numbers: dict[int, int]) -> tuple[bytes, Index] | None:
    """Return content and index of a chunk whose messages have one channel and length; None for any other chunk."""
    length = 9 + int.from_bytes(content[1:9], "little")
    if length < MESSAGE_HEAD.size or not content or len(content) % length:
        return None
    rows = np.frombuffer(content, np.dtype([*cdr.HEAD, ("rest", f"V{length - MESSAGE_HEAD.size}")]))
    number = numbers.get(int(rows["channel"][0]))
    alike = all((rows[name] == rows[name][0]).all() for name in ("opcode", "length", "channel"))
    if not alike or rows["opcode"][0] != mcap.MESSAGE or number is None or rows["log_time"].max() >> 63:
        return None
    rows = rows.copy()
    rows["channel"] = number
    times = rows["log_time"].astype(np.int64)
    return rows.tobytes(), {number: (times, np.arange(len(rows), dtype=np.int64) * length)}


def _one_by_one(content: bytes, numbers: dict[int, int]) -> tuple[bytes, Index]:
    index: dict[int, list[tuple[int, int]]] = {}
    messages = bytearray()
    for opcode, at, end in whole_records(content):
        if opcode != mcap.MESSAGE or end - at < 22:
            continue
        _op, _length, old, sequence, time_ns, published = MESSAGE_HEAD.unpack_from(content, at - 9)
        number = numbers.get(old)
        if number is not None and time_ns < 1 << 63:
            index.setdefault(number, []).append((time_ns, len(messages)))
            messages += MESSAGE_HEAD.pack(opcode, end - at, number, sequence, time_ns, published) + content[at + 22:end]
    return bytes(messages), {number: _columns(entries) for number, entries in index.items()}


def _columns(entries: list[tuple[int, int]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    both = np.array(entries, np.int64)
    return both[:, 0], both[:, 1]


def _attach(made: mcap.Container, view: mmap.mmap, at: int, end: int, found: Recovery) -> None:
    try:
        name, data = records.attachment(view, at, end)
    except (records.CutError, ValueError):
        found.damaged += 1
    else:
        made.attachment(name, "text/plain", data)


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
    """Return whether the bytes at `at` can be the head of a record, or the end of the file."""
    head = view[at:at + 9]
    if len(head) < 9:
        return head in (b"", mcap.MAGIC)
    limit = records.CHUNK_LIMIT if head[0] in (mcap.CHUNK, mcap.ATTACHMENT) else LONGEST_OTHER
    return 1 <= head[0] <= 15 and int.from_bytes(head[1:], "little") <= limit


def surviving(view: records.View, at: int, end: int) -> tuple[bytes, bool]:
    """Return a chunk's content and True; of a cut chunk its readable beginning, of a damaged one nothing, and False."""
    try:
        return records.unpack(view, at, end)[0], True
    except records.CutError:
        return _front(view, at, end), False
    except ValueError:
        return b"", False


def _front(view: records.View, at: int, end: int) -> bytes:
    """Return the bytes that a chunk cut by the end of the file still unpacks to."""
    try:
        size, crc, compression, begin, _ = records.chunk_head(view, at, end)
    except records.CutError:
        return b""
    rest = view[begin:end]
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


def surviving_channels(view: mmap.mmap) -> dict[int, records.Channel]:
    """Return the channels of a file without a summary, wherever they survived: in front or in chunks."""
    described = records.Descriptions()
    for opcode, at, end in walk(view, []):
        with suppress(records.CutError):
            described.take(opcode, view, at, end)
        if opcode == mcap.CHUNK and not described.channels:
            content, _ = surviving(view, at, end)
            for inner, begin, stop in whole_records(content):
                with suppress(records.CutError):
                    described.take(inner, content, begin, stop)
    return described.channels
