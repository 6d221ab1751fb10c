"""Base of all SDO transfers: multiplexer, answers, end.

A transfer never sends; it returns the frame to send, or raises `TransferAbortedError`.
"""

from typing import Final

from eds.cia301 import Abort
from eds.datatype import DataType
from nodes.core.objects import MAX_BYTES
from nodes.core.parts import FAR_NS

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
