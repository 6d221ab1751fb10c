"""`bowden live` and `bowden watch`: a trial or a running bus shown in a browser, or diagnosed while it is recorded.

Both receive and never send a frame; requests of a page reach the player of a recording only.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from bowden.bench import buses, configuration
from bowden.cli import ending, options, terminal
from bowden.cli.app import NothingGivenError, app
from bowden.cli.options import Bus, argument, new_file, option, watched_bench
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.live import feeds
    from bowden.live.web import LivePage
    from bowden.models import logbook_entries
    from bowden.trials.recording import BusRecording
    from bowden.watch import file_watch, watch_process
    from bowden.watch.file_watch import WatchedBench
    from eds.bench.bench_network import wire
    from logbook.database import refuse_no_logbook
    from trial import playback
    from trial.read import open as opened
    from trial.read import path_names


PlayedTrial = Annotated[Path | None, argument("TRIAL", "A recorded trial.")]
Web = Annotated[str, option(
    "Address of the page; port 0: a free one; 0.0.0.0: open to other computers.", "[HOST:]PORT")]
Speed = Annotated[float, option("Playing speed, 0.001 … 1000 times real time.", "X")]


@app.command(example="bowden live trial.mcap --web 8080 --for 5")
def live(
    trial: PlayedTrial = None, *, reached: Bus, web: Web = "8765", speed: Speed = 1.0, seconds: options.Seconds = None,
) -> int:
    """Show a trial or a running bus in a browser, live.

    The page plays a trial with play, pause, seek and speed.  A bus is only listened to.
    """
    _refuse_both(trial, reached, "a live view shows")
    if trial is not None:
        return _play(trial, reached, speed, web, ending.after(seconds))
    return _follow_bus(reached, web, ending.after(seconds))


def _refuse_both(trial: Path | None, reached: Bus, what: str) -> None:
    if (trial is None) == (reached.interface is None):
        raise NothingGivenError("TRIAL | --interface NAME",
                                f"{what} a trial or a bus; give either a file or --interface.")


def _show_page(page: LivePage) -> None:
    terminal.show(CommandAnswer({"web": page.url, "port": page.port}, f"page: {page.url}"))
    sys.stdout.flush()


def _play(path: Path, reached: Bus, speed: float, web: str, over: Callable[[], bool]) -> int:
    slowest, fastest = playback.SPEEDS
    if not slowest <= speed <= fastest:
        raise InputError(f"--speed {speed:g}: expected {slowest:g} … {fastest:g}; give another one.")
    trial = opened(path)
    shown = feeds.state(path.name, "recorded", configuration.read(reached.config)["network"],
                        path_names(trial) or ("",))
    player = feeds.TrialPlayer(trial, speed, time.monotonic_ns, shown)
    with closing(LivePage(shown, web, None, feeds.RECORDED, player.request)) as page:
        _show_page(page)
        player.play(over)
    return 0


def _follow_bus(reached: Bus, web: str, over: Callable[[], bool]) -> int:
    network = reached.network()
    shown = feeds.state(reached.chosen().in_words, "bus", network, decode_events=True)
    with buses.opened_one(reached.chosen(), network.bitrate) as bus, \
            closing(LivePage(shown, web, None, feeds.OTHER_PROCESS)) as page:
        _show_page(page)
        failure = buses.listened(bus, feeds.BusFeed(network, shown).take, over, feeds.FRAME_S)
        if failure is not None:
            shown.status("ended", f"the bus has failed: {failure}")
            terminal.remark(f"the bus has failed: {failure}.")
    return 0 if failure is None else 1


Written = Annotated[Path | None, argument("TRIAL", "Trial that is being written, by bowden trial or bowden record.")]
Recording = Annotated[Path | None, new_file("With --interface: where the bus is recorded.", *options.RECORDING)]
Book = Annotated[Path | None, option(
    "Logbook of the bench, in place of --healthy and for the scatter between sessions.", "DIR")]


@app.command(
    example="bowden trial --cycles 3 -o good.mcap && bowden watch trial.mcap --healthy good.mcap")
def watch(
    trial: Written = None, output: Recording = None, healthy: options.Healthy = None, logbook: Book = None, *,
    reached: Bus, seconds: options.Seconds = None, path: options.ForcePath = None,
) -> CommandAnswer:
    """Diagnose a trial while it is written, or a bus that is only listened to.

    A line for each gait cycle; the diagnosis of the whole once the file is closed.
    """
    _refuse_both(trial, reached, "a watch reads")
    refuse_no_logbook(logbook)
    bench = replace(watched_bench(healthy, logbook), path=logbook_entries.path_of(logbook, path))
    if trial is not None:
        if trial.suffix.lower() != ".mcap":
            raise InputError(f"{trial}: a watch reads a trial (.mcap) while it is written; say "
                             f"bowden diagnose {trial}, or make a trial of it with bowden import.")
        return _file(trial, bench, seconds)
    return _bus(reached, output, bench, seconds)


def _file(trial: Path, bench: WatchedBench, seconds: float | None) -> CommandAnswer:
    with terminal.fitting("fitting the reference trials"):
        watched = file_watch.FileWatch(trial, bench)
    cycles = []
    for verdict in watched.follow(ending.after(seconds), terminal.remark):
        cycles.append(verdict.as_json())
        if not terminal.quiet():
            print(watched.told(verdict), flush=True)
    result: dict[str, Any] = {"trial": str(trial), "cycles": cycles, "diagnosis": None}
    if watched.closed:
        with terminal.fitting("diagnosing the whole trial"):
            result["diagnosis"] = file_watch.as_json(watched.diagnosis())
    return _answer(result)


def _bus(reached: Bus, output: Path | None, bench: WatchedBench, seconds: float | None) -> CommandAnswer:
    """Record the bus in this process, and watch the recording in another one."""
    if output is None:
        raise InputError("a watch records the bus that it watches; name the file with -o FILE.")
    network = reached.network()
    about = {"interface": str(reached.interface), "channel": reached.channel or ""}
    failure = None
    with watch_process.beside(output, bench, paced=False, shown=not terminal.quiet()) as watched, \
            buses.opened_one(reached.chosen(), network.bitrate) as heard:
        with BusRecording(output, wire(network), overwrite=True, about=about) as made:
            terminal.remark(f"watching {reached.chosen().in_words}; Ctrl-C ends it.")
            try:
                failure = made.listen(heard, seconds, None)
            except KeyboardInterrupt:
                terminal.remark("ended; the whole recording is diagnosed.")
        watched.ended("recorded")
        watched.conclude()
        result = {"trial": str(output), **watched.as_json()}
    if failure is not None:
        terminal.remark(f"the bus has failed: {failure}; what it gave is diagnosed.")
    return _answer(result, failed=failure is not None)


def _answer(result: dict[str, Any], *, failed: bool = False) -> CommandAnswer:
    """Return the diagnosis of the whole; status 1 where the file was not closed or not diagnosed, or the bus failed."""
    found = result["diagnosis"]
    if found is None:
        terminal.notice(f"{result['trial']}: no diagnosis of the whole: "
                        f"{result.get('remark') or 'the file is not closed yet.'}")
        return CommandAnswer(result, "", 1)
    named = f": {', '.join(found['class'])}" if found["class"] else ""
    refused = found["warnings"] if found["verdict"] == "refused" else []
    return CommandAnswer(result, [f"Verdict: {found['verdict']}{named}", *refused], int(failed))
