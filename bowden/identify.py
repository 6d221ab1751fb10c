"""`bowden identify`: measure a bench by the paper's procedures and write its calibration."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden import options, terminal
from bowden.app import app

if TYPE_CHECKING:
    from master.calibration import Calibration

What = Annotated[str, typer.Argument(metavar="WHAT", help="stiffness, swing, friction, sensors or all.")]
Guess = Annotated[Path | None, typer.Option("--calibration", metavar="FILE", help="What it starts from.")]


@app.command()
def identify(
    what: What,
    output: options.Output,
    calibration: Guess = None,
    rate: options.Rate = None,
    serial: options.Serial = None,
    day: options.Day = None,
    seed: options.Seed = None,
    plant: options.Plant = None,
    plant_model: options.PlantModel = None,
    interface: options.Interface = None,
    channel: options.Channel = None,
    bitrate: options.Bitrate = None,
    option: options.Extra = None,
    config: options.Config = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Measure a bench and write its calibration.

    The trial that it was measured in is recorded beside it.

    Example: bowden identify all --serial 3 -o calibration.toml
    """
    from bowden import bus, identification, outputs
    from bowden import config as configuration

    sections = configuration.read(config)
    sections["network"] = configuration.override(
        sections["network"], {"rate_hz": ("--rate", rate), "bitrate": ("--bitrate", bitrate)})
    chosen = bus.choose(interface, channel, option, bus.Simulated(serial, day, seed, plant, plant_model))
    recorded = output.with_suffix(".mcap")
    outputs.refuse([output, recorded], overwrite=overwrite)
    outcome, found = identification.perform(
        what, sections, calibration, chosen, recorded, date=datetime.date.today().isoformat(), overwrite=overwrite,
        quiet=json)
    if found is not None:
        from master.calibration import write

        output.write_text(write(found), encoding="utf-8")
    terminal.emit(_object(output, recorded, outcome, found)) if json else _tell(output, recorded, outcome, found)
    return 0 if outcome is None else 1


def _rows(found: Calibration) -> dict[str, dict[str, Any]]:
    from parameters import declarations

    return {
        name: {"value": getattr(found, name), "unit": declared.unit, "low": proof.low, "high": proof.high,
               "r_squared": proof.r_squared}
        for name, _, declared in declarations(type(found))
        if (proof := found.evidence.get(name)) is not None and proof.date
    }


def _object(output: Path, recorded: Path, reason: str | None, found: Calibration | None) -> dict[str, Any]:
    return {
        "calibration": None if found is None else str(output), "trial": str(recorded),
        "outcome": "completed" if reason is None else "stopped", "stop_reason": reason,
        "scalars": {} if found is None else _rows(found),
    }


def _tell(output: Path, recorded: Path, reason: str | None, found: Calibration | None) -> None:
    if found is None:
        print(f"Stopped: {reason}; no calibration was written. Trial: {recorded}")
        return
    terminal.table(f"{output}, measured in {recorded}", ("scalar", "unit", "value", "95 % low", "high", "R²"), [
        (name, row["unit"] or "1", f"{row['value']:.4g}",
         *("–" if row[key] != row[key] else f"{row[key]:.4g}" for key in ("low", "high", "r_squared")))
        for name, row in _rows(found).items()])
