"""The nodes of a recorded trial as one device that sends their recorded frames again, to a running master.

The rule of this file: sans-IO, time goes in.  Every recorded frame of a node follows a frame of the master: an SDO
response its request, any other the last NMT command or SYNC before it.  It is sent as long after that frame as it was
in the recording.  So a master may start at any time, and hears the recorded answers as long as it sends what the
recorded master sent.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bowden.replay.comparison import Comparison
from bowden.replay.schedule import Rows, frame_of
from eds.cia301 import NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID
from eds.frame import Frame
from trial.mcap_file import cdr

SECOND_NS = 1_000_000_000
_ANSWERS = SDO_REQUEST_BASE - SDO_RESPONSE_BASE
_NODES = 0x80
POWER_ON = -1
"""What the frames ahead of the first command hang on."""

Hook = tuple[int, int]
"""COB-ID of a master's frame and how many of it came before."""


class Heard(NamedTuple):
    """A frame of the master and when it ended."""

    time_ns: int
    frame: Frame


class RecordedNodes:
    """All nodes of a trial, as one device (see `nodes` in docs/architecture.md); `heard` is what the master said.

    `starts_ns` are the times at which the frames' first bits were on the wire; `masters` are the COB-IDs of the master.
    """

    def __init__(self, frames: Rows, starts_ns: NDArray[np.int64], masters: frozenset[int]) -> None:
        self.node_id = 1
        self.filters = masters
        self.outbox: deque[Frame] = deque()
        self.heard: list[Heard] = []
        self.left = 0
        self.last_ns = 0
        self._counts: Counter[int] = Counter()
        self._hung = self._hang(frames, starts_ns)
        self._due: list[tuple[int, int, Frame]] = []
        self._serial = 0

    def _hang(self, frames: Rows, starts_ns: NDArray[np.int64]) -> dict[Hook, list[tuple[int, Frame]]]:
        """Frames of the nodes by what they hang on, with the time from its end to their start."""
        counts: Counter[int] = Counter()
        began = int(frames["time_ns"].min()) // SECOND_NS * SECOND_NS if len(frames) else 0
        last: tuple[Hook, int] = (POWER_ON, 0), began
        requests: dict[int, tuple[Hook, int]] = {}
        hung: dict[Hook, list[tuple[int, Frame]]] = {}
        ends, ids, flags = (frames[name].tolist() for name in ("time_ns", "can_id", "flags"))
        for place in np.argsort(frames["time_ns"], kind="stable").tolist():
            can_id, start_ns = ids[place], int(starts_ns[place])
            if flags[place] & cdr.ERROR:
                continue
            if can_id in self.filters:
                hook = (can_id, counts[can_id]), ends[place]
                counts[can_id] += 1
                if can_id in (NMT_COB_ID, SYNC_COB_ID):
                    last = hook
                elif can_id >= SDO_REQUEST_BASE:
                    requests[can_id] = hook
                continue
            responds = SDO_RESPONSE_BASE <= can_id < SDO_RESPONSE_BASE + _NODES
            what, end_ns = requests.get(can_id + _ANSWERS, last) if responds else last
            hung.setdefault(what, []).append((max(0, start_ns - end_ns), frame_of(frames[place])))
            self.left += 1
        return hung

    def power_on(self, now_ns: int) -> None:
        """Say what was said before any command."""
        self._release((POWER_ON, 0), now_ns)

    def _release(self, hook: Hook, now_ns: int) -> None:
        for delay_ns, frame in self._hung.pop(hook, ()):
            heappush(self._due, (now_ns + delay_ns, self._serial, frame))
            self._serial += 1

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Hear the master."""
        self.heard.append(Heard(now_ns, frame))
        self.last_ns = now_ns
        can_id = frame.can_id
        self._release((can_id, self._counts[can_id]), now_ns)
        self._counts[can_id] += 1

    def poll(self, now_ns: int) -> None:
        """Say what is due."""
        due = self._due
        while due and due[0][0] <= now_ns:
            self.outbox.append(heappop(due)[2])
            self.left -= 1

    def next_ns(self) -> int | None:
        """When something is due."""
        return self._due[0][0] if self._due else None

    def bus_off(self, now_ns: int) -> None:
        """A recording cannot lose the bus."""

    def bus_recovered(self, now_ns: int) -> None:
        """Nor have it back."""


@dataclass(frozen=True)
class Difference:
    """The first frame that is not as recorded: which one of its COB-ID, when (s from the master's first), both."""

    cob_id: int
    number: int
    time_s: float
    recorded: str | None
    live: str | None


@dataclass(frozen=True, kw_only=True)
class MasterComparison(Comparison[Difference]):
    """What a live master sent against the recorded one: frames compared; frames that differ by COB-ID.

    `beyond` counts what it sent after the recording's end; `timing_max_us` is the largest difference in time, both
    counted from the first frame.
    """

    frames: int
    beyond: int
    timing_max_us: float


def compare(recorded: Sequence[Heard], live: Sequence[Heard]) -> MasterComparison:
    """Compare two masters COB-ID by COB-ID: the n-th frame of one with the n-th of the other."""
    one, other = _by_cob_id(recorded), _by_cob_id(live)
    differences: list[Difference] = []
    late_ns = 0
    for can_id, then in one.items():
        now = other.get(can_id, [])
        for number, (time_ns, payload) in enumerate(then):
            answered = now[number] if number < len(now) else None
            if answered is None or answered[1] != payload:
                differences.append(Difference(can_id, number, time_ns / 1e9, payload, answered and answered[1]))
            if answered is not None:
                late_ns = max(late_ns, abs(answered[0] - time_ns))
    end_ns = max((then[-1][0] for then in one.values()), default=0)
    beyond = 0
    for can_id, now in other.items():
        for number in range(len(one.get(can_id, ())), len(now)):
            time_ns, payload = now[number]
            beyond += time_ns > end_ns
            if time_ns <= end_ns:
                differences.append(Difference(can_id, number, time_ns / 1e9, None, payload))
    counted = Counter(f"{difference.cob_id:03X}" for difference in differences)
    first = min(differences, key=lambda difference: difference.time_s, default=None)
    return MasterComparison(frames=len(recorded), beyond=beyond, timing_max_us=late_ns / 1e3,
                            differing=dict(sorted(counted.items())), first=first)


def _by_cob_id(heard: Sequence[Heard]) -> dict[int, list[tuple[int, str]]]:
    """Time from the first frame, ns, and payload of each frame."""
    found: dict[int, list[tuple[int, str]]] = {}
    for time_ns, frame in heard:
        found.setdefault(frame.can_id, []).append((time_ns - heard[0].time_ns, frame.data.hex(" ")))
    return found


def said(frames: Rows, masters: frozenset[int]) -> list[Heard]:
    """The master's frames of a recording."""
    chosen = frames[np.isin(frames["can_id"], list(masters)) & (frames["flags"] & cdr.ERROR == 0)]
    return [Heard(int(row["time_ns"]), frame_of(row)) for row in chosen]
