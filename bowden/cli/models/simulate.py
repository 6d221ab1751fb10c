"""`bowden simulate`: what START and END would have been under a trial's motion, beside what they were."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.terminal import CommandAnswer
from parameters.files import write_whole

if TYPE_CHECKING:
    from estimation.data.table import Table
    from physics.bench_model import BenchModel
    from physics.simulated_bench import SimulatedTensions

Trial = Annotated[Path, typer.Argument(
    metavar="TRIAL", help="MCAP, or CSV (.gz) with rope position and knee angle (none: locked).", show_default=False)]
Model = Annotated[Path | None, typer.Option(
    metavar="FILE", help="model.toml of bowden fit, or extended.toml (default: the nominal bench).")]
Output = Annotated[Path | None, typer.Option(
    "-o", "--output", metavar="FILE", help="CSV of measured and simulated tensions.")]


@app.command()
def simulate(
    trial: Trial, model: Model = None, output: Output = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Simulate a bench under a trial's measured motion.

    Rope and knee go where they were measured; START and END come from the many-segment simulation.

    Example: bowden simulate trial.mcap --model model.toml
    """
    from estimation import bench_fit, simulation
    from estimation.data import table
    from physics import bench_model

    output_files.refuse([output], overwrite=overwrite, inputs=[trial, model])
    if output is not None:
        output_files.refuse_ending(output, ".csv", what="a table")
    used = bench_model.BenchModel() if model is None else bench_model.read(model)
    given = table.read(trial)
    with terminal.waiting("simulating"):
        told = simulation.simulate(bench_fit.as_fitted(given, used), used.simulation_values())
    if output is not None:
        _write(output, given, told)
    figures = simulation.compared(given, told)
    result: dict[str, Any] = {"trial": str(trial), "model": None if model is None else str(model), **figures}
    return CommandAnswer(result, lambda: _tell(result, figures, used))


def _write(output: Path, given: Table, told: SimulatedTensions) -> None:
    import io

    import numpy as np

    from estimation.simulation import SIGNALS

    columns = {"time_s": given["time_s"]}
    for name in SIGNALS:
        if name in given:
            columns[name] = given[name]
        columns[f"simulated_{name}"] = getattr(told, name)
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="",
               fmt="%.9g")
    write_whole(output, text.getvalue(), overwrite=True)


def _tell(result: dict[str, Any], figures: dict[str, Any], used: BenchModel) -> None:
    print(f"The simulation of {result['model'] or 'the nominal bench'} under the motion of {result['trial']}:")
    number = terminal.number
    for name, row in figures.items():
        title = f"{name}: measured less simulated, RMS {number(row['rms_n'])} N, peak {number(row['peak_n'], 1)} N"
        terminal.table(title, ("class", "samples", "RMS (N)", "mean (N)"), [
            (one["class"], str(one["samples"]), number(one["rms_n"]), number(one["mean_n"]))
            for part in ("by_phase", "by_load", "by_direction") for one in row.get(part, ())])
    if not figures:
        print("No tension was measured: nothing to compare with.")
