"""MCAP records, written.

The rule of this file: every record goes through `_write`, which keeps position and checksum, and the file
is readable up to the last whole record at any moment.  Format: the MCAP specification, version 0.
"""

import struct
import zlib
from collections.abc import Mapping
from typing import Protocol

import numpy as np
import zstandard
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT = range(1, 10)
ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(10, 16)
INDEX_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])
ZSTD_LEVEL = 1  # level 3 costs 1.6 times the processor time for a tenth of the size


class ByteSink(Protocol):
    """Destination of bytes: an unbuffered binary file."""

    def write(self, data: bytes, /) -> int | None: ...


def string(text: str) -> bytes:
    """Return a length-prefixed string."""
    raw = text.encode()
    return struct.pack("<I", len(raw)) + raw


def string_map(mapping: Mapping[str, str]) -> bytes:
    """Return a length-prefixed map of strings, in its own order."""
    body = b"".join(string(key) + string(value) for key, value in mapping.items())
    return struct.pack("<I", len(body)) + body


def record(opcode: int, *parts: bytes) -> bytes:
    """Return one whole record."""
    body = b"".join(parts)
    return struct.pack("<BQ", opcode, len(body)) + body


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
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._indexes: dict[int, list[bytes]] = {CHUNK_INDEX: [], ATTACHMENT_INDEX: [], METADATA_INDEX: []}
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._write(MAGIC + record(HEADER, string("ros2"), string(library)))

    def _write(self, data: bytes) -> None:
        write_all(self._sink, data)
        self.position += len(data)
        self._crc = zlib.crc32(data, self._crc)

    def schema(self, name: str, encoding: str, text: str) -> int:
        """Describe a message; returns the schema's id."""
        number = len(self._schemas) + 1
        data = text.encode()
        self._schemas.append(record(SCHEMA, struct.pack("<H", number), string(name), string(encoding),
                                    struct.pack("<I", len(data)), data))
        self._write(self._schemas[-1])
        return number

    def channel(self, topic: str, schema: int, encoding: str, metadata: Mapping[str, str]) -> int:
        """Open a topic; returns the channel's id."""
        number = len(self._channels) + 1
        self._channels.append(record(CHANNEL, struct.pack("<HH", number, schema), string(topic), string(encoding),
                                     string_map(metadata)))
        self._counts[number] = 0
        self._write(self._channels[-1])
        return number

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, whole; its times are 0, as nothing wall-timed goes in here."""
        body = struct.pack("<QQ", 0, 0) + string(name) + string(media_type) + struct.pack("<Q", len(data)) + data
        whole = record(ATTACHMENT, body, struct.pack("<I", zlib.crc32(body)))
        self._indexes[ATTACHMENT_INDEX].append(record(
            ATTACHMENT_INDEX, struct.pack("<QQQQQ", self.position, len(whole), 0, 0, len(data)),
            string(name), string(media_type)))
        self._write(whole)

    def metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a named map of strings."""
        whole = record(METADATA, string(name), string_map(mapping))
        self._indexes[METADATA_INDEX].append(
            record(METADATA_INDEX, struct.pack("<QQ", self.position, len(whole)), string(name)))
        self._write(whole)

    def chunk(
        self, content: bytes | memoryview, index: Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
    ) -> None:
        """Write the message records `content`; `index` gives, by channel, their times and where each begins."""
        first = min(int(times.min()) for times, _ in index.values())
        last = max(int(times.max()) for times, _ in index.values())
        packed = self._compress(content)
        chunk = record(CHUNK, struct.pack("<QQQI", first, last, len(content), zlib.crc32(content)),
                       string("zstd"), struct.pack("<Q", len(packed)), packed)
        at = self.position
        places, indexes = b"", b""
        for channel, (times, offsets) in index.items():
            places += struct.pack("<HQ", channel, at + len(chunk) + len(indexes))
            indexes += _message_index(channel, times, offsets)
        self._write(chunk + indexes)
        self._indexes[CHUNK_INDEX].append(record(
            CHUNK_INDEX, struct.pack("<QQQQI", first, last, at, len(chunk), len(places)), places,
            struct.pack("<Q", len(indexes)), string("zstd"), struct.pack("<QQ", len(packed), len(content))))
        for channel, (times, _) in index.items():
            self._counts[channel] += len(times)
        self._first_ns = first if self._first_ns is None else min(self._first_ns, first)
        self._last_ns = max(self._last_ns, last)

    def finish(self) -> None:
        """Write the end of the data, the summary that makes the file seekable, and the footer."""
        self._write(record(DATA_END, struct.pack("<I", self._crc)))
        start = self.position
        groups = [(SCHEMA, self._schemas), (CHANNEL, self._channels), (STATISTICS, [self._statistics()]),
                  *self._indexes.items()]
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            whole = b"".join(records)
            if whole:
                offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, start + len(summary), len(whole)))
                summary += whole
        offset_start = start + len(summary)
        summary += offsets + struct.pack("<BQQQ", FOOTER, 20, start, offset_start)
        self._write(bytes(summary) + struct.pack("<I", zlib.crc32(summary)) + MAGIC)

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in self._counts.items())
        return record(STATISTICS, struct.pack(
            "<QHIIIIQQ", sum(self._counts.values()), len(self._schemas), len(self._channels),
            len(self._indexes[ATTACHMENT_INDEX]), len(self._indexes[METADATA_INDEX]),
            len(self._indexes[CHUNK_INDEX]), self._first_ns or 0, self._last_ns,
        ) + struct.pack("<I", len(counts)) + counts)


def _message_index(channel: int, times: NDArray[np.int64], offsets: NDArray[np.int64]) -> bytes:
    entries = np.empty(len(times), INDEX_ENTRY)
    entries["time"], entries["offset"] = times, offsets
    return record(MESSAGE_INDEX, struct.pack("<HI", channel, entries.nbytes), entries.tobytes())
