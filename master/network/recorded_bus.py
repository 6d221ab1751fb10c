"""The master's bus and the recorder's monitor socket in one socket of the kernel's CAN, and its complete cycles.

Every frame is read from the kernel once. It becomes a row for the recorder, and a message for the master unless the
master itself sent it. The kernel marks such frames (`MSG_CONFIRM`), which distinguishes them from those of another
program of this computer.

A complete cycle wakes the process once, by its last input: a second socket, filtered to that input, wakes; the master's
own, which receives everything, is read once. If all that comes is SYNC, the inputs and heartbeats of nodes at work, it
is one cycle; if anything else comes, every frame of the cycle waits in its order for the master to receive it singly.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import Any, Final, cast

import can
import numpy as np

from eds.bench.complete_cycle import CompleteCycle
from master.network import kernel_frames as frames
from master.network.socketcan import KernelBus

NS: Final = 1_000_000_000
FRAME_BYTES: Final = 16
_HEAD = struct.Struct("=IB3x")
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


class KernelCycles:
    """Cycles of one master on its `bus`: the frames that it sends, the inputs that it waits for.

    `targets` and `inputs` are identifiers with the least numbers of bytes; `heartbeat` is the master's identifier and
    its byte.  Inputs have to come within `budget_ns` of their SYNC, SYNC within a period.  `count` is the number of
    cycles taken as one.
    """

    def __init__(
        self, bus: RecordedBus, targets: tuple[int, int], inputs: Sequence[tuple[int, int]], period_ns: int,
        budget_ns: int, heartbeat: tuple[int, int],
    ) -> None:
        self.count = 0
        self._bus, self._budget_ns, self._period_ns, self._heartbeat = bus, budget_ns, period_ns, heartbeat
        targets_id, size = targets
        self._last = max(can_id for can_id, _ in inputs)
        self._trigger = bus.trigger(self._last)
        numbers = self._numbers = np.zeros(frames.NUMBERS, np.int64)
        numbers[[frames.MAIN, frames.TRIGGER, frames.TARGETS, frames.PATIENCE]] = (
            bus.socket.fileno(), self._trigger.fileno(), targets_id, period_ns - period_ns // 2 + budget_ns)
        numbers[frames.IDS:frames.SIZES] = [can_id for can_id, _ in inputs]
        numbers[frames.SIZES:frames.HEED] = [least for _, least in inputs]
        self._settings: Any = memoryview(cast(Any, numbers))
        self._results = self._settings[frames.HEED:]
        raw = self._settings.cast("B")
        self._inputs = raw[8 * (frames.HEED + frames.FRAMES):]
        _HEAD.pack_into(raw, 8 * frames.FRAME, targets_id, size)
        _HEAD.pack_into(raw, 8 * frames.BEAT_FRAME, heartbeat[0], 1)
        raw[8 * frames.BEAT_FRAME + _HEAD.size] = heartbeat[1]
        data = 8 * frames.FRAME + _HEAD.size
        self._data = raw[data:data + size]
        self._behind = True

    def run(self, data: bytes, beat_ns: int, after_ns: int) -> CompleteCycle | bool:
        """Send the targets, and go on to the last input of the next SYNC, which has to come after `after_ns`.

        The heartbeat at `beat_ns` is sent if it is due within a period from then, and recorded with the others.
        False: nothing has happened, for frames wait, or `beat_ns` is 0. True: the targets were sent, and the received
        frames wait; a heartbeat is then sent once more at its time. Raises `can.CanError` if the bus failed.
        """
        bus, told = self._bus, self._results
        if bus.waiting or not beat_ns or (self._behind and not self._forgotten()):
            self._behind = True
            return False
        self._data[:] = data
        self._settings[frames.AFTER] = after_ns
        due = beat_ns < after_ns + self._period_ns
        self._settings[frames.ALIVE] = due
        ended = frames.cycle(self._numbers, bus.memory, bus.block_rows)
        if told[frames.DROPPED] >= 0:
            bus.lost = told[frames.DROPPED]
        if ended != frames.COMPLETE and not self._mended(ended, after_ns):
            self._behind = True
            return ended != frames.NOT_SENT
        self._behind = ended != frames.COMPLETE or self._settings[frames.WOKEN] != self._last
        self.count += 1
        heard = bus.told
        count = heard[frames.FIRST] = heard[frames.SYNC_END]
        beats = self._beats() if told[frames.BEATS] else ()
        if due and not self._settings[frames.ALIVE]:
            beats = (*beats, (self._heartbeat[0], max(beat_ns, after_ns), self._heartbeat[1]))
        return CompleteCycle(sync_ns=told[frames.AT_NS], target_ns=heard[frames.MARKED_NS], inputs=self._inputs,
                             heartbeats=beats, frames=bus.row_bytes[:frames.ROW_BYTES * count], frame_count=count)

    def _forgotten(self) -> bool:
        """Drain stale wake-ups of cycles that were received frame by frame; return False if the socket failed."""
        self._behind = False
        try:
            while True:
                self._trigger.recv(FRAME_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return True
        except OSError:  # the master's own socket fails with it, and says so
            return False

    def _mended(self, ended: int, after_ns: int) -> bool:
        """Return whether the missing inputs arrive by their deadline; if not, all frames stay to be received one by
        one.

        Raises `can.CanOperationError` where a socket failed.
        """
        bus, told, numbers = self._bus, self._results, self._numbers
        if ended == frames.FAILED:
            code = self._settings[frames.ERRNO]
            raise can.CanOperationError(f"{bus.channel}: {os.strerror(code)}", code)
        if ended != frames.FETCHED:
            return False
        status, count = frames.STRANGE, self._settings[frames.COUNT]
        if told[frames.MISSING] > 0:
            status = frames.WAITING
        deadline_ns = told[frames.AT_NS] + self._budget_ns
        while True:
            if status == frames.DONE and told[frames.AT_NS] > after_ns:
                bus.waiting.clear()  # what was kept below of this cycle
                frames.mark(bus.block_rows, bus.told[frames.SYNC_END], self._settings[frames.TARGETS], bus.numbers)
                return True
            bus.keep(count)
            left_ns = deadline_ns - time.time_ns()
            if status != frames.WAITING or left_ns <= 0 or not select.select([bus.socket], (), (), left_ns / NS)[0]:
                return False
            count = bus.fetch()
            status = frames.heed(bus.slots, bus.headers, count, numbers[frames.IDS:frames.SIZES],
                                 numbers[frames.SIZES:frames.HEED], numbers[frames.HEED:])

    def _beats(self) -> tuple[tuple[int, int, int], ...]:
        told, first = self._results, frames.BEAT
        return tuple([(told[at], told[at + 1], told[at + 2])
                      for at in range(first, first + 3 * told[frames.BEATS], 3)])
