"""A trial in a viewer: the playback, the tape, and the viewer that receives due messages and sends requests.

A viewer's threads only change the playback, under the lock; messages are sent by `look` alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from bowden.live.feeds import PagedViewer
from bowden.live.viewer import PlayerRequest, Viewer
from trial.playback import Playback, ready
from trial.read import Trial
from trial.tape import Tape


class TrialPlayback:
    """A trial to be played by `clock` (ns); `units` are its columns, `span_ns` its first and last time."""

    def __init__(self, recorded: Trial, speed: float, clock: Callable[[], int]) -> None:
        self._tape, self._clock, self._lock = Tape(recorded), clock, threading.Lock()
        self.units, self.span_ns = dict(recorded.units), (self._tape.first_ns, self._tape.last_ns)
        self._playback = ready(*self.span_ns, clock(), speed)
        self._topics: frozenset[str] = frozenset()
        self._sought = False

    def asked(self, asked: PlayerRequest) -> Playback:
        """Apply a request of a viewer's controls; return the playback after it."""
        with self._lock:
            self._sought = self._sought or asked.seek_ns is not None
            self._playback = self._playback.told(
                self._clock(), asked.control, speed=asked.speed, seek_ns=asked.seek_ns)
            return self._playback

    def look(self, viewer: Viewer | PagedViewer) -> None:
        """Send due messages, and a new status; new subscriptions and a seek also get the last message before.

        A playback that is READY begins when the subscriptions are the same at two looks: clients subscribe one by
        one.
        """
        topics = viewer.wanted()
        with self._lock:
            clock = self._clock()
            if topics and topics == self._topics:
                self._playback = self._playback.watched(clock)
            before, sought, self._sought = self._playback, self._sought, False
            self._playback = now = before.advanced(clock)
        shown = topics if sought else topics - self._topics
        self._topics = topics
        for message in self._tape.latest(before.at_ns, shown) + self._tape.between(before.at_ns, now.at_ns, topics):
            viewer.publish(message.topic, message.payload, message.time_ns)
        if now.at_ns != before.at_ns or sought:
            viewer.time(min(now.at_ns, now.last_ns))
        if now.status != before.status:
            viewer.state(now)
