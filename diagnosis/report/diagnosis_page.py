"""HTML page of a diagnosis: verdict in words, measured and simulated signals, residuals, and rejected models.

The page only shows the findings of the diagnosis; each figure has its unit.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from diagnosis.findings import Findings
from diagnosis.report import figure_tables, law_section, plots, residual_picture, tracking
from diagnosis.report.headline import headline, interval
from diagnosis.report.plots import AFTER, BEFORE
from diagnosis.report.residuals import where
from eds.declaration import ForcePath, packaged
from estimation.data.table import Table
from physics.effects.catalogue import CATALOGUE
from trial import read
from trial.report import bench_drawing
from trial.report.page import NamedText, Page, Tile, number
from trial.report.words import words

VERDICTS: Final = ("Changed:", "The trial ")
"""Beginnings of the sentence of the headline that states the verdict."""
TO_DO: Final = ("It is at ", "Look at the ", "To separate", "Mend ", "bowden discover", "bowden identify",
                "Run bowden identify")
"""Beginnings of the sentences of the headline that state the next step."""
KINDS: Final = {"none": "good", "found": "warn", "ambiguous": "warn", "unexplained": "bad", "refused": "bad"}


def write(
    found: Findings, trials: Sequence[Table], holdout: Sequence[Table], path: str | Path,
    tracked: tuple[str | Path, str | Path] | None = None,
) -> int:
    """Write the report of a diagnosis of `trials` as one HTML file and return its size in bytes.

    `tracked`: closed-loop trials without and with the extended controller model.  Raises `InputError` if the file
    cannot be written, or if the two `tracked` trials cannot be compared.
    """
    return build(found, trials, holdout, tracked).write(path, overwrite=True)


def build(
    found: Findings, trials: Sequence[Table], holdout: Sequence[Table],
    tracked: tuple[str | Path, str | Path] | None = None,
) -> Page:
    """Return the page of a diagnosis of `trials`, which are the tables as they were read."""
    more = f" and {len(trials) - 1} more" if len(trials) > 1 else ""
    names = f"{Path(trials[0].source).name}{more}"
    stated = f" · every signal low-passed at {found.lowpass_hz:g} Hz, no phase" if found.lowpass_hz is not None else ""
    page = Page(f"Diagnosis of {names}", f"against {_against(found)}{stated}",
                badge=(found.verdict, KINDS.get(found.verdict, "plain")))
    sides, named, turning = found.traces, bool(found.causes), trials[0].turning
    _first(page, found, trials)
    _summary(page, found)
    if found.laws is not None:
        law_section.section(page, found.laws)
    if not found.candidates:
        residual_picture.section(page, found, turning)
    plots.measured(page, sides, "Measured against simulated", "time_s", named=named)
    plots.residuals(page, sides, turning, named=named)
    if holdout:
        plots.measured(page, found.held_traces, "Held-out trials", "held-out time_s", named=named)
    if tracked is not None:
        tracking.section(page, *tracked, (BEFORE, AFTER))
    if not found.candidates:
        figure_tables.ranking(page, found)
        figure_tables.limits(page, found)
    _said(page, found)
    return page


def _against(found: Findings) -> str:
    if found.part == "wire":
        return "what a sound wire and converter give"
    return {"calibration": "the bench population and the bench's own calibration", "nominal": "the bench population",
            "healthy": "reference trials"}.get(found.reference, found.reference)


def _first(page: Page, found: Findings, trials: Sequence[Table]) -> None:
    """Add the first section: verdict, drawing with the changed part, loop, errors, and the next step."""
    page.section("What is wrong")
    sentences = list(headline(found))
    todo = [sentence for sentence in sentences if sentence.startswith(TO_DO)]
    said = [sentence for sentence in sentences if sentence not in todo]
    if found.causes and not found.of_rig:
        todo.append("bowden diagnose … -o extended.toml and bowden verify extended.toml show what control loses by it.")
    lead = next((sentence for sentence in said if sentence.startswith(VERDICTS)), said[0] if said else "")
    page.text(lead, "lead")
    if found.verdict != "refused":
        sites = {cause["site"] for cause in found.causes} or {CATALOGUE[name].site for name in found.rivals}
        recorded = {name for trial in trials for name in trial.columns}
        title, parts = ("The rig by its columns", bench_drawing.parts_of_rig(recorded)) if found.of_rig else (
            "The bench as declared", bench_drawing.parts_of(_declared_path(trials[0])))
        page.drawing(title, bench_drawing.svg(parts, recorded, sites))
        if not found.candidates:
            residual_picture.loop_section(page, found, trials[0].turning)
    figure_tables.errors(page, found)
    for sentence in said:
        if sentence != lead:
            page.text(sentence)
    page.heading("What to do")
    for sentence in todo or [_next(found)]:
        page.text(sentence)


def _declared_path(table: Table) -> ForcePath:
    """Return the force path of the bench that a trial carries; of a table, that of the paper's bench."""
    source = Path(table.source)
    carried = read.open_file(source).attachments if source.suffix == ".mcap" and source.exists() else {}
    rows = tomllib.loads(carried.get("bench.toml", b"").decode()).get("force_path")
    paths = [ForcePath(**row) for row in rows] if rows else packaged().force_paths
    return next((path for path in paths if path.name == table.joint), paths[0])


def _next(found: Findings) -> str:
    """Return the next step where the headline has none."""
    if found.verdict == "none":
        return "Nothing to mend by these data."
    return "Look where the simulation misses most, below, and record that motion again, slower and with other loads."


def _summary(page: Page, found: Findings) -> None:
    page.section("Figures")
    if found.verdict == "unexplained" and (left := where(found)):
        page.text(left)
    if found.causes:
        page.tiles([Tile(words(c["effect"]), "", c["site"],
                         f"reduces by {number(round(c['gain_percent'], 1), 3)} % the residual that it reduces most")
                    for c in found.causes])
        page.table(("cause", "value", "law", "how it shows"), [
            (NamedText(words(c["effect"]), c["effect"]), f"{words(name)} = {interval(one)}",
             CATALOGUE[c["effect"]].law, CATALOGUE[c["effect"]].signature)
            for c in found.causes for name, one in c["parameters"].items()])
    figure_tables.relations(page, found)
    figure_tables.rivals(page, found)


def _said(page: Page, found: Findings) -> None:
    page.section("What to keep in mind")
    for warning in found.warnings:
        page.text(warning, "warning")
    if not found.warnings:
        page.text("No warning.", "note")
