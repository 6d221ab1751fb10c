"""A diagnosis as one HTML page: the verdict in words, measured against simulated, residuals, what was rejected.

The rule of this file: it shows what the diagnosis found and decides nothing; every figure has its unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from diagnosis import tracking
from diagnosis.data import Table
from diagnosis.finder import Diagnosis
from diagnosis.residuals import Compared, binned, bins_of, compared, directions, joined, rms
from diagnosis.words import interval, paragraph
from physics.effects import CATALOGUE
from physics.experiments import EXPERIMENTS
from trial.page import UNKNOWN, Cell, Page, Series, Tile, number

BEFORE, AFTER, MEASURED = "#c2410c", "#2563eb", "#6b7280"
KINDS: Final = {"none": "good", "found": "warn", "ambiguous": "warn", "unexplained": "bad", "refused": "bad"}
SIDES: Final = (
    ("gait_percent", "phase", "gait_percent (%)"), ("tension_start_n", "load", "tension_start_n (N)"),
    ("knee_angle_rad", "knee angle", "knee_angle_rad (rad)"), ("servo_position_m", "rope", "servo_position_m (m)"),
    ("time_s", "time", "time_s (s)"),
)
"""What residuals are looked at against: signal, word, axis."""
MODELS_SHOWN: Final = 40


def write(
    found: Diagnosis, trials: Sequence[Table], holdout: Sequence[Table], path: str | Path,
    tracked: tuple[str | Path, str | Path] | None = None, *, overwrite: bool = True,
) -> int:
    """Write the report of a diagnosis of `trials` as one HTML file; returns its bytes.  Raises `InputError`.

    `tracked`: trials of the closed loop before and after the controller was told.
    """
    return build(found, trials, holdout, tracked).write(path, overwrite=overwrite)


def build(
    found: Diagnosis, trials: Sequence[Table], holdout: Sequence[Table],
    tracked: tuple[str | Path, str | Path] | None = None,
) -> Page:
    """Return the page of a diagnosis; tables as they were read."""
    more = f" and {len(trials) - 1} more" if len(trials) > 1 else ""
    names = f"{Path(trials[0].source).name}{more}"
    stated = f" · every signal low-passed at {found.lowpass_hz:g} Hz, no phase" if found.lowpass_hz is not None else ""
    page = Page(f"Diagnosis of {names}", f"against {_against(found)}{stated}",
                badge=(found.verdict, KINDS.get(found.verdict, "plain")))
    _summary(page, found)
    sides = compared(found, trials)
    _measured(page, sides, "Measured against simulated", "time_s")
    _residuals(page, sides)
    if holdout:
        _measured(page, compared(found, holdout), "Held-out trials", "held-out time_s")
    if tracked is not None:
        tracking.section(page, *tracked, (BEFORE, AFTER))
    _ranking(page, found)
    _limits(page, found)
    _said(page, found)
    return page


def _against(found: Diagnosis) -> str:
    return {"calibration": "the bench's own calibration", "nominal": "the nominal bench",
            "none": "an ideal transmission: no calibration fits this rig"}.get(found.reference, found.reference)


def _summary(page: Page, found: Diagnosis) -> None:
    page.section("Summary")
    page.text(paragraph(found))
    if found.causes:
        page.tiles([Tile(c["effect"], "", c["site"], f"takes {number(c['gain_percent'], 3)} % of the residual")
                    for c in found.causes])
        page.table(("cause", "value", "law", "how it shows"), [
            (c["effect"], f"{name} = {interval(one)}", CATALOGUE[c["effect"]].law, CATALOGUE[c["effect"]].signature)
            for c in found.causes for name, one in c["parameters"].items()])
    page.heading("Relations, on cycles that no fit has seen")
    page.table(("relation", "unit", "healthy floor", "before", "after", "gain (%)", "95 % low", "high",
                "held-out trials before", "after"), [_figures(name, f) for name, f in found.relations.items()])
    _class(page, found)


def _figures(name: str, f: Any) -> tuple[Cell, ...]:
    if not f.checked:
        return (name, f.unit, *[None] * 8)
    return (name, f.unit, f.floor, f.rmse_before, f.rmse_after, f.gain_percent, f.low, f.high, f.holdout_before,
            f.holdout_after)


def _class(page: Page, found: Diagnosis) -> None:
    chosen = {c["effect"] for c in found.causes}
    if len(found.rivals) <= len(chosen):
        return
    page.heading("The class: what these data cannot tell apart")
    page.table(("effect", "what it means", "experiment that would tell", "what to look at"), [
        (name + (" (chosen)" if name in chosen else ""), CATALOGUE[name].words,
         EXPERIMENTS[CATALOGUE[name].experiment].motion, EXPERIMENTS[CATALOGUE[name].experiment].reads)
        for name in found.rivals])


def _measured(page: Page, sides: Mapping[str, Sequence[Compared]], title: str, linked: str) -> None:
    page.section(title)
    parts_of = {name: parts for name, parts in sides.items() if parts}
    if not parts_of:
        page.text("No relation could be checked.", "note")
    elif max(len(parts) for parts in parts_of.values()) > 1:
        page.text("The first trial is drawn; the figures are of all.", "note")
    for name, parts in parts_of.items():
        first, relation = parts[0], parts[0].block.relation
        page.plot(f"{name}: {relation.output}", first.time, [
            Series("measured", first.measured, MEASURED, width=2.2),
            Series("simulated before", first.measured - first.before, BEFORE, width=1.0, dash=True),
            Series("simulated after", first.measured - first.after, AFTER, width=1.0)],
            "time_s (s)", relation.unit, linked=linked, height=240)


def _residuals(page: Page, sides: Mapping[str, Sequence[Compared]]) -> None:
    page.section("Residuals")
    page.text("Measured less simulated. Lines are the mean in each bin, bands its root mean square either side of "
              "zero; what is left after follows no axis where the model has everything.", "note")
    for name, parts in sides.items():
        page.heading(name)
        _by_direction(page, parts)
        unit = parts[0].block.relation.unit
        for signal, word, axis in SIDES:
            along, before, after = joined(parts, signal)
            if along.size and float(np.ptp(along)) > 0.0:
                centres = binned(along, before, bins_of(along.size))[0]
                page.plot(f"{name} by {word}", centres, _banded(along, before, after), axis, unit,
                          linked=f"{signal} bins", height=190)
        _loops(page, name, parts)


def _banded(along: np.ndarray[Any, Any], before: np.ndarray[Any, Any], after: np.ndarray[Any, Any]) -> list[Series]:
    series = []
    for label, residual, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        _, mean, square = binned(along, residual, bins_of(along.size))
        series += [Series(label, -square, colour, high=square, width=0.3), Series(label, mean, colour, width=1.8)]
    return series


def _by_direction(page: Page, parts: Sequence[Compared]) -> None:
    masks = directions(parts)
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    unit = parts[0].block.relation.unit
    if masks:
        page.table(("rope", "samples", f"mean before ({unit})", "after", f"rms before ({unit})", "after"), [
            (word, int(mask.sum()), float(before[mask].mean()), float(after[mask].mean()), rms(before[mask]),
             rms(after[mask])) for word, mask in masks.items() if mask.any()])


def _loops(page: Page, name: str, parts: Sequence[Compared]) -> None:
    """Plot the mean residual by load, pulling and paying out apart: friction opens a loop, a gain a slope."""
    masks = directions(parts)
    load, before, after = joined(parts, "tension_start_n")
    if not masks or load.size != sum(p.measured.size for p in parts) or float(np.ptp(load)) <= 0.0:
        return
    bins, series = bins_of(load.size), list[Series]()
    for word, dash in (("pulled", False), ("paid out", True)):
        if not masks[word].any():
            continue
        for label, residual, colour in (("before", before, BEFORE), ("after", after, AFTER)):
            along = np.concatenate([load[masks[word]], [load.min(), load.max()]])
            mean = binned(along, np.concatenate([residual[masks[word]], [0.0, 0.0]]), bins)[1]
            series.append(Series(f"{word}, {label}", mean, colour, dash=dash))
    centres = binned(load, before, bins)[0]
    page.plot(f"{name} by load and direction", centres, series, "tension_start_n (N)", parts[0].block.relation.unit,
              linked="tension_start_n bins", height=190)


def _ranking(page: Page, found: Diagnosis) -> None:
    page.section("What was tried")
    if found.found is None:
        page.text("Nothing was fitted.", "note")
        return
    base, best, models = found.found.baseline, found.found.best, found.found.models
    whole = base.score - best.score
    page.text(f"{len(models)} models were fitted in full, each judged on cycles it was not fitted on. A share of 100 % "
              "is what the chosen model gains; a model is a rival from 85 % on and within 10 % of its RMSE.", "note")
    rows: list[tuple[Cell, ...]] = []
    for model in models[:MODELS_SHOWN]:
        share = 100.0 * (base.score - model.score) / whole if whole > 0.0 else None
        behind = 100.0 * (math.sqrt(max(model.score, 0.0) / best.score) - 1.0) if best.score > 0.0 else None
        rows.append((" + ".join(model.names) or "healthy", "chosen" if model is best else "rejected", share, behind,
                     model.score))
    page.table(("model", "", "share of the gain (%)", "unseen RMSE above the chosen (%)", "χ² on unseen cycles"), rows,
               tall=len(rows) > 15)


def _limits(page: Page, found: Diagnosis) -> None:
    page.section("Detection limit")
    limit = found.detection_limit
    if not limit:
        page.text("Not available for these data.", "note")
        return
    page.facts({name: _told(value) for name, value in limit.items() if not isinstance(value, Mapping | list)})
    for name, value in limit.items():
        if isinstance(value, Mapping) and value:
            page.heading(name)
            page.facts({key: _told(one) for key, one in value.items()})


def _told(value: object) -> Cell:
    if value is None:
        return UNKNOWN
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_told(one)}" for key, one in value.items())
    return value if isinstance(value, str | int) else number(value) if isinstance(value, float) else str(value)


def _said(page: Page, found: Diagnosis) -> None:
    page.section("What to keep in mind")
    for warning in found.warnings:
        page.text(warning, "warning")
    if not found.warnings:
        page.text("No warning.", "note")
