"""The kernel's CAN, as a master needs it: python-can's SocketCAN bus with the per-frame path made short.

The rule of this file: what the kernel knows comes out: exact time stamps, which frames are this computer's own,
and how many frames found the receive queue full (`SO_RXQ_OVFL`).  One call fetches every frame that waits
(recvmmsg), and keeps the interpreter meanwhile: it never blocks.  SYNC stays with the broadcast manager.
"""

from __future__ import annotations

import ctypes
import os
import select
import socket
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, Final, cast

import can
import numpy as np
from can.interfaces.socketcan import SocketcanBus

from master.network import kernel_frames
from master.network.kernel_cycles import KernelCycles
from master.network.kernel_frames import FIRST, LAST_NS, LOST, MARKED_NS, TAKEN
from trial.mcap_file.cdr import FRAME_STRUCT

NS: Final = 1_000_000_000
RECEIVE_BUFFER: Final = 8 << 20
"""Bytes that are asked for; the kernel charges about 770 for a waiting frame, so a second of a full bus fits."""
BATCH: Final = 32

_SO_TIMESTAMPNS, _SO_RCVBUFFORCE, _SO_RXQ_OVFL = 35, 33, 40
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_OWN, _NOW = int(socket.MSG_DONTROUTE), int(socket.MSG_DONTWAIT)
"""As plain integers: an operation on `socket.MsgFlag` costs more than all else that is done with a frame."""
_EAGAIN: Final = 11
_FRAME = struct.Struct("=IB3x8s")
_SLOT = struct.Struct("=IB3x8s16xqq16xI12x")
"""A frame and its ancillary data: a time stamp, then the count of lost frames once there are any."""
_VECTOR = struct.Struct("@QQ")
_HEADER = struct.Struct("@QIxxxxQQQQixxxxIxxxx")
"""struct mmsghdr: name, its length, vector, its length, control, its length, flags; bytes received."""
_HEADER_END = struct.Struct("=40xQi12x")
"""Of a header: how much ancillary data there is, flags."""
_ANCILLARY = 64
_PLAIN = kernel_frames.PLAIN
_FILTER = struct.Struct("=II")
_ALONE: Final = _EFF | _RTR | 0x7FF
"""Mask of a filter that passes data frames of the base format with one identifier."""
ROW: Final = FRAME_STRUCT.size

_recvmmsg = ctypes.PyDLL(None, use_errno=True).recvmmsg


Row = tuple[int, int, bytes, int, bool]


class KernelMessage(can.Message):
    """A message with the kernel's time stamp as it is, ns."""

    __slots__ = ("time_ns",)
    time_ns: int


