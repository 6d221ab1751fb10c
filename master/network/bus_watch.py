"""Foreign frames on the bench's bus: frames of neither the master nor a node.

On most interfaces the master's socket never receives the master's own frames, so a command received there comes from
another program, possibly on this computer. Some interfaces (UDP multicast) return every frame to its sender. There a
frame equal to one of those sent last counts as the master's own, and a foreign SYNC or heartbeat of the master cannot
be detected. Each kind is logged once, with its number of repetitions. Nothing here reacts: `moves` marks frames that
can move something.
"""

from collections import deque
from collections.abc import Mapping
from typing import Final, NamedTuple

import can

from eds.bench.bench_network import MASTER, MONITOR, WireLayout
from eds.cia301 import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    TPDO_BASE,
    NmtCommand,
)

SDO_REQUEST_BASE: Final = 0x600
LSS: Final = 0x7E5
NS: Final = 1_000_000_000
FLOOD_NS: Final = 10_000_000
FLOOD: Final = 20
"""Foreign frames within `FLOOD_NS` from which on they count as a babbler: two in each millisecond."""
STREAM_NS: Final = 1_000_000_000
STREAM: Final = 500
"""Foreign frames within a second that count as a babbler: half of the cycles of 1 kHz, ten times a monitor's SDO
requests."""
DOUBLED: Final = 3
"""Cycles with a doubled SYNC or input within the last `DOUBLED_WITHIN` that show another sender."""
DOUBLED_WITHIN: Final = 20
RETURNED: Final = 64
"""Number of the last sent frames with which a returned frame is compared: more than a burst of a bring-up."""
EXTENDED: Final = 1 << 29
"""Key of all extended identifiers in `BusWatch.counts`: beyond the largest of them, so that their counts are one."""
_WRITES: Final = {0: "a segment of an SDO write", 1: "an SDO write", 6: "an SDO block write", 4: "an SDO abort"}
_DIRECTIONS: Final[Mapping[int, str]] = {int(command): command.name.replace("_", " ") for command in NmtCommand}


class Stranger(NamedTuple):
    """One kind of foreign frame: time of the first, its meaning in words, and whether it can move anything."""

    time_ns: int
    can_id: int
    text: str
    moves: bool


