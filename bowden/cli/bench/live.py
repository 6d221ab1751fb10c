"""`bowden live`: a trial played, or a running bus followed, in a page of its own.

It receives and shows; it never sends a frame, and a page's requests reach the player only.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.option_groups import Bus
from bowden.cli.terminal import CommandAnswer
from parameters import InputError

if TYPE_CHECKING:
    from bowden.live.web import LivePage

LOOK_S = 1 / 60  # between two looks at the clock
Recorded = Annotated[Path | None, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]
Web = Annotated[str, typer.Option(
    metavar="[HOST:]PORT", help="Address of the page; port 0: a free one; 0.0.0.0: open to other computers.")]
Speed = Annotated[float, typer.Option(metavar="X", help="Playing speed, 0.001 … 1000 times real time.")]


@app.command()
def live(
    trial: Recorded = None, *, reached: Bus, web: Web = "8765", speed: Speed = 1.0, seconds: options.Seconds = None,
) -> int:
    """Show a trial or a running bus in a browser, live.

    The page plays a trial with play, pause, seek and speed.  A bus is only listened to.

    Example: bowden live trial.mcap --web 8080 --for 5
    """
    if (trial is None) == (reached.interface is None):
        raise NothingGivenError("TRIAL | --interface NAME",
                                "bowden live shows a trial or a bus; give either a file or --interface.")
    if trial is not None:
        return _play(trial, reached, speed, web, ending.after(seconds))
    return _follow(reached, web, ending.after(seconds))


def _show(page: LivePage) -> None:
    terminal.show(CommandAnswer({"web": page.url, "port": page.port}, f"page: {page.url}"))
    sys.stdout.flush()


def _play(path: Path, reached: Bus, speed: float, web: str, over: Callable[[], bool]) -> int:
    from bowden.bench import configuration
    from bowden.live import feeds
    from bowden.live.trial_player import TrialPlayer
    from bowden.live.web import LivePage
    from trial.paths import names
    from trial.playback import SPEEDS
    from trial.read import open as opened

    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(f"--speed {speed:g}: expected {SPEEDS[0]:g} … {SPEEDS[1]:g}; give another one.")
    trial = opened(path)
    shown = feeds.state(path.name, "recorded", configuration.read(reached.config)["network"], names(trial) or ("",))
    player = TrialPlayer(trial, speed, time.monotonic_ns, shown)
    with closing(LivePage(shown, web, None, feeds.RECORDED, player.request)) as page:
        _show(page)
        while not over():
            player.look()
            time.sleep(LOOK_S)
    return 0


def _follow(reached: Bus, web: str, over: Callable[[], bool]) -> int:
    import can

    from bowden.bench import buses
    from bowden.live import feeds
    from bowden.live.web import LivePage

    network = reached.network()
    shown = feeds.state(f"{reached.interface} {reached.channel or ''}".strip(), "bus", network, decode_events=True)
    with buses.opened_one(reached.chosen(), network.bitrate) as bus, \
            closing(LivePage(shown, web, None, feeds.OTHER_PROCESS)) as page:
        _show(page)
        feed = feeds.BusFeed(network, shown)
        try:
            while not over():
                message = bus.recv(LOOK_S)
                if message is not None:
                    feed.take(message)
        except (can.CanError, OSError) as error:
            terminal.remark(f"the bus has failed: {error}.")
            shown.status("ended", f"the bus has failed: {error}")
            return 1
    return 0
