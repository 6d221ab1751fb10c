"""`bowden fit`, `simulate`, `identify`: a bench model fitted, simulated under a measured motion, or measured."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, SimulatedOptions, argument, new_file, option
from bowden.cli.terminal import AnswerTable, CommandAnswer, Words
from bowden.deferred import on_first_use
from bowden.trials import force_paths
from parameters import InputError
from parameters.files import write_whole

with on_first_use():
    from bowden.models import diagnosing, identification, logbook_entries, simulating
    from bowden.pages import model_pictures
    from bowden.trials import session
    from estimation import bench_fit, simulation
    from estimation.data import table
    from logbook.database import refuse_no_logbook
    from physics import bench_model
    from physics.calibration import Calibration, write
    from trial.report.words import quantity


@app.command(example="bowden fit good.mcap -o model.toml")
def fit(
    trials: Annotated[list[Path], argument(
        "TRIAL…", "Healthy trials of one bench: MCAP, or CSV (.gz) with canonical headers.")],
    output: Annotated[Path, new_file("model.toml to write.", "a bench model", ".toml")],
    path: options.ForcePath = None, lowpass: options.Lowpass = None, logbook: options.Logbook = None,
) -> CommandAnswer:
    """Fit calibration and simulation of a bench, from its healthy trials.

    Any motion, own or imported: rope position, knee angle (none: locked) and START, END beside it.  The file is a
    calibration as of bowden identify, too.  A rig of another kind (a seal, a turning axis, a motor) has its own terms
    fitted.
    """
    refuse_no_logbook(logbook)
    with terminal.fitting("fitting"):
        found = bench_fit.fit([diagnosing.table_of(file, path) for file in trials], lowpass)
    write_whole(output, found.text(), overwrite=True)
    if logbook is not None:
        logbook_entries.add_model(logbook, "fit", output)
    known = None if found.rig is not None else found.model.calibration
    result: dict[str, Any] = {"model": str(output), **found.as_json(), **_scalars_json(known)}
    return CommandAnswer(result, _words_of_fit(output, found))


def _words_of_fit(output: Path, found: bench_fit.FittedBench) -> Words:
    if found.rig is None:
        yield from _words_of_scalars("calibration", found.model.calibration)
    yield AnswerTable(f"constants{' of the simulation' * (found.rig is None)}", (
        "constant", "value", "95 % interval", "unit"), [
        (name, c.value, f"{c.low:.4g} … {c.high:.4g}", c.unit)
        for name, c in found.constants.items() if c.determined], ".4g")
    unseen = "on the last part of each trial, which the fit had not seen"
    if found.rig is not None:
        yield f"A rig of another kind than the bench; terms found: {', '.join(found.rig) or 'none'}."
        yield AnswerTable(f"measured less predicted, {unseen}", ("signal", "RMS", "of a spread of"), [
            (name, quantity(row["unseen"], row["unit"]), quantity(row["spread"], row["unit"]))
            for name, row in found.relations.items()])
    else:
        yield f"Not determined by these trials: {', '.join(found.undetermined)}."
        yield AnswerTable(f"measured less simulated, {unseen}", ("signal", "RMS (N)", "peak (N)"), [
            (name, row["rms_n"], terminal.number(row["peak_n"], ".1f")) for name, row in found.figures.items()])
    yield from (f"Warning: {warning}" for warning in found.warnings)
    yield f"Model: {output}"


@app.command(example="bowden simulate trial.mcap --model model.toml")
def simulate(
    trial: Annotated[Path, argument("TRIAL", "MCAP, or CSV (.gz) with rope position and knee angle (none: locked).")],
    model: Annotated[Path | None, option(
        "model.toml of bowden fit, or extended.toml (default: the nominal bench).", "FILE")] = None,
    output: Annotated[Path | None, new_file("CSV of measured and simulated tensions.", "a table", ".csv")] = None,
    path: options.ForcePath = None,
) -> CommandAnswer:
    """Simulate a bench under a trial's measured motion.

    Rope and knee go where they were measured; START and END come from the many-segment simulation.
    """
    used = bench_model.BenchModel() if model is None else bench_model.read(model)
    given = table.read(trial, path)
    with terminal.waiting("simulating"):
        told = simulation.simulate(bench_fit.as_fitted(given, used), used.simulation_values())
    if output is not None:
        write_whole(output, simulating.as_csv(given, told), overwrite=True)
    figures = simulation.compared(given, told)
    result: dict[str, Any] = {"trial": str(trial), "model": None if model is None else str(model), **figures}
    return CommandAnswer(result, [
        f"The simulation of {result['model'] or 'the nominal bench'} under the motion of {trial}:",
        *(AnswerTable(
            f"{name}: measured less simulated, RMS {terminal.number(row['rms_n'])} N, peak "
            f"{terminal.number(row['peak_n'], '.1f')} N", ("class", "samples", "RMS (N)", "mean (N)"), [
                (one["class"], one["samples"], one["rms_n"], one["mean_n"])
                for part in ("by_phase", "by_load", "by_direction") for one in row.get(part, ())])
          for name, row in figures.items()), "" if figures else "No tension was measured: nothing to compare with."])


@app.command(example="bowden identify all --serial 3 -o calibration.toml")
def identify(
    what: Annotated[str, typer.Argument(
        metavar="WHAT", help="stiffness, swing, friction, sensors, gait (on a calibration) or all.")],
    output: Annotated[Path, new_file("File to write.", "a calibration", ".toml")],
    calibration: Annotated[Path | None, option("Calibration to start from.", "FILE")] = None,
    recorded: Annotated[list[Path] | None, option(
        "Fit recorded experiments in place of measuring.", "TRIAL...", "--from")] = None,
    picture: Annotated[Path | None, new_file(
        "Draw the paper's Figs. 9 and 10 (png, svg, pdf).", *options.PICTURE, name="--picture")] = None,
    *, no_gait: Annotated[bool, option(
        "Leave out the gait trials that end identify all: the calibration has no discrepancy then.")] = False,
    rate: options.Rate = None, simulated: SimulatedOptions, reached: Bus, logbook: options.Logbook = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it; --from fits such trials again, without a bus. identify
    all ends with two short gait trials, which measure END's departure from the calibrated model.
    """
    refuse_no_logbook(logbook)
    if picture is not None and what in ("sensors", "gait"):
        raise InputError(f"--picture {picture}: identify {what} measures no loop of Figs. 9 and 10; leave it out.")
    today = datetime.date.today().isoformat()
    if recorded:
        options.refuse_given({"--no-gait": no_gait, "--rate": rate, **options.spelled(reached, simulated)},
                             "{} belongs to measuring a bench; leave it out with --from.")
        again = identification.again(what, recorded, calibration, date=today, progress=terminal.TERMINAL)
        return _written([again], output, ", ".join(map(str, recorded)), picture, logbook)
    sections = reached.sections(rate)
    logbook = session.entered(sections, logbook, reached.config)
    chosen = reached.chosen(simulated)
    recording = output.with_suffix(".mcap")
    output_files.refuse([recording], overwrite=overwrite, inputs=[calibration, reached.config, simulated.plant_model])
    paths = [path.name for path in sections["network"].bench.force_paths]
    if len(paths) > 1:
        output_files.refuse([force_paths.file_of(output, path) for path in paths], overwrite=overwrite)
    found = identification.perform(
        what, sections, calibration, chosen, recording, date=today, gait=not no_gait, overwrite=overwrite,
        progress=terminal.TERMINAL)
    return _written(found, output, str(recording), picture, logbook, f"Bench: {chosen.in_words}")


