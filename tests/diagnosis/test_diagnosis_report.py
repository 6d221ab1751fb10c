"""The page of a diagnosis and its paragraph: what was found is said, drawn and ranked, and nothing is loaded."""

from __future__ import annotations

import csv
import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.data.table import Table, table
from diagnosis.findings import Findings
from diagnosis.judgement.verdict import Figures
from diagnosis.problem.fit import solve
from diagnosis.problem.problem import build_problem
from diagnosis.report import figure_export, figure_tables, residual_picture, residuals, words
from diagnosis.report.diagnosis_page import build, write
from diagnosis.report.headline import change, headline, healthy_value
from diagnosis.report.remaining import concentrated
from diagnosis.search.search import FittedEffects, SearchResult
from parameters import InputError
from physics.effects.catalogue import CATALOGUE
from physics.relations.relation import RELATIONS
from tests.hidden.bench import Bench
from tests.hidden.walk import trial
from trial.report.page import Page


@pytest.fixture(scope="module")
def measured() -> Table:
    """Four gait cycles of the bench written apart, its sheath rubbing too much."""
    return table("rubbing.csv", trial(Bench(cap=0.25), seed=1, cycles=4))


@pytest.fixture(scope="module")
def found(measured: Table) -> Findings:
    """A diagnosis as the finder gives it, of two models fitted here."""
    setting = build_problem([measured], (), None)
    candidate = next(c for c in setting.offered if c.name == "cable_friction")
    free = tuple(f for f in setting.reference.nuisance if f.name not in candidate.parameters)
    plain = solve(setting.problem, setting.reference.values, setting.reference.nuisance)
    fitted = solve(setting.problem, {**plain.values, **candidate.starts[-1]}, (*free, *candidate.frees))
    base, best = (FittedEffects(effects, fit, setting.problem, setting.folds)
                  for effects, fit in (((), plain), ((candidate,), fitted)))
    figures = {name: Figures(relation.unit, name in setting.checked, 0.25, 2.0, 0.5, 2.2, 0.6, 75.0, 70.0, 79.0)
               if name in setting.checked else Figures(relation.unit, False) for name, relation in RELATIONS.items()}
    cause = {"effect": "cable_friction", "site": "cable", "gain_percent": 75.0, "parameters": {
        "mu1": {"value": fitted.values["mu1"], "low": 0.1, "high": 0.2, "unit": ""}},
             "was": {"mu1": setting.reference.values["mu1"]}}
    return Findings("ambiguous", [cause], ["cable_friction", "fabric_friction"], "known_bend", figures,
                    ["the clock is told from one column"], {
                         "cable_friction": {"parameter": "mu1", "value": 0.02, "unit": ""},
                         "slack": {"parameter": "slack", "value": None, "unit": "m"}}, 1.0, None, "nominal",
                    SearchResult(base, best, (best, base)))


def test_the_paragraph_says_cause_gain_class_and_what_to_do(found: Findings) -> None:
    said = words.paragraph(found)
    assert CATALOGUE["cable_friction"].words in said
    assert "falls by 75 % (95 %: 70 … 79 %), from 2 to 0.5" in said
    assert "from 2.2 to 0.6" in said
    assert "cannot tell this from fabric_friction (the fabric rubs on the knee" in said
    assert "change the sheath's bend by a known angle" in said


@pytest.mark.parametrize(("verdict", "says"), [
    ("none", "Nothing was found"), ("refused", "contradict themselves"), ("unexplained", "no effect of the catalogue"),
])
def test_every_verdict_has_its_words(verdict: str, says: str) -> None:
    assert says in words.paragraph(Findings(verdict))


def test_the_page_draws_every_checked_relation_from_every_side(found: Findings, measured: Table) -> None:
    html = build(found, [measured], [measured]).html()
    for name, figures in found.relations.items():
        sides = set(re.findall(rf'aria-label="{name} by ([a-z ]+)"', html))
        wanted = {"phase", "load", "knee angle", "rope", "time", "load and direction"} if figures.checked else set()
        assert sides == wanted
        assert (f'aria-label="{name}: {RELATIONS[name].output}"' in html) == figures.checked
    assert "Held-out trials" in html
    assert "the clock is told from one column" in html


