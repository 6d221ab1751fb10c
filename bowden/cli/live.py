"""`bowden live`: a trial played, or a running bus followed, for Foxglove and others that speak its WebSocket protocol.

The rule of this file: it listens and tells.  It never sends a frame, and a viewer's wishes reach the player only.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped
from parameters import InputError

if TYPE_CHECKING:
    from bowden.live.viewer import Viewer

LOOK_S = 1 / 60  # between two looks at the clock
Recorded = Annotated[Path | None, typer.Argument(metavar="[TRIAL]", help="A recorded trial.", show_default=False)]
Host = Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 lets other computers watch.")]
Port = Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one.")]
Speed = Annotated[float, typer.Option(help="Of playing, 0.001 … 1000 times real time.")]
Seconds = Annotated[float | None, typer.Option("--for", metavar="S", help="End after so many seconds.")]


@app.command()
@grouped
def live(
    trial: Recorded = None,
    *,
    reached: Bus,
    config: options.Config = None,
    host: Host = "127.0.0.1",
    port: Port = 8765,
    speed: Speed = 1.0,
    seconds: Seconds = None,
    json: options.Json = False,
) -> int:
    """Show a trial or a running bus in Foxglove.

    A trial is served with play, pause, seek and speed, until Ctrl-C.  A bus is only listened to.
    A layout for Foxglove is docs/foxglove-layout.json.

    Example: bowden live trial.mcap --for 5
    """
    if (trial is None) == (reached.interface is None):
        raise InputError("bowden live shows a trial or a bus; give either a file or --interface.")
    deadline = None if seconds is None else time.monotonic() + seconds

    def ended() -> bool:
        return deadline is not None and time.monotonic() >= deadline

    if trial is not None:
        return _play(trial, host, port, speed, ended, json=json)
    return _follow(reached, config, host, port, ended, json=json)


def _say(viewer: Viewer, *, json: bool) -> None:
    if json:
        terminal.emit({"url": viewer.url, "port": viewer.port})
    else:
        print(f"{viewer.url}   {viewer.app_url}")
    sys.stdout.flush()


def _play(path: Path, host: str, port: int, speed: float, ended: Callable[[], bool], *, json: bool) -> int:
    from bowden.live.playback import TrialPlayback
    from bowden.live.viewer import Viewer
    from trial.player_tape import SPEEDS
    from trial.read import open as opened

    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(f"--speed {speed:g}: expected {SPEEDS[0]:g} … {SPEEDS[1]:g}; give another one.")
    playback = TrialPlayback(opened(path), speed, time.monotonic_ns)
    viewer = Viewer(path.name, host, port, playback.units, span_ns=playback.span_ns, asked=playback.asked)
    _say(viewer, json=json)
    try:
        while not ended():
            playback.look(viewer)
            time.sleep(LOOK_S)
    finally:
        viewer.close()
    return 0


def _follow(
    reached: Bus, config: Path | None, host: str, port: int, ended: Callable[[], bool], *, json: bool,
) -> int:
    import can

    from bowden import buses
    from bowden.live.relay import Relay
    from bowden.live.viewer import Viewer
    from eds.bench import wire
    from trial.follow import Follower

    network = reached.sections(config)["network"]
    follower = Follower(wire(network))
    with buses.opened_one(reached.chosen(), network.bitrate) as heard:
        viewer = Viewer(f"{reached.interface} {reached.channel or ''}".strip(), host, port, follower.units)
        _say(viewer, json=json)
        relay = Relay(follower, viewer)
        try:
            while not ended():
                message = heard.recv(LOOK_S)
                if message is not None:
                    relay.take(message)
        except (can.CanError, OSError) as error:
            terminal.remark(f"the bus has failed: {error}.")
            return 1
        finally:
            viewer.close()
    return 0
