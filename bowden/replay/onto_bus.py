"""Recorded frames on a bus, in their time or one by one."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any

from bowden.bench.buses import BusSettings, opened_one
from bowden.replay.player import (
    LINGER_NS,
    Lateness,
    Outlet,
    Player,
    Selection,
    ignore_message,
    plan,
    play_out,
    wait_until,
)
from eds.cia301 import Frame
from parameters import InputError
from trial.playback import PlayerStatus
from trial.read import Trial


@dataclass(frozen=True)
class PlaybackResult:
    """Result of playing: frames sent, passes begun, frames that restored the state before, frames the bus refused.

    `left_out` counts unsendable frames by kind; `lateness` is the delay of frames at the bus.
    """

    frames: int
    passes: int
    status: PlayerStatus
    restored: int
    lost: int
    left_out: Mapping[str, int]
    lateness: Lateness

    def as_json(self) -> dict[str, Any]:
        """Return the figures as values that JSON can hold."""
        return {
            "frames": self.frames, "passes": self.passes, "state": self.status.value, "restored_frames": self.restored,
            "lost_frames": self.lost, **{f"left_out_{name}": count for name, count in self.left_out.items()},
            "lateness_median_us": self.lateness.median_ns / 1e3, "lateness_p99_us": self.lateness.p99_ns / 1e3,
            "lateness_max_us": self.lateness.max_ns / 1e3}


class Playing:
    """A player on open buses; `opened` creates one."""

    def __init__(self, player: Player, bus: Any, outlet: Outlet, restored: int) -> None:
        self.player, self._bus, self._outlet, self._restored = player, bus, outlet, restored
        self.clock: Callable[[], int] = getattr(bus, "time_ns", time.monotonic_ns)

    def run(self, progress: Callable[[float], None] = lambda share: None) -> None:
        """Play to the end."""
        self.player.play(self.clock())
        play_out(self.player, self._bus, self.clock, progress=progress)

    def step(self) -> Frame | None:
        """Send the next frame regardless of its time; None at the end."""
        frame = self.player.step()
        wait_until(self._bus, self.clock, self.clock() + LINGER_NS, ignore_message)
        return frame

    def seek(self, position_ns: int) -> None:
        """Go to a position, ns of the window that is played."""
        self.player.seek(position_ns, self.clock())

    def pause(self) -> None:
        """Pause the playback."""
        self.player.pause(self.clock())

    @property
    def position_ns(self) -> int:
        """Position in the window."""
        return self.player.position_ns(self.clock())

    @property
    def ended(self) -> bool:
        """True if every frame was played."""
        return self.player.status is PlayerStatus.ENDED

    def played(self) -> PlaybackResult:
        """Return the figures so far."""
        player = self.player
        return PlaybackResult(player.sent, player.pass_ + 1, player.status, self._restored, self._outlet.lost,
                              player.schedule.left_out, player.lateness())


@contextmanager
def opened(
    recorded: Trial, selection: Selection, chosen: BusSettings, channels: Mapping[int, str] | None = None, *,
    speed: float = 1.0, loops: int = 1,
) -> Iterator[Playing]:
    """Open the buses, restore the nodes' state at the first selected frame, and yield the player of the frames.

    `channels` maps a recorded channel to a channel of `chosen`'s interface; without it one bus takes all of them.
    """
    schedule = plan(recorded.frames, selection)
    with _outlet(chosen, channels or {}) as (outlet, bus):
        player = Player(schedule, outlet.send, speed=speed, loops=loops)
        playing = Playing(player, bus, outlet, 0)
        restored = player.seek(0, playing.clock()) if selection.from_s > 0 else []
        yield Playing(player, bus, outlet, len(restored))


@contextmanager
def _outlet(chosen: BusSettings, channels: Mapping[int, str]) -> Iterator[tuple[Outlet, Any]]:
    """Return the bus of each recorded channel that is mapped; without a map one bus takes all of them."""
    with ExitStack() as stack:
        if not channels:
            bus = stack.enter_context(opened_one(chosen, chosen.arguments["bitrate"]))
            yield Outlet({}, bus), bus
            return
        named = {
            name: stack.enter_context(opened_one(
                replace(chosen, arguments={**chosen.arguments, "channel": name}), chosen.arguments["bitrate"]))
            for name in dict.fromkeys(channels.values())
        }
        yield Outlet({number: named[name] for number, name in channels.items()}), next(iter(named.values()))


def own_direction(recorded: Trial) -> str:
    """Return the direction to play onto the simulated bench, whose nodes send their own frames: tx.

    Raises `InputError` if the recorder sent nothing.
    """
    frames = recorded.frames
    if len(frames) and not frames["sent"].any():
        raise InputError(f"{recorded.path}: holds no frame that its recorder sent, only received ones, and the nodes "
                         "of the simulated bench send their own; give --interface and --channel of another bus, "
                         "--nodes-only, or --direction both.")
    return "tx"


def channel_map(given: Sequence[str] | None) -> dict[int, str]:
    """Read options NUMBER=CHANNEL, such as 0=can1."""
    found: dict[int, str] = {}
    for text in given or ():
        number, equals, channel = text.partition("=")
        if not (equals and channel and number.isdecimal() and int(number) < 16 and int(number) not in found):
            raise InputError(f"--map {text}: expected NUMBER=CHANNEL, a recorded channel 0 … 15 once; "
                             "write for instance --map 0=can1.")
        found[int(number)] = channel
    return found
