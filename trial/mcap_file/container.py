"""MCAP files, written: records of the package mcap in the order of a trial, indexes of messages in bulk.

The rule of this file: every record goes through `_write`, which keeps position and checksum, and the file
is readable up to the last whole record at any moment.  Format: the MCAP specification, version 0.

The writer of a recording takes blocks and makes chunks, in its own thread or in place.  A block is flat memory of one
topic, filled by one thread and read by one other: `count` belongs to the thread that fills it and rises only after its
row is whole, `taken` to the writer.  Blocks are written in the order they were handed over; what cannot be written ends
the recording with the file closed and whole up to its last record, and the reason kept for the control thread.
"""

import contextlib
import os
import queue
import struct
import threading
import zlib
from collections.abc import Callable, Mapping
from io import FileIO
from pathlib import Path
from typing import Any, cast

import numpy as np
import zstandard
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from numpy.typing import NDArray

from trial.mcap_file import cdr

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT = range(1, 10)
ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(10, 16)
INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
ZSTD_LEVEL = 1  # level 3 costs 1.6 times the processor time for a tenth of the size


def write_all(file: FileIO, data: bytes | bytearray) -> None:
    """Write every byte of `data`; an unbuffered file may take fewer at a time than it is given."""
    view = memoryview(data)
    while view:
        taken = file.write(view)
        if not taken:
            raise OSError("the file takes no more bytes")
        view = view[taken:]


class Container:
    """An MCAP file being written: header and descriptions first, then chunks of one channel each."""

    def __init__(self, file: FileIO, library: str) -> None:
        self.position = 0
        self._file = file
        self._crc = 0
        self._compress = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress
        self._summary: dict[int, bytearray] = {opcode: bytearray() for opcode in (
            SCHEMA, CHANNEL, STATISTICS, CHUNK_INDEX, ATTACHMENT_INDEX, METADATA_INDEX)}
        self._records = dict.fromkeys(self._summary, 0)
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._write(MAGIC + _record(mcap.Header("ros2", library)))

    def _write(self, data: bytes | bytearray) -> None:
        write_all(self._file, data)
        self.position += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _describe(self, opcode: int, record: Any) -> int:
        """Write a record that the summary repeats; returns its number among those."""
        whole = _record(record)
        self._write(whole)
        return self._summarise(opcode, whole)

    def _summarise(self, opcode: int, whole: bytes) -> int:
        """Keep a record for the summary; returns its number among those of `opcode`."""
        self._summary[opcode] += whole
        self._records[opcode] += 1
        return self._records[opcode]

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Describe a message; returns the schema's id."""
        return self._describe(SCHEMA, mcap.Schema(self._records[SCHEMA] + 1, text.encode(), encoding, name))

    def channel(self, topic: str, schema: int, encoding: str, metadata: Mapping[str, str]) -> int:
        """Open a topic; returns the channel's id."""
        number = self._describe(CHANNEL, mcap.Channel(
            self._records[CHANNEL] + 1, topic, encoding, dict(metadata), schema))
        self._counts[number] = 0
        return number

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, whole; its times are 0, as nothing wall-timed goes in here."""
        whole = _record(mcap.Attachment(0, 0, name, media_type, data))
        self._summarise(ATTACHMENT_INDEX, _record(mcap.AttachmentIndex(
            self.position, len(whole), 0, 0, len(data), name, media_type)))
        self._write(whole)

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a named map of strings."""
        whole = _record(mcap.Metadata(name, dict(mapping)))
        self._summarise(METADATA_INDEX, _record(mcap.MetadataIndex(self.position, len(whole), name)))
        self._write(whole)

    def chunk(
        self, content: bytes | memoryview, index: Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
    ) -> None:
        """Write the message records `content`; `index` gives, by channel, their times and where each begins."""
        first = min(int(times.min()) for times, _ in index.values())
        last = max(int(times.max()) for times, _ in index.values())
        packed = self._compress(content)
        chunk = _record(mcap.Chunk("zstd", packed, last, first, zlib.crc32(content), len(content)))
        places, indexes = {}, b""
        for channel, (times, offsets) in index.items():
            places[channel] = self.position + len(chunk) + len(indexes)
            indexes += _message_index(channel, times, offsets)
            self._counts[channel] += len(times)
        self._summarise(CHUNK_INDEX, _record(mcap.ChunkIndex(
            len(chunk), self.position, "zstd", len(packed), last, len(indexes), places, first, len(content))))
        self._write(chunk + indexes)
        self._first_ns = first if self._first_ns is None else min(self._first_ns, first)
        self._last_ns = max(self._last_ns, last)

    def finish(self) -> None:
        """Write the end of the data, the summary that makes the file seekable, and the footer."""
        self._write(_record(mcap.DataEnd(self._crc)))
        start, crc, offsets, counts = self.position, 0, b"", self._records
        self._summary[STATISTICS] += _record(mcap.Statistics(
            counts[ATTACHMENT_INDEX], counts[CHANNEL], self._counts, counts[CHUNK_INDEX], sum(self._counts.values()),
            self._last_ns, self._first_ns or 0, counts[METADATA_INDEX], counts[SCHEMA]))
        for opcode, whole in self._summary.items():  # each in one piece: an hour has 7 MB of chunk indexes
            if whole:
                offsets += _record(mcap.SummaryOffset(opcode, self.position, len(whole)))
                crc = zlib.crc32(whole, crc)
                self._write(whole)
        end = offsets + _record(mcap.Footer(start, self.position, 0))[:-4]
        self._write(end + struct.pack("<I", zlib.crc32(end, crc)) + MAGIC)


