"""Complete control cycles on the kernel's CAN: the process is woken once in each, by the last input.

The rule of this file: a cycle in which all that comes is SYNC, the inputs and heartbeats of nodes at work is taken as
one; where anything else comes, every frame of the cycle waits in its order for the master to receive it singly.  A
second socket, filtered to one input, wakes; the master's own, which receives everything, is read once.
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

from eds.bench.complete_cycle import CompleteCycle
from master.network import kernel_frames as frames

Socket = socket.socket
NS: Final = 1_000_000_000
_HEAD = struct.Struct("=IB3x")
FRAME_BYTES: Final = 16


class ReadSocket(Protocol):
    """Interface of a `master.network.recorded_bus.RecordedBus` towards a cycle: its socket, and the memory of its
    frames."""

    channel: str
    socket: Socket
    waiting: Any
    lost: int
    memory: Any
    slots: Any
    headers: Any
    numbers: Any
    told: Any
    block_rows: Any
    row_bytes: Any

    def trigger(self, can_id: int) -> Socket: ...

    def keep(self, count: int) -> None: ...

    def fetch(self) -> int: ...


class KernelCycles:
    """Cycles of one master on its `bus`: the frames that it sends, the inputs that it waits for.

    `targets` and `inputs` are identifiers with the least numbers of bytes; `heartbeat` is the master's identifier and
    its byte.  Inputs have to come within `budget_ns` of their SYNC, SYNC within a period.  `count` is the number of
    cycles taken as one.
    """

    def __init__(
        self, bus: ReadSocket, targets: tuple[int, int], inputs: Sequence[tuple[int, int]], period_ns: int,
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
