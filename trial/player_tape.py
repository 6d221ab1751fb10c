"""A recorded trial played again: a player as a state machine, and the tape it plays.

The rule of this file: time comes in as an argument and nothing here waits or sends.  The player says which span of
the trial is due; the tape says what lies in it.  Every message of a trial played from end to end comes exactly once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr
from trial.read import Trial

LONGEST_NS = 200_000_000  # of the clock between two looks: who looks later plays slower, never in one great leap
SPEEDS = (0.001, 1000.0)


class Status(Enum):
    """Where the player stands; READY is paused until somebody watches."""

    READY = "ready"
    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "ended"


class Command(Enum):
    """What a player is told; WATCH: somebody watches."""

    PLAY = "play"
    PAUSE = "pause"
    WATCH = "watch"


TRANSITIONS: dict[tuple[Status, Command], Status] = {
    (Status.READY, Command.WATCH): Status.PLAYING,
    (Status.READY, Command.PLAY): Status.PLAYING,
    (Status.READY, Command.PAUSE): Status.PAUSED,
    (Status.PLAYING, Command.PAUSE): Status.PAUSED,
    (Status.PAUSED, Command.PLAY): Status.PLAYING,
    (Status.ENDED, Command.PLAY): Status.PLAYING,
    (Status.ENDED, Command.PAUSE): Status.PAUSED,
}
"""(status, command): status; what is not here changes nothing."""


@dataclass(frozen=True)
class Playback:
    """A player of the span `first_ns` … `last_ns`, both included; everything before `at_ns` has been played.

    `origin_ns` was played at `origin_clock_ns` of the clock handed in, whose last reading was `clock_ns`.
    """

    first_ns: int
    last_ns: int
    at_ns: int
    clock_ns: int
    origin_ns: int
    origin_clock_ns: int
    status: Status = Status.READY
    speed: float = 1.0

    def advanced(self, clock_ns: int) -> Playback:
        """Return the player at a later reading of the clock; what is due is in `self.at_ns` … `.at_ns`, without it."""
        late = max(0, clock_ns - self.clock_ns - LONGEST_NS)
        clock = replace(self, clock_ns=clock_ns, origin_clock_ns=self.origin_clock_ns + late)
        if self.status is not Status.PLAYING:
            return clock
        at = self.origin_ns + round((clock_ns - clock.origin_clock_ns) * self.speed)
        if at > self.last_ns:
            return replace(clock, at_ns=self.last_ns + 1, status=Status.ENDED)
        return replace(clock, at_ns=max(at, self.at_ns))

    def watched(self, clock_ns: int) -> Playback:
        """Return the player when somebody watches: READY begins, any other goes on undisturbed."""
        return self.told(clock_ns, Command.WATCH) if (self.status, Command.WATCH) in TRANSITIONS else self

    def told(
        self, clock_ns: int, command: Command, *, speed: float | None = None, seek_ns: int | None = None
    ) -> Playback:
        """Return the player after a command; a seek is held inside the trial, a speed between 0.001 and 1000.

        It goes on from `at_ns`: what the clock has counted since the last look does not count.  An end that is
        played on begins again.
        """
        status = TRANSITIONS.get((self.status, command), self.status)
        at = self.at_ns
        if seek_ns is not None:
            at = min(max(seek_ns, self.first_ns), self.last_ns)
        elif status is Status.PLAYING and at > self.last_ns:
            at = self.first_ns
        faster = self.speed if speed is None or not math.isfinite(speed) or speed <= 0 else speed
        return replace(self, status=status, at_ns=at, origin_ns=at, clock_ns=clock_ns, origin_clock_ns=clock_ns,
                       speed=min(max(faster, SPEEDS[0]), SPEEDS[1]))


def player(first_ns: int, last_ns: int, clock_ns: int, speed: float = 1.0) -> Playback:
    """Return a player at the start of a trial, READY."""
    return Playback(first_ns, last_ns, first_ns, clock_ns, first_ns, clock_ns, speed=speed)


class Message(NamedTuple):
    """One message as it is recorded: topic and CDR payload."""

    time_ns: int
    topic: str
    payload: bytes


class Tape:
    """The messages of a trial by time; `first_ns` … `last_ns` holds all of them."""

    def __init__(self, trial: Trial) -> None:
        frames = trial.frames
        if (np.diff(frames["time_ns"]) < 0).any():  # logged out of order
            frames = frames[np.argsort(frames["time_ns"], kind="stable")]
        self._frames, self._columns = frames, list(trial.columns.values())
        self._events = sorted(trial.events, key=lambda event: event.time_ns)
        self._times: dict[str, NDArray[np.int64]] = {
            cdr.CYCLE: trial.time_ns, cdr.FRAMES: np.ascontiguousarray(frames["time_ns"]),
            cdr.EVENTS: np.array([event.time_ns for event in self._events], np.int64)}
        ends = [int(times[place]) for times in self._times.values() if len(times) for place in (0, -1)]
        self.first_ns, self.last_ns = min(ends, default=0), max(ends, default=0)

    def between(self, first_ns: int, end_ns: int, topics: frozenset[str]) -> list[Message]:
        """Return the messages of `topics` from `first_ns` up to, not including, `end_ns`, oldest first."""
        found = [message for topic in sorted(topics)
                 for message in self._rows(topic, *self._span(topic, first_ns, end_ns))]
        found.sort(key=lambda message: message.time_ns)
        return found

    def latest(self, at_ns: int, topics: frozenset[str]) -> list[Message]:
        """Return the last message of each of `topics` before `at_ns`: what a viewer shows after a seek."""
        found: list[Message] = []
        for topic in sorted(topics):
            _, end = self._span(topic, self.first_ns, at_ns)
            found += self._rows(topic, max(end - 1, 0), end)
        return found

    def _span(self, topic: str, first_ns: int, end_ns: int) -> tuple[int, int]:
        first, end = np.searchsorted(self._times[topic], (first_ns, end_ns))
        return int(first), int(end)

    def _rows(self, topic: str, first: int, end: int) -> Iterator[Message]:
        if topic == cdr.EVENTS:
            for event in self._events[first:end]:
                yield Message(event.time_ns, topic, cdr.event_message(*event))
            return
        times = self._times[topic][first:end].tolist()
        yield from map(Message, times, [topic] * len(times), self._payloads(topic, first, end))

    def _payloads(self, topic: str, first: int, end: int) -> list[bytes]:
        if topic == cdr.FRAMES:
            return payloads(cdr.frame_records(self._frames[first:end], 0, 0))
        rows = np.empty(end - first, [("time_ns", "<i8"), ("values", "<f8", (len(self._columns),))])
        rows["time_ns"] = self._times[topic][first:end]
        for place, column in enumerate(self._columns):
            rows["values"][:, place] = column[first:end]
        return payloads(cdr.cycle_records(rows, 0, 0))


def payloads(records: NDArray[np.void]) -> list[bytes]:
    """Return the CDR payloads of message records."""
    size, head = records.dtype.itemsize, cdr.MESSAGE_HEAD.size
    data = records.tobytes()
    return [data[at + head:at + size] for at in range(0, len(data), size)]
