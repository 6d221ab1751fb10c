"""The master's bus and the recorder's monitor socket in one socket of the kernel's CAN.

Every frame is read from the kernel once. It becomes a row for the recorder, and a message for the master unless the
master itself sent it. The kernel marks such frames (`MSG_CONFIRM`), which distinguishes them from those of another
program of this computer.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from typing import Any, Final, cast

import can
import numpy as np

from master.network import kernel_frames as frames
from master.network.kernel_cycles import KernelCycles
from master.network.socketcan import KernelBus

_FILTER = struct.Struct("=II")
_ALONE: Final = frames.EFF | frames.RTR | 0x7FF
"""Mask of a filter that passes data frames of the base format with one identifier."""


class RecordedBus(KernelBus):
    """A `KernelBus` that keeps every frame, its own ones too, until `block` hands them over as rows."""

    def __init__(self, channel: str = "", **options: Any) -> None:
        super().__init__(channel, receive_own_messages=True, **options)
        frames.prepare()
        self._trigger: socket.socket | None = None
        self._make_room(2 * frames.BATCH)
        self.numbers[[frames.MARKED_NS, frames.SYNC_END]] = -1
        self.told: Any = memoryview(cast(Any, self.numbers))

    def fetch(self) -> int:
        """Read the waiting frames into memory and rows, at most `BATCH`; return their number."""
        count = super().fetch()
        if self.told[frames.TAKEN] + count > len(self.block_rows):
            self._make_room(2 * len(self.block_rows))
        frames.rows(self.slots, self.headers, count, self.block_rows, self.numbers)
        return count

    def block(self, marked_id: int) -> tuple[Any, int, int, int]:
        """Return every frame up to now: bytes of `cdr.FRAME_ROW`s, their number, time stamps of the last and of
        `marked_id`.

        A time stamp is −1 where there was no such frame yet. The bytes hold until the next call.
        """
        frames.to_front(self.block_rows, self.numbers)
        count = frames.BATCH
        while count == frames.BATCH:
            count = self.fetch()
            self.keep(count)
        told, count = self.told, self.told[frames.TAKEN]
        frames.mark(self.block_rows, count, marked_id, self.numbers)
        told[frames.FIRST] = count
        last_ns = int(self.block_rows[count - 1, 0]) if count else -1
        return self.row_bytes[:frames.ROW_BYTES * count], count, last_ns, told[frames.MARKED_NS]

    def _make_room(self, count: int) -> None:
        """Enlarge the memory to `count` rows; present rows are kept."""
        before = getattr(self, "block_rows", np.zeros((0, frames.ROW), np.uint64))
        self.block_rows: Any = np.zeros((count, frames.ROW), np.uint64)
        self.block_rows[:len(before)] = before
        self.row_bytes = memoryview(cast(Any, self.block_rows)).cast("B")

    def cycles(
        self, tap: can.BusABC | None, targets: tuple[int, int], inputs: Sequence[tuple[int, int]], period_ns: int,
        budget_ns: int, heartbeat: tuple[int, int, int],
    ) -> KernelCycles | None:
        """Offer complete cycles to a master, see `KernelCycles`; None if another bus is the recorder's monitor
        socket.

        `targets` and `inputs` are identifiers and sizes of the frame that the master sends in each and of those that
        it then waits for, within `budget_ns` of their SYNC; `heartbeat`: identifier, byte and period of the master's.
        """
        return KernelCycles(self, targets, inputs, period_ns, budget_ns, heartbeat[:2]) if tap is self else None

    def trigger(self, can_id: int) -> socket.socket:
        """Open another socket on the same interface that hears this identifier alone; it closes with this bus."""
        if self._trigger is not None:
            self._trigger.close()
        opened = self._trigger = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        opened.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, _FILTER.pack(can_id, _ALONE))
        opened.bind((self.channel,))
        return opened

    def shutdown(self) -> None:
        """Close every socket."""
        if self._trigger is not None:
            self._trigger.close()
        super().shutdown()
