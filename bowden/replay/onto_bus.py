"""`bowden replay --onto bus`: recorded frames on a bus, in their time or one by one."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from bowden.buses import Chosen, opened_one
from bowden.cli import terminal
from parameters import InputError

if TYPE_CHECKING:
    from bowden.replay.player import Player
    from bowden.replay.playing_bus import Outlet
    from bowden.replay.schedule import Selection
    from trial.read import Trial

LOST = ("frames were not taken: nodes on the bus send the same COB-IDs, or nobody is on it; "
        "--direction tx leaves out what the recorded nodes sent.")
HELP = "Enter sends the next frame, a number seeks to that second, play plays the rest, pause ends it there."


def replay(
    recorded: Trial, selection: Selection, chosen: Chosen, channels: Mapping[int, str], *, speed: float, loops: int,
    stepped: bool, json: bool,
) -> int:
    """Play the frames that `selection` names; 1 where the bus did not take all of them."""
    from bowden.replay import playing_bus
    from bowden.replay.player import Player
    from bowden.replay.schedule import plan

    schedule = plan(recorded.frames, selection)
    with _outlet(chosen, channels) as (outlet, bus):
        clock: Callable[[], int] = getattr(bus, "time_ns", time.monotonic_ns)
        player = Player(schedule, outlet.send, speed=speed, loops=loops)
        restored = player.seek(0, clock()) if selection.from_s > 0 else []
        with terminal.progress("replay", shown=not (json or stepped)) as update:
            if stepped:
                _step(player, bus, clock, shown=not json)
            else:
                player.play(clock())
                playing_bus.run(player, bus, clock, progress=update)
    result = _result(recorded, player, outlet, len(restored))
    terminal.emit(result) if json else _tell(result)
    return 1 if outlet.lost else 0


@contextmanager
def _outlet(chosen: Chosen, channels: Mapping[int, str]) -> Iterator[tuple[Outlet, Any]]:
    """The bus of each recorded channel that is mapped; without a map one bus takes all of them."""
    from bowden.replay.playing_bus import Outlet

    with ExitStack() as stack:
        if not channels:
            bus = stack.enter_context(opened_one(chosen, chosen.arguments["bitrate"]))
            yield Outlet({}, bus), bus
            return
        named = {
            name: stack.enter_context(opened_one(_on(chosen, name), chosen.arguments["bitrate"]))
            for name in dict.fromkeys(channels.values())
        }
        yield Outlet({number: named[name] for number, name in channels.items()}), next(iter(named.values()))


def _on(chosen: Chosen, channel: str) -> Chosen:
    return replace(chosen, arguments={**chosen.arguments, "channel": channel})


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


def _step(player: Player, bus: Any, clock: Callable[[], int], *, shown: bool) -> None:
    """Take one line of standard input at a time."""
    from bowden.replay import playing_bus
    from bowden.replay.player import State

    if shown:
        terminal.remark(HELP)
    for line in sys.stdin:
        word = line.strip()
        if word == "pause":
            player.pause(clock())
            break
        if word == "play":
            player.play(clock())
            playing_bus.run(player, bus, clock)
        elif word:
            player.seek(_position(word), clock())
        else:
            frame = player.step()
            playing_bus.wait(bus, clock, clock() + playing_bus.LINGER_NS, playing_bus.ignore)
            if shown and frame is not None:
                print(f"{player.position_ns(clock()) / 1e9:12.6f} s  {frame.can_id:03X}  {frame.data.hex(' ')}")
        if player.state is State.ENDED:
            break


def _position(word: str) -> int:
    try:
        return round(float(word) * 1e9)
    except (ValueError, OverflowError):
        raise InputError(f"{word!r} is no command; {HELP}") from None


def _result(recorded: Trial, player: Player, outlet: Outlet, restored: int) -> dict[str, Any]:
    late = player.lateness()
    return {
        "trial": str(recorded.path), "onto": "bus", "frames": player.sent, "passes": player.pass_ + 1,
        "state": player.state.value, "restored_frames": restored, "lost_frames": outlet.lost,
        **{f"left_out_{name}": count for name, count in player.schedule.left_out.items()},
        "lateness_median_us": late.median_ns / 1e3, "lateness_p99_us": late.p99_ns / 1e3,
        "lateness_max_us": late.max_ns / 1e3,
    }


def _tell(result: Mapping[str, Any]) -> None:
    print(f"{result['frames']} frames in {result['passes']} passes, {result['lost_frames']} not taken by the bus; "
          f"{result['restored_frames']} restored what was before.")
    if result["lost_frames"]:
        terminal.remark(LOST)
    terminal.table("lateness", ("figure", "µs"), [
        (name, terminal.number(result[f"lateness_{name}_us"], 1)) for name in ("median", "p99", "max")])
