"""`bowden doctor`: what stands between this computer and a trial, with what to type."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped

if TYPE_CHECKING:
    from master.network.doctor import DoctorFinding

Seconds = Annotated[float, typer.Option("--for", metavar="S", min=0.1, help="How long the timer is watched.")]


@app.command()
@grouped
def doctor(
    reached: Bus,
    seconds: Seconds = 5.0,
    config: options.Config = None,
    json: options.Json = False,
) -> int:
    """Check the bench; name the commands to type.

    Of interface, computer, bus and nodes: each finding has its remedy.

    Example: bowden doctor --interface socketcan --channel can0
    """
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


def _object(finding: DoctorFinding) -> dict[str, Any]:
    return {"what": finding.what, "good": finding.good, "seen": finding.seen,
            "remedy": None if finding.good else finding.remedy}
