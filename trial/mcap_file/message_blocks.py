"""Rows on their way from the control thread to a chunk.

The rule of this file: a block is flat memory of one topic, filled by one thread and read by one other;
`count` belongs to the thread that fills it and rises only after its row is whole, `taken` to the writer.
"""

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr

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
