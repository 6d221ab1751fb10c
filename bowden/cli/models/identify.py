"""`bowden identify`: measure a bench by the paper's procedures, or fit its recorded trials, into a calibration."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, SimulatedOptions, grouped
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    from bowden.models.identification import Identified
    from physics.calibration import Calibration

What = Annotated[str, typer.Argument(metavar="WHAT", help="stiffness, swing, friction, sensors or all.")]
Guess = Annotated[Path | None, typer.Option("--calibration", metavar="FILE", help="What it starts from.")]
From = Annotated[list[Path] | None, typer.Option(
    "--from", metavar="TRIAL", help="Fit recorded experiments in place of measuring; repeatable.")]
Picture = Annotated[Path | None, typer.Option(
    metavar="FILE", help="Draw the paper's Figs. 9 and 10 (png, svg, pdf).")]


@app.command()
@grouped
def identify(
    what: What,
    output: options.Output,
    calibration: Guess = None,
    recorded: From = None,
    picture: Picture = None,
    *,
    rate: options.Rate = None,
    simulated: SimulatedOptions,
    reached: Bus,
    config: options.Config = None,
    logbook: options.Logbook = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it; --from fits such trials again, without a bus.

    Example: bowden identify all --serial 3 -o calibration.toml
    """
    from bowden import output_files
    from bowden.models import identification
    from bowden.trials import session

    session.refuse_no_logbook(logbook)
    _drawable(what, picture)
    output_files.refuse_ending(output, ".toml", what="a calibration")
    output_files.refuse_picture(picture)
    today = datetime.date.today().isoformat()
    progress = terminal.Terminal(shown=not json)
    if recorded:
        _no_bench({"rate": rate, "config": config, **reached._asdict(), **simulated._asdict()})
        output_files.refuse([output, picture], overwrite=overwrite, inputs=[*recorded, calibration])
        found = identification.again(what, recorded, calibration, date=today, progress=progress)
        status = _ended(found, output, ", ".join(map(str, recorded)), picture, json)
        _enter(logbook, found, output)
        return status
    sections = reached.sections(config, rate)
    logbook = session.entered(sections, logbook, config)
    chosen = reached.chosen(simulated)
    recording = output.with_suffix(".mcap")
    output_files.refuse([output, recording, picture], overwrite=overwrite, inputs=[
        calibration, config, simulated.plant_model])
    found = identification.perform(
        what, sections, calibration, chosen, recording, date=today, overwrite=overwrite, progress=progress)
    status = _ended(found, output, str(recording), picture, json)
    _enter(logbook, found, output)
    if not json:
        print(f"Bench: {chosen.told}")
    return status


def _enter(logbook: Path | None, found: Identified, output: Path) -> None:
    """Enter the calibration in a logbook, where both are there."""
    if logbook is not None and found.calibration is not None:
        from bowden.models import logbook_entries

        logbook_entries.add_model(logbook, "calibration", output)


def _drawable(what: str, picture: Path | None) -> None:
    if picture is not None and what == "sensors":
        raise InputError(f"--picture {picture}: identify sensors pulls and swings nothing that could be drawn; "
                         "leave it out.")


def _no_bench(given: Mapping[str, object]) -> None:
    for name, value in given.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} belongs to measuring a bench; leave it out with --from.")


def _ended(found: Identified, output: Path, source: str, picture: Path | None, json: bool) -> int:
    if found.calibration is not None:
        from physics.calibration import write

        write_whole(output, write(found.calibration), overwrite=True)
        if picture is not None:
            from bowden.pages import loops_picture

            loops_picture.draw(found.segments, f"{output.name}, measured in {source}", picture)
    terminal.emit(_object(found, output, source)) if json else _tell(found, output, source)
    from bowden.cli import ending

    return ending.status_of("completed" if found.reason is None else "stopped", found.reason)


def _rows(found: Calibration) -> dict[str, dict[str, Any]]:
    from parameters import declarations

    return {
        name: {"value": getattr(found, name), "unit": declared.unit, "low": proof.low, "high": proof.high,
               "r_squared": proof.r_squared}
        for name, _, declared in declarations(type(found))
        if (proof := found.evidence.get(name)) is not None and proof.date
    }


def _object(found: Identified, output: Path, source: str) -> dict[str, Any]:
    made = found.calibration
    return {
        "calibration": None if made is None else str(output), "trial": source,
        "outcome": "completed" if found.reason is None else "stopped", "stop_reason": found.reason,
        "scalars": {} if made is None else _rows(made),
    }


def _tell(found: Identified, output: Path, source: str) -> None:
    if found.calibration is None:
        print(f"Stopped: {found.reason}; no calibration was written. Trial: {source}")
        return
    terminal.table(f"{output}, measured in {source}", ("scalar", "unit", "value", "95 % low", "high", "R²"), [
        (name, row["unit"] or "1", f"{row['value']:.4g}",
         *("–" if row[key] != row[key] else f"{row[key]:.4g}" for key in ("low", "high", "r_squared")))
        for name, row in _rows(found.calibration).items()])
