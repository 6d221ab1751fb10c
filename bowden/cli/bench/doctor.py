"""`bowden doctor`: what stands between this computer and a trial, with what to type."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus
from bowden.cli.terminal import CommandAnswer
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    pass

Seconds = Annotated[float, typer.Option("--for", metavar="S", min=0.1, help="Duration of the timer check.")]


@app.command()
def doctor(
    reached: Bus, seconds: Seconds = 5.0,
    compiles: Annotated[bool, typer.Option(
        "--compile", help="Compile the laws and end: the warm-up of a container image.")] = False,
    soak: Annotated[float | None, typer.Option(
        metavar="MINUTES", min=0.0, help="Instead, measure wake-ups and SDO round trips for so many minutes.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE",
                                                help="With --soak: the report, Markdown.")] = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Check the bench; name the commands to type.

    Of interface, computer, bus and nodes: each finding has its remedy.

    Example: bowden doctor --interface socketcan --channel can0
    """
    if compiles:
        from bowden.trials import session

        session.compile_laws(simulated=True, progress=terminal.Terminal())
        return CommandAnswer({"compiled": True}, "The laws are compiled.")
    if soak is not None:
        return _soak(reached, soak, output, overwrite=overwrite)
    if output is not None:
        raise InputError(f"-o {output}: is the report of a soak; add --soak MINUTES.")
    from bowden.bench import examination, safety_table
    from master.limit_holders import COLUMNS

    sections = reached.sections()
    held = safety_table.table(sections)
    with terminal.waiting("looking"):
        found = list(examination.examine(sections["network"], reached.chosen(), seconds))
    faults = sum(not finding.good for finding in found)

    def words() -> None:
        for finding in found:
            print(f"{'ok ' if finding.good else 'BAD'} {finding.what}: {finding.seen}")
            if not finding.good:
                print(f"      {finding.remedy}")
        terminal.table("safety functions", COLUMNS, [row.cells for row in held])
        print(f"{faults} faults.")

    return CommandAnswer({"findings": [
        {"what": finding.what, "good": finding.good, "seen": finding.seen,
         "remedy": None if finding.good else finding.remedy} for finding in found], "faults": faults,
        "safety_functions": safety_table.as_objects(held)}, words, 1 if faults else 0)


def _soak(reached: Bus, minutes: float, output: Path | None, *, overwrite: bool) -> CommandAnswer:
    """Soak the bus and print or write the report; 1 where no node answered or the bus had errors."""
    from bowden.bench import soak
    from master.network.host_computer import prepared
    from master.node_access.node_scan import scan

    output_files.refuse([output], overwrite=overwrite)
    with reached.linked() as link, ending.interrupted() as ended, prepared() as refused:
        nodes = [one.node_id for one in scan(link, []) if one.identity is not None]
        figures = soak.soak(link, nodes, minutes, ended)
    text = soak.as_text(figures, f"{reached.interface or 'the virtual bus'} {reached.channel or ''}".strip())
    text += "".join(f"\n{sentence}\n" for sentence in refused)
    if output is not None:
        write_whole(output, text, overwrite=True)
    return CommandAnswer(
        {**asdict(figures), "file": None if output is None else str(output)},
        text if output is None else f"{output}: {len(figures.late_ns)} waits, {len(nodes)} nodes.",
        0 if nodes and not figures.error_frames and not figures.unanswered else 1)