def test_the_page_ranks_what_was_rejected(found: Findings, measured: Table) -> None:
    html = build(found, [measured], []).html()
    assert re.search(r"<td[^>]*>cable_friction</td><td[^>]*>chosen</td>", html)
    assert re.search(r"<td[^>]*>as simulated</td><td[^>]*>the simulation as it was</td>", html)


def test_the_page_says_what_could_have_been_seen(found: Findings, measured: Table) -> None:
    html = build(found, [measured], []).html()
    rows = re.findall(r"<td[^>]*>(cable_friction|slack)</td>" + 5 * r"<td[^>]*>([^<]*)</td>", html)
    assert [(row[0], row[2], row[5]) for row in rows] == [
        ("cable_friction", "0.02", "yes: found"), ("slack", "–", "no")]


def test_first_come_what_is_wrong_by_how_much_what_it_costs_and_what_to_do(found: Findings,
                                                                           measured: Table) -> None:
    told = headline(found)
    old = healthy_value(found.causes[0], "mu1")
    new = found.causes[0]["parameters"]["mu1"]["value"]
    assert old == pytest.approx(0.08, rel=0.5)
    assert f"mu1 {old:.3g} → {new:.3g} (95 %: 0.1 … 0.2; old: the nominal bench)" in told.wrong
    assert "cannot tell it from: fabric_friction" in told.wrong
    # the fixture's figures: 2 before, 0.5 after; √(2² − 0.5²) = 1.94
    assert re.match(r"It costs 1\.94 N RMS of predicted force: 2 N before, 0\.5 N with it", told.cost)
    assert "healthy trials leave 0.25 N" in told.cost
    assert told.todo.startswith("To tell them apart, run known_bend")
    html = build(found, [measured], []).html().partition("<main>")[2]
    first = [html.index(text) for text in (
        "mu1 0.", "It costs 1.94 N", "To tell them apart, run", "residual over gait phase", "START over END, tension",
        "Root mean square on cycles", "What was tried")]
    assert first == sorted(first)


@pytest.mark.parametrize(("changed", "sentence"), [
    ({"verdict": "none", "causes": [], "rivals": [], "experiment": None}, "Nothing is wrong that these trials show"),
    ({"verdict": "unexplained", "causes": [], "rivals": [], "experiment": None}, "no effect of the catalogue explains"),
    ({"verdict": "refused", "causes": [], "warnings": ["knee is not sampled."]}, "knee is not sampled."),
    ({"verdict": "found", "rivals": ["cable_friction"], "experiment": None}, "--controller-model extended.toml"),
    ({"undecided": "step did not decide between A, B: both meet it."}, "Step did not decide between A, B: both"),
])
def test_every_verdict_has_its_first_lines(found: Findings, changed: dict[str, Any], sentence: str) -> None:
    assert sentence in " ".join(headline(dataclasses.replace(found, **changed)))


@pytest.mark.parametrize(("after", "says"), [
    (0.2, "misses START by 0.23 N RMS, 0.2 N with what was found."),
    (0.277, "misses START by 0.23 N RMS, which what was found does not lower: the name rests on the relations")])
def test_a_name_never_makes_the_headline_worse(found: Findings, after: float, says: str) -> None:
    told = {"signals": ["tension_start_n"], "before_rms_n": 0.23, "after_rms_n": after, "on": "holdout"}
    cost = headline(dataclasses.replace(found, simulation=told)).cost
    assert says in cost
    known = headline(dataclasses.replace(found, simulation={**told, "healthy_rms_n": 0.162})).cost
    assert "misses START by 0.23 N RMS (its healthy trials by 0.162 N), " in known
    assert "0.277" not in cost


def test_a_length_is_written_in_millimetres(found: Findings) -> None:
    cause: dict[str, Any] = {
        "effect": "presliding", "site": "cable", "gain_percent": 30.0, "was": {"presliding": 4.73e-5}, "parameters": {
            "presliding": {"value": 4.67e-4, "low": 3.58e-4, "high": 5.77e-4, "unit": "m"}}}
    assert change(found, cause, "presliding").startswith("presliding 0.0473 → 0.467 mm (95 %: 0.358 … 0.577; old: ")
    far = {**cause, "parameters": {"presliding": {"value": 0.5, "low": 0.4, "high": 0.6, "unit": "m"}}}
    assert "0.5 m (95 %: 0.4 … 0.6" in change(found, far, "presliding")


