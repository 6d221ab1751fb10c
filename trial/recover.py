"""Repair of a torn or damaged recording.

Surviving messages are kept as they were, byte for byte and with their sequence numbers, so that gaps stay visible.
Data that do not match their checksum are left out and counted, never mended. The file is read once from front to
back, a chunk at a time.
"""

import mmap
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import replaced
from trial.assemble import Progress, silent
from trial.mcap_file import cdr, records, salvage, scan
from trial.mcap_file import container as mcap
from trial.mcap_file.cdr import MESSAGE_HEAD

Index = dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]


@dataclass
class Recovery:
    """Result of a recovery: messages kept, chunks they came from, chunks left out, bytes that belong to no record."""

    messages: int = 0
    chunks: int = 0
    damaged: int = 0
    bytes_skipped: int = 0

    def as_metadata(self) -> dict[str, str]:
        """Return the counts as the metadata record "recovered" holds them."""
        return {name: str(count) for name, count in vars(self).items()}


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
        channels = scan.described(view, torn) or salvage.channels(view)
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
    for opcode, at, end in salvage.walk(view, skipped):
        cursor = records.Cursor(view, at, end)
        if opcode == mcap.CHUNK:
            chunked = True
            content, intact = salvage.surviving(cursor)
            found.chunks += _keep(made, content, numbers, found) > 0
            found.damaged += not intact
            progress(at / len(view))
        elif opcode == mcap.MESSAGE:
            loose += view[at - 9:end]
        elif opcode == mcap.ATTACHMENT:
            _attach(made, cursor, found)
        elif opcode == mcap.METADATA:
            _note(made, cursor)
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
    made.metadata("recovered", found.as_metadata())
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
    for opcode, at, end in salvage.whole_records(content):
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


def _attach(made: mcap.Container, cursor: records.Cursor, found: Recovery) -> None:
    try:
        name, data = records.read_attachment(cursor)
    except (records.CutError, ValueError):
        found.damaged += 1
    else:
        made.attachment(name, "text/plain", data)


def _note(made: mcap.Container, cursor: records.Cursor) -> None:
    try:
        name, mapping = cursor.string(), cursor.string_map()
    except records.CutError:
        return
    made.metadata(name, mapping)
