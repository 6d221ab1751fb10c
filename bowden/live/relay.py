"""A running bus in a viewer: each frame, the cycle that it ended, the event that it is.

The rule of this file: what nobody has subscribed to is not made.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from bowden.live.state import LiveState
from bowden.live.viewer import Viewer
from trial.convert.frames import rows_of
from trial.decode import events
from trial.follow import Follower
from trial.mcap_file import cdr
from trial.tape import payloads

LOOK_NS = 50_000_000  # between two times told and two looks at who has subscribed
RARE = frozenset((0x000, *range(0x081, 0x100), *range(0x701, 0x780)))
"""COB-IDs of NMT, EMCY and boot-up, which can be events."""


class Relay:
    """Relay of python-can messages, as a trial's topics, and to a page (`shown`); either may be absent."""

    def __init__(self, follower: Follower, viewer: Viewer | None, shown: LiveState | None = None) -> None:
        self._follow, self._viewer, self._shown = follower.frame, viewer, shown
        self._places = [follower.names.index(name) for name in ("tension_start_n", "tension_end_n")]
        self._row = struct.Struct(f"<IiI{len(follower.names)}d")
        self._looked_ns: int | None = None
        self._wanted: frozenset[str] = frozenset()

    def take(self, message: Any) -> None:
        """Take one message as `can.BusABC.recv` gives it; CAN FD frames are no bench's and are left out."""
        if message.is_fd:
            return
        time_ns = getattr(message, "time_ns", None) or round(message.timestamp * 1e9)
        if self._looked_ns is None or not 0 <= time_ns - self._looked_ns < LOOK_NS:
            self._looked_ns = time_ns
            if self._viewer is not None:
                self._wanted = self._viewer.wanted()
                self._viewer.time(time_ns)
        flags = (message.is_remote_frame * cdr.REMOTE | message.is_extended_id * cdr.EXTENDED
                 | message.is_error_frame * cdr.ERROR)
        if self._shown is not None:
            self._shown.frame(time_ns, message.arbitration_id, bytes(message.data), flags)
        if not flags:
            self._cycle(time_ns, message.arbitration_id, bytes(message.data))
        rare = cdr.EVENTS in self._wanted and message.arbitration_id in RARE
        if rare or cdr.FRAMES in self._wanted:
            self._frame(time_ns, message, flags)

    def _cycle(self, time_ns: int, can_id: int, data: bytes) -> None:
        done = self._follow(time_ns, can_id, data)
        if done is None:
            return
        at, values = done
        if self._shown is not None:  # no PDO carries the desired force
            self._shown.force(at, math.nan, *(values[place] for place in self._places))
        if self._viewer is not None and cdr.CYCLE in self._wanted:
            self._viewer.publish(cdr.CYCLE, self._row.pack(cdr.LITTLE_ENDIAN, *divmod(at, 1_000_000_000), *values), at)

    def _frame(self, time_ns: int, message: Any, flags: int) -> None:
        if self._viewer is None:
            return
        row = rows_of([(time_ns, message.arbitration_id, flags, min(message.dlc, 8), 0, not message.is_rx,
                        bytes(message.data))])
        if cdr.FRAMES in self._wanted:
            self._viewer.publish(cdr.FRAMES, payloads(cdr.frame_records(row, 0, 0))[0], time_ns)
        if cdr.EVENTS in self._wanted:
            for event in events(row):
                self._viewer.publish(cdr.EVENTS, cdr.event_message(*event), time_ns)