def test_the_detection_limit_never_contradicts_what_was_found(found: Findings) -> None:
    change = found.causes[0]["parameters"]["mu1"]["value"] - healthy_value(found.causes[0], "mu1")
    for limit in (None, 5.0, 0.001):
        told = dataclasses.replace(found, detection_limit={
            "cable_friction": {"parameter": "mu1", "value": limit, "unit": ""},
            "start_gain": {"parameter": "start_gain", "value": 0.5, "unit": ""},
            "end_gain": {"parameter": "end_gain", "value": 0.01, "unit": ""}})
        named, beyond, within = figure_tables.limit_rows(told)
        assert named[5] == "yes: found"
        assert named[2] == pytest.approx(min(abs(change), math.inf if limit is None else limit))
        assert (beyond[5], within[5]) == ("only beyond the likely range", "the larger ones")


def test_the_picture_has_both_branches_and_less_residual_after(found: Findings, measured: Table) -> None:
    sides = residuals.compared(found, [measured])
    one = residual_picture.residual(found, sides)
    assert one is not None
    assert one.word == "gait phase"
    rising, falling = residual_picture.loops(sides)
    both = np.isfinite(rising.measured) & np.isfinite(falling.measured)
    assert both.sum() > 50
    assert np.mean(rising.measured[both] - falling.measured[both]) > 1.0  # N: pulling takes more START for one END
    left = [np.nanmean(np.abs(getattr(rising, which) - rising.measured)) for which in ("before", "after")]
    assert left[1] < left[0]