def _record(record: Any) -> bytes:
    """Return one whole record of the package mcap as bytes."""
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _message_index(channel: int, times: NDArray[np.int64], offsets: NDArray[np.int64]) -> bytes:
    """Return the index of one channel's messages in a chunk; the package mcap would write it number by number."""
    entries = np.empty(len(times), INDEX_ENTRY)
    entries["time"], entries["offset"] = times, offsets
    return struct.pack("<BQHI", MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes) + entries.tobytes()


CHUNK_BYTES = 65_536
EVENTS_PER_CHUNK = 256
ChunkContent = tuple[bytes | memoryview, NDArray[np.int64], NDArray[np.int64]]
"""Content of a chunk: message records, the time of each (ns), and the byte where each begins."""


class FlatBlock:
    """Rows of one topic in flat memory, at most a chunk of them.

    `row`, `record`: dtypes of a row and of its message record; `as_records` turns rows into records, with a channel
    and a first sequence number. `most`: rows that the block holds.
    """

    __slots__ = ("as_records", "count", "most", "record", "row", "rows", "taken", "topic")

    def __init__(self, topic: str, row: np.dtype[np.void], record: np.dtype[np.void],
                 as_records: Callable[[NDArray[np.void], int, int], NDArray[np.void]]) -> None:
        self.topic, self.row, self.record, self.as_records = topic, row, record, as_records
        self.most = max(1, CHUNK_BYTES // record.itemsize)
        self.rows = bytearray(self.most * row.itemsize)
        self.count = self.taken = 0

    def content(self, first: int, end: int, channel: int, sequence: int) -> ChunkContent:
        """Return rows `first` to `end` as message records, numbered from `sequence`."""
        rows = np.frombuffer(self.rows, self.row)[first:end]
        records = self.as_records(rows, channel, sequence)
        offsets = np.arange(len(records), dtype=np.int64) * records.dtype.itemsize
        return memoryview(cast(Any, records.view(np.uint8))), rows["time_ns"].copy(), offsets


class Events:
    """Events: variable in size and rare, so a list."""

    __slots__ = ("count", "rows", "taken")
    topic = cdr.EVENTS

    def __init__(self) -> None:
        self.rows: list[tuple[int, str, str, str]] = []
        self.count = self.taken = 0

    def content(self, first: int, end: int, channel: int, sequence: int) -> ChunkContent:
        """Return events `first` to `end` as message records, numbered from `sequence`."""
        data, offsets = bytearray(), []
        for number, (time_ns, kind, source, text) in enumerate(self.rows[first:end], start=sequence):
            payload = cdr.event_message(time_ns, kind, source, text)
            offsets.append(len(data))
            data += cdr.MESSAGE_HEAD.pack(cdr.MESSAGE, len(payload) + 22, channel, number, time_ns, time_ns) + payload
        times = np.array([row[0] for row in self.rows[first:end]], np.int64)
        return bytes(data), times, np.array(offsets, np.int64)


Block = FlatBlock | Events
IDLE_S = 0.1  # where the bus falls silent, what is waiting is written after this long


class Writer:
    """Writer of blocks to `container`, whose topics have the ids `channels`.

    `waiting` returns the blocks that the control thread is filling now; only a writer with a thread asks for them,
    when nothing has been handed over for 100 ms. `failure` is the reason if the recording ended early.
    """

    def __init__(
        self, path: Path, file: FileIO, container: Container, channels: Mapping[str, int],
        waiting: Callable[[], tuple[Block, ...]], threaded: bool,
    ) -> None:
        self.failure: str | None = None
        self._path, self._file, self._container, self._channels = path, file, container, channels
        self._waiting = waiting
        self._sequence = dict.fromkeys(channels, 0)
        self._spare: dict[str, list[FlatBlock]] = {topic: [] for topic in channels}
        self._queue: queue.SimpleQueue[Block | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        if threaded:
            self._thread = threading.Thread(target=self._run, name="trial writer", daemon=True)
            self._thread.start()

    def put(self, block: Block) -> None:
        """Pass a complete block to the writer thread."""
        if self._thread is None:
            self._take(block)
        else:
            self._queue.put(block)

    def spare(self, full: FlatBlock) -> FlatBlock:
        """Return an emptied block like `full`, or a new one if none is at hand."""
        spare = self._spare[full.topic]
        return spare.pop() if spare else FlatBlock(full.topic, full.row, full.record, full.as_records)

    def join(self) -> None:
        """Wait until every block is written, and end the thread."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def finish(self, result: Mapping[str, str]) -> None:
        """Write the result and the summary and close the file; `join` comes first."""
        if self.failure is None and not self._file.closed:
            try:
                self._container.metadata("result", result)
                self._container.finish()
                self._file.close()
            except OSError as error:
                self._fail(error)

    def _run(self) -> None:
        while True:
            try:
                block = self._queue.get(timeout=IDLE_S)
            except queue.Empty:
                self._take_waiting()
                continue
            if block is None:
                return
            self._take(block)

    def _take_waiting(self) -> None:
        live = [(block, block.count) for block in self._waiting()]
        if self._queue.empty():  # else what was handed over meanwhile comes first
            for block, count in live:
                self._write(block, count)

    def _take(self, block: Block) -> None:
        self._write(block, block.count)
        if isinstance(block, FlatBlock):
            block.count = block.taken = 0
            self._spare[block.topic].append(block)

    def _write(self, block: Block, count: int) -> None:
        first, block.taken = block.taken, count
        if count == first or self.failure is not None:
            return
        channel, sequence = self._channels[block.topic], self._sequence[block.topic]
        self._sequence[block.topic] = sequence + count - first
        try:
            data, times, offsets = block.content(first, count, channel, sequence)
            self._container.chunk(data, {channel: (times, offsets)})
        except Exception as error:  # whatever it is, the control thread must hear of it
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Cut the file back to its last complete record, close it properly if that still fits, and store the reason."""
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        self._cut()
        with contextlib.suppress(OSError):
            self._container.finish()
        self._cut()
        with contextlib.suppress(OSError):
            self._file.close()
        self.failure = f"{self._path}: recording stopped ({reason}); make room, and bowden recover what is there."

    def _cut(self) -> None:
        with contextlib.suppress(OSError):  # a device that cannot be cut is left as it is
            os.ftruncate(self._file.fileno(), self._container.position)
            self._file.seek(self._container.position)
