"""`bowden identify` and `bowden fit`: measure a bench into a calibration, or fit a bench model to recorded trials."""

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
from parameters import InputError, declarations
from parameters.files import write_whole

with on_first_use():
    from bowden.models import identification, logbook_entries
    from bowden.models.diagnosing import table_of
    from bowden.models.identification import IdentificationResult
    from bowden.pages import model_pictures
    from bowden.trials import session
    from estimation import bench_fit
    from estimation.bench_fit import FittedBench
    from logbook.database import refuse_no_logbook
    from physics.calibration import Calibration, write
    from trial.report.words import quantity


HealthyTrials = Annotated[list[Path], argument(
    "TRIAL…", "Healthy trials of one bench: MCAP, or CSV (.gz) with canonical headers.")]
FittedModel = Annotated[Path, new_file("model.toml to write.", "a bench model", ".toml")]


@app.command()
def fit(
    trials: HealthyTrials, output: FittedModel, path: options.ForcePath = None, lowpass: options.Lowpass = None,
    logbook: options.Logbook = None,
) -> CommandAnswer:
    """Fit calibration and simulation of a bench, from its healthy trials.

    Any motion, own or imported: rope position, knee angle (none: locked) and START, END beside it.  The file is a
    calibration as of bowden identify, too.  A rig of another kind (a seal, a turning axis, a motor) has its own terms
    fitted.

    Example: bowden fit good.mcap -o model.toml
    """
    refuse_no_logbook(logbook)
    with terminal.fitting("fitting"):
        found = bench_fit.fit([table_of(file, path) for file in trials], lowpass)
    write_whole(output, found.text(), overwrite=True)
    if logbook is not None:
        logbook_entries.add_model(logbook, "fit", output)
    known = None if found.rig is not None else found.model.calibration
    result: dict[str, Any] = {"model": str(output), **found.as_json(), **_scalars_json(known)}
    return CommandAnswer(result, _words_of_fit(output, found))


def _words_of_fit(output: Path, found: FittedBench) -> Words:
    if found.rig is None:
        yield from _words_of_scalars("calibration", found.model.calibration)
    yield AnswerTable(f"constants{' of the simulation' * (found.rig is None)}", (
        "constant", "value", "95 % interval", "unit"), [
        (name, f"{c.value:.4g}", f"{c.low:.4g} … {c.high:.4g}", c.unit)
        for name, c in found.constants.items() if c.determined])
    unseen = "on the last part of each trial, which the fit had not seen"
    if found.rig is not None:
        yield f"A rig of another kind than the bench; terms found: {', '.join(found.rig) or 'none'}."
        yield AnswerTable(f"measured less predicted, {unseen}", ("signal", "RMS", "of a spread of"), [
            (name, quantity(row["unseen"], row["unit"]), quantity(row["spread"], row["unit"]))
            for name, row in found.relations.items()])
    else:
        yield f"Not determined by these trials: {', '.join(found.undetermined)}."
        yield AnswerTable(f"measured less simulated, {unseen}", ("signal", "RMS (N)", "peak (N)"), [
            (name, row["rms_n"], terminal.number(row["peak_n"], 1)) for name, row in found.figures.items()])
    yield from (f"Warning: {warning}" for warning in found.warnings)
    yield f"Model: {output}"


NewCalibration = Annotated[Path, new_file("File to write.", "a calibration", ".toml")]
What = Annotated[str, typer.Argument(
    metavar="WHAT", help="stiffness, swing, friction, sensors, gait (on a calibration) or all.")]
Guess = Annotated[Path | None, option("Calibration to start from.", "--calibration", metavar="FILE")]
From = Annotated[list[Path] | None, option(
    "Fit recorded experiments in place of measuring; repeatable.", "--from", metavar="TRIAL")]
Picture = Annotated[Path | None, new_file(
    "Draw the paper's Figs. 9 and 10 (png, svg, pdf).", *options.PICTURE, name="--picture")]
NoGait = Annotated[bool, option(
    "Leave out the gait trials that end identify all: the calibration has no discrepancy then.", "--no-gait")]


@app.command()
def identify(
    what: What, output: NewCalibration, calibration: Guess = None, recorded: From = None, picture: Picture = None, *,
    no_gait: NoGait = False, rate: options.Rate = None, simulated: SimulatedOptions, reached: Bus,
    logbook: options.Logbook = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it; --from fits such trials again, without a bus. identify
    all ends with two short gait trials, which measure END's departure from the calibrated model.

    Example: bowden identify all --serial 3 -o calibration.toml
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


def _written(found: Sequence[IdentificationResult], output: Path, source: str, picture: Path | None,
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


def _words(found: IdentificationResult, output: Path, source: str) -> Words:
    if found.calibration is None:
        yield f"Stopped: {found.reason}; no calibration was written. Trial: {source}"
        return
    if found.reason is not None:
        yield f"Stopped in a gait trial: {found.reason}; the discrepancy is of the trials before it."
    yield from _words_of_scalars(f"{output}, measured in {source}", found.calibration)


def _scalars_json(found: Calibration | None) -> dict[str, Any]:
    """Return `scalars`, those that a trial determined, and `discrepancy`; empty and None without a calibration."""
    beyond = None if found is None else found.discrepancy
    return {"scalars": {} if found is None else _scalar_rows(found),
            "discrepancy": None if beyond is None else {"prior": beyond.prior, "residual": beyond.residual}}


def _words_of_scalars(title: str, found: Calibration) -> Words:
    """Yield the scalars with their 95 % intervals, and the discrepancy."""
    yield AnswerTable(title, ("scalar", "unit", "value", "95 % low", "high", "R²"), [
        (name, row["unit"] or "1", f"{row['value']:.4g}",
         *("–" if row[key] != row[key] else f"{row[key]:.4g}" for key in ("low", "high", "r_squared")))
        for name, row in _scalar_rows(found).items()])
    if found.discrepancy is not None:
        yield (f"Discrepancy START → END in the gait trials: {100.0 * found.discrepancy.prior:.1f} % of END, its model "
               f"leaves {100.0 * found.discrepancy.residual:.1f} %.")


def _scalar_rows(found: Calibration) -> dict[str, dict[str, Any]]:
    return {
        name: {"value": getattr(found, name), "unit": declared.unit, "low": proof.low, "high": proof.high,
               "r_squared": proof.r_squared}
        for name, _, declared in declarations(type(found))
        if (proof := found.evidence.get(name)) is not None and proof.trial
    }
