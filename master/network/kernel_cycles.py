"""Whole control cycles on the kernel's CAN: the process is woken twice in each, by SYNC and by the last input.

The rule of this file: a cycle in which all that comes is SYNC, the inputs and heartbeats of nodes at work is taken as
one; where anything else comes, every frame of the cycle waits in its order for the master to receive it singly.  A
second socket, filtered to SYNC and one input, wakes; the master's own, which receives everything, is read once.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any, Final, Protocol, cast

import can
import numpy as np

from eds.cia301 import SYNC_COB_ID
from master.network import kernel_frames as frames

Socket = socket.socket
NS: Final = 1_000_000_000
_HEAD = struct.Struct("=IB3x")
FRAME_BYTES: Final = 16
ROW_BYTES: Final = 8 * frames.ROW
BATCH: Final = 32
"""Rows that the tap's memory has room for beside what one call fetches."""

Whole = tuple[int, int, Any, tuple[tuple[int, int, int], ...], Any, int]
"""Time stamps of SYNC and of the targets, ns; time stamps and data of the inputs, as `eds.pdo_plan.Joined` takes them;
identifier, time and state of heartbeats; the frames that the tap heard up to that SYNC, bytes of `cdr.FRAME_ROW`s, and
their number.  Bytes hold until the next call."""


class ReadSocket(Protocol):
    """What a cycle uses of a `master.network.socketcan.KernelBus`: its socket, and the memory that it reads into."""

    channel: str
    socket: Socket
    waiting: Any
    lost: int
    slots: Any
    headers: Any
    told: Any
    numbers: Any
    row_bytes: Any
    block_rows: Any

    def trigger(self, can_ids: list[int]) -> Socket: ...

    def keep(self, count: int) -> None: ...

    def fetch(self) -> int: ...


class KernelCycles:
    """Cycles of one master: its `bus`, the recorder's `tap`, the frame that it sends, the inputs that it waits for.

    `targets` and `inputs` are identifiers with the least numbers of bytes.  Inputs have to come within `budget_ns` of
    their SYNC, SYNC within a period and a quarter of the targets.  `count` is the number of cycles taken as one.
    """

    def __init__(
        self, bus: ReadSocket, tap: ReadSocket | None, targets: tuple[int, int], inputs: Sequence[tuple[int, int]],
        period_ns: int, budget_ns: int,
    ) -> None:
        frames.prepare()
        self.count = 0
        self._bus, self._tap, self._period_ns = bus, tap, period_ns
        targets_id, size = targets
        self._numbers: Any = np.zeros(frames.HEEDED, np.int64)
        self._told: Any = memoryview(cast(Any, self._numbers))
        self._inputs = self._told.cast("B")[8 * frames.FRAMES:]
        self._last = max(can_id for can_id, _ in inputs)
        self._trigger = bus.trigger([SYNC_COB_ID, self._last])
        settings: Any = np.zeros(frames.SETTINGS, np.int64)
        settings[[frames.MAIN, frames.TAP, frames.TRIGGER, frames.TARGETS, frames.PATIENCE, frames.BUDGET]] = (
            bus.socket.fileno(), -1 if tap is None else tap.socket.fileno(), self._trigger.fileno(), targets_id,
            period_ns + period_ns // 4, budget_ns)
        self._settings: Any = memoryview(cast(Any, settings))
        frame: Any = np.zeros(FRAME_BYTES, np.uint8)
        self._data = memoryview(frame)[_HEAD.size:_HEAD.size + size]
        memoryview(frame)[:_HEAD.size] = _HEAD.pack(targets_id, size)
        heard = bus if tap is None else tap
        self._tap_told, self._rows = heard.told, heard.row_bytes
        self._call = (settings, frame, bus.slots, bus.headers, np.array([can_id for can_id, _ in inputs]),
                      np.array([least for _, least in inputs]), self._numbers, heard.slots, heard.headers,
                      heard.block_rows, heard.numbers)
        self._behind = True

    def run(self, data: bytes, beat_ns: int, after_ns: int) -> Whole | bool:
        """Send the targets, and go on to the last input of the next SYNC, which has to come after `after_ns`.

        False: nothing has happened, for frames wait or the heartbeat at `beat_ns` is due about now.  True: the targets
        were sent, and the frames that came wait to be received.  Raises `can.CanError` where the bus failed.
        """
        if self._bus.waiting or beat_ns < time.time_ns() + 2 * self._period_ns or not self._ready():
            self._behind = True
            return False
        self._data[:] = data
        self._settings[frames.AFTER] = after_ns
        ended = frames.cycle(*self._call)
        told, heard = self._told, self._tap_told
        if told[frames.DROPPED] >= 0:
            self._bus.lost = told[frames.DROPPED]
        if ended != frames.WHOLE and not self._mended(ended, after_ns):
            self._behind = True
            return ended != frames.NOT_SENT
        self._behind = self._behind or self._settings[frames.WOKEN] != self._last
        self.count += 1
        count = 0
        if self._tap is not None:
            count = heard[frames.FIRST] = heard[frames.SYNC_END]
        return (told[frames.AT_NS], heard[frames.MARKED_NS], self._inputs, self._beats() if told[frames.BEATS] else (),
                self._rows[:ROW_BYTES * count], count)

    def _ready(self) -> bool:
        """Whether the tap has room, and what woke cycles that were received singly is forgotten."""
        tap, told = self._tap, self._tap_told
        if tap is not None:
            if tap.row_bytes is not self._rows or told[frames.TAKEN] - told[frames.FIRST] > BATCH:
                return False
            if told[frames.LOST] >= 0:
                tap.lost = told[frames.LOST]
        if self._behind:
            self._behind = False
            try:
                while True:
                    self._trigger.recv(FRAME_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return True
            except OSError:  # the master's own socket fails with it, and says so
                return False
        return True

    def _mended(self, ended: int, after_ns: int) -> bool:
        """Whether the inputs that were not there yet come by their deadline; else all frames wait to be received.

        Raises `can.CanOperationError` where a socket failed.
        """
        bus, told, settings = self._bus, self._told, self._settings
        if ended == frames.FAILED:
            raise can.CanOperationError(f"{bus.channel}: {os.strerror(settings[frames.ERRNO])}", settings[frames.ERRNO])
        if ended != frames.FETCHED:
            return False
        status, count = frames.STRANGE, settings[frames.COUNT]
        if told[frames.MISSING] > 0:
            status = frames.WAITING
        deadline_ns = told[frames.AT_NS] + settings[frames.BUDGET]
        while True:
            if status == frames.DONE and told[frames.AT_NS] > after_ns:
                bus.waiting.clear()  # what was kept below of this cycle
                return True
            bus.keep(count)
            left_ns = deadline_ns - time.time_ns()
            if status != frames.WAITING or left_ns <= 0 or not select.select([bus.socket], (), (), left_ns / NS)[0]:
                return False
            count = bus.fetch()
            status = frames.heed(bus.slots, bus.headers, count, self._call[4], self._call[5], self._numbers)

    def _beats(self) -> tuple[tuple[int, int, int], ...]:
        told, first = self._told, frames.BEAT
        return tuple([(told[at], told[at + 1], told[at + 2])
                      for at in range(first, first + 3 * told[frames.BEATS], 3)])
