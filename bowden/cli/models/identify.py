"""`bowden identify`: measure a bench by the paper's procedures, or fit its recorded trials, into a calibration."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.models import scalars_table
from bowden.cli.option_groups import Bus, SimulatedOptions, grouped
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    from bowden.models.identification import Identified

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
@grouped
def identify(
    what: What,
    output: options.Output,
    calibration: Guess = None,
    recorded: From = None,
    picture: Picture = None,
    *,
    no_gait: NoGait = False,
    rate: options.Rate = None,
    simulated: SimulatedOptions,
    reached: Bus,
    config: options.Config = None,
    logbook: options.Logbook = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it; --from fits such trials again, without a bus. identify
    all ends with two short gait trials, which measure END's departure from the calibrated model.

    Example: bowden identify all --serial 3 -o calibration.toml
    """
    from bowden import output_files
    from bowden.models import identification
    from bowden.trials import session
    from bowden.trials.force_paths import file_of

    session.refuse_no_logbook(logbook)
    _drawable(what, picture)
    output_files.refuse_ending(output, ".toml", what="a calibration")
    output_files.refuse_picture(picture)
    today = datetime.date.today().isoformat()
    progress = terminal.Terminal(shown=not json)
    if recorded:
        _no_bench({"no-gait": no_gait or None, "rate": rate, "config": config,
                   **reached._asdict(), **simulated._asdict()})
        output_files.refuse([output, picture], overwrite=overwrite, inputs=[*recorded, calibration])
        again = identification.again(what, recorded, calibration, date=today, progress=progress)
        status = _ended([again], output, ", ".join(map(str, recorded)), picture, json)
        _enter(logbook, again, output)
        return status
    sections = reached.sections(config, rate)
    logbook = session.entered(sections, logbook, config)
    chosen = reached.chosen(simulated)
    recording = output.with_suffix(".mcap")
    output_files.refuse([output, recording, picture], overwrite=overwrite, inputs=[
        calibration, config, simulated.plant_model])
    paths = [path.name for path in sections["network"].bench.force_paths]
    if len(paths) > 1:
        output_files.refuse([file_of(output, path) for path in paths], overwrite=overwrite)
    found = identification.perform(
        what, sections, calibration, chosen, recording, date=today, gait=not no_gait, overwrite=overwrite,
        progress=progress)
    status = _ended(found, output, str(recording), picture, json)
    for one in found:
        _enter(logbook, one, _file(output, one))
    if not json:
        print(f"Bench: {chosen.told}")
    return status


def _enter(logbook: Path | None, found: Identified, output: Path) -> None:
    """Enter the calibration in a logbook, if both exist."""
    if logbook is not None and found.calibration is not None:
        from bowden.models import logbook_entries

        logbook_entries.add_model(logbook, "calibration", output)


def _drawable(what: str, picture: Path | None) -> None:
    if picture is not None and what in ("sensors", "gait"):
        raise InputError(f"--picture {picture}: identify {what} measures no loop of Figs. 9 and 10; "
                         "leave it out.")


def _no_bench(given: Mapping[str, object]) -> None:
    for name, value in given.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} belongs to measuring a bench; leave it out with --from.")


def _file(output: Path, found: Identified) -> Path:
    """The calibration's file: `output`, or on a bench of several force paths that of its path."""
    from bowden.trials.force_paths import file_of

    return file_of(output, found.path) if found.path else output


def _ended(found: Sequence[Identified], output: Path, source: str, picture: Path | None, json: bool) -> int:
    from bowden.cli import ending

    for one in found:
        if one.calibration is not None:
            from physics.calibration import write

            write_whole(_file(output, one), write(one.calibration), overwrite=True)
            if picture is not None:
                from bowden.pages import loops_picture

                title = f"{_file(output, one).name}, measured in {source}"
                loops_picture.draw(one.segments, title, _file(picture, one))
    objects = {one.path: _object(one, _file(output, one), source) for one in found}
    if json:
        terminal.emit(objects.get("") or {"paths": objects})
    else:
        for one in found:
            _tell(one, _file(output, one), source)
    return ending.status_of("completed" if found[0].reason is None else "stopped", found[0].reason)


def _object(found: Identified, output: Path, source: str) -> dict[str, Any]:
    made = found.calibration
    return {
        "calibration": None if made is None else str(output), "trial": source,
        "outcome": "completed" if found.reason is None else "stopped", "stop_reason": found.reason,
        **scalars_table.as_json(made),
    }


def _tell(found: Identified, output: Path, source: str) -> None:
    if found.calibration is None:
        print(f"Stopped: {found.reason}; no calibration was written. Trial: {source}")
        return
    if found.reason is not None:
        print(f"Stopped in a gait trial: {found.reason}; the discrepancy is of the trials before it.")
    scalars_table.show(f"{output}, measured in {source}", found.calibration)
