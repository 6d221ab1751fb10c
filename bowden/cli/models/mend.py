"""`bowden mend`: a night at the bench without anybody."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import ending, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.option_groups import BusAlone, SimulatedOptions
from bowden.cli.terminal import CommandAnswer

if TYPE_CHECKING:
    from bowden.mending.supervisor import MendedBench

Reference = Annotated[list[Path] | None, typer.Option(
    metavar="TRIAL", help="Trial of the bench in the reference condition, of bowden trial; repeatable.")]
Folder = Annotated[Path, typer.Option(
    "-o", "--output", metavar="DIR", help="Folder for trials, journal, extended.toml and mend.html.")]
Hours = Annotated[float, typer.Option(metavar="HOURS", min=0.0, help="Bench time after which no trial begins.")]
Cycles = Annotated[int, typer.Option(metavar="COUNT", min=4, help="Gait cycles of each trial.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the journal in the folder.")]


@app.command()
def mend(
    output: Folder, reference: Reference = None, hours: Hours = 1.0, cycles: Cycles = 10, resume: Resume = False, *,
    simulated: SimulatedOptions, reached: BusAlone,
) -> CommandAnswer:
    """Repair the model of a bench unattended.

    Records a gait, diagnoses it, runs the experiments that decide, extends the model, and keeps what gains in the loop.

    Example: bowden mend --reference good.mcap --plant-model bench.toml -o night
    """
    from bowden.mending import supervisor

    if not reference:
        raise NothingGivenError("--reference TRIAL -o DIR",
                                "bowden mend: give a trial of the bench in the reference condition.")
    found = supervisor.mend(reference, output, bus=reached.chosen(simulated), hours=hours, cycles=cycles, resume=resume,
                            progress=terminal.Terminal())
    stopped = "stopped" in found.ending or "time is up" in found.ending
    return CommandAnswer(found.as_json(), lambda: _tell(found),
                         ending.CTRL_C if found.ending.startswith("interrupted") else int(stopped))


def _tell(found: MendedBench) -> None:
    for equation in found.equations:
        print(textwrap.fill(f"Law: {equation}.", 80))
    if found.names:
        print(f"Named: {', '.join(found.names)}.")
    if found.gain is not None:
        low, high = found.interval or (float("nan"), float("nan"))
        print(f"END's error falls by {found.gain:.3g} points of the peak (95 %: {low:.3g} … {high:.3g}).")
    print(f"{found.ending[:1].upper()}{found.ending[1:]}.")
    print(f"Page: {found.folder / 'mend.html'}")
