"""SDO server 0x1200 (CiA 301, 7.2.4): one client, one transfer at a time.

Every request gets exactly one answer, the right one or an abort with its code; after an abort the server is idle.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from eds.cia301 import SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SERVICES, Abort, Frame, NmtState, Service
from nodes.core.parts import FAR_NS, MS, Handler, Part
from nodes.core.sdo_transfers import (
    BlockDownload,
    BlockUpload,
    DownloadBuffer,
    SegmentDownload,
    SegmentUpload,
    Transfer,
    TransferAbortedError,
    multiplexer,
)

if TYPE_CHECKING:
    from nodes.core.device import Device

TIMEOUT_NS: Final = 1000 * MS
"""Silence of the client after which a transfer is aborted; CiA 301 makes the time the device's choice."""

_ABORT: Final = 0x80
_SIZE: Final = 0x01
_EXPEDITED: Final = 0x02


class SdoServer(Part):
    """The default SDO server: 0x600 + node id to 0x580 + node id."""

    service = Service.SDO

    def __init__(self, device: Device) -> None:
        self._device = device
        self._transfer: Transfer | None = None
        self._silent_ns = FAR_NS
        # client command specifiers (CiA 301, 7.2.4.3)
        self._initiate = {1: self._download, 2: self._upload, 5: self._block_upload, 6: self._block_download}

    def reset(self, now_ns: int) -> None:
        """Discard a transfer in progress."""
        self._transfer = None

    def state_entered(self, state: NmtState, now_ns: int) -> None:
        """Discard a transfer on entering a state without SDO."""
        if Service.SDO not in SERVICES[state]:
            self._transfer = None

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of the client's requests."""
        yield SDO_REQUEST_BASE + self._device.node_id, self.receive

    def receive(self, data: bytes, now_ns: int) -> None:
        """Answer a request."""
        transfer = self._transfer
        try:
            if data[:1] == bytes((_ABORT,)):
                # an abort of any length ends the transfer and is not answered: an answer would begin a loop of aborts
                self._transfer = None
                return
            if len(data) != 8:
                raise TransferAbortedError(Abort.COMMAND)
            # a request in the middle of a transfer is refused at once, which beats a time-out; the next one works
            # (decision 11)
            self._send(self._begin(data, now_ns) if transfer is None else transfer.receive(data, now_ns))
        except TransferAbortedError as refused:
            self._abort(refused.code, _about(data) if transfer is None else transfer.key)
        self._await(now_ns)

    @property
    def idle(self) -> bool:
        """True if no transfer is in progress."""
        return self._transfer is None

    def poll(self, now_ns: int) -> int:
        """Send block segments that are due; abort a transfer whose client has timed out."""
        transfer = self._transfer
        if transfer is None:
            return FAR_NS
        if transfer.due_ns <= now_ns:
            self._send(transfer.poll(now_ns))
            self._silent_ns = now_ns + TIMEOUT_NS
        if self._silent_ns <= now_ns:
            self._abort(Abort.TIMEOUT, transfer.key)
            return FAR_NS
        return min(transfer.due_ns, self._silent_ns)

    def _begin(self, data: bytes, now_ns: int) -> bytes | None:
        initiate = self._initiate.get(data[0] >> 5)
        if initiate is None:
            raise TransferAbortedError(Abort.COMMAND)
        return initiate(data[0], _about(data), data[4:], now_ns)

    def _await(self, now_ns: int) -> None:
        if self._transfer is not None and self._transfer.finished:
            self._transfer = None
        if self._transfer is not None:
            self._silent_ns = now_ns + TIMEOUT_NS
            self._device.wake(min(self._silent_ns, self._transfer.due_ns))

    def _download(self, head: int, key: int, data: bytes, now_ns: int) -> bytes:
        if head & _EXPEDITED:
            self._expedited(head, key, data, now_ns)
        else:
            received = self._receiving(key, int.from_bytes(data, "little") if head & _SIZE else None)
            self._transfer = SegmentDownload(key, received, self._device.download)
        return bytes((0x60,)) + multiplexer(key) + bytes(4)

    def _expedited(self, head: int, key: int, data: bytes, now_ns: int) -> None:
        size = 4 - (head >> 2 & 3)
        # expedited without a size: the object's own length, at most the four bytes of the frame
        if not head & _SIZE:
            entry = self._device.objects.entries.get(key)
            size = min(entry.data_type.size or 4, 4) if entry is not None else 4
        refusal = self._device.download(key, data[:size], now_ns)
        if refusal:
            raise TransferAbortedError(refusal)

    def _upload(self, head: int, key: int, data: bytes, now_ns: int) -> bytes:
        return self._normal_upload(key, self._read(key, now_ns))

    def _normal_upload(self, key: int, found: bytes) -> bytes:
        if len(found) <= 4:
            return bytes((0x43 | (4 - len(found)) << 2,)) + multiplexer(key) + found.ljust(4, b"\0")
        self._transfer = SegmentUpload(key, found)
        return bytes((0x41,)) + multiplexer(key) + len(found).to_bytes(4, "little")

    def _block_download(self, head: int, key: int, data: bytes, now_ns: int) -> bytes:
        if head & 1:
            raise TransferAbortedError(Abort.COMMAND)
        received = self._receiving(key, int.from_bytes(data, "little") if head & 2 else None)
        transfer = BlockDownload(key, received, bool(head & 4), self._device.download)
        self._transfer = transfer
        return transfer.accept()

    def _block_upload(self, head: int, key: int, data: bytes, now_ns: int) -> bytes:
        if head & 3:
            raise TransferAbortedError(Abort.COMMAND)
        found = self._read(key, now_ns)
        transfer = BlockUpload(key, found, data[0], bool(head & 4))
        if len(found) <= data[1]:  # protocol switch threshold: for so few bytes the client asks a normal transfer
            return self._normal_upload(key, found)
        self._transfer = transfer
        return transfer.accept()

    def _receiving(self, key: int, announced: int | None) -> DownloadBuffer:
        refusal = self._device.objects.may_download(key, announced)
        if refusal:
            raise TransferAbortedError(refusal)
        return DownloadBuffer(self._device.objects.entries[key].data_type, announced)

    def _read(self, key: int, now_ns: int) -> bytes:
        found = self._device.upload(key, now_ns)
        if isinstance(found, Abort):
            raise TransferAbortedError(found)
        return found

    def _abort(self, code: int, key: int) -> None:
        self._transfer = None
        self._send(bytes((_ABORT,)) + multiplexer(key) + code.to_bytes(4, "little"))

    def _send(self, data: bytes | None) -> None:
        if data is not None:
            self._device.outbox.append(Frame(SDO_RESPONSE_BASE + self._device.node_id, data))


def _about(data: bytes) -> int:
    """Read the multiplexer of an initiating request; 0 where the frame has none."""
    if len(data) < 4 or data[0] >> 5 not in (1, 2, 5, 6):
        return 0
    return (data[1] | data[2] << 8) << 8 | data[3]
