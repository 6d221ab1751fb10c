"""SDO transfers of more than one exchange: segmented (CiA 301, 7.2.4.3.4 and 7.2.4.3.7), block (7.2.4.3.8 to 16).

A transfer never sends; it returns the frame to send, or raises `TransferAbortedError`.
"""

from binascii import crc_hqx
from collections.abc import Callable
from enum import Enum
from typing import Final

from eds.cia301 import Abort
from eds.datatype import DataType
from nodes.core.objects import MAX_BYTES
from nodes.core.parts import FAR_NS, US

SEGMENT: Final = 7
"""Bytes of data in a segment."""


class TransferAbortedError(Exception):
    """Abort of a transfer, with its SDO abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}")
        self.code = code


class Transfer:
    """A transfer of more than one exchange; `finished` after its last frame."""

    __slots__ = ("due_ns", "finished", "key")

    def __init__(self, key: int) -> None:
        self.key = key
        self.finished = False
        self.due_ns = FAR_NS

    def receive(self, data: bytes, now_ns: int) -> bytes | None:
        """Process the client's next frame of 8 bytes; return the answer, if there is one."""
        raise NotImplementedError

    def poll(self, now_ns: int) -> bytes | None:
        """Return a frame that is due without a request, if any; `due_ns` is its time."""
        return None

    def finish(self, refusal: int) -> None:
        """End a download by the result of its write, 0 or the abort code."""
        if refusal:
            raise TransferAbortedError(refusal)
        self.finished = True


class DownloadBuffer:
    """Bytes of a download so far, checked against the announced size and the object's capacity."""

    __slots__ = ("_announced", "_limit", "data")

    def __init__(self, data_type: DataType, announced: int | None) -> None:
        self.data = bytearray()
        self._announced = announced
        self._limit = data_type.size or MAX_BYTES

    def append(self, segment: bytes) -> None:
        """Append a segment; abort the transfer if the data exceed the announced size."""
        self.data += segment
        self._check(len(self.data))

    def append_block(self, segment: bytes) -> None:
        """Append a block's segment; only the end of the transfer gives the number of valid bytes in the last one."""
        self.data += segment
        self._check(len(self.data) - SEGMENT + 1)

    def whole(self) -> bytes:
        """Return all bytes; abort if they are fewer than announced."""
        if self._announced is not None and len(self.data) < self._announced:
            raise TransferAbortedError(Abort.TOO_SHORT)
        return bytes(self.data)

    def whole_block(self, unused: int) -> bytes:
        """Return all bytes but the `unused` ones of the last segment."""
        if unused:
            del self.data[-unused:]
        self._check(len(self.data))
        return self.whole()

    def _check(self, size: int) -> None:
        if size > self._limit:
            raise TransferAbortedError(Abort.MEMORY if self._limit == MAX_BYTES else Abort.TOO_LONG)
        if self._announced is not None and size > self._announced:
            raise TransferAbortedError(Abort.TOO_LONG)


def multiplexer(key: int) -> bytes:
    """Return index and sub-index in the byte order of SDO frames."""
    return bytes((key >> 8 & 0xFF, key >> 16, key & 0xFF))


Write = Callable[[int, bytes, int], int]
"""(key, data, now_ns) → 0 or an abort code."""

_TOGGLE: Final = 0x10
_LAST: Final = 0x01


class SegmentDownload(Transfer):
    """SDO segmented download: the client writes an object."""

    __slots__ = ("_received", "_toggle", "_write")

    def __init__(self, key: int, received: DownloadBuffer, write: Write) -> None:
        super().__init__(key)
        self._received, self._write = received, write
        self._toggle = 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Receive a segment (ccs 0); the last one writes the object."""
        head = data[0]
        if head >> 5 != 0:
            raise TransferAbortedError(Abort.COMMAND)
        if head & _TOGGLE != self._toggle:
            raise TransferAbortedError(Abort.TOGGLE)
        self._received.append(data[1:1 + SEGMENT - (head >> 1 & 7)])
        if head & _LAST:  # written whole or not at all: no object holds a part of a value
            self.finish(self._write(self.key, self._received.whole(), now_ns))
        answer = 0x20 | self._toggle
        self._toggle ^= _TOGGLE
        return bytes((answer,)) + bytes(7)


class SegmentUpload(Transfer):
    """SDO segmented upload: the client reads an object."""

    __slots__ = ("_data", "_sent", "_toggle")

    def __init__(self, key: int, data: bytes) -> None:
        super().__init__(key)
        self._data = data
        self._sent = self._toggle = 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Answer a request for the next segment (ccs 3)."""
        head = data[0]
        if head >> 5 != 3:
            raise TransferAbortedError(Abort.COMMAND)
        if head & _TOGGLE != self._toggle:
            raise TransferAbortedError(Abort.TOGGLE)
        segment = self._data[self._sent:self._sent + SEGMENT]
        self._sent += SEGMENT
        self.finished = self._sent >= len(self._data)
        answer = self._toggle | (SEGMENT - len(segment)) << 1 | (_LAST if self.finished else 0)
        self._toggle ^= _TOGGLE
        return bytes((answer,)) + segment.ljust(SEGMENT, b"\0")