class KernelBus(SocketcanBus):
    """One CAN_RAW socket; `lost` counts the frames that found its receive queue full.

    `timeout` of `send` is ignored: a full transmit queue is `can.CanOperationError` with ENOBUFS at once.
    """

    def __init__(self, channel: str = "", *, receive_buffer: int = RECEIVE_BUFFER, **options: Any) -> None:
        super().__init__(channel, **options)
        self.lost = 0
        self._readers = [self.socket]
        self._number = self.socket.fileno()
        self.waiting: deque[KernelMessage] = deque()
        self._triggers: list[socket.socket] = []
        self._slots, self._vectors = bytearray(BATCH * _SLOT.size), bytearray(BATCH * _VECTOR.size)
        self._headers = bytearray(BATCH * _HEADER.size)
        self._template = self._laid_out()
        self._seen, self._ends = memoryview(self._slots), memoryview(self._headers)
        self.slots: Any = np.frombuffer(self._slots, np.uint64).reshape(BATCH, kernel_frames.SLOT)
        self.headers: Any = np.frombuffer(self._headers, np.uint64).reshape(BATCH, kernel_frames.HEADER)
        self._make_room(2 * BATCH)
        self.numbers: Any = np.full(kernel_frames.TOLD, -1, np.int64)
        self.told: Any = memoryview(cast(Any, self.numbers))
        self.told[FIRST] = self.told[TAKEN] = 0
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        try:
            self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, receive_buffer)
        except PermissionError:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)

    def _laid_out(self) -> bytes:
        """Point every header at its own frame and ancillary bytes; what the kernel overwrites is copied back."""
        slots, vectors, first = (
            ctypes.addressof(ctypes.c_char.from_buffer(memory))
            for memory in (self._slots, self._vectors, self._headers))
        for i in range(BATCH):
            slot = slots + i * _SLOT.size
            _VECTOR.pack_into(self._vectors, i * _VECTOR.size, slot, _FRAME.size)
            _HEADER.pack_into(self._headers, i * _HEADER.size, 0, 0, vectors + i * _VECTOR.size, 1,
                              slot + _FRAME.size, _ANCILLARY, 0, 0)
        self._address = ctypes.c_void_p(first)
        return bytes(self._headers)

    @property
    def receive_buffer(self) -> int:
        """Bytes of the receive queue as the kernel granted them."""
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def recv(self, timeout: float | None = None) -> KernelMessage | None:
        """The next message within `timeout` s; 0 takes only what is there, without waiting for anything.

        Raises `can.CanOperationError` with the kernel's errno where the interface is down (once) or gone.
        """
        waiting = self.waiting
        if waiting:
            return waiting.popleft()
        if timeout != 0.0:
            try:
                if not select.select(self._readers, (), (), timeout)[0]:
                    return None
            except OSError as error:
                raise can.CanOperationError(f"{self.channel}: {error.strerror}", error.errno) from error
        self.keep(self.fetch())
        return waiting.popleft() if waiting else None

    def keep(self, count: int) -> None:
        """Let the frames that were fetched wait to be received, as messages."""
        for frame in self._frames(count):
            self.waiting.append(self._message(*frame))

    def rows(self) -> Iterator[Row]:
        """Every frame that waits, as `master.cycle.log` wants them, without a message made of each."""
        block, _, _, _ = self.block(0)
        for time_ns, can_id, flags, size, _, sent, payload in FRAME_STRUCT.iter_unpack(bytes(block)):
            yield time_ns, can_id, payload[:size], flags, sent

    def block(self, marked_id: int) -> tuple[Any, int, int, int]:
        """Every frame that waits: bytes of `cdr.FRAME_ROW`s, their number, time stamps of the last and of `marked_id`.

        A time stamp is −1 where there was never such a frame.  The bytes hold until the next call.
        """
        told = self.told
        kernel_frames.to_front(self.block_rows, self.numbers)
        count = BATCH
        while count == BATCH:
            count = self.fetch()
            if told[TAKEN] + count > len(self.block_rows):
                self._make_room(2 * len(self.block_rows))
            kernel_frames.rows(self.slots, self.headers, count, self.block_rows, marked_id, self.numbers)
        if told[LOST] >= 0:
            self.lost = told[LOST]
        told[FIRST] = told[TAKEN]
        return self.row_bytes[:ROW * told[TAKEN]], told[TAKEN], told[LAST_NS], told[MARKED_NS]

    def _make_room(self, count: int) -> None:
        """Have memory for so many rows, with the rows that are there."""
        before = getattr(self, "block_rows", np.zeros((0, kernel_frames.ROW), np.uint64))
        self.block_rows: Any = np.zeros((count, kernel_frames.ROW), np.uint64)
        self.block_rows[:len(before)] = before
        self.row_bytes = memoryview(cast(Any, self.block_rows)).cast("B")

    def cycles(
        self, tap: can.BusABC | None, targets: tuple[int, int], inputs: Sequence[tuple[int, int]], period_ns: int,
        budget_ns: int, heartbeat: tuple[int, int, int],
    ) -> KernelCycles | None:
        """Offer whole control cycles to a master, see `KernelCycles`; None with a tap of another kind.

        `tap` is the bus on which everything is recorded; `targets` and `inputs` are identifiers and sizes of the frame
        that the master sends in each and of those that it then waits for, within `budget_ns` of their SYNC.
        """
        if tap is not None and not isinstance(tap, KernelBus):
            return None
        return KernelCycles(self, tap, targets, inputs, period_ns, budget_ns)

    def trigger(self, can_ids: Sequence[int]) -> socket.socket:
        """Open another socket on the same interface that hears these identifiers alone; it closes with this bus."""
        opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._triggers.append(opened)
        opened.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER,
                          b"".join(_FILTER.pack(can_id, _ALONE) for can_id in can_ids))
        opened.bind((self.channel,))
        return opened

    def fetch(self) -> int:
        """Take what waits into memory, at most `BATCH` frames; returns how many."""
        self._headers[:] = self._template
        count: int = _recvmmsg(self._number, self._address, BATCH, _NOW, None)
        if count >= 0:
            return count
        code = ctypes.get_errno()
        if code != _EAGAIN:
            raise can.CanOperationError(f"{self.channel}: {os.strerror(code)}", code)
        return 0

    def _frames(self, count: int) -> Iterator[tuple[int, int, bytes, int, bool]]:
        """The frames taken: identifier with the kernel's flags, size, eight bytes, time stamp, own."""
        ends = _HEADER_END.iter_unpack(self._ends[:count * _HEADER.size])
        for can_id, size, payload, seconds, nanoseconds, lost in _SLOT.iter_unpack(self._seen[:count * _SLOT.size]):
            told, flags = next(ends)
            if told > _PLAIN:
                self.lost = lost
            yield can_id, size, payload, seconds * NS + nanoseconds, flags & _OWN != 0

    def _message(self, can_id: int, size: int, payload: bytes, time_ns: int, own: bool) -> KernelMessage:
        message = KernelMessage.__new__(KernelMessage)
        message.time_ns = time_ns
        message.timestamp = time_ns / NS
        message.is_rx = not own
        message.channel = self.channel
        message.dlc = size
        message.is_fd = message.bitrate_switch = message.error_state_indicator = False
        if can_id <= 0x7FF:
            message.arbitration_id = can_id
            message.is_extended_id = message.is_remote_frame = message.is_error_frame = False
            message.data = bytearray(payload[:size])
        else:
            self._unusual(message, can_id, payload)
        return message

    @staticmethod
    def _unusual(message: KernelMessage, can_id: int, payload: bytes) -> None:
        """Extended, remote and error frames."""
        message.is_extended_id, message.is_remote_frame = can_id & _EFF != 0, can_id & _RTR != 0
        message.is_error_frame = can_id & _ERR != 0
        message.arbitration_id = can_id & 0x1FFFFFFF
        message.data = bytearray() if message.is_remote_frame else bytearray(payload[:message.dlc])

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a classical frame to the kernel; raises `can.CanOperationError` with the kernel's errno."""
        can_id = msg.arbitration_id | _EFF * msg.is_extended_id | _RTR * msg.is_remote_frame | _ERR * msg.is_error_frame
        try:
            self.socket.send(_FRAME.pack(can_id, msg.dlc, bytes(msg.data)))
        except OSError as error:
            raise can.CanOperationError(f"{self.channel}: {error.strerror}", error.errno) from error

    def shutdown(self) -> None:
        """Close every socket: the broadcast manager ends what it sends for one, if its interface has not done so."""
        self._periodic_tasks.clear()
        for opened in self._triggers:
            opened.close()
        super().shutdown()
