"""`bowden doctor`: what stands between this computer and a trial, with what to type."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped
from parameters import InputError

if TYPE_CHECKING:
    from master.network.doctor import DoctorFinding

Seconds = Annotated[float, typer.Option("--for", metavar="S", min=0.1, help="Duration of the timer check.")]


@app.command()
@grouped
def doctor(
    reached: Bus,
    seconds: Seconds = 5.0,
    compiles: Annotated[bool, typer.Option(
        "--compile", help="Compile the laws and end: the warm-up of a container image.")] = False,
    soak: Annotated[float | None, typer.Option(
        metavar="MINUTES", min=0.0, help="Instead, measure wake-ups and SDO round trips for so many minutes.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE",
                                                help="With --soak: the report, Markdown.")] = None,
    overwrite: options.Overwrite = False,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Check the bench; name the commands to type.

    Of interface, computer, bus and nodes: each finding has its remedy.

    Example: bowden doctor --interface socketcan --channel can0
    """
    if compiles:
        from bowden.trials import session

        session.compile_laws(simulated=True, progress=terminal.Terminal(shown=not json))
        terminal.emit({"compiled": True}) if json else print("The laws are compiled.")
        return 0
    if soak is not None:
        return _soak(reached, config, soak, output, overwrite=overwrite, json=json)
    if output is not None:
        raise InputError(f"-o {output}: is the report of a soak; add --soak MINUTES.")
    from bowden.bench import examination, safety_table
    from master.limit_holders import COLUMNS

    sections = reached.sections(config)
    held = safety_table.table(sections)
    with terminal.waiting("looking", shown=not json):
        found = list(examination.examine(sections["network"], reached.chosen(), seconds))
    bad = [finding for finding in found if not finding.good]
    if json:
        terminal.emit({"findings": [_object(finding) for finding in found], "faults": len(bad),
                       "safety_functions": safety_table.as_objects(held)})
    else:
        for finding in found:
            print(f"{'ok ' if finding.good else 'BAD'} {finding.what}: {finding.seen}")
            if not finding.good:
                print(f"      {finding.remedy}")
        terminal.table("safety functions", COLUMNS, [row.cells for row in held])
        print(f"{len(bad)} faults.")
    return 1 if bad else 0


def _soak(reached: Bus, config: Path | None, minutes: float, output: Path | None, *, overwrite: bool,
          json: bool) -> int:
    """Soak the bus and print or write the report; 1 where no node answered or the bus had errors."""
    from dataclasses import asdict

    from bowden import output_files
    from bowden.bench import soak
    from bowden.bench.any_node import linked
    from bowden.cli import ending
    from master.network.host_computer import prepared
    from master.node_access.node_scan import scan
    from parameters.files import write_whole

    output_files.refuse([output], overwrite=overwrite)
    bitrate = int(reached.sections(config)["network"].bitrate)
    with linked(reached.configured(config), bitrate) as link, ending.interrupted() as ended, prepared() as refused:
        nodes = [one.node_id for one in scan(link, []) if one.identity is not None]
        figures = soak.soak(link, nodes, minutes, ended)
    text = soak.as_text(figures, f"{reached.interface or 'the virtual bus'} {reached.channel or ''}".strip())
    text += "".join(f"\n{sentence}\n" for sentence in refused)
    if output is not None:
        write_whole(output, text, overwrite=True)
    if json:
        terminal.emit({**asdict(figures), "file": None if output is None else str(output)})
    else:
        print(text if output is None else f"{output}: {len(figures.late_ns)} waits, {len(nodes)} nodes.")
    return 0 if nodes and not figures.error_frames and not figures.unanswered else 1


def _object(finding: DoctorFinding) -> dict[str, Any]:
    return {"what": finding.what, "good": finding.good, "seen": finding.seen,
            "remedy": None if finding.good else finding.remedy}
