"""MCAP files, written: records of the package mcap in the order of a trial, indexes of messages in bulk.

The rule of this file: every record goes through `_write`, which keeps position and checksum, and the file
is readable up to the last whole record at any moment.  Format: the MCAP specification, version 0.
"""

import struct
import zlib
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import zstandard
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT = range(1, 10)
ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(10, 16)
INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
ZSTD_LEVEL = 1  # level 3 costs 1.6 times the processor time for a tenth of the size


class ByteSink(Protocol):
    """Destination of bytes: an unbuffered binary file."""

    def write(self, data: bytes, /) -> int | None: ...


def write_all(sink: ByteSink, data: bytes) -> None:
    """Write every byte of `data`; an unbuffered file may take fewer at a time than it is given."""
    view = memoryview(data)
    while view:
        taken = sink.write(view)  # type: ignore[arg-type]
        if not taken:
            raise OSError("the file takes no more bytes")
        view = view[taken:]


class Container:
    """An MCAP file being written: header and descriptions first, then chunks of one channel each."""

    def __init__(self, sink: ByteSink, library: str) -> None:
        self.position = 0
        self._sink = sink
        self._crc = 0
        self._compress = zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress
        self._summary: dict[int, list[bytes]] = {opcode: [] for opcode in (
            SCHEMA, CHANNEL, STATISTICS, CHUNK_INDEX, ATTACHMENT_INDEX, METADATA_INDEX)}
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._write(MAGIC + _record(mcap.Header("ros2", library)))

    def _write(self, data: bytes) -> None:
        write_all(self._sink, data)
        self.position += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def _describe(self, opcode: int, record: Any) -> int:
        """Write a record that the summary repeats; returns its number among those."""
        whole = _record(record)
        self._summary[opcode].append(whole)
        self._write(whole)
        return len(self._summary[opcode])

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Describe a message; returns the schema's id."""
        return self._describe(SCHEMA, mcap.Schema(len(self._summary[SCHEMA]) + 1, text.encode(), encoding, name))

    def channel(self, topic: str, schema: int, encoding: str, metadata: Mapping[str, str]) -> int:
        """Open a topic; returns the channel's id."""
        number = self._describe(CHANNEL, mcap.Channel(
            len(self._summary[CHANNEL]) + 1, topic, encoding, dict(metadata), schema))
        self._counts[number] = 0
        return number

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, whole; its times are 0, as nothing wall-timed goes in here."""
        whole = _record(mcap.Attachment(0, 0, name, media_type, data))
        self._summary[ATTACHMENT_INDEX].append(_record(mcap.AttachmentIndex(
            self.position, len(whole), 0, 0, len(data), name, media_type)))
        self._write(whole)

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a named map of strings."""
        whole = _record(mcap.Metadata(name, dict(mapping)))
        self._summary[METADATA_INDEX].append(_record(mcap.MetadataIndex(self.position, len(whole), name)))
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
        self._summary[CHUNK_INDEX].append(_record(mcap.ChunkIndex(
            len(chunk), self.position, "zstd", len(packed), last, len(indexes), places, first, len(content))))
        self._write(chunk + indexes)
        self._first_ns = first if self._first_ns is None else min(self._first_ns, first)
        self._last_ns = max(self._last_ns, last)

    def finish(self) -> None:
        """Write the end of the data, the summary that makes the file seekable, and the footer."""
        self._write(_record(mcap.DataEnd(self._crc)))
        start, counts = self.position, {opcode: len(found) for opcode, found in self._summary.items()}
        self._summary[STATISTICS].append(_record(mcap.Statistics(
            counts[ATTACHMENT_INDEX], counts[CHANNEL], self._counts, counts[CHUNK_INDEX], sum(self._counts.values()),
            self._last_ns, self._first_ns or 0, counts[METADATA_INDEX], counts[SCHEMA])))
        summary, offsets = bytearray(), b""
        for opcode, found in self._summary.items():
            if whole := b"".join(found):
                offsets += _record(mcap.SummaryOffset(opcode, start + len(summary), len(whole)))
                summary += whole
        summary += offsets + _record(mcap.Footer(start, start + len(summary), 0))[:-4]
        self._write(bytes(summary) + struct.pack("<I", zlib.crc32(summary)) + MAGIC)


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
