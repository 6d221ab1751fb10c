"""State of a played recording: position on one time axis, and one table of states for pause, step and seek.

Time is an argument; nothing here waits or sends. Positions are ns of the recording, clock readings are ns of the
caller's clock. The live view (`bowden.live`) and the replay onto a bus (`bowden.replay.player`) share it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from types import MappingProxyType
from typing import Final

LONGEST_NS = 200_000_000
"""Longest clock time, ns, by which one look advances the playback: after a longer pause it plays slower and does not
leap."""
SPEEDS = (0.001, 1000.0)


class PlayerStatus(Enum):
    """State of a player; READY is paused at the start, until a viewer opens or plays."""

    READY = "ready"
    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "ended"


class PlayerControl(Enum):
    """Command to a player; WATCH: a viewer has opened; END comes from the recording itself."""

    PLAY = "play"
    PAUSE = "pause"
    STEP = "step"
    SEEK = "seek"
    WATCH = "watch"
    END = "end"


_S, _C = PlayerStatus, PlayerControl
TRANSITIONS: Final = MappingProxyType({
    (_S.READY, _C.PLAY): _S.PLAYING,
    (_S.READY, _C.PAUSE): _S.PAUSED,
    (_S.READY, _C.STEP): _S.PAUSED,
    (_S.READY, _C.SEEK): _S.PAUSED,
    (_S.READY, _C.WATCH): _S.PLAYING,
    (_S.PLAYING, _C.PAUSE): _S.PAUSED,
    (_S.PLAYING, _C.STEP): _S.PAUSED,
    (_S.PLAYING, _C.SEEK): _S.PLAYING,
    (_S.PLAYING, _C.END): _S.ENDED,
    (_S.PAUSED, _C.PLAY): _S.PLAYING,
    (_S.PAUSED, _C.STEP): _S.PAUSED,
    (_S.PAUSED, _C.SEEK): _S.PAUSED,
    (_S.PAUSED, _C.END): _S.ENDED,
    (_S.ENDED, _C.PLAY): _S.PLAYING,
    (_S.ENDED, _C.PAUSE): _S.PAUSED,
    (_S.ENDED, _C.SEEK): _S.PAUSED,
})
"""(status, control) → status; a control without a row changes nothing.  PLAY after the end begins again."""


@dataclass(frozen=True)
class Playback:
    """The span `first_ns` … `last_ns` of a recording, both included, while it is played.

    Position `origin_ns` was played at `origin_clock_ns` of the clock.  For a viewer, which looks now and then:
    everything before `at_ns` has been shown, and the clock's last reading was `clock_ns`.
    """

    first_ns: int
    last_ns: int
    at_ns: int
    clock_ns: int
    origin_ns: int
    origin_clock_ns: int
    status: PlayerStatus = PlayerStatus.READY
    speed: float = 1.0

    def position_ns(self, clock_ns: int) -> int:
        """Return the position at that reading of the clock, at most the last one."""
        if self.status is not PlayerStatus.PLAYING:
            return self.origin_ns
        return min(self.origin_ns + round((clock_ns - self.origin_clock_ns) * self.speed), self.last_ns)

    def due_ns(self, position_ns: int) -> int:
        """Return the reading of the clock at which a position is played; now where it has been passed."""
        return self.origin_clock_ns + round(max(0, position_ns - self.origin_ns) / self.speed)

    def advanced(self, clock_ns: int) -> Playback:
        """Return the playback at a later clock reading; messages in `self.at_ns` … `.at_ns` are due, the latter
        excluded."""
        late = max(0, clock_ns - self.clock_ns - LONGEST_NS)
        clock = replace(self, clock_ns=clock_ns, origin_clock_ns=self.origin_clock_ns + late)
        if self.status is not PlayerStatus.PLAYING:
            return clock
        at = self.origin_ns + round((clock_ns - clock.origin_clock_ns) * self.speed)
        if at > self.last_ns:
            return replace(clock, at_ns=self.last_ns + 1, origin_ns=self.last_ns,
                           status=TRANSITIONS[self.status, PlayerControl.END])
        return replace(clock, at_ns=max(at, self.at_ns))

    def at(self, position_ns: int, clock_ns: int) -> Playback:
        """Return the playback moved to a position at that clock reading; the status stays."""
        return replace(self, at_ns=position_ns, origin_ns=position_ns, clock_ns=clock_ns, origin_clock_ns=clock_ns)

    def watched(self, clock_ns: int) -> Playback:
        """Return the playback with a viewer present: READY starts, every other status stays."""
        starts = (self.status, PlayerControl.WATCH) in TRANSITIONS
        return self.commanded(clock_ns, PlayerControl.WATCH) if starts else self

    def commanded(
        self, clock_ns: int, control: PlayerControl, *, speed: float | None = None, seek_ns: int | None = None
    ) -> Playback:
        """Return the playback after a command; a seek is limited to the recording, a speed to 0.001 … 1000.

        Playing goes on from `at_ns`: clock time since the last look does not count. PLAY at the end begins again.
        """
        status = TRANSITIONS.get((self.status, control), self.status)
        at = self.at_ns
        if seek_ns is not None:
            at = min(max(seek_ns, self.first_ns), self.last_ns)
        elif status is PlayerStatus.PLAYING and (at > self.last_ns or self.status is PlayerStatus.ENDED):
            at = self.first_ns
        faster = self.speed if speed is None or not math.isfinite(speed) or speed <= 0 else speed
        held = min(max(faster, SPEEDS[0]), SPEEDS[1])
        return replace(self.at(at, clock_ns), status=status, speed=held)


def ready(first_ns: int, last_ns: int, clock_ns: int, speed: float = 1.0) -> Playback:
    """Return the playback of that span at its start, READY."""
    return Playback(first_ns, last_ns, first_ns, clock_ns, first_ns, clock_ns, speed=speed)
