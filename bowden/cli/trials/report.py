"""`bowden report`: a trial as one HTML page."""

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.terminal import CommandAnswer


@app.command()
def report(
    trial: options.Trial, output: options.Output, path: options.ForcePath = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Write a trial as one offline HTML page.

    Figures, plots that zoom together, timing, bus load and events; of several force paths all, or one with --path.

    Example: bowden report trial.mcap -o report.html
    """
    from bowden.pages import reports
    from bowden.trials.force_paths import opened

    output_files.refuse([output], overwrite=overwrite, inputs=[trial])
    output_files.refuse_ending(output, ".html", ".htm", what="a page")
    with terminal.waiting(f"reading {trial}"):
        recorded = opened(trial, path, whole=True)
    size = reports.write_trial_page(recorded, output, overwrite=overwrite, progress=terminal.Terminal())
    return CommandAnswer({"report": str(output), "bytes": size}, f"{output}: {size / 1e6:.1f} MB.")
