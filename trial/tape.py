"""Messages of a recorded trial by time, for a player.

The player asks for a time span; the tape returns the messages in it. Every message of a trial played from end to end
comes exactly once.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr
from trial.read import Trial


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
        """Return the last message of each of `topics` before `at_ns`: a viewer's content after a seek."""
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
