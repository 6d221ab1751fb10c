"""Commands between trials and the files of others: `bowden import`, `export`, `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app

if TYPE_CHECKING:
    from trial.compare import Comparison

Source = Annotated[Path, typer.Argument(metavar="FILE", help="csv, csv.gz, candump log, asc, blf, trc or mcap.")]
Trial = Annotated[Path, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]
A = Annotated[Path, typer.Argument(metavar="A", help="A recorded trial.", show_default=False)]
B = Annotated[Path, typer.Argument(metavar="B", help="Another one.", show_default=False)]
Map = Annotated[Path | None, typer.Option("--map", metavar="FILE", help="map.toml: names, units, offsets of columns.")]


@app.command("import")
def import_(
    source: Source,
    output: options.Output,
    columns: Map = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Make a trial of a table or a CAN log.

    Foreign MCAP files too; every change is counted.

    Example: bowden import candump.log -o trial.mcap
    """
    from trial.convert.csv_table import read_map
    from trial.convert.imports import import_file

    mapped = None if columns is None else read_map(columns)
    with terminal.progress(f"importing {source}", shown=not json) as update:
        report = import_file(source, output, mapped=mapped, overwrite=overwrite, progress=update)
    if json:
        terminal.emit({"trial": str(output), **report.as_json()})
        return 0
    print(f"Trial: {output}")
    for name, count in report.counts.items():
        if count:
            print(f"  {name.replace('_', ' ')}: {count}")
    for name in report.left_out:
        print(f"  left out: {name}")
    return 0


@app.command()
def export(
    trial: Trial, output: options.Output, overwrite: options.Overwrite = False, json: options.Json = False
) -> int:
    """Write a trial as a table or a CAN log.

    csv, csv.gz and parquet hold its cycles; log, asc, blf and trc its frames.

    Example: bowden export trial.mcap -o trial.csv
    """
    from trial.convert.export import export as exported
    from trial.read import open as opened

    with terminal.progress(f"exporting {trial}", shown=not json) as update:
        rows = exported(opened(trial), output, overwrite=overwrite, progress=update)
    terminal.emit({"file": str(output), "rows": rows}) if json else print(f"{output}: {rows} rows.")
    return 0


@app.command()
def compare(a: A, b: B, json: options.Json = False) -> int:
    """Show what differs between two trials.

    Configuration, calibration, figures and signals.

    Example: bowden compare a.mcap b.mcap
    """
    from trial.compare import compare as compared
    from trial.read import open as opened

    with terminal.waiting("comparing", shown=not json):
        found = compared(opened(a), opened(b))
    terminal.emit(found.as_json()) if json else _tell(found)
    return 0


def _tell(found: Comparison) -> None:
    if found.same:
        print("The same, in every channel.")
    attached = [(f"{name}: {row.key}", row) for name, rows in found.attachments.items() for row in rows]
    rows = [(row.key, row) for row in (*found.metadata, *found.result)] + attached
    if rows:
        terminal.table("figures and what differs", ("key", "A", "B"), [
            (key, *("–" if value is None else str(value) for value in (row.a, row.b))) for key, row in rows])
    if found.signals:
        terminal.table(f"signals, A − B, matched {found.matched}", ("signal", "unit", "RMS", "mean", "largest"), [
            (row.name, row.unit, *(f"{value:.3g}" for value in (row.rms, row.mean, row.largest)))
            for row in found.signals])
