"""`bowden watch`: diagnosis of a trial that another process writes, or of a bus that is recorded meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.option_groups import Bus, watched_bench
from bowden.cli.terminal import CommandAnswer
from parameters import InputError

if TYPE_CHECKING:
    from bowden.watch.file_watch import FileWatch, WatchedBench
    from estimation.running_evidence import WatchVerdict

Written = Annotated[Path | None, typer.Argument(
    metavar="TRIAL", help="Trial that is being written, by bowden trial or bowden record.", show_default=False)]
Recorded = Annotated[Path | None, typer.Option(
    "-o", "--output", metavar="FILE", help="With --interface: where the bus is recorded.")]
Book = Annotated[Path | None, typer.Option(
    metavar="DIR", help="Logbook of the bench, in place of --healthy and for the scatter between sessions.")]
LOOK_S = 0.1
"""Time between two looks at the file, s."""


@app.command()
def watch(
    trial: Written = None, output: Recorded = None, healthy: options.Healthy = None, logbook: Book = None, *,
    reached: Bus, seconds: options.Seconds = None, path: options.ForcePath = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Diagnose a trial while it is written, or a bus that is only listened to.

    A line for each gait cycle; the diagnosis of the whole once the file is closed.

    Example: bowden trial --cycles 3 -o good.mcap && bowden watch trial.mcap --healthy good.mcap
    """
    from bowden.models import logbook_entries
    from bowden.trials import session

    if (trial is None) == (reached.interface is None):
        raise NothingGivenError("TRIAL | --interface NAME",
                                "bowden watch reads a trial or a bus; give either a file or --interface.")
    session.refuse_no_logbook(logbook)
    bench = replace(watched_bench(healthy, logbook), path=path or (
        None if logbook is None else logbook_entries.path_of(logbook)))
    if trial is not None:
        return _file(trial, bench, seconds)
    return _bus(reached, output, bench, seconds, overwrite=overwrite)


def _file(trial: Path, bench: WatchedBench, seconds: float | None) -> CommandAnswer:
    from bowden.watch import file_watch

    over = ending.after(seconds)
    with terminal.waiting("fitting the reference trials"):
        watched = file_watch.FileWatch(trial, bench)
    cycles = []
    for verdict in _looked(watched, over):
        cycles.append(verdict.as_json())
        if not terminal.quiet():
            print(watched.told(verdict), flush=True)
    result: dict[str, Any] = {"trial": str(trial), "cycles": cycles, "diagnosis": None}
    if watched.closed:
        with terminal.waiting("diagnosing the whole trial"):
            result["diagnosis"] = file_watch.as_json(watched.diagnosis())
    return _answer(result)


def _looked(watched: FileWatch, ended: Callable[[], bool]) -> Iterator[WatchVerdict]:
    """Yield each suspicion until the file is closed or the time is over."""
    while not watched.closed and not ended():
        yield from watched.look()
        if not watched.closed:
            time.sleep(LOOK_S)
    yield from watched.look(last=True)


def _bus(reached: Bus, output: Path | None, bench: WatchedBench, seconds: float | None, *, overwrite: bool
         ) -> CommandAnswer:
    """Record the bus in this process, and watch the recording in another one."""
    import can

    from bowden.bench import buses
    from bowden.trials.recording import BusRecording
    from bowden.watch import watch_process
    from eds.bench.bench_network import wire

    if output is None:
        raise InputError("bowden watch records the bus that it watches; name the file with -o FILE.")
    output_files.refuse_ending(output, ".mcap", what="a recording")
    output_files.refuse([output], overwrite=overwrite)
    network = reached.network()
    about = {"interface": str(reached.interface), "channel": reached.channel or ""}
    failure = None
    with watch_process.beside(output, bench, paced=False, shown=not terminal.quiet()) as watched, \
            buses.opened_one(reached.chosen(), network.bitrate) as heard:
        with BusRecording(output, wire(network), overwrite=overwrite, about=about) as made:
            terminal.remark(f"watching {reached.interface} {reached.channel or ''}; Ctrl-C ends it.")
            try:
                made.listen(heard, seconds, None)
            except (can.CanError, OSError) as error:
                failure = str(error)
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
    if found is None and not terminal.quiet():
        terminal.remark(f"{result['trial']}: no diagnosis of the whole: "
                        f"{result.get('remark') or 'the file is not closed yet.'}")
    return CommandAnswer(result, "" if found is None else f"Verdict: {found['verdict']}" + (
        f": {', '.join(found['class'])}" if found["class"] else ""), int(failed or found is None))
