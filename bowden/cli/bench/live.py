"""`bowden live`: a trial played, or a running bus followed, for Foxglove and other clients of its WebSocket protocol.

It receives and shows; it never sends a frame, and a viewer's requests reach the player only. Both servers listen at
loopback by default. The page beyond it has a token in its address; the Foxglove server has none (its SDK has no
option for it), and the output warns of that.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, cast

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.option_groups import Bus, grouped
from parameters import InputError

if TYPE_CHECKING:
    from bowden.live.viewer import Viewer
    from bowden.live.web import LivePage

Closable = TypeVar("Closable", bound="Viewer | LivePage | None")
LOOK_S = 1 / 60  # between two looks at the clock
Recorded = Annotated[Path | None, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]
Host = Annotated[str, typer.Option(metavar="ADDRESS", help="Address to listen at; 0.0.0.0 lets other computers watch.")]
Port = Annotated[int, typer.Option(
    metavar="PORT", min=0, max=65535, help="Port to listen at; 0 takes a free one.")]
Speed = Annotated[float, typer.Option(metavar="X", help="Of playing, 0.001 … 1000 times real time.")]
Web = Annotated[str | None, typer.Option(
    metavar="[HOST:]PORT", help="Built-in page beside it, needs no Foxglove; port 0: a free one.")]
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
    web: Web = None,
    speed: Speed = 1.0,
    seconds: Seconds = None,
    json: options.Json = False,
) -> int:
    """Show a trial or a running bus, live.

    In Foxglove, with play, pause, seek and speed for a trial; in a browser with --web.  A bus is only listened to.
    A layout for Foxglove is docs/foxglove-layout.json.

    Example: bowden live trial.mcap --web 8080 --for 5
    """
    if (trial is None) == (reached.interface is None):
        raise NothingGivenError("TRIAL | --interface NAME",
                                "bowden live shows a trial or a bus; give either a file or --interface.")
    deadline = None if seconds is None else time.monotonic() + seconds

    def ended() -> bool:
        return deadline is not None and time.monotonic() >= deadline

    served = LiveAddress(host, port, web, json)
    if trial is not None:
        return _play(trial, config, speed, served, ended)
    return _follow(reached, config, served, ended)


class LiveAddress(NamedTuple):
    """Addresses of the viewers: Foxglove's host and port, the page's address (None: no page), and the form of output.
    """

    host: str
    port: int
    web: str | None
    json: bool

    def viewer(self, name: str, units: Mapping[str, str], **played: Any) -> Viewer | None:
        """Return Foxglove's server; None if its SDK is not installed and the live page replaces it."""
        from bowden.live.viewer import Viewer, installed

        if self.web is not None and not installed():
            terminal.remark("foxglove-sdk is not installed: there is the page alone.")
            return None
        viewer = Viewer(name, self.host, self.port, units, **played)
        if not viewer.loopback:
            terminal.remark(f"--host {self.host}: Foxglove's protocol has no token, so whoever reaches port "
                            f"{viewer.port} can watch; leave --host out, or watch through an SSH tunnel.")
        return viewer

    def page(self, name: str, kind: str, network: Any, why: str) -> LivePage | None:
        """Return the page, None where none was asked for."""
        if self.web is None:
            return None
        from bowden.live import feeds, web

        return web.LivePage(feeds.state(name, kind, network, decode_events=kind == "bus"), self.web, None, why)

    def say(self, viewer: Viewer | None, page: LivePage | None) -> None:
        """Print the addresses of the viewer's feed and of the live page."""
        if self.json:
            told = {} if viewer is None else {"url": viewer.url, "port": viewer.port}
            terminal.emit(told | ({} if page is None else {"web": page.url}))
        else:
            lines = [] if viewer is None else [f"{viewer.url}   {viewer.app_url}"]
            print("\n".join(lines + ([] if page is None else [f"page: {page.url}"])))
        sys.stdout.flush()


def _play(path: Path, config: Path | None, speed: float, served: LiveAddress, ended: Callable[[], bool]) -> int:
    from bowden.bench import configuration
    from bowden.live.feeds import RECORDED, PagedViewer
    from bowden.live.trial_player import TrialPlayback
    from trial.playback import SPEEDS
    from trial.read import open as opened

    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(f"--speed {speed:g}: expected {SPEEDS[0]:g} … {SPEEDS[1]:g}; give another one.")
    playback = TrialPlayback(opened(path), speed, time.monotonic_ns)
    page = served.page(path.name, "recorded", configuration.read(config)["network"], RECORDED)
    with _closing(page):
        viewer = served.viewer(path.name, playback.units, span_ns=playback.span_ns, asked=playback.asked)
        served.say(viewer, page)
        with _closing(viewer):
            shown = viewer if page is None else PagedViewer(viewer, page, list(playback.units))
            while shown is not None and not ended():
                playback.look(shown)
                time.sleep(LOOK_S)
    return 0


def _follow(reached: Bus, config: Path | None, served: LiveAddress, ended: Callable[[], bool]) -> int:
    import can

    from bowden.bench import buses
    from bowden.live.feeds import OTHER_PROCESS
    from bowden.live.relay import Relay
    from eds.bench.bench_network import wire
    from trial.follow import Follower

    network = reached.sections(config)["network"]
    follower = Follower(wire(network))
    name = f"{reached.interface} {reached.channel or ''}".strip()
    with buses.opened_one(reached.chosen(), network.bitrate) as heard, \
            _closing(served.page(name, "bus", network, OTHER_PROCESS)) as page, \
            _closing(served.viewer(name, follower.units)) as viewer:
        served.say(viewer, page)
        relay = Relay(follower, viewer, None if page is None else page.state)
        try:
            while not ended():
                message = heard.recv(LOOK_S)
                if message is not None:
                    relay.take(message)
        except (can.CanError, OSError) as error:
            terminal.remark(f"the bus has failed: {error}.")
            if page is not None:
                page.state.status("ended", f"the bus has failed: {error}")
            return 1
    return 0


def _closing(opened: Closable) -> AbstractContextManager[Closable]:
    return nullcontext(opened) if opened is None else cast("AbstractContextManager[Closable]", closing(opened))
