"""`bowden report`: a trial as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app

Recorded = Annotated[Path, typer.Argument(metavar="TRIAL", help="A recorded trial.", show_default=False)]


@app.command()
def report(
    trial: Recorded, output: options.Output, path: options.ForcePath = None, overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Write a trial as one offline HTML page.

    Figures, plots that zoom together, timing, bus load and events; of several force paths all, or one with --path.

    Example: bowden report trial.mcap -o report.html
    """
    from bowden.pages import reports
    from bowden.trials.force_paths import opened

    output_files.refuse([output], overwrite=overwrite, inputs=[trial])
    output_files.refuse_ending(output, ".html", ".htm", what="a page")
    with terminal.waiting(f"reading {trial}", shown=not json):
        recorded = opened(trial, path, whole=True)
    size = reports.write_trial_page(recorded, output, overwrite=overwrite,
                                    progress=terminal.Terminal(shown=not json))
    terminal.emit({"report": str(output), "bytes": size}) if json else print(f"{output}: {size / 1e6:.1f} MB.")
    return 0