def _written(found: Sequence[identification.IdentificationResult], output: Path, source: str, picture: Path | None,
             logbook: Path | None, last: str = "") -> CommandAnswer:
    """Write the calibration and the picture of each force path, and enter them; return the answer."""
    files = {one.path: force_paths.file_of(output, one.path) if one.path else output for one in found}
    for one in found:
        if one.calibration is None:
            continue
        write_whole(files[one.path], write(one.calibration), overwrite=True)
        if picture is not None:
            model_pictures.draw_loops(one.segments, f"{files[one.path].name}, measured in {source}",
                               force_paths.file_of(picture, one.path) if one.path else picture)
        if logbook is not None:
            logbook_entries.add_model(logbook, "calibration", files[one.path])
    objects = {one.path: {
        "calibration": None if one.calibration is None else str(files[one.path]), "trial": source,
        "outcome": "completed" if one.reason is None else "stopped", "stop_reason": one.reason,
        **_scalars_json(one.calibration)} for one in found}
    lines = (line for one in found for line in _words(one, files[one.path], source))
    return CommandAnswer(objects.get("") or {"paths": objects}, chain(lines, [last]),
                         ending.status_of(found[0].reason))


def _words(found: identification.IdentificationResult, output: Path, source: str) -> Words:
    if found.calibration is None:
        yield f"Stopped: {found.reason}; no calibration was written. Trial: {source}"
        return
    if found.reason is not None:
        yield f"Stopped in a gait trial: {found.reason}; the discrepancy is of the trials before it."
    yield from _words_of_scalars(f"{output}, measured in {source}", found.calibration)


def _scalars_json(found: Calibration | None) -> dict[str, Any]:
    """Return `scalars`, those that a trial determined, and `discrepancy`; empty and None without a calibration."""
    beyond = None if found is None else found.discrepancy
    return {"scalars": {} if found is None else found.determined(),
            "discrepancy": None if beyond is None else {"prior": beyond.prior, "residual": beyond.residual}}


def _words_of_scalars(title: str, found: Calibration) -> Words:
    """Yield the scalars with their 95 % intervals, and the discrepancy."""
    yield AnswerTable(title, ("scalar", "unit", "value", "95 % low", "high", "R²"), [
        (name, row["unit"] or "1", *(row[key] for key in ("value", "low", "high", "r_squared")))
        for name, row in found.determined().items()], ".4g")
    if found.discrepancy is not None:
        yield (f"Discrepancy START → END in the gait trials: {100.0 * found.discrepancy.prior:.1f} % of END, its model "
               f"leaves {100.0 * found.discrepancy.residual:.1f} %.")
