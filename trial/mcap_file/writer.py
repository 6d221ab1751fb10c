"""The writer of a recording: blocks in, chunks out, in its own thread or in place.

The rule of this file: blocks are written in the order they were handed over; what cannot be written ends the
recording with the file closed and whole up to its last record, and the reason kept for the control thread.
"""

import contextlib
import os
import queue
import threading
from collections.abc import Callable, Mapping
from io import FileIO
from pathlib import Path

from trial.mcap_file.container import Container
from trial.mcap_file.message_blocks import Block, Events

IDLE_S = 0.1  # where the bus falls silent, what is waiting is written after this long


class Writer:
    """Writer of blocks to `container`, whose topics have the ids `channels`.

    `waiting` returns the blocks that the control thread is filling now; only a writer with a thread asks for them,
    when nothing has been handed over for 100 ms. `failure` is the reason if the recording ended early.
    """

    def __init__(
        self, path: Path, file: FileIO, container: Container, channels: Mapping[str, int],
        waiting: Callable[[], tuple[Block, ...]], threaded: bool,
    ) -> None:
        self.failure: str | None = None
        self._path, self._file, self._container, self._channels = path, file, container, channels
        self._waiting = waiting
        self._sequence = dict.fromkeys(channels, 0)
        self._spare: dict[str, list[Block]] = {topic: [] for topic in channels}
        self._queue: queue.SimpleQueue[Block | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        if threaded:
            self._thread = threading.Thread(target=self._run, name="trial writer", daemon=True)
            self._thread.start()

    def put(self, block: Block) -> None:
        """Pass a complete block to the writer thread."""
        if self._thread is None:
            self._take(block)
        else:
            self._queue.put(block)

    def spare(self, topic: str) -> Block | None:
        """Return an emptied block, if one is at hand."""
        spare = self._spare[topic]
        return spare.pop() if spare else None

    def join(self) -> None:
        """Wait until every block is written, and end the thread."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join()
            self._thread = None

    def finish(self, result: Mapping[str, str]) -> None:
        """Write the result and the summary and close the file; `join` comes first."""
        if self.failure is None and not self._file.closed:
            try:
                self._container.metadata("result", result)
                self._container.finish()
                self._file.close()
            except OSError as error:
                self._fail(error)

    def _run(self) -> None:
        while True:
            try:
                block = self._queue.get(timeout=IDLE_S)
            except queue.Empty:
                self._take_waiting()
                continue
            if block is None:
                return
            self._take(block)

    def _take_waiting(self) -> None:
        live = [(block, block.count) for block in self._waiting()]
        if self._queue.empty():  # else what was handed over meanwhile comes first
            for block, count in live:
                self._write(block, count)

    def _take(self, block: Block) -> None:
        self._write(block, block.count)
        if not isinstance(block, Events):
            block.count = block.taken = 0
            self._spare[block.topic].append(block)

    def _write(self, block: Block, count: int) -> None:
        first, block.taken = block.taken, count
        if count == first or self.failure is not None:
            return
        channel, sequence = self._channels[block.topic], self._sequence[block.topic]
        self._sequence[block.topic] = sequence + count - first
        try:
            data, times, offsets = block.content(first, count, channel, sequence)
            self._container.chunk(data, {channel: (times, offsets)})
        except Exception as error:  # whatever it is, the control thread must hear of it
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Cut the file back to its last complete record, close it properly if that still fits, and store the reason."""
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        self._cut()
        with contextlib.suppress(OSError):
            self._container.finish()
        self._cut()
        with contextlib.suppress(OSError):
            self._file.close()
        self.failure = f"{self._path}: recording stopped ({reason}); make room, and bowden recover what is there."

    def _cut(self) -> None:
        with contextlib.suppress(OSError):  # a device that cannot be cut is left as it is
            os.ftruncate(self._file.fileno(), self._container.position)
            self._file.seek(self._container.position)