def test_figures_are_exported_as_pictures_and_tables(found: Findings, measured: Table, tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    made = figure_export.write(found, [measured], folder)
    names = sorted(path.name for path in made)
    assert names == sorted(figure_export.NAMES) == sorted(path.name for path in folder.iterdir())
    assert (folder / "loop.png").read_bytes().startswith(b"\x89PNG")
    (row,) = list(csv.DictReader((folder / "causes.csv").read_text().splitlines()))
    assert (row["effect"], row["parameter"]) == ("cable_friction", "mu1")
    assert float(row["old"]) < float(row["new"])
    assert len(list(csv.DictReader((folder / "residual.csv").read_text().splitlines()))) > 10
    with pytest.raises(InputError, match="give another folder or --overwrite"):
        figure_export.write(found, [measured], folder)
    figure_export.write(found, [measured], folder, overwrite=True)
    with pytest.raises(InputError, match="is a file; give a folder"):
        figure_export.write(found, [measured], folder / "loop.png")


def test_what_is_unexplained_is_told_by_place_and_size(found: Findings, measured: Table) -> None:
    strange = dataclasses.replace(found, verdict="unexplained", causes=[], rivals=[])
    html = build(strange, [measured], []).html()
    # the fixture's figures: 0.5 after, over a floor of 0.25
    assert "2 times what healthy trials leave" in html
    assert re.search(r"Half of its square lies at \d+ … \d+ % of gait and START at", html)


def test_a_fault_of_the_wire_is_told_as_one(measured: Table) -> None:
    cause = {"effect": "lost_pdo", "site": "bus", "gain_percent": 100.0, "parameters": {
        "lost_share": {"value": 0.05, "low": 0.04, "high": 0.06, "unit": ""}}}
    told = Findings("ambiguous", [cause], ["lost_pdo", "late_pdo"], "bus_log", {
        name: Figures(relation.unit, False) for name, relation in RELATIONS.items()})
    html = build(told, [measured], []).html()
    assert "late_pdo (PDOs arrive" in html
    assert "mend the wire, record again" in html
    assert "no calibration fits" not in html
    assert "for want of columns" not in html


def test_half_of_the_squares_is_found_where_it_lies() -> None:
    along = np.linspace(0.0, 100.0, 1001)
    low, high = concentrated(along, np.where((along > 20.0) & (along < 24.0), 1.0, 0.01))
    # bins of 2: half of what lies in 20…24 is one or two of them
    assert 20.0 <= low < high <= 24.0


def test_a_browser_shows_it_with_nothing_fetched(
    found: Findings, measured: Table, browser: Any, tmp_path: Path
) -> None:
    path = tmp_path / "diagnosis.html"
    write(found, [measured], [measured], path)
    browser.open(path)
    assert browser.requests == [path.resolve().as_uri()]
    assert browser.complaints == []
    drawn = browser.run("document.querySelectorAll('.plot[role=img] canvas').length")
    assert drawn == browser.run("document.querySelectorAll('.plot[role=img]').length") > 20
    assert browser.run("document.documentElement.scrollWidth <= innerWidth")
    legends = set(browser.run("[...document.querySelectorAll('.legend')].map(l => l.innerText.trim())"))
    assert "" not in legends


def test_the_page_is_written_whole_and_loads_nothing(found: Findings, measured: Table, tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.html"
    assert write(found, [measured], [], path) == path.stat().st_size
    html = path.read_text(encoding="utf-8")
    assert "default-src 'none'" in html
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=", html)


def test_a_refused_diagnosis_has_a_page_too(measured: Table) -> None:
    html = build(Findings("refused", warnings=["velocity is no derivative"]), [measured], []).html()
    assert "velocity is no derivative" in html
    assert "contradict themselves" in html


def test_residuals_are_what_was_measured_less_what_was_simulated(found: Findings, measured: Table) -> None:
    parts = residuals.compared(found, [measured])
    assert set(parts) == {name for name, figures in found.relations.items() if figures.checked}
    first = parts["friction"][0]
    assert residuals.rms(first.after) < 0.5 * residuals.rms(first.before)
    assert np.isin(first.measured, first.signals["tension_start_n"]).all()


def test_bins_hold_the_mean_and_the_spread() -> None:
    along = np.repeat([0.0, 1.0], 50)
    centres, mean, square = residuals.binned(along, np.tile([3.0, 1.0], 50), bins=2)
    np.testing.assert_allclose(centres, [0.25, 0.75])
    np.testing.assert_allclose(mean, 2.0)
    np.testing.assert_allclose(square, np.sqrt(5.0))
    assert np.isnan(residuals.binned(np.append(along, 9.0), np.zeros(101), bins=9)[1][-1])


def test_a_rig_that_nothing_is_known_of_is_not_told_to_use_this_bench(found: Findings) -> None:
    elsewhere = dataclasses.replace(found, reference="none", experiment="two_peaks")
    assert "bowden trial" not in words.paragraph(elsewhere)
    assert "bowden trial --experiment two_peaks" in words.paragraph(dataclasses.replace(found, experiment="two_peaks"))


@pytest.mark.parametrize(("warning", "reason"), [
    ("a.csv: no relation can be checked (servo_position_m is missing).", "Columns are missing"),
    ("a.csv: 2 cycles; expected at least 3, so that some stay unseen.", "The trials are too short"),
    ("a.csv: velocity is no derivative.", "These data contradict themselves")])
def test_missing_too_short_and_contradicting_are_three_reasons(warning: str, reason: str) -> None:
    found = Findings("refused", warnings=[warning])
    assert headline(found).wrong.startswith(reason)
    assert warning in headline(found).wrong
    assert words.paragraph(found).startswith(reason)


def test_a_relation_without_its_columns_has_no_row_and_a_nominal_trial_no_gain(found: Findings) -> None:
    page = Page("a")
    page.section("b")
    name = next(name for name, one in found.relations.items() if one.checked)
    unseen = dataclasses.replace(found, relations={
        **found.relations, "unheard_of": dataclasses.replace(found.relations[name], checked=False)})
    figure_tables.relations(page, unseen)
    assert "unheard_of" not in page.html()
    assert "gain (%)" in page.html()
    nominal = Page("a")
    nominal.section("b")
    figure_tables.relations(nominal, dataclasses.replace(found, candidates=[{"effect": "slack"}]))
    assert name in nominal.html()
    assert "gain (%)" not in nominal.html()