MAX_BLOCK: Final = 127
"""Segments in a block, as this server requests."""

PACE_NS: Final = 200 * US
"""From one uploaded segment to the next: longer than a frame at 1 Mbit/s, so that PDOs find the queue free."""

_CRC: Final = 0x04
_SIZE: Final = 0x02
_BLOCK_END: Final = 0x80


class BlockDownload(Transfer):
    """SDO block download: the client writes an object in blocks."""

    __slots__ = ("_crc", "_ending", "_received", "_sequence", "_write")

    def __init__(self, key: int, received: DownloadBuffer, crc: bool, write: Write) -> None:
        super().__init__(key)
        self._received, self._crc, self._write = received, crc, write
        self._sequence = 0
        self._ending = False

    def accept(self) -> bytes:
        """Answer the initiation: CRC supported, block size."""
        return bytes((0xA0 | _CRC,)) + multiplexer(self.key) + bytes((MAX_BLOCK, 0, 0, 0))

    def receive(self, data: bytes, now_ns: int) -> bytes | None:
        """Take a segment, or the end (ccs 6, cs 1) after the last one."""
        return self._end(data, now_ns) if self._ending else self._segment(data)

    def _segment(self, data: bytes) -> bytes | None:
        number, last = data[0] & 0x7F, bool(data[0] & _BLOCK_END)
        if not 1 <= number <= MAX_BLOCK:
            raise TransferAbortedError(Abort.SEQUENCE)
        # a segment out of order is dropped: the acknowledgement names the last good one, and the client repeats from it
        if number == self._sequence + 1:
            self._sequence = number
            self._received.append_block(data[1:])
            self._ending = last
        if not last and number < MAX_BLOCK:
            return None
        answer = bytes((0xA2, self._sequence, MAX_BLOCK, 0, 0, 0, 0, 0))
        self._sequence = 0
        return answer

    def _end(self, data: bytes, now_ns: int) -> bytes:
        if data[0] & 0xE3 != 0xC1:
            raise TransferAbortedError(Abort.COMMAND)
        whole = self._received.whole_block(data[0] >> 2 & 7)
        if self._crc and crc_hqx(whole, 0) != int.from_bytes(data[1:3], "little"):
            raise TransferAbortedError(Abort.CRC)
        self.finish(self._write(self.key, whole, now_ns))
        return bytes((0xA1, 0, 0, 0, 0, 0, 0, 0))


class _Phase(Enum):
    START = "waiting for the client to start"
    SEND = "sending a block, or waiting for its acknowledgement"
    END = "waiting for the client to confirm the end"


class BlockUpload(Transfer):
    """SDO block upload: the client reads an object in blocks."""

    __slots__ = ("_block", "_crc", "_data", "_first", "_phase", "_sent")

    def __init__(self, key: int, data: bytes, block: int, crc: bool) -> None:
        super().__init__(key)
        self._data, self._crc = data, crc
        self._block = _block_size(block)
        self._first = self._sent = 0
        self._phase = _Phase.START

    def accept(self) -> bytes:
        """Answer the initiation: CRC supported, size."""
        return bytes((0xC0 | _CRC | _SIZE,)) + multiplexer(self.key) + len(self._data).to_bytes(4, "little")

    def receive(self, data: bytes, now_ns: int) -> bytes | None:
        """Take start (cs 3), acknowledgement (cs 2) or end (cs 1), each in its phase."""
        head = data[0]
        if head & 0xE3 == 0xA3 and self._phase is _Phase.START:
            self._phase, self.due_ns = _Phase.SEND, now_ns
            return None
        if head & 0xE3 == 0xA2 and self._phase is _Phase.SEND:
            return self._acknowledged(data[1], data[2], now_ns)
        if head & 0xE3 == 0xA1 and self._phase is _Phase.END:
            self.finished = True
            return None
        raise TransferAbortedError(Abort.COMMAND)

    def poll(self, now_ns: int) -> bytes | None:
        """Return the next segment of the block."""
        if self.due_ns > now_ns:
            return None
        at = (self._first + self._sent) * SEGMENT
        self._sent += 1
        last = at + SEGMENT >= len(self._data)
        self.due_ns = FAR_NS if last or self._sent == self._block else now_ns + PACE_NS
        return bytes((self._sent | (_BLOCK_END if last else 0),)) + self._data[at:at + SEGMENT].ljust(SEGMENT, b"\0")

    def _acknowledged(self, sequence: int, block: int, now_ns: int) -> bytes | None:
        if sequence > self._sent:
            raise TransferAbortedError(Abort.SEQUENCE)
        self._first += sequence
        self._sent = 0
        if self._first * SEGMENT >= len(self._data):
            self._phase, self.due_ns = _Phase.END, FAR_NS
            unused = -len(self._data) % SEGMENT
            crc = crc_hqx(self._data, 0) if self._crc else 0
            return bytes((0xC1 | unused << 2,)) + crc.to_bytes(2, "little") + bytes(5)
        self._block, self.due_ns = _block_size(block), now_ns
        return None


def _block_size(asked: int) -> int:
    if not 1 <= asked <= MAX_BLOCK:
        raise TransferAbortedError(Abort.BLOCK_SIZE)
    return asked
