"""`bowden fit`: calibration and simulation of a bench from its healthy trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.models import scalars_table
from bowden.cli.terminal import CommandAnswer
from parameters.files import write_whole

if TYPE_CHECKING:
    from estimation.bench_fit import FittedBench

Trials = Annotated[list[Path], typer.Argument(
    metavar="TRIAL…", help="Healthy trials of one bench: MCAP, or CSV (.gz) with canonical headers.",
    show_default=False)]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="model.toml to write.")]


@app.command()
def fit(
    trials: Trials, output: Output, path: options.ForcePath = None, lowpass: options.Lowpass = None,
    logbook: options.Logbook = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Fit calibration and simulation of a bench, from its healthy trials.

    Any motion, own or imported: rope position, knee angle (none: locked) and START, END beside it.  The file is a
    calibration as of bowden identify, too.  A rig of another kind (a seal, a turning axis, a motor) has its own terms
    fitted.

    Example: bowden fit good.mcap -o model.toml
    """
    from bowden.models.diagnosing import table_of
    from bowden.trials import session
    from estimation import bench_fit

    session.refuse_no_logbook(logbook)
    output_files.refuse([output], overwrite=overwrite, inputs=trials)
    output_files.refuse_ending(output, ".toml", what="a bench model")
    with terminal.waiting("fitting"):
        found = bench_fit.fit([table_of(file, path) for file in trials], lowpass)
    write_whole(output, found.text(), overwrite=True)
    if logbook is not None:
        from bowden.models import logbook_entries

        logbook_entries.add_model(logbook, "fit", output)
    known = None if found.rig is not None else found.model.calibration
    result: dict[str, Any] = {"model": str(output), **found.as_json(), **scalars_table.as_json(known)}
    return CommandAnswer(result, lambda: _tell(output, found))


def _tell(output: Path, found: FittedBench) -> None:
    if found.rig is None:
        scalars_table.show("calibration", found.model.calibration)
    title = "constants of the simulation" if found.rig is None else "constants"
    terminal.table(title, ("constant", "value", "95 % interval", "unit"), [
        (name, f"{c.value:.4g}", f"{c.low:.4g} … {c.high:.4g}", c.unit)
        for name, c in found.constants.items() if c.determined])
    if found.rig is not None:
        _tell_rig(found)
    else:
        _tell_bench(found)
    for warning in found.warnings:
        print(f"Warning: {warning}")
    print(f"Model: {output}")


def _tell_rig(found: FittedBench) -> None:
    print(f"A rig of another kind than the bench; terms found: {', '.join(found.rig or ()) or 'none'}.")
    terminal.table("measured less predicted, on the last part of each trial, which the fit had not seen", (
        "signal", "RMS", "of a spread of", "unit"), [
        (name, terminal.number(row["unseen"]), terminal.number(row["spread"]), row["unit"])
        for name, row in found.relations.items()])


def _tell_bench(found: FittedBench) -> None:
    print(f"Not determined by these trials: {', '.join(found.undetermined)}.")
    terminal.table("measured less simulated, on the last part of each trial, which the fit had not seen", (
        "signal", "RMS (N)", "peak (N)"), [
        (name, terminal.number(row["rms_n"]), terminal.number(row["peak_n"], 1))
        for name, row in found.figures.items()])
