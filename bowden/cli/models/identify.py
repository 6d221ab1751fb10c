"""`bowden identify`: measure a bench by the paper's procedures, or fit its recorded trials, into a calibration."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden import output_files
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.models import scalars_table
from bowden.cli.option_groups import Bus, SimulatedOptions
from bowden.cli.terminal import CommandAnswer
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    from bowden.models.identification import IdentificationResult

What = Annotated[str, typer.Argument(
    metavar="WHAT", help="stiffness, swing, friction, sensors, gait (on a calibration) or all.")]
Guess = Annotated[Path | None, typer.Option("--calibration", metavar="FILE", help="Calibration to start from.")]
From = Annotated[list[Path] | None, typer.Option(
    "--from", metavar="TRIAL", help="Fit recorded experiments in place of measuring; repeatable.")]
Picture = Annotated[Path | None, typer.Option(
    metavar="FILE", help="Draw the paper's Figs. 9 and 10 (png, svg, pdf).")]
NoGait = Annotated[bool, typer.Option(
    "--no-gait", help="Leave out the gait trials that end identify all: the calibration has no discrepancy then.")]


@app.command()
def identify(
    what: What, output: options.Output, calibration: Guess = None, recorded: From = None, picture: Picture = None, *,
    no_gait: NoGait = False, rate: options.Rate = None, simulated: SimulatedOptions, reached: Bus,
    logbook: options.Logbook = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it; --from fits such trials again, without a bus. identify
    all ends with two short gait trials, which measure END's departure from the calibrated model.

    Example: bowden identify all --serial 3 -o calibration.toml
    """
    from bowden.models import identification
    from bowden.trials import session
    from bowden.trials.force_paths import file_of

    session.refuse_no_logbook(logbook)
    if picture is not None and what in ("sensors", "gait"):
        raise InputError(f"--picture {picture}: identify {what} measures no loop of Figs. 9 and 10; leave it out.")
    output_files.refuse_ending(output, ".toml", what="a calibration")
    output_files.refuse_picture(picture)
    today = datetime.date.today().isoformat()
    if recorded:
        for name, value in {"no-gait": no_gait or None, "rate": rate, **reached._asdict(),
                            **simulated._asdict()}.items():
            if value is not None:
                raise InputError(
                    f"--{name.replace('_', '-')} belongs to measuring a bench; leave it out with --from.")
        output_files.refuse([output, picture], overwrite=overwrite, inputs=[*recorded, calibration])
        again = identification.again(what, recorded, calibration, date=today, progress=terminal.Terminal())
        return _written([again], output, ", ".join(map(str, recorded)), picture, logbook)
    sections = reached.sections(rate)
    logbook = session.entered(sections, logbook, reached.config)
    chosen = reached.chosen(simulated)
    recording = output.with_suffix(".mcap")
    output_files.refuse([output, recording, picture], overwrite=overwrite, inputs=[
        calibration, reached.config, simulated.plant_model])
    paths = [path.name for path in sections["network"].bench.force_paths]
    if len(paths) > 1:
        output_files.refuse([file_of(output, path) for path in paths], overwrite=overwrite)
    found = identification.perform(
        what, sections, calibration, chosen, recording, date=today, gait=not no_gait, overwrite=overwrite,
        progress=terminal.Terminal())
    return _written(found, output, str(recording), picture, logbook, f"Bench: {chosen.told}")


def _written(found: Sequence[IdentificationResult], output: Path, source: str, picture: Path | None,
             logbook: Path | None, last: str = "") -> CommandAnswer:
    """Write the calibration and the picture of each force path, and enter them; return the answer."""
    from bowden.trials.force_paths import file_of
    from physics.calibration import write

    files = {one.path: file_of(output, one.path) if one.path else output for one in found}
    for one in found:
        if one.calibration is None:
            continue
        write_whole(files[one.path], write(one.calibration), overwrite=True)
        if picture is not None:
            from bowden.pages import loops_picture

            loops_picture.draw(one.segments, f"{files[one.path].name}, measured in {source}",
                               file_of(picture, one.path) if one.path else picture)
        if logbook is not None:
            from bowden.models import logbook_entries

            logbook_entries.add_model(logbook, "calibration", files[one.path])
    objects = {one.path: {
        "calibration": None if one.calibration is None else str(files[one.path]), "trial": source,
        "outcome": "completed" if one.reason is None else "stopped", "stop_reason": one.reason,
        **scalars_table.as_json(one.calibration)} for one in found}

    def words() -> None:
        for one in found:
            _tell(one, files[one.path], source)
        if last:
            print(last)

    return CommandAnswer(objects.get("") or {"paths": objects}, words,
                         ending.status_of("completed" if found[0].reason is None else "stopped", found[0].reason))


def _tell(found: IdentificationResult, output: Path, source: str) -> None:
    if found.calibration is None:
        print(f"Stopped: {found.reason}; no calibration was written. Trial: {source}")
        return
    if found.reason is not None:
        print(f"Stopped in a gait trial: {found.reason}; the discrepancy is of the trials before it.")
    scalars_table.show(f"{output}, measured in {source}", found.calibration)
