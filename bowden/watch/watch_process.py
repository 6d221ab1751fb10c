"""A watch in a separate process, and the recorder that receives from it: on hardware the control cycle never waits.

The watch reads the file that the recorder writes; the processes exchange only words. On a simulated bench the trial
waits at each gait cycle for the watch, so that a stop comes at the same row in every run.
"""

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from bowden.child_processes import unsignalled
from bowden.watch import file_watch
from bowden.watch.file_watch import LOOK_S, FileWatch, WatchedBench
from master.cycle.run_safely import stop_button
from parameters import InputError

HEAR_ROWS: Final = 100
"""Rows between two looks for a word of the watch: a tenth of a second at 1 kHz."""
NICE: Final = 5
"""Niceness added to the watch, so that the trial has priority."""
READY, CYCLE_DONE, STEP, END, DIAGNOSIS, REFUSED = "ready", "cycle", "step", "end", "diagnosis", "refused"


def run(path: Path, bench: WatchedBench, words: Connection, shown: bool) -> None:
    """Watch until the trial has ended, in this process; `words`: to and from the trial."""
    with contextlib.suppress(OSError, AttributeError):  # Windows has no niceness
        os.nice(NICE)
    with contextlib.suppress(BrokenPipeError, EOFError, KeyboardInterrupt):
        with contextlib.suppress(AttributeError):  # blocked until here
            signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
        try:
            watch = FileWatch(path, bench, replaced=True)
            words.send((READY, None))
            _follow(watch, words, shown)
            words.send((DIAGNOSIS, file_watch.as_json(watch.diagnosis())))
        except InputError as error:
            words.send((REFUSED, str(error)))


def _follow(watch: FileWatch, words: Connection, shown: bool) -> None:
    """Read the file whenever it may have grown, until the trial reports its end."""
    asked = None
    while asked != END:
        asked = words.recv() if words.poll(LOOK_S) else None
        for found in watch.look(last=asked == END):
            if shown:
                print(f"bowden: {watch.told(found)}", file=sys.stderr, flush=True)
            words.send((CYCLE_DONE, found.as_json() | {"stop": watch.stops(found), "told": watch.told(found)}))
        if asked == STEP:
            words.send((STEP, None))


class TrialWatch:
    """The watch of a trial that this process runs: `beside` is its recorder; `cycles`: the suspicion after each.

    `paced`: the trial waits for the watch at each gait cycle, whose number is at `place` in a row. `stop` requests the
    safe stop; `show`, if set, receives each suspicion as a sentence.
    """

    def __init__(self, words: Connection, paced: bool, stop: Callable[[], None], place: int) -> None:
        self._words, self.paced, self._stop, self.place = words, paced, stop, place
        self.show: Callable[[str], None] | None = None
        self.cycles: list[dict[str, Any]] = []
        self.diagnosis: dict[str, Any] | None = None
        self.lost = ""
        self.stopped_by = ""

    def beside(self, recording: Any) -> Any:
        """Return a recorder that also hears the watch."""
        return _HearingRecorder(recording, self)

    def ended(self, sentence: str) -> None:
        """Report to the watch that the trial has ended."""
        self.say(END)

    def say(self, word: str) -> None:
        """Send a word to the watch process, if it still runs."""
        with contextlib.suppress(BrokenPipeError, OSError):
            self._words.send(word)

    def hear(self, until: str | None) -> None:
        """Receive the messages of the watch; `until`: wait for that word, None: wait for nothing."""
        try:
            while not self.lost and (until is not None or self._words.poll()):
                word, content = self._words.recv()
                self._take(word, content)
                if word in (until, REFUSED):
                    return
        except (EOFError, OSError):
            self.lost = self.lost or "the watch has ended before the trial; the trial is not touched by that."

    def conclude(self) -> None:
        """Wait for the diagnosis of the whole trial."""
        self.hear(DIAGNOSIS)

    def _take(self, word: str, content: Any) -> None:
        if word == CYCLE_DONE:
            self.cycles.append({k: v for k, v in content.items() if k not in ("told", "stop")})
            if self.show is not None:
                self.show(content["told"])
            if content["stop"] and not self.stopped_by:
                self.stopped_by = content["told"]
                self._stop()
        elif word == DIAGNOSIS:
            self.diagnosis = content
        elif word == REFUSED:
            self.lost = content

    def as_json(self) -> dict[str, Any]:
        """Return the suspicion after each cycle, the diagnosis of the complete trial, and the reason if it is
        missing."""
        return {"cycles": self.cycles, "stopped_by": self.stopped_by or None, "diagnosis": self.diagnosis,
                "remark": self.lost or None}


class _HearingRecorder:
    """A trial's recorder that looks for words of the watch between two rows, the recording first."""

    def __init__(self, recording: Any, watch: TrialWatch) -> None:
        self.frame, self.frames, self.event = recording.frame, recording.frames, recording.event
        self._record, self._watch = recording.cycle, watch
        self._rows, self._number, self._told_stop = 0, -1.0, False

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle."""
        self._record(time_ns, values)
        watch = self._watch
        if watch.paced:
            if values[watch.place] <= self._number:
                return
            self._number = values[watch.place]
            watch.say(STEP)
            watch.hear(STEP)
        else:
            self._rows += 1
            if self._rows % HEAR_ROWS:
                return
            watch.hear(None)
        if watch.stopped_by and not self._told_stop:
            self._told_stop = True
            self.event(time_ns, "stop", "master", f"safe stop requested by the watch: {watch.stopped_by}.")


@contextmanager
def beside(path: Path, bench: WatchedBench, place: int = 0, *, paced: bool, shown: bool) -> Iterator[TrialWatch]:
    """Start the watch of the file `path` and wait until it has fitted the reference trials; end it at the end.

    `place`: of the number of the gait cycle in a row; `shown`: the watch prints a line a cycle on stderr.  Raises
    `InputError` where it cannot watch.
    """
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=run, args=(path, bench, there, shown), daemon=True)
    with unsignalled():
        process.start()
    there.close()
    try:
        with stop_button() as stop:
            watch = TrialWatch(here, paced, stop, place)
            watch.hear(READY)
            if watch.lost:
                raise InputError(watch.lost)
            yield watch
    finally:
        here.close()
        process.join(LOOK_S)
        if process.is_alive():
            process.terminate()
        process.join()
