"""`bowden discover`: a law where no effect of the catalogue fits."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.command import NothingGivenError
from bowden.cli.terminal import CommandAnswer
from parameters.files import write_whole

if TYPE_CHECKING:
    from bowden.models.discovering import DiscoveryResult

Trials = Annotated[list[Path] | None, typer.Argument(
    metavar="TRIAL…", help="Trials of one session, MCAP or CSV.", show_default=False)]
Extended = Annotated[Path | None, typer.Option(
    "-o", "--output", metavar="FILE", help="extended.toml with the terms, for --plant-model and --controller-model.")]
Picture = Annotated[Path | None, typer.Option(
    metavar="FILE", help="Residual against the variable of each term, PNG, SVG or PDF.")]

Promoted = Annotated[Path | None, typer.Option(
    "--promote", metavar="FILE", help="The terms as effects of your own, TOML, for bowden diagnose --effects.")]


@app.command()
def discover(
    trials: Trials = None, healthy: options.Healthy = None, path: options.ForcePath = None,
    lowpass: options.Lowpass = None, output: Extended = None, picture: Picture = None,
    promote: Promoted = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Find terms that extend the model where no effect of the catalogue fits.

    At most three terms: constants of the bench that change with load, motion, angle or time.

    Example: bowden discover trial.mcap --healthy good.mcap -o extended.toml --picture law.png
    """
    from bowden.models import discovering

    if not trials or not healthy:
        raise NothingGivenError("TRIAL… --healthy TRIAL",
                                "bowden discover: give a trial, and with --healthy one in the reference condition.")
    output_files.refuse([output, picture, promote], overwrite=overwrite, inputs=[*trials, *healthy])
    output_files.refuse_ending(output, ".toml", what="a law")
    output_files.refuse_ending(promote, ".toml", what="an effect")
    output_files.refuse_ending(picture, ".png", ".svg", ".pdf", what="a picture")
    with terminal.waiting("fitting the reference trials, then the terms"):
        found = discovering.discover(trials, healthy, lowpass_hz=lowpass, path=path)
    written = _write(found, output, picture, promote)
    return CommandAnswer(found.as_json(), lambda: _tell(found, written))


def _write(found: DiscoveryResult, output: Path | None, picture: Path | None, promote: Path | None) -> list[Path]:
    """Write the requested files; without a law nothing is written."""
    from physics.effects import own_effects

    if not found.terms:
        return []
    if output is not None:
        write_whole(output, found.model.text(), overwrite=True)
    if picture is not None:
        from bowden.pages import law_picture

        law_picture.draw(found.laws, picture)
    if promote is not None:
        write_whole(promote, own_effects.promoted(found.terms), overwrite=True)
    return [path for path in (output, picture, promote) if path is not None]


def _tell(found: DiscoveryResult, written: list[Path]) -> None:
    from diagnosis.report.headline import law_sentences

    for sentence in law_sentences(found.laws):
        print(textwrap.fill(sentence, 80))
    terminal.table("RMS error on cycles that no fit has seen", (
        "signal", "unit", "reference", "session", "law"), [
        (name, f.unit, *(terminal.number(value, 4) for value in (f.rmse_before, f.rmse_session, f.rmse_after)))
        for name, f in found.errors.items()])
    for path in written:
        print(f"Wrote {path}.")
