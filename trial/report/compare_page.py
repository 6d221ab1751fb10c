"""Two trials in one HTML page: settings, results, overlaid signals and their difference.

The page shows the result of `trial.compare`; A and B keep their colours throughout.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from trial import metrics
from trial.compare import FieldDifference, SignalDifference, TrialComparison, aligned
from trial.read import Trial
from trial.report.overview import BINS, known, setting
from trial.report.page import Cell, NamedText, Page, Tile, broken, number, thinned
from trial.report.plot import Plot, Series
from trial.report.sections import FORCE, MOTION
from trial.report.trial_page import FIGURES, NEEDED
from trial.report.words import label, plain, quantities, words

A, B = "#1f6fb2", "#d9730d"
MOST_ROWS = 400
SHOWN = 4
"""Number of metadata keys that a sentence lists; further ones are counted."""
COMPARED = ("tension_end_n", "tension_start_n", "servo_position_m", "knee_angle_rad")
HASHES = ("commit", "calibration_digest", "packages", "limits_digest")


def write(a: Trial, b: Trial, found: TrialComparison, path: Path, *, overwrite: bool = False) -> int:
    """Write the page; returns its bytes.  Raises `InputError`."""
    return build(a, b, found).write(path, overwrite=overwrite)


def build(a: Trial, b: Trial, found: TrialComparison) -> Page:
    """Return the page of a comparison."""
    badge = ("the same", "good") if found.same else ("they differ", "plain")
    page = Page("Two trials", f"A: {a.path.name} · B: {b.path.name} · signals matched {found.matched}", badge=badge)
    page.section("Figures")
    _figures(page, a, b)
    _result(page, found)
    _signals(page, a, b, found)
    _attached(page, found)
    return page


def _figures(page: Page, a: Trial, b: Trial) -> None:
    sides = [judged(side) for side in (a, b)]
    rows = [(f"{text} ({unit})", *(number(side.get(name), 3) for side in sides)) for name, unit, text in FIGURES
            if any(side.get(name) is not None for side in sides)]
    if rows:
        page.table(("figure", "A", "B"), rows)
        key, unit, text = FIGURES[0]
        page.tiles([Tile(number(side.get(key), 3), unit, f"{letter}: {text}")
                    for letter, side in zip("AB", sides, strict=True)])


def judged(side: Trial) -> dict[str, float | None]:
    """Return the four figures of a trial by name; {} if peak, rate, gait cycles or forces are not known."""
    settings = setting(side)
    if settings.peak_n is None or settings.rate_hz is None or not settings.cycles or any(
            known(side, name) is None for name in NEEDED):
        return {}
    return dict(metrics.figures(side.columns, peak_n=settings.peak_n, rate_hz=settings.rate_hz, cycles=settings.cycles,
                                settle=settings.settle))


def _result(page: Page, found: TrialComparison) -> None:
    rows = _rows([*found.metadata, *(row for row in found.result if row.a != row.b)])
    if rows:
        page.heading("What else came out or was told differently")
        page.table(("key", "A", "B"), rows, tall=len(rows) > 20)


def _rows(differences: Sequence[FieldDifference]) -> list[tuple[Cell, ...]]:
    return [(NamedText(label(row.key), row.key), *("–" if value is None else str(plain(row.key, value))[:300]
                                                   for value in (row.a, row.b)))
            for row in differences[:MOST_ROWS]]


def _signals(page: Page, a: Trial, b: Trial, found: TrialComparison) -> None:
    page.section("Signals")
    if found.signals:
        page.table(("signal", "unit", "RMS of A − B", "mean", "largest", "at (s)"), [
            _shown(row) for row in found.signals], tall=len(found.signals) > 15)
    for text, names in (("Only A has", found.only_a), ("Only B has", found.only_b)):
        if names:
            page.text(f"{text}: {', '.join(names)}.", "note")
    there = {row.name: row for row in found.signals}
    for name in [*reversed(FORCE), *(name for _, names, _ in MOTION for name in names)]:
        if name in there:
            _plot(page, a, b, name, there[name].unit)


def _shown(row: SignalDifference) -> tuple[Cell, ...]:
    texts, unit = quantities((row.rms, row.mean, row.largest), row.unit)
    return NamedText(words(row.name), row.name), unit, *texts, row.largest_at_s


def _plot(page: Page, a: Trial, b: Trial, name: str, unit: str) -> None:
    matched, along, one, other = aligned(a, b, name)
    good = np.isfinite(along)
    along, values = along[good], [one[good], other[good], (one - other)[good]]
    if len(along) < 2:
        return
    x_label = "gait cycles" if matched == "by gait phase" else "time (s)"
    along, values = broken(along, values, 2.5 * float(np.median(np.diff(along))))
    along, values = thinned(along, values, BINS)
    linked = "along"
    page.plot(Plot(name, along, [Series("A", values[0], A), Series("B", values[1], B, dash=True)], x_label, unit,
              linked=linked))
    page.plot(Plot(f"{name}, A − B", along, [Series("A − B", values[2], "#30363f")], x_label, unit, linked=linked,
              height=150))


def _attached(page: Page, found: TrialComparison) -> None:
    if not found.attachments:
        return
    page.section("Attached files that differ")
    for name, differences in found.attachments.items():
        page.heading(name)
        rows = _rows(differences)
        page.table(("key", "A", "B"), rows, tall=len(rows) > 20)


def sentences(found: TrialComparison) -> Iterator[str]:
    """Yield what differs in at most five lines; values of attached files are counted."""
    if found.same:
        yield "The same, in every channel."
    ended = {row.key: row for row in found.result}
    changed = [row for row in found.metadata if row.key not in HASHES]
    if changed:
        more = f"; and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        yield f"Set up differently: {'; '.join(map(_change, changed[:SHOWN]))}{more}."
    if "outcome" in ended and ended["outcome"].a != ended["outcome"].b:
        yield f"Ended: {_change(ended.get('stop_reason', ended['outcome']))}."
    if found.attachments:
        yield "Attached files that differ: " + ", ".join(
            f"{name} ({len(rows)} value{'' if len(rows) == 1 else 's'})" for name, rows in found.attachments.items()
            ) + "."
    forces = [row for row in found.signals if row.name in COMPARED and row.rms > 0]
    if forces:
        yield f"A − B, {found.matched}: " + "; ".join(
            f"{row.name} {row.rms:.3g} {row.unit} RMS, at most {row.largest:.3g} at {row.largest_at_s:.3g} s"
            for row in forces) + "."
    if changed or found.attachments or not found.same:
        yield "All of it: --all, or --report page.html."


def _change(row: FieldDifference) -> str:
    a, b = ("–" if value is None else str(plain(row.key, value))[:60] for value in (row.a, row.b))
    return f"{row.key.replace('_', ' ')} {a} in A, {b} in B"
