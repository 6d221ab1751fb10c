"""SDO segmented transfer (CiA 301, 7.2.4.3.4 and 7.2.4.3.7).

The rule of this file: seven bytes an exchange, the toggle bit alternates from 0, the segment with c = 1 is the last.
"""

from collections.abc import Callable
from typing import Final

from eds.cia301 import Abort
from nodes.core.sdo.sdo_transfer import SEGMENT, DownloadBuffer, Transfer, TransferAbortedError

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
        if head & _LAST:
            refusal = self._write(self.key, self._received.whole(), now_ns)
            if refusal:
                raise TransferAbortedError(refusal)
            self.finished = True
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
