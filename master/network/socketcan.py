"""The kernel's CAN for a master: python-can's SocketCAN bus with a shorter path per frame.

It provides exact time stamps, marks this computer's own frames, and counts frames that met a full receive queue
(`SO_RXQ_OVFL`). One call fetches every waiting frame (recvmmsg), and keeps the interpreter meanwhile: it never
blocks. SYNC stays with the broadcast manager.
"""

import ctypes
import os
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Iterator
from typing import Any, Final, cast

import can
import numpy as np
from can.interfaces.socketcan import SocketcanBus

from master.network import kernel_frames
from master.network.host_computer import HARDWARE_STAMPS, hardware_stamps
from master.network.kernel_frames import BATCH, HEADER, KNOWN, SLOT, SLOTS

NS: Final = 1_000_000_000
RECEIVE_BUFFER: Final = 8 << 20
"""Requested size of the receive queue, bytes: a second of a full bus, at about 770 bytes for each waiting frame."""

_SO_RCVBUFFORCE, _SO_RXQ_OVFL = 33, 40
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_NOW: Final = int(socket.MSG_DONTWAIT)
"""`MSG_DONTWAIT` as a plain integer: an operation on `socket.MsgFlag` costs more than all other work per frame."""
_EAGAIN: Final = 11
_FRAME = struct.Struct("=IB3x8s")
_SLOT = struct.Struct("=IB3x8s16xqq16xI76x")
"""A frame and its ancillary data: a time stamp, then the count of lost frames once there are any."""
_VECTOR = struct.Struct("@QQ")
_HEADER = struct.Struct("@QIxxxxQQQQixxxxIxxxx")
"""struct mmsghdr: name, its length, vector, its length, control, its length, flags; bytes received."""
_HEADER_END = struct.Struct("=40xQi12x")
"""Fields of a `msghdr`: length of the ancillary data, and flags."""
_PLAIN = kernel_frames.PLAIN

_recvmmsg = ctypes.PyDLL(None, use_errno=True).recvmmsg


class KernelMessage(can.Message):
    """A message with the kernel's time stamp as an integer, ns."""

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
        self.memory: Any = np.zeros(kernel_frames.MEMORY, np.uint64)
        self.headers, self.slots = (self.memory[:SLOTS].reshape(BATCH, HEADER),
                                    self.memory[SLOTS:KNOWN].reshape(BATCH, SLOT))
        self._headers, self._slots = (memoryview(cast(Any, part)).cast("B") for part in (self.headers, self.slots))
        self._vectors = bytearray(BATCH * _VECTOR.size)
        self.numbers: Any = self.memory[KNOWN:].view(np.int64)
        self._template = self._laid_out()
        self._stamped = hardware_stamps(channel)
        """Whether the adapter stamps frames itself."""
        if self._stamped:
            self.socket.setsockopt(socket.SOL_SOCKET, kernel_frames.SO_TIMESTAMPING, HARDWARE_STAMPS)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        try:
            self.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, receive_buffer)
        except PermissionError:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)

    def _laid_out(self) -> bytes:
        """Point every header at its own frame and ancillary bytes; fields that the kernel overwrites are restored by
        copying."""
        slots, first = self.slots.ctypes.data, self.headers.ctypes.data
        vectors = ctypes.addressof(ctypes.c_char.from_buffer(self._vectors))
        for i in range(BATCH):
            slot = slots + i * _SLOT.size
            _VECTOR.pack_into(self._vectors, i * _VECTOR.size, slot, _FRAME.size)
            _HEADER.pack_into(self._headers, i * _HEADER.size, 0, 0, vectors + i * _VECTOR.size, 1,
                              slot + _FRAME.size, kernel_frames.ANCILLARY, 0, 0)
        self._address = ctypes.c_void_p(first)
        return bytes(self._headers)

    @property
    def stamps(self) -> str:
        """Return in words whose clock stamps the frames, and how much later the kernel's time stamps are."""
        count = int(self.numbers[kernel_frames.FRAMES_STAMPED])
        if not self._stamped or not count:
            return "time stamps of the kernel; the adapter's driver gives none of its own"
        late_us = self.numbers[kernel_frames.WORST_NS] * 1e-3
        late = f"the adapter stamped {count} frames, and the kernel stamped them up to {late_us:.0f} µs later"
        used = bool(self.numbers[kernel_frames.ECHOED])
        whose = "adapter" if used else "kernel, since own frames have none of the adapter"
        return f"time stamps of the {whose}; {late}"

    def recv(self, timeout: float | None = None) -> KernelMessage | None:
        """Return the next message within `timeout` s; 0 returns only a message that waits.

        Raises `can.CanOperationError` with the kernel's errno if the interface is down (once) or gone.
        """
        waiting = self.waiting
        if waiting:
            return waiting.popleft()
        until = None if timeout is None else time.monotonic() + timeout
        while True:
            if timeout != 0.0:
                try:
                    if not select.select(self._readers, (), (), timeout)[0]:
                        return None
                except OSError as error:
                    raise can.CanOperationError(f"{self.channel}: {error.strerror}", error.errno) from error
            self.keep(self.fetch())
            if waiting:
                return waiting.popleft()
            if timeout == 0.0:
                return None
            if until is not None:  # what came were this socket's own frames
                timeout = max(0.0, until - time.monotonic())

    def keep(self, count: int) -> None:
        """Keep the fetched frames for `recv`, as messages, without those that this socket sent."""
        for frame in self._frames(count):
            self.waiting.append(self._message(*frame))

    def fetch(self) -> int:
        """Receive waiting frames into memory, at most `BATCH`; returns their number."""
        self._headers[:] = self._template
        count: int = _recvmmsg(self._number, self._address, BATCH, _NOW, None)
        if count >= 0:
            if self._stamped:
                kernel_frames.settle(self.slots, self.headers, count, self.numbers)
            return count
        code = ctypes.get_errno()
        if code != _EAGAIN:
            raise can.CanOperationError(f"{self.channel}: {os.strerror(code)}", code)
        return 0

    def _frames(self, count: int) -> Iterator[tuple[int, int, bytes, int, bool]]:
        """Yield the fetched frames of other senders: identifier with the kernel's flags, size, 8 bytes, time stamp,
        whether from this computer."""
        ends = _HEADER_END.iter_unpack(self._headers[:count * _HEADER.size])
        for can_id, size, payload, seconds, nanoseconds, lost in _SLOT.iter_unpack(self._slots[:count * _SLOT.size]):
            told, flags = next(ends)
            if told > _PLAIN:
                self.lost = lost
            if not flags & kernel_frames.OWN:
                yield can_id, size, payload, seconds * NS + nanoseconds, flags & kernel_frames.HERE != 0

    def _message(self, can_id: int, size: int, payload: bytes, time_ns: int, here: bool) -> KernelMessage:
        message = KernelMessage.__new__(KernelMessage)
        message.time_ns = time_ns
        message.timestamp = time_ns / NS
        message.is_rx = not here
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
        """Decode an extended, remote or error frame."""
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
        """Close the sockets: the broadcast manager ends their periodic frames, if the interface has not done so."""
        self._periodic_tasks.clear()
        super().shutdown()
