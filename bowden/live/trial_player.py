"""A recorded trial played into a live page, with the controls of the page.

The page's threads only change the playback, under the lock; messages are added by `look` alone.
"""

import threading
from collections.abc import Callable
from typing import Final

import numpy as np

from bowden.live.state import FORCES, ROW_NS, WINDOW_S, LiveState
from trial.playback import Playback, PlayerControl, PlayerStatus, ready
from trial.read import Trial
from trial.signals import of_paths

STATUS: Final = {PlayerStatus.READY: "waiting", PlayerStatus.PLAYING: "running", PlayerStatus.PAUSED: "paused",
                 PlayerStatus.ENDED: "ended"}
PLAYED: Final = "the recording has been played"


class TrialPlayer:
    """Player of a trial: `clock` in ns, the content goes to `shown`; begins when somebody watches."""

    def __init__(self, recorded: Trial, speed: float, clock: Callable[[], int], shown: LiveState) -> None:
        self._shown, self._clock, self._lock, self._sought = shown, clock, threading.Lock(), False
        self._frames = recorded.frames[np.argsort(recorded.frames["time_ns"], kind="stable")]
        self._events = sorted(recorded.events, key=lambda event: event.time_ns)
        missing = np.full(len(recorded.time_ns), np.nan)
        self._forces = np.column_stack([recorded.columns.get(name, missing) for name in of_paths(shown.paths, FORCES)])
        self._times = (recorded.time_ns, np.ascontiguousarray(self._frames["time_ns"]),
                       np.array([event.time_ns for event in self._events], np.int64))
        ends = [int(times[place]) for times in self._times if len(times) for place in (0, -1)]
        self._playback = ready(min(ends, default=0), max(ends, default=0), clock(), speed)
        shown.first_ns = self._playback.first_ns
        self._tell()

    def request(self, control: PlayerControl, speed: float | None, at_s: float | None) -> None:
        """Apply a request of the page's controls; `at_s`: position after the beginning, s.  From any thread."""
        seek_ns = None if at_s is None else self._playback.first_ns + round(min(max(at_s, 0.0), 1e9) * 1e9)
        with self._lock:
            self._sought = self._sought or seek_ns is not None
            self._playback = self._playback.told(self._clock(), control, speed=speed, seek_ns=seek_ns)

    def look(self) -> None:
        """Add the messages that are due; after a seek also those of the window before the position."""
        with self._lock:
            clock = self._clock()
            if self._shown.watchers:
                self._playback = self._playback.watched(clock)
            before, sought, self._sought = self._playback, self._sought, False
            self._playback = now = before.advanced(clock)
        if sought:
            self._shown.begin_again()
        self._add(before.at_ns - sought * round(WINDOW_S * 1e9), now.at_ns)
        self._tell()

    def _add(self, first_ns: int, end_ns: int) -> None:
        """Add what was recorded from `first_ns` up to, not including, `end_ns`; forces as densely as a page shows."""
        rows, frames, events = (slice(*np.searchsorted(times, (first_ns, end_ns)).tolist()) for times in self._times)
        times = self._times[0][rows]
        shown = np.diff(times // ROW_NS, prepend=-1) != 0
        for at, forces in zip(times[shown].tolist(), self._forces[rows][shown].tolist(), strict=True):
            self._shown.force(at, *forces)
        if frames.stop > frames.start:
            self._shown.frames(self._frames[frames].tobytes())
        for event in self._events[events]:
            self._shown.event(*event)

    def _tell(self) -> None:
        """Show the position, and the status where it has changed."""
        playback: Playback = self._playback
        self._shown.player = {
            "at_s": (min(playback.at_ns, playback.last_ns) - playback.first_ns) * 1e-9,
            "length_s": (playback.last_ns - playback.first_ns) * 1e-9, "speed": playback.speed}
        status = STATUS[playback.status]
        if status != self._shown.present_status:
            self._shown.digest()
            self._shown.status(status, PLAYED if status == "ended" else "")
