"""A whole trial written at once, from arrays.

The rule of this file: frames, cycles and events go through the recorder in windows of 100 ms, so that a file made
in bulk is laid out as a recorded one is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import replaced
from trial.mcap_file import cdr
from trial.record import FLUSH_NS, Recorder, RecordingError
from trial.signals import SIGNALS, Signal

Event = tuple[int, str, str, str]
Progress = Callable[[float], None]


def silent(share: float) -> None:
    """Report no progress."""


def _no_frames() -> NDArray[np.void]:
    return np.empty(0, cdr.FRAME_ROW)


@dataclass
class TrialContent:
    """A trial to be: cycles at `times` (ns, rising) with columns by signal name, frames, events (time first).

    `signals` declares the names that may be written, in the order of the file.
    """

    times: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.float64]]
    frames: NDArray[np.void] = field(default_factory=_no_frames)
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
        times = content.times[cycle:cycle_end].tolist()
        for time_ns, values in zip(times, table[cycle:cycle_end].tolist(), strict=True):
            recorder.cycle(time_ns, values)
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
