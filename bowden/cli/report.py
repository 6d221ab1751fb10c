"""`bowden report`: a trial as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app

if TYPE_CHECKING:
    from trial.read import Trial

Recorded = Annotated[Path, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]


@app.command()
def report(
    trial: Recorded, output: options.Output, overwrite: options.Overwrite = False, json: options.Json = False
) -> int:
    """Write a trial as one offline HTML page.

    Figures, plots that zoom together, timing, bus load and events.

    Example: bowden report trial.mcap -o report.html
    """
    from bowden.bus_load import frame_bits
    from trial.read import open as opened
    from trial.report import trial_page as page

    output_files.refuse([output], overwrite=overwrite)
    with terminal.waiting(f"reading {trial}", shown=not json):
        recorded = opened(trial)
    with terminal.progress("report", shown=not json) as update:
        size = page.write(recorded, output, frame_bits, published=_published(recorded), bound_percent=_bound(recorded),
                          overwrite=overwrite, progress=update)
    terminal.emit({"report": str(output), "bytes": size}) if json else print(f"{output}: {size / 1e6:.1f} MB.")
    return 0


def _bound(recorded: Trial) -> float | None:
    """The sustained load, %, computed for the network that the trial carries with it; None where it has none."""
    import tomllib

    from eds import bus_load
    from eds.bench import Network, wire
    from parameters import InputError, from_table

    try:
        table = tomllib.loads(recorded.attachments["bench.toml"].decode())["network"]
        return bus_load.load_percent(wire(from_table(Network, table, where="bench.toml [network]")))
    except (KeyError, ValueError, InputError):
        return None


def _published(recorded: Trial) -> dict[str, str]:
    """The paper's figures at the same peak."""
    from bowden.cli.trial import PAPER_RMSE_PERCENT

    try:
        rmse = PAPER_RMSE_PERCENT.get(float(recorded.metadata.get("peak_n", "")))
    except ValueError:
        return {}
    return {} if rmse is None else {"relative_rmse_percent": f"{rmse} %", "max_idle_tension_n": "< 1 N"}
