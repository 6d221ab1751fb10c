"""SDO block transfer (CiA 301, 7.2.4.3.8 to 7.2.4.3.15), with CRC (7.2.4.3.16).

The rule of this file: only the segments received in sequence count; the acknowledgement names the last of them and
the sender repeats from there.  The CRC is CCITT's, 0x1021 from 0, over all data.
"""

from binascii import crc_hqx
from enum import Enum
from typing import Final

from eds.cia301 import Abort
from nodes.core.parts import FAR_NS, US
from nodes.core.sdo.sdo_segment import Write
from nodes.core.sdo.sdo_transfer import SEGMENT, DownloadBuffer, Transfer, TransferAbortedError, multiplexer

MAX_BLOCK: Final = 127
"""Segments in a block, as this server requests."""

PACE_NS: Final = 200 * US
"""From one uploaded segment to the next: longer than a frame at 1 Mbit/s, so that PDOs find the queue free."""

_CRC: Final = 0x04
_SIZE: Final = 0x02
_LAST: Final = 0x80


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
        number, last = data[0] & 0x7F, bool(data[0] & _LAST)
        if not 1 <= number <= MAX_BLOCK:
            raise TransferAbortedError(Abort.SEQUENCE)
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
        refusal = self._write(self.key, whole, now_ns)
        if refusal:
            raise TransferAbortedError(refusal)
        self.finished = True
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
        return bytes((self._sent | (_LAST if last else 0),)) + self._data[at:at + SEGMENT].ljust(SEGMENT, b"\0")

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
