"""The writer of a recording: blocks in, chunks out, in its own thread or in place.

A block is flat memory of one topic, filled by one thread and read by one other: `count` belongs to the thread that
fills it and rises only after its row is whole, `taken` to the writer.  Blocks are written in the order they were
handed over; what cannot be written ends the recording with the file closed and whole up to its last record, and the
reason kept for the control thread.
"""

import contextlib
import os
import queue
import threading
from collections.abc import Callable, Mapping
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr
from trial.mcap_file.container import Container

CHUNK_BYTES = 65_536
FRAMES_PER_CHUNK = CHUNK_BYTES // cdr.FRAME_RECORD.itemsize
EVENTS_PER_CHUNK = 256


class ChunkContent(NamedTuple):
    """Content of a chunk: message records, bytes, the time of each (ns), and its start in `data`."""

    data: bytes | memoryview
    times: NDArray[np.int64]
    offsets: NDArray[np.int64]


class FrameBlock:
    """CAN frames, as `cdr.FRAME_STRUCT` packs them."""

    __slots__ = ("count", "rows", "taken")
    topic = cdr.FRAMES

    def __init__(self) -> None:
        self.rows = bytearray(FRAMES_PER_CHUNK * cdr.FRAME_ROW.itemsize)
        self.count = self.taken = 0

    def content(self, first: int, end: int, channel: int, sequence: int) -> ChunkContent:
        """Return rows `first` to `end` as message records, numbered from `sequence`."""
        rows = np.frombuffer(self.rows, cdr.FRAME_ROW)[first:end]
        return _fixed(cdr.frame_records(rows, channel, sequence), rows["time_ns"])


class CycleBlock:
    """Control cycles, as `cdr.cycle_row(width)` packs them."""

    __slots__ = ("count", "dtype", "rows", "taken", "topic")

    def __init__(self, topic: str, width: int) -> None:
        self.topic = topic
        self.dtype = np.dtype([("time_ns", "<i8"), ("values", "<f8", (width,))])
        self.rows = bytearray(cycles_per_chunk(width) * self.dtype.itemsize)
        self.count = self.taken = 0

    def content(self, first: int, end: int, channel: int, sequence: int) -> ChunkContent:
        """Return rows `first` to `end` as message records, numbered from `sequence`."""
        rows = np.frombuffer(self.rows, self.dtype)[first:end]
        return _fixed(cdr.cycle_records(rows, channel, sequence), rows["time_ns"])


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
        return ChunkContent(bytes(data), times, np.array(offsets, np.int64))


Block = FrameBlock | CycleBlock | Events


def cycles_per_chunk(width: int) -> int:
    """Return how many cycles of `width` columns make a chunk."""
    return max(1, CHUNK_BYTES // cdr.cycle_record(width).itemsize)


def _fixed(records: NDArray[np.void], times: NDArray[np.int64]) -> ChunkContent:
    offsets = np.arange(len(records), dtype=np.int64) * records.dtype.itemsize
    return ChunkContent(memoryview(cast(Any, records.view(np.uint8))), times.copy(), offsets)


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
        self._spare: dict[str, list[Block]] = {topic: [] for topic in channels}
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

    def spare(self, topic: str) -> Block | None:
        """Return an emptied block, if one is at hand."""
        spare = self._spare[topic]
        return spare.pop() if spare else None

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
        if not isinstance(block, Events):
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