class BusWatch:
    """Watch over frames that belong to no node of the link; `found` holds those not logged yet.

    `returned`: the interface returns the master's own frames to it. `own` are the COB-IDs of frames that only the
    master sends, with the last payload. A frame that the wire doubled is therefore not taken for another master's.
    """

    def __init__(self, wire: WireLayout, returned: bool = False) -> None:
        self._returned: deque[tuple[int, bytes]] | None = deque(maxlen=RETURNED) if returned else None
        self.found: deque[Stranger] = deque()
        self._targets = frozenset(plan.cob_id for plan in wire.target_frames)
        self.own: dict[int, bytes] = dict.fromkeys(
            [plan.cob_id for plan in (*wire.target_frames, *wire.controlword_frames)], b"")
        self.flooded = False
        self._marked = False  # a SYNC came back marked as the master's own: an unmarked one is somebody else's
        self.counts: dict[int, int] = {}
        self._names = {node: entry.name for node, entry in wire.nodes.items()}
        self._quiet = frozenset(wire.tpdo)
        self._nodes = frozenset(
            base + node for node in wire.nodes for base in (HEARTBEAT_BASE, EMCY_BASE, SDO_RESPONSE_BASE))
        if MONITOR not in wire.nodes:
            self._nodes |= {base + MONITOR for base in (HEARTBEAT_BASE, EMCY_BASE, TPDO_BASE)}
        self._recent: deque[int] = deque(maxlen=STREAM)
        self._doubled: deque[int] = deque(maxlen=DOUBLED)
        self._reported: set[str] = set()

    def sent(self, can_id: int, data: bytes) -> None:
        """Remember a frame that the master is about to send."""
        if self._returned is not None:
            self._returned.append((can_id, bytes(data)))
        if can_id in self.own:
            self.own[can_id] = data

    def hear(self, message: can.Message, paced: bool) -> None:
        """Classify one received frame; `paced`: the master sends SYNC itself, and never receives it."""
        can_id = message.arbitration_id
        if can_id in self._quiet and not (message.is_extended_id or message.is_remote_frame):
            return
        time_ns = stamp_ns(message)
        if message.is_extended_id or message.is_remote_frame:
            self._count(EXTENDED if message.is_extended_id else can_id, time_ns)
            kind = "remote" if message.is_remote_frame else "extended"
            self._tell(time_ns, can_id, f"{kind} frame {can_id:X}h, which nobody here owns", moves=False, kind=kind)
            return
        if can_id in self._nodes or (self._returned is not None and self._is_own(can_id, bytes(message.data))):
            return
        if can_id == SYNC_COB_ID:
            self._marked = self._marked or not message.is_rx
            if (message.is_rx and self._marked) or paced:
                self._tell(time_ns, can_id, "SYNC from somebody else", moves=True)
            return
        self._count(can_id, time_ns)
        if can_id in self.own:
            self._commanded(time_ns, can_id, bytes(message.data))
        else:
            text, moves, kind = self._described(can_id, bytes(message.data))
            self._tell(time_ns, can_id, text, moves, kind)

    def _is_own(self, can_id: int, data: bytes) -> bool:
        """Whether a frame on an interface that returns the master's frames is, or may be, the master's own."""
        if can_id in (SYNC_COB_ID, HEARTBEAT_BASE + MASTER):
            return True
        assert self._returned is not None
        return (can_id, data) in self._returned

    def doubled(self, time_ns: int, cycle: int, what: str) -> None:
        """Report a SYNC or an input that came twice in a cycle: an event, and a stop if it repeats."""
        if self._doubled and self._doubled[-1] == cycle:
            return
        self._doubled.append(cycle)
        often = len(self._doubled) == DOUBLED and cycle - self._doubled[0] < DOUBLED_WITHIN
        self._tell(time_ns, 0, f"{what} twice in a cycle" + (f", {DOUBLED} times within {DOUBLED_WITHIN} cycles"
                                                            if often else ""), moves=often)

    def _commanded(self, time_ns: int, can_id: int, data: bytes) -> None:
        if data == self.own[can_id]:
            self._tell(time_ns, can_id, f"{can_id:X}h, as the master sent it, a second time", moves=False)
        else:
            what = "targets" if can_id in self._targets else "controlwords"
            self._tell(time_ns, can_id, f"{what} ({can_id:X}h) from another master", moves=True)

    def _described(self, can_id: int, data: bytes) -> tuple[str, bool, str]:
        """Return a frame's meaning in words, whether it can move anything, and the kind that is logged once ("": the
        words)."""
        if can_id == NMT_COB_ID:
            command = _DIRECTIONS.get(data[0], f"{data[0]:02X}h") if data else "empty"
            node = data[1] if len(data) > 1 else 0
            whom = "all nodes" if node == 0 else self._names.get(node, f"node {node}")
            return f"NMT {command} to {whom} from another master", True, ""
        node = can_id & 0x7F
        if can_id - node == SDO_REQUEST_BASE and node in self._names:
            write = _WRITES.get(data[0] >> 5) if data else None
            at = f" of {int.from_bytes(data[1:3], 'little'):04X}:{data[3]:02X}" if len(data) >= 4 else ""
            text = f"{write or 'an SDO read'}{at} to {self._names[node]} from somebody else"
            return text, write is not None, "" if write else f"SDO read {node}"
        if can_id == HEARTBEAT_BASE + MASTER:
            return f"heartbeat of another master (node {MASTER})", True, ""
        if can_id == LSS:
            return "LSS command from somebody else", True, ""
        if can_id > HEARTBEAT_BASE and can_id < HEARTBEAT_BASE + 0x80:
            return f"heartbeat of node {node}, which is none of this bench", False, ""
        return f"identifier {can_id:X}h, which nobody here owns", False, "unknown"

    def _count(self, can_id: int, time_ns: int) -> None:
        self.counts[can_id] = self.counts.get(can_id, 0) + 1
        self._recent.append(time_ns)
        for frames, within_ns in ((FLOOD, FLOOD_NS), (STREAM, STREAM_NS)):
            if self.flooded or len(self._recent) < frames or time_ns - self._recent[-frames] > within_ns:
                continue
            self.flooded = True
            most = max(self.counts, key=self.counts.__getitem__)
            span_ms = (time_ns - self._recent[-frames]) / 1e6
            self._tell(time_ns, most, f"babbler: {frames} frames that are nobody's within {span_ms:.1f} ms, most of "
                                      f"them {_shown(most)}", moves=True)

    def _tell(self, time_ns: int, can_id: int, text: str, moves: bool, kind: str = "") -> None:
        if (kind or text) not in self._reported:
            self._reported.add(kind or text)
            self.found.append(Stranger(time_ns, can_id, text, moves))

    def summary(self) -> list[str]:
        """Return the number of frames of each identifier that was logged once, the most frequent first."""
        often = sorted(((count, can_id) for can_id, count in self.counts.items() if count > 1), reverse=True)
        return [f"{_shown(can_id)} came {count} times" for count, can_id in often[:8]]


def _shown(can_id: int) -> str:
    return "extended identifiers" if can_id == EXTENDED else f"{can_id:X}h"


def stamp_ns(message: can.Message) -> int:
    """Return the time stamp of a message, ns: exact if the bus gives `time_ns`, else its float seconds rounded."""
    exact: int | None = getattr(message, "time_ns", None)
    return round(message.timestamp * NS) if exact is None else exact
