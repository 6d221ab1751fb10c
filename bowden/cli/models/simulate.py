"""`bowden simulate` and `bowden verify`: a bench model against a recorded trial, and in the control loop."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Annotated, Any

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, SimulatedOptions, WalkOptions, argument, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Words
from bowden.deferred import on_first_use
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    import numpy as np

    from bowden.trials import session
    from bowden.trials.experiment import gained
    from estimation import bench_fit, simulation
    from estimation.data import table
    from estimation.data.table import Table
    from physics import bench_model
    from physics.forward.path_parameters import SimulatedTensions
    from trial import signals

Trial = Annotated[Path, argument("TRIAL", "MCAP, or CSV (.gz) with rope position and knee angle (none: locked).")]
Model = Annotated[Path | None, option(
    "model.toml of bowden fit, or extended.toml (default: the nominal bench).", metavar="FILE")]
Output = Annotated[Path | None, new_file("CSV of measured and simulated tensions.", "a table", ".csv")]


@app.command()
def simulate(
    trial: Trial, model: Model = None, output: Output = None, path: options.ForcePath = None,
) -> CommandAnswer:
    """Simulate a bench under a trial's measured motion.

    Rope and knee go where they were measured; START and END come from the many-segment simulation.

    Example: bowden simulate trial.mcap --model model.toml
    """
    used = bench_model.BenchModel() if model is None else bench_model.read(model)
    given = table.read(trial, path)
    with terminal.waiting("simulating"):
        told = simulation.simulate(bench_fit.as_fitted(given, used), used.simulation_values())
    if output is not None:
        _write(output, given, told)
    figures = simulation.compared(given, told)
    result: dict[str, Any] = {"trial": str(trial), "model": None if model is None else str(model), **figures}
    return CommandAnswer(result, _words(result, figures))


def _write(output: Path, given: Table, told: SimulatedTensions) -> None:
    columns = {"time_s": given["time_s"]}
    for name in simulation.SIGNALS:
        if name in given:
            columns[name] = given[name]
        columns[f"simulated_{name}"] = getattr(told, name)
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="",
               fmt="%.9g")
    write_whole(output, text.getvalue(), overwrite=True)


def _words(result: dict[str, Any], figures: dict[str, Any]) -> Words:
    yield f"The simulation of {result['model'] or 'the nominal bench'} under the motion of {result['trial']}:"
    for name, row in figures.items():
        yield AnswerTable(
            f"{name}: measured less simulated, RMS {terminal.number(row['rms_n'])} N, peak "
            f"{terminal.number(row['peak_n'], 1)} N", ("class", "samples", "RMS (N)", "mean (N)"), [
                (one["class"], one["samples"], one["rms_n"], one["mean_n"])
                for part in ("by_phase", "by_load", "by_direction") for one in row.get(part, ())])
    if not figures:
        yield "No tension was measured: nothing to compare with."


VerifiedModel = Annotated[Path, argument("EXTENDED", "extended.toml of bowden diagnose -o.")]
VerifiedTrials = Annotated[Path, option(
    "Trials to write: FILE with -before and -after before its suffix.", "-o", "--output", metavar="FILE")]


@app.command()
def verify(
    model: VerifiedModel, output: VerifiedTrials, walk: WalkOptions, rate: options.Rate = None,
    calibration: options.Calibration = None, *, simulated: SimulatedOptions, reached: Bus,
    path: options.ForcePath = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure what compensation of named effects gains in the control loop.

    One experiment twice on a bench, without and with compensation of the effects in EXTENDED.  Of several force paths
    EXTENDED has one file each, such as extended.left.toml; a path without one is not compensated.

    The controller is the extended one unless another is named.

    Example: bowden verify extended.toml --plant-model bench.toml --cycles 4 -o verify.mcap
    """
    sections = reached.sections(rate)
    sections["gait"] = walk.gait(sections["gait"], controller="extended")
    chosen = reached.chosen(simulated)
    files = {name: output.with_name(f"{output.stem}-{name}{output.suffix}") for name in ("before", "after")}
    names = [one.name for one in sections["network"].bench.force_paths]
    if (path is not None or len(names) > 1) and path not in names:
        raise InputError(f"--path {path or 'is missing'}: name the force path that is judged, of {', '.join(names)}.")
    output_files.refuse_ending(output, ".mcap", what="a trial")
    output_files.refuse(files.values(), overwrite=overwrite, inputs=[
        model, calibration, reached.config, simulated.plant_model])
    prepared = {
        name: session.prepare_gait(sections, calibration, chosen, peak_given=walk.peak is not None,
                                   period_given=walk.period is not None,
                                   controller_model=model if name == "after" else None) for name in files}
    figures = {name: session.perform(prepared[name], file, overwrite=overwrite, progress=terminal.TERMINAL,
                                     announce="" if terminal.quiet() else f"{name}, bench on {chosen.in_words}.")
               for name, file in files.items()}
    extended = prepared["after"].paths.get(path or "", prepared["after"].experiment)
    figures = {name: one | one.get("paths", {}).get(path, {}) for name, one in figures.items()}
    judged, gain = gained(figures["before"], figures["after"])
    result = {"controller_model": str(model), "effects": {name: dict(of) for name, of in extended.known.items()},
              "terms": [term.equation for term in extended.terms], "judged_by": judged, "gain_percent": gain, **figures}
    return CommandAnswer(result, _words_of_verified(result, figures),
                         max(ending.status_of(one["stop_reason"]) for one in figures.values()))


def _words_of_verified(result: dict[str, Any], figures: dict[str, dict[str, Any]]) -> Words:
    true = result["judged_by"].startswith("true_")
    changes = ", ".join([*result["effects"], *result["terms"]]) or "no effect"
    yield AnswerTable(
        f"{changes}: END {'true' if true else 'by its sensor'}, controller {figures['after']['controller']}",
        ("END", "uncompensated", "compensated"), [
            (f"{one.text} ({one.unit})", *(figures[name]["true_" * true + one.name] for name in ("before", "after")))
            for one in signals.FORCE_FIGURES])
    yield f"Gain in relative RMSE: {terminal.number(result['gain_percent'], 1)} %"
    for name, one in figures.items():
        yield f"Trial {name}: {one['trial']}" + (f", stopped: {one['stop_reason']}" if one["stop_reason"] else "")
