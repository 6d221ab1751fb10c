"""Recording of a trial: the control thread packs rows into flat memory, a writer makes chunks of them in bulk.

Nothing is lost and nothing blocks. A row is one `pack_into`. Rows are handed over when a chunk is full or when the
next 100 ms of trial time begin. The file therefore depends on the recorded data only, not on the time of writing.
With `threaded=True` another thread writes; if the bus has been silent for 100 ms, that thread also takes pending
rows. With False (virtual time) rows are written in place. `write` records a whole trial from arrays, in windows of
100 ms, so that its file is laid out as a recorded one is.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import replaced
from trial.mcap_file import cdr
from trial.mcap_file.container import EVENTS_PER_CHUNK, Block, Container, Events, FlatBlock, Writer
from trial.signals import SIGNALS, Signal

FLUSH_NS = 100_000_000
LIBRARY = "bowden-bench"
FRAME_BYTES = cdr.FRAME_STRUCT.size


class RecordingError(Exception):
    """The file accepts no more data; all data up to here are closed and readable. The text names the file and the
    reason."""


class Recorder:
    """One trial being recorded to `path`, which must not exist unless `overwrite`.

    Times are integer nanoseconds, ≥ 0.  `signals` are the columns of `table` (other columns, or another table,
    make an import or a side file).  Raises `InputError` where the file cannot be made, leaving nothing behind;
    later `RecordingError`, once, when it can no longer be written; what comes after that is not recorded.
    """

    def __init__(
        self, path: str | Path, *, metadata: Mapping[str, str], attachments: Mapping[str, bytes], threaded: bool = True,
        overwrite: bool = False, signals: Sequence[Signal] = SIGNALS, table: str = cdr.CYCLE,
    ) -> None:
        self.path = Path(path)
        self.width = len(signals)
        cycle = cdr.cycle_row(self.width)
        self._cycle_bytes, self._pack_cycle = cycle.size, cycle.pack_into
        self._pack_frame = cdr.FRAME_STRUCT.pack_into
        self._frames = FlatBlock(cdr.FRAMES, cdr.FRAME_ROW, cdr.FRAME_RECORD, cdr.frame_records)
        self._cycles = FlatBlock(table, np.dtype([("time_ns", "<i8"), ("values", "<f8", (self.width,))]),
                                cdr.cycle_record(self.width), cdr.cycle_records)
        self._events = Events()
        self._due_ns = 0
        self._reported = False
        self._open(overwrite)
        try:
            container = Container(self._file, LIBRARY)
            container.metadata("trial", metadata)
            for name, data in attachments.items():
                container.attachment(name, "text/plain", data)
            channels = _open_channels(container, signals, table)
        except OSError as error:
            self._remove()
            raise InputError(f"{self.path}: cannot be written ({error.strerror}); make room there.") from None
        self._writer = Writer(self.path, self._file, container, channels, self._waiting, threaded)

    def _open(self, overwrite: bool) -> None:
        try:
            if overwrite and self.path.is_symlink():
                self.path.unlink()  # a link is replaced, never written through
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except FileExistsError:
            raise InputError(f"{self.path}: the file exists; give another name or --overwrite.") from None
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror}); give a writable path.") from None

    def _remove(self) -> None:
        self._file.close()
        if self.path.is_file():
            self.path.unlink()

    def _waiting(self) -> tuple[Block, ...]:
        return self._frames, self._cycles, self._events

    @property
    def failure(self) -> str | None:
        """Reason why the recording ended early, or None."""
        return self._writer.failure

    def frame(
        self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
    ) -> None:
        """Record one CAN frame; a remote frame's DLC is `len(data)`.  `flags`: cdr.REMOTE, EXTENDED, ERROR."""
        size = len(data)
        if size > 8 or channel > 15:
            raise ValueError(f"a frame of {size} bytes on channel {channel}: at most 8 bytes, channels 0 to 15")
        if not 0 <= time_ns < self._due_ns:
            self._hand_over_all(time_ns)
        block = self._frames
        at = block.count
        if at == block.most:
            block, at = self._fresh_frames(), 0
        self._pack_frame(block.rows, at * FRAME_BYTES, time_ns, can_id, flags, size, channel, sent, data)
        block.count = at + 1

    def frames(self, rows: Any, count: int, last_ns: int) -> None:
        """Record `count` frames at once: bytes of `cdr.FRAME_ROW`s, in the order of their times to `last_ns`."""
        block, size = self._frames, count * FRAME_BYTES
        at = block.count
        if last_ns < self._due_ns and at + count <= block.most:
            block.rows[at * FRAME_BYTES:at * FRAME_BYTES + size] = rows
            block.count = at + count
            return
        for time_ns, can_id, flags, dlc, channel, sent, data in cdr.FRAME_STRUCT.iter_unpack(rows):
            self.frame(time_ns, can_id, data[:dlc], flags, channel, sent)

    def cycles(self, times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Record control cycles at once: n times, none before its predecessor, and (n, width) values."""
        rows = np.empty(len(times_ns), self._cycles.row)
        rows["time_ns"], rows["values"] = times_ns, values
        first = 0
        while first < len(rows):
            time_ns = int(times_ns[first])
            if not 0 <= time_ns < self._due_ns:
                self._hand_over_all(time_ns)
            block = self._cycles
            if block.count == block.most:
                block = self._fresh_cycles()
            room = first + block.most - block.count
            end = min(room, int(np.searchsorted(times_ns, self._due_ns)))
            at = block.count * self._cycle_bytes
            block.rows[at:at + (end - first) * self._cycle_bytes] = rows[first:end].tobytes()
            block.count += end - first
            first = end

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle: a value for each of the recorder's signals, NaN where unknown."""
        if not 0 <= time_ns < self._due_ns:
            self._hand_over_all(time_ns)
        block = self._cycles
        at = block.count
        if at == block.most:
            block, at = self._fresh_cycles(), 0
        self._pack_cycle(block.rows, at * self._cycle_bytes, time_ns, *values)
        block.count = at + 1

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Record what happened: kind ("nmt", "emcy", "safety", "miss" …), who, and one sentence."""
        if not 0 <= time_ns < self._due_ns:
            self._hand_over_all(time_ns)
        if self._events.count == EVENTS_PER_CHUNK:
            self._fresh_events()
        self._events.rows.append((time_ns, kind, source, text))
        self._events.count += 1

    def close(self, result: Mapping[str, object]) -> None:
        """Write pending rows, then `result` (each value as JSON) and the summary; a second call does nothing."""
        written = {key: json.dumps(value, allow_nan=False) for key, value in result.items()}
        for block in self._waiting():
            self._writer.put(block)
        self._writer.join()
        self._writer.finish(written)
        self._report()

    def discard(self) -> None:
        """Close and remove the file: for a run that is refused before it starts."""
        self._writer.join()
        self._remove()

    def _hand_over_all(self, time_ns: int) -> None:
        if time_ns < 0:
            raise ValueError(f"{time_ns} ns: a trial's clock does not begin before 0")
        self._due_ns = time_ns - time_ns % FLUSH_NS + FLUSH_NS
        if self._frames.count:
            self._fresh_frames()
        if self._cycles.count:
            self._fresh_cycles()
        if self._events.count:
            self._fresh_events()

    def _report(self) -> None:
        if self._writer.failure is not None and not self._reported:
            self._reported = True
            raise RecordingError(self._writer.failure)

    def _put(self, full: Block) -> None:
        self._writer.put(full)
        self._report()

    def _fresh_frames(self) -> FlatBlock:
        full, self._frames = self._frames, self._writer.spare(self._frames)
        self._put(full)
        return self._frames

    def _fresh_cycles(self) -> FlatBlock:
        full, self._cycles = self._cycles, self._writer.spare(self._cycles)
        self._put(full)
        return self._cycles

    def _fresh_events(self) -> None:
        full, self._events = self._events, Events()
        self._put(full)


def _open_channels(container: Container, signals: Sequence[Signal], table: str) -> dict[str, int]:
    about = {signal.name: signal.unit for signal in signals}
    derived = " ".join(signal.name for signal in signals if signal.derived)
    if derived:
        about["derived"] = derived
    topics: tuple[tuple[str, str, str, dict[str, str]], ...] = (
        (cdr.FRAMES, cdr.FRAME_SCHEMA_NAME, cdr.FRAME_SCHEMA, {}),
        (table, cdr.CYCLE_SCHEMA_NAME, cdr.cycle_schema([signal.name for signal in signals]), about),
        (cdr.EVENTS, cdr.EVENT_SCHEMA_NAME, cdr.EVENT_SCHEMA, {}),
    )
    return {
        topic: container.channel(topic, container.schema(name, "ros2msg", text), "cdr", described)
        for topic, name, text, described in topics
    }


Event = tuple[int, str, str, str]
Progress = Callable[[float], None]


def silent(share: float) -> None:
    """Report no progress."""


@dataclass
class TrialContent:
    """A trial to be: cycles at `times` (ns, rising) with columns by signal name, frames, events (time first).

    `signals` declares the names that may be written, in the order of the file.
    """

    times: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.float64]]
    frames: NDArray[np.void] = field(default_factory=lambda: np.empty(0, cdr.FRAME_ROW))
    events: list[Event] = field(default_factory=list)
    signals: Sequence[Signal] = SIGNALS


def write(
    target: str | Path, content: TrialContent, *, metadata: Mapping[str, str], result: Mapping[str, object],
    attachments: Mapping[str, bytes] | None = None, overwrite: bool = False, progress: Progress = silent,
) -> None:
    """Write a trial; its columns are those of its signals that `content` has. Raises `InputError`.

    The file appears when it is complete; `progress` receives the share done, 0 … 1.
    """
    signals = [signal for signal in content.signals if signal.name in content.columns]
    columns = [content.columns[signal.name] for signal in signals]
    table = np.array(columns).T if columns else np.empty((len(content.times), 0))
    target = Path(target)
    with replaced(target, overwrite=overwrite) as part:
        try:
            recorder = Recorder(part, metadata=metadata, attachments=attachments or {}, threaded=False, overwrite=True,
                                signals=signals)
            _record(recorder, content, table, progress)
            recorder.close(result)
        except (RecordingError, InputError) as error:
            raise InputError(str(error).replace(str(part), str(target))) from None


def _record(recorder: Recorder, content: TrialContent, table: NDArray[np.float64], progress: Progress) -> None:
    windows = _windows(content)
    for number, ((frame, cycle, event), (frame_end, cycle_end, event_end)) in enumerate(pairwise(windows), start=1):
        for time_ns, can_id, flags, dlc, channel, sent, data in content.frames[frame:frame_end].tolist():
            recorder.frame(time_ns, can_id, bytes(data[:dlc]), flags, channel, sent)
        recorder.cycles(content.times[cycle:cycle_end], table[cycle:cycle_end])
        for row in content.events[event:event_end]:
            recorder.event(*row)
        progress(number / (len(windows) - 1))


def _windows(content: TrialContent) -> list[tuple[int, ...]]:
    """Return where in frames, cycles and events each 100 ms of the trial begins, and their ends."""
    events = np.array([event[0] for event in content.events], np.int64)
    streams = (content.frames["time_ns"], content.times, events)
    latest = [np.maximum.accumulate(stream) if len(stream) else stream for stream in streams]
    edges = np.unique(np.concatenate(latest) // FLUSH_NS)[1:] * FLUSH_NS
    places = [np.searchsorted(stream, edges).tolist() for stream in latest]
    return [(0, 0, 0), *zip(*places, strict=True), tuple(len(stream) for stream in streams)]
