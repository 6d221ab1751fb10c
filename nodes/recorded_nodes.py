"""The nodes of a recording as one device that sends their recorded frames again, to a running master.

Sans-IO: time is an argument. Every recorded frame of a node follows a frame of the master: an SDO response its
request, any other the last NMT command or SYNC before it. It is sent as long after that frame as it was in the
recording. So a master may start at any time, and receives the recorded answers as long as it sends the recorded
commands.
"""

from collections import Counter, deque
from collections.abc import Sequence
from heapq import heappop, heappush
from typing import NamedTuple

from eds.cia301 import NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID, Frame

SECOND_NS = 1_000_000_000
_ANSWERS = SDO_REQUEST_BASE - SDO_RESPONSE_BASE
_NODES = 0x80
POWER_ON = -1
"""Reference event of the frames before the first command."""

Hook = tuple[int, int]
"""COB-ID of a master's frame, and number of frames with that COB-ID before it."""


class MasterFrame(NamedTuple):
    """A frame of the master, and the time of its end."""

    time_ns: int
    frame: Frame


class OnWire(NamedTuple):
    """A recorded frame with the times of its first and last bit on the wire, ns."""

    start_ns: int
    end_ns: int
    frame: Frame


class RecordedNodes:
    """Device that sends the recorded frames of all nodes, each in answer to the master's frame that preceded it.

    `frames` are the nodes' recorded frames, without error frames; `masters` are the COB-IDs that the master sends.
    `heard` collects the master's present frames; `left` counts recorded frames that have not been sent yet.
    """

    def __init__(self, frames: Sequence[OnWire], masters: frozenset[int]) -> None:
        self.node_id = 1
        self.filters = masters
        self.outbox: deque[Frame] = deque()
        self.heard: list[MasterFrame] = []
        self.left = 0
        self.last_ns = 0
        self._counts: Counter[int] = Counter()
        self._hung = self._hang(sorted(frames, key=lambda row: row.end_ns))
        self._due: list[tuple[int, int, Frame]] = []
        self._serial = 0

    def _hang(self, frames: Sequence[OnWire]) -> dict[Hook, list[tuple[int, Frame]]]:
        """Return the nodes' frames by the master's frame that they follow, with the time from its end to their start.
        """
        counts: Counter[int] = Counter()
        began = frames[0].end_ns // SECOND_NS * SECOND_NS if frames else 0
        last: tuple[Hook, int] = (POWER_ON, 0), began
        requests: dict[int, tuple[Hook, int]] = {}
        hung: dict[Hook, list[tuple[int, Frame]]] = {}
        for start_ns, frame_end_ns, frame in frames:
            can_id = frame.can_id
            if can_id in self.filters:
                hook = (can_id, counts[can_id]), frame_end_ns
                counts[can_id] += 1
                if can_id in (NMT_COB_ID, SYNC_COB_ID):
                    last = hook
                elif can_id >= SDO_REQUEST_BASE:
                    requests[can_id] = hook
                continue
            responds = SDO_RESPONSE_BASE <= can_id < SDO_RESPONSE_BASE + _NODES
            what, end_ns = requests.get(can_id + _ANSWERS, last) if responds else last
            hung.setdefault(what, []).append((max(0, start_ns - end_ns), frame))
            self.left += 1
        return hung

    def power_on(self, now_ns: int) -> None:
        """Send the frames recorded before any command."""
        self._release((POWER_ON, 0), now_ns)

    def _release(self, hook: Hook, now_ns: int) -> None:
        for delay_ns, frame in self._hung.pop(hook, ()):
            heappush(self._due, (now_ns + delay_ns, self._serial, frame))
            self._serial += 1

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Receive a frame of the master."""
        self.heard.append(MasterFrame(now_ns, frame))
        self.last_ns = now_ns
        can_id = frame.can_id
        self._release((can_id, self._counts[can_id]), now_ns)
        self._counts[can_id] += 1

    def poll(self, now_ns: int) -> None:
        """Send the frames that are due."""
        due = self._due
        while due and due[0][0] <= now_ns:
            self.outbox.append(heappop(due)[2])
            self.left -= 1

    def next_ns(self) -> int | None:
        """Return the time of the next frame."""
        return self._due[0][0] if self._due else None

    def bus_off(self, now_ns: int) -> None:
        """Ignore bus-off: a recording has no fault confinement."""

    def bus_recovered(self, now_ns: int) -> None:
        """Ignore the end of bus-off."""
