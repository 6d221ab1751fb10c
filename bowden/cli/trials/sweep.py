"""`bowden sweep`: many trials of simulated benches, one table."""

from pathlib import Path
from typing import Annotated

import typer

from bowden.bench import configuration
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.options import option
from bowden.cli.terminal import AnswerTable, CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.sweep import rows as sweep_rows
    from bowden.sweep import run as sweep_run
    from bowden.sweep import summary, sweep_table
    from bowden.trials import provenance


@app.command(example="bowden sweep --grid peak=40,50,60 --grid serial=1-20 --identify --grid day=1 -o table.csv")
def sweep(
    output: Annotated[Path, option("Table, .csv or .parquet; continued.", "FILE", "-o", "--output")],
    grid: Annotated[list[str] | None, option(
        "Values of an option of bowden trial, or of table.key of bench.toml or of the plant; 1-20 for whole numbers. "
        "Repeatable.", "NAME=V,V…", "--grid")] = None,
    draw: Annotated[list[str] | None, option(
        "A number drawn at random. Repeatable.", "NAME=LOW:HIGH[:log]", "--draw")] = None,
    draws: Annotated[int, option("Random draws for each point of the grid.", "COUNT")] = 1,
    draw_seed: Annotated[int, option("Seed of the draws.", "NUMBER")] = 0,
    identify: Annotated[bool, option("Identify each bench on its day 0 first.")] = False,
    calibration: options.Calibration = None, knee: options.Knee = None, desired: options.Desired = None,
    config: options.Config = None,
    keep: Annotated[Path | None, option("Keep the recordings there (default: none is kept).", "DIR")] = None,
    workers: Annotated[int | None, option("Processes (default: one a processor).", "COUNT")] = None,
    scheduler: Annotated[str | None, option("Dask scheduler to run on, host:port.", "ADDRESS")] = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Run trials over grids and random draws of any value. One row a trial; a partial table is continued."""
    if draws < 1 or draw_seed < 0 or (workers is not None and workers < 1):
        raise typer.BadParameter("--draws and --workers are whole numbers from 1, --draw-seed from 0")
    if identify and calibration is not None:
        raise InputError("--identify measures the calibration that --calibration gives; leave one of them out.")
    axes = [sweep_rows.axis(text) for text in grid or ()]
    fixed = {"files.calibration": sweep_rows.IDENTIFIED if identify else calibration, "files.knee": knee,
             "files.desired": desired}
    rows = sweep_rows.rows(
        configuration.read(config), {name: str(value) for name, value in fixed.items() if value is not None}, axes,
        [sweep_rows.draw(text) for text in draw or ()], draws, draw_seed)
    if keep is not None and not keep.is_dir():
        raise InputError(f"--keep {keep}: is no directory; make it first.")
    with sweep_table.SweepTable(output, list(rows[0]), overwrite=overwrite) as table:
        resumed = sum(table.found(row) is not None for row in rows)
        if resumed:
            terminal.remark(f"{table.path}: {resumed} of {len(rows)} trials are there from before.")
            if table.commits - {provenance.commit()}:
                terminal.remark("some of them are by another commit; --overwrite makes them again.")
        try:
            found = sweep_run.into_table(rows, table, overwrite=overwrite, scheduler=scheduler, workers=workers,
                                         keep=keep, progress=terminal.TERMINAL)
        except (InputError, KeyboardInterrupt):
            terminal.remark(f"{table.growing}: keeps the trials that are done; the same command goes on from there.")
            raise
    cells = summary.cells(found, [name for name, _ in axes])
    failed = len(found) - summary.completed(found)
    figures = summary.spreads(found)
    return CommandAnswer(
        {"table": str(output), "trials": len(rows), "resumed": resumed, "not_completed": failed,
         "figures": {name: one._asdict() for name, one in figures.items()}, "cells": cells}, [
            *([AnswerTable("over the trials that completed", ("figure", "median", "least", "greatest", "in row"), [
                (summary.FIGURES[name], one.median, one.least, one.greatest, one.worst_row)
                for name, one in figures.items()])] if figures else []),
            *summary.cell_lines(cells),
            f"{output}: {len(rows)} trials, {resumed} of them from before, {failed} not completed."],
        1 if failed else 0)
