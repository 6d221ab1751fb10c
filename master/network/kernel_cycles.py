"""Whole control cycles on the kernel's CAN: the process is woken twice in each, by SYNC and by the last input.

The rule of this file: a cycle in which all that comes is SYNC, the inputs and heartbeats of nodes at work is taken as
one; where anything else comes, every frame of the cycle waits in its order for the master to receive it singly.  A
second socket, filtered to SYNC and one input, wakes; the master's own, which receives everything, is read once.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, cast

import can
import numpy as np

from eds.cia301 import SYNC_COB_ID
from master.network import kernel_frames as frames

if TYPE_CHECKING:
    from master.network.socketcan import KernelBus

NS: Final = 1_000_000_000
_HEAD = struct.Struct("=IB3x")
_ID = struct.Struct("=I")
_SYNC: Final = _ID.pack(SYNC_COB_ID)
_FRAME_BYTES: Final = 16
_NOW: Final = int(socket.MSG_DONTWAIT)

Whole = tuple[int, int, Any, tuple[tuple[int, int, int], ...], Any, int]
"""Time stamps of SYNC and of the targets, ns; time stamps and data of the inputs, as `eds.plan.Joined` takes them;
identifier, time and state of heartbeats; the frames that the tap heard up to that SYNC, bytes of `cdr.FRAME_ROW`s, and
their number.  Bytes hold until the next call."""


class KernelCycles:
    """Cycles of one master: its `bus`, the recorder's `tap`, the frame that it sends, the inputs that it waits for.

    `targets` and `inputs` are identifiers with the least numbers of bytes.  Inputs have to come within `budget_ns` of
    their SYNC, SYNC within a period and a quarter of the targets.  `count` is the number of cycles taken as one.
    """

    def __init__(
        self, bus: KernelBus, tap: KernelBus | None, targets: tuple[int, int], inputs: Sequence[tuple[int, int]],
        period_ns: int, budget_ns: int,
    ) -> None:
        frames.prepare()
        self.count = 0
        self._bus, self._tap, self._period_ns, self._budget_ns = bus, tap, period_ns, budget_ns
        self._patience_s = 1.25 * period_ns / NS
        self._targets_id, size = targets
        self._head, self._pad = _HEAD.pack(self._targets_id, size), bytes(8 - size)
        self._numbers: Any = np.zeros(frames.HEEDED, np.int64)
        self._told: Any = memoryview(cast(Any, self._numbers))
        self._frames = self._told.cast("B")[8 * frames.FRAMES:]
        self._ids, self._sizes = np.array([can_id for can_id, _ in inputs]), np.array([size for _, size in inputs])
        self._last = _ID.pack(max(can_id for can_id, _ in inputs))
        self._trigger = bus.trigger([SYNC_COB_ID, max(can_id for can_id, _ in inputs)])
        self._wakes, self._reads = [self._trigger], [bus.socket]
        self._behind = True

    def run(self, data: bytes, beat_ns: int, after_ns: int) -> Whole | bool:
        """Send the targets, and go on to the last input of the next SYNC, which has to come after `after_ns`.

        False: nothing has happened, for frames wait or the heartbeat at `beat_ns` is due about now.  True: the targets
        were sent, and the frames that came wait to be received.  Raises `can.CanError` where the bus failed.
        """
        bus = self._bus
        if bus.waiting or beat_ns < time.time_ns() + 2 * self._period_ns:
            self._behind = True
            return False
        try:
            if self._behind:
                self._catch_up()
            bus.socket.send(self._head + data + self._pad)
        except OSError:
            self._behind = True
            return False
        try:
            whole = self._received(after_ns)
        except OSError as error:
            raise can.CanOperationError(f"{bus.channel}: {error.strerror}", error.errno) from error
        if whole is None:
            self._behind = True
            return True
        self.count += 1
        return whole

    def _received(self, after_ns: int) -> Whole | None:
        """Wait for SYNC, take what the tap has heard, wait for the last input, take all of them."""
        told = self._told
        told[frames.MISSING], told[frames.DROPPED], told[frames.BEATS] = -1, -1, 0
        if self._woken(self._patience_s) != _SYNC:
            return None
        targets_ns, sync_ns, rows, count = -1, time.time_ns(), b"", 0
        if self._tap is not None:
            targets_ns, sync_ns, rows, count = self._tap.up_to_sync(self._targets_id)
            if sync_ns < 0:
                return None
        deadline_ns = sync_ns + self._budget_ns
        if self._woken((deadline_ns - time.time_ns()) / NS) != self._last:
            self._behind = True
        if not self._taken(deadline_ns, after_ns):
            return None
        if self._tap is not None:
            self._tap.release(count)
        beats = self._beats() if told[frames.BEATS] else ()
        return told[frames.AT_NS], targets_ns, self._frames, beats, rows, count

    def _taken(self, deadline_ns: int, after_ns: int) -> bool:
        """Read the master's socket until every input is there; False where something else is, or one is late.

        Then all frames of the cycle wait in the bus.
        """
        bus, told = self._bus, self._told
        while True:
            count = bus.fetch()
            status = frames.heed(bus.slots, bus.headers, count, self._ids, self._sizes, self._numbers)
            if told[frames.DROPPED] >= 0:
                bus.lost = told[frames.DROPPED]
            if status == frames.DONE and told[frames.AT_NS] > after_ns:
                bus.waiting.clear()  # what was kept below of this cycle
                return True
            bus.keep(count)
            left_ns = deadline_ns - time.time_ns()
            if status != frames.WAITING or left_ns <= 0 or not select.select(self._reads, (), (), left_ns / NS)[0]:
                return False

    def _beats(self) -> tuple[tuple[int, int, int], ...]:
        told, first = self._told, frames.BEAT
        return tuple([(told[at], told[at + 1], told[at + 2])
                      for at in range(first, first + 3 * told[frames.BEATS], 3)])

    def _woken(self, timeout_s: float) -> bytes:
        """The identifier's bytes of the frame that wakes within so long; nothing where none does."""
        if timeout_s <= 0.0 or not select.select(self._wakes, (), (), timeout_s)[0]:
            return b""
        return self._trigger.recv(_FRAME_BYTES, _NOW)[:4]

    def _catch_up(self) -> None:
        """Forget what woke cycles that were received singly."""
        self._behind = False
        try:
            while True:
                self._trigger.recv(_FRAME_BYTES, _NOW)
        except BlockingIOError:
            return
