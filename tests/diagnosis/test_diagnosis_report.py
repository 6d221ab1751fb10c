"""The page of a diagnosis and its first lines: what was found is said, drawn and ranked, and nothing is loaded."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from diagnosis.compared_signals import Figures, SignalResiduals
from diagnosis.findings import Findings
from diagnosis.report import figure_export, figure_tables, residual_picture, residuals
from diagnosis.report.diagnosis_page import build, write
from diagnosis.report.headline import (
    Errors,
    change,
    error_sentence,
    gain_sentence,
    headline,
    healthy_value,
    likeliest_sentence,
    none_sentence,
)
from diagnosis.report.residuals import concentrated
from estimation.data.table import Table, table
from parameters import InputError
from physics.bench_model import BenchModel
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS
from tests.hidden.bench import Bench
from tests.hidden.walk import trial
from trial.report.page import Page
from trial.report.words import words


@pytest.fixture(scope="module")
def measured() -> Table:
    """Four gait cycles of the bench written apart, its sheath rubbing too much."""
    return table("rubbing.csv", trial(Bench(cap=0.25), seed=1, cycles=4))


def traced(measured: Table, name: str, slack: float) -> SignalResiduals:
    """Return an output of the trial beside a simulation without friction, and beside one with most of it."""
    keep = slice(None, None, 16)
    speed = np.gradient(measured["servo_position_m"], measured["time_s"])
    before = slack * np.tanh(speed / 1e-3) * measured[name] / 20.0
    along = {n: measured[n][keep] for n in ("time_s", "gait_percent", "knee_angle_rad", "servo_position_m",
                                            "tension_start_n", "tension_end_n")}
    return SignalResiduals(name, "N", measured[name][keep], before[keep], 0.9 * before[keep], 0.25 * before[keep],
                           measured["cycle"][keep].astype(np.intp), {**along, "rope_m_s": speed[keep]})


@pytest.fixture(scope="module")
def found(measured: Table) -> Findings:
    """A diagnosis as the finder gives it, with figures that are easy to check."""
    traces = {name: [traced(measured, name, slack)] for name, slack in (("tension_start_n", 2.0),
                                                                        ("tension_end_n", 1.0))}
    figures = {"tension_start_n": Figures("N", 0.25, 2.0, 1.9, 0.5, 2.2, 2.1, 0.6, 74.0, 70.0, 79.0),
               "tension_end_n": Figures("N", 0.2, 1.0, 0.9, 0.4, None, None, None, 56.0, 50.0, 65.0)}
    cause = {"effect": "cable_friction", "site": "cable", "gain_percent": 75.0, "parameters": {
        "mu1": {"value": 0.16, "low": 0.1, "high": 0.2, "unit": ""}}, "was": {"mu1": 0.08}}
    shift = {"from": 0.13, "to": 0.25, "low": 0.2, "high": 0.3, "unit": "", "sessions": 12.0}
    evidence = {"log_bayes_factors": {"cable_friction": 80.0, "fabric_friction": 60.0, "slack": 2.0},
                "named_nats": 12.0, "misfit": {}, "error_n": {},
                "shifts": {"cable": shift, "fabric": {**shift, "sessions": 0.5}}}
    simulation = {"before_rms_n": 1.6, "session_rms_n": 1.5, "after_rms_n": 0.45, "healthy_rms_n": 0.23,
                  "gain_percent": 70.0, "gain_interval": [66.0, 73.0], "session_sigma": 8.0, "signals": list(traces)}
    return Findings("ambiguous", [cause], ["cable_friction", "fabric_friction"], "known_bend", figures,
                    ["the clock is told from one column"], {
                         "cable_friction": {"parameter": "mu1", "value": 0.02, "unit": ""},
                         "slack": {"parameter": "slack", "value": None, "unit": "m"}}, 1.0, None, "healthy",
                    simulation, bench=BenchModel({"mu1": 0.08}), part="friction path", evidence=evidence,
                    traces=traces, held_traces=traces)


def test_the_page_draws_every_signal_from_every_side(found: Findings, measured: Table) -> None:
    html = build(found, [measured], [measured]).html()
    for name in found.relations:
        sides = set(re.findall(rf'aria-label="{re.escape(words(name))} by ([A-Za-z ]+)"', html))
        assert sides == {"gait phase", "START", "knee angle", "rope", "time", "START and direction"}
        assert f'aria-label="{words(name)}, simulated from rope and knee motion"' in html
        assert f"{name}: " not in html
    assert "Held-out trials" in html
    assert "the clock is told from one column" in html


def test_the_page_ranks_what_was_fitted(found: Findings, measured: Table) -> None:
    html = build(found, [measured], []).html().rpartition("What was tried")[2]
    rows = re.findall(r"<td[^>]*>(?:<[^>]*>)*(cable friction|fabric friction|slack)(?:<[^>]*>)*</td>"
                      + 3 * r"<td[^>]*>([^<]*)</td>"
                      + "</tr>", html)
    assert [(row[0], row[3]) for row in rows] == [
        ("cable friction", "named"), ("fabric friction", "in the ambiguity set"), ("slack", "less likely")]


def test_the_page_says_what_could_have_been_seen(found: Findings, measured: Table) -> None:
    html = build(found, [measured], []).html()
    rows = re.findall(r"<td[^>]*>(?:<[^>]*>)*(cable friction|slack)(?:<[^>]*>)*</td>"
                      + 5 * r"<td[^>]*>(?:<[^>]*>)*([^<]*)(?:<[^>]*>)*?</td>", html)
    assert [(row[0], row[2], row[5]) for row in rows] == [
        ("cable friction", "0.02", "yes: found"), ("slack", "–", "no")]


def test_first_come_error_cause_ambiguity_set_and_next_step(found: Findings, measured: Table) -> None:
    told = list(headline(found))
    assert told[0] == ("The simulation of this bench misses START and END by 1.60 N in the reference condition, "
                       "1.50 N with this session's constants adapted and 0.45 N with what is named below, on cycles "
                       "that no fit has seen; reference trials miss each other by 0.23 N.")
    assert told[1].startswith("Changed: friction path. cable friction at cable (")
    assert "mu1 0.08 → 0.16 (95 %: 0.1 … 0.2)" in told[1]
    assert told[2] == "It removes 70 % (95 %: 66 … 73) of the error with the session adapted."
    assert told[3].startswith("It is at the rope in its sheath, between START and the fabric. Look for a kink, ")
    assert told[4] == "These data do not separate it from: fabric friction."
    assert told[5].startswith("To separate them, record known_bend: ")
    assert told[6] == "Constants that moved most: cable 0.13 → 0.25."
    html = build(found, [measured], []).html().partition("<main>")[2]
    first = [html.index(text) for text in (
        "mu1 0.08", 'class="bench"', "START over END", "Error of the simulation",
        "misses START and END", "To separate them", "Root mean square on cycles", "over gait phase", "What was tried")]
    assert first == sorted(first)


def test_a_page_without_a_cause_begins_with_what_departs_and_ends_with_what_to_do(
        found: Findings, measured: Table) -> None:
    alone = dataclasses.replace(found, verdict="unexplained", causes=[], rivals=[], experiment=None, unexplained={
        "tension_end_n": {"misfit": 3.0, "rms": 0.9, "floor": 0.2}})
    html = build(alone, [measured], []).html().partition("<main>")[2]
    assert re.search(r'<p class="lead">The trial departs from the model in a way that no effect', html)
    assert re.search(r"What to do</h\d>\s*<p[^>]*>bowden discover, with the same trials", html)
    assert f"The residual is largest in {words('tension_start_n')}: " in html


def test_constants_that_moved_have_prefixed_units(found: Findings) -> None:
    moved = {"cable_compliance": {"from": 1.68e-5, "to": 2.93e-5, "unit": "m/N", "sessions": 4.0},
             "load": {"from": 0.04, "to": -0.07, "unit": "", "sessions": -5.0}}
    [told] = [line for line in headline(dataclasses.replace(found, evidence={"shifts": moved})) if "moved most" in line]
    assert told == "Constants that moved most: load 0.04 → −0.07; cable compliance 16.8 → 29.3 µm/N."


@pytest.mark.parametrize("effect", [*CATALOGUE])
def test_no_name_of_a_program_is_in_the_first_lines(found: Findings, effect: str) -> None:
    parameters = {p.name: {"value": p.likely[1], "low": p.likely[0], "high": p.likely[1], "unit": p.unit}
                  for p in CATALOGUE[effect].parameters}
    cause = {"effect": effect, "site": CATALOGUE[effect].site, "gain_percent": 30.0, "parameters": parameters}
    shifts = {"cable_travel": {"from": 1e-5, "to": 3e-5, "unit": "m", "sessions": 5.0}}
    told = dataclasses.replace(found, causes=[cause], rivals=[effect, *CATALOGUE], evidence={"shifts": shifts})
    raw = re.findall(r"\b[a-z]+_[a-z]\w*", " ".join(headline(told)).replace(f"({CATALOGUE[effect].law})", ""))
    assert set(raw) <= set(EXPERIMENTS)  # names that `bowden trial --experiment` takes


@pytest.mark.parametrize(("changed", "sentence"), [
    ({"verdict": "none", "causes": [], "rivals": [], "experiment": None}, "which no effect of the catalogue explains"),
    ({"verdict": "unexplained", "causes": [], "rivals": [], "experiment": None, "unexplained": {"tension_end_n": {
        "misfit": 3.0, "rms": 0.9, "floor": 0.2}}}, "no effect of the catalogue explains: END is missed by 0.90 N"),
    ({"unexplained": {"tension_end_n": {"misfit": 3.0, "rms": 0.4, "floor": 0.2}}},
     "Something else differs, too: END is missed by 0.40 N, where reference trials miss each other by 0.20 N."),
    ({"unexplained": {"tension_end_n": {"misfit": 3.0, "rms": 0.15, "floor": 0.2}}},
     "END is missed by 0.15 N, but only with constants up to 8 σ outside their scatter between sessions."),
    ({"verdict": "refused", "causes": [], "warnings": ["knee is not sampled."]}, "knee is not sampled."),
    ({"undecided": "step did not decide between A, B: both meet it."}, "Step did not decide between A, B: both"),
    ({"bench": None}, "The simulation of this rig misses"),
    ({"candidates": [{"effect": "slack"}]}, "Run bowden identify first"),
])
def test_every_verdict_has_its_first_lines(found: Findings, changed: dict[str, Any], sentence: str) -> None:
    assert sentence in " ".join(headline(dataclasses.replace(found, **changed)))


AGREES, SESSION, NOTHING = "agrees with the reference", "which is the session's", "no effect of the catalogue explains"
NONE = [(reference, session, floor, AGREES if reference <= 1.5 * floor else SESSION if session <= 1.5 * floor
         else NOTHING) for reference, session in ((0.2, 0.2), (0.3, 0.2), (0.31, 0.3), (0.31, 0.31), (0.9, 0.2),
                                                  (0.9, 0.31), (3.97, 0.2), (3.97, 3.5), (369.0, 205.0))
        for floor in (0.2, 0.55, 205.0)]
"""Errors of the reference condition's model and of the adapted session, the floor, and what is said."""


@pytest.mark.parametrize(("reference", "session", "floor", "words"), NONE)
def test_what_is_said_of_a_trial_without_a_name_follows_from_its_figures(
    reference: float, session: float, floor: float, words: str
) -> None:
    told = none_sentence(Errors(reference, session, None, floor))
    assert words in told
    assert ("agrees" in told) == (reference <= 1.5 * floor)
    if words != AGREES:
        assert f"by {reference:.2f} N" in told
    if words == NOTHING:
        assert f"leave {session:.2f} N" in told


@pytest.mark.parametrize(("percent", "low", "high", "words"), [
    (80.0, 75.0, 84.0, "It removes 80 % (95 %: 75 … 84) of the error"), (4.0, 0.5, 8.0, "It removes 4 %"),
    (2.0, -1.0, 5.0, "It gains nothing on cycles that no fit has seen (2 %, 95 %: -1 … 5)"),
    (-2.0, -6.0, 1.0, "It gains nothing"), (0.0, 0.0, 0.0, "It gains nothing")])
def test_what_is_said_of_a_gain_follows_from_its_interval(percent: float, low: float, high: float, words: str) -> None:
    assert gain_sentence(Errors(1.0, 0.9, 0.5, 0.2, (percent, low, high))).startswith(words)


@pytest.mark.parametrize(("sigma", "words"), [(1.0, "within their scatter"), (3.0, "within their scatter"),
                                              (12.0, "12 σ")])
def test_how_far_the_session_moves_its_constants_is_said(sigma: float, words: str) -> None:
    assert words in none_sentence(Errors(0.9, 0.2, None, 0.2, None, sigma))
    assert words in gain_sentence(Errors(0.9, 0.2, 0.2, 0.2, (1.0, -1.0, 2.0), sigma))


def test_a_trial_without_reference_trials_agrees_with_none() -> None:
    told = none_sentence(Errors(0.9, 0.3))
    assert told.startswith("No effect is named: a bench of the population")
    assert "0.30 N" in told
    assert "reference trials" not in error_sentence(Errors(0.9, 0.3), ["START"])


@pytest.mark.parametrize(("nats", "said"), [
    ({"fabric_wrap": 10.27, "fabric_friction": 10.13, "slack": 1.8},
     "Likeliest, but not named: fabric wrap, fabric friction (10.3 of 12 nats)."),
    ({"fabric_wrap": 6.0, "slack": 2.9}, "Likeliest, but not named: fabric wrap (6.0 of 12 nats)."),
    ({"fabric_wrap": 5.9}, ""), ({"fabric_wrap": -1.0}, ""), ({}, ""),
    # reached, but with a lack of fit: a warning says so
    ({"fabric_wrap": 12.0}, ""),
])
def test_the_likeliest_effect_is_stated_where_it_is_near_the_threshold(nats: dict[str, float], said: str) -> None:
    assert " ".join(likeliest_sentence(nats, 12.0)).startswith(said)
    assert bool(said) == bool(list(likeliest_sentence(nats, 12.0)))


def test_a_trial_without_a_name_has_the_likeliest_effect_among_its_first_sentences(found: Findings) -> None:
    assert found.evidence is not None
    nats = {"fabric_wrap": 10.27, "slack": 1.8}
    near = dataclasses.replace(found, verdict="none", causes=[], rivals=[],
                               evidence={**found.evidence, "log_bayes_factors": nats})
    assert any(sentence.startswith("Likeliest, but not named: fabric wrap (10.3") for sentence in headline(near))
    assert not any(sentence.startswith("Likeliest") for sentence in headline(found))


def test_a_length_is_written_in_millimetres() -> None:
    cause: dict[str, Any] = {
        "effect": "presliding", "site": "cable", "gain_percent": 30.0, "was": {"presliding": 4.73e-5}, "parameters": {
            "presliding": {"value": 4.67e-4, "low": 3.58e-4, "high": 5.77e-4, "unit": "m"}}}
    assert change(cause, "presliding") == "pre-sliding 0.0473 → 0.467 mm (95 %: 0.358 … 0.577)"
    far = {**cause, "parameters": {"presliding": {"value": 0.5, "low": 0.4, "high": 0.6, "unit": "m"}}}
    assert "0.5 m (95 %: 0.4 … 0.6" in change(far, "presliding")


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


def test_a_table_for_programs_has_the_names_of_files(found: Findings, tmp_path: Path) -> None:
    limit = {"cable_friction": {"parameter": "mu1", "value": 0.01, "unit": ""}}
    figure_export.write(dataclasses.replace(found, detection_limit=limit), tmp_path)
    (row,) = csv.DictReader((tmp_path / "detection_limit.csv").read_text().splitlines())
    assert (row["effect"], row["parameter"]) == ("cable_friction", "mu1")


def test_the_picture_has_both_branches_and_less_residual_after(found: Findings) -> None:
    one = residual_picture.residual(found)
    assert one is not None
    assert one.word == "gait phase"
    rising, falling = residual_picture.loops(found.traces)
    both = np.isfinite(rising.measured) & np.isfinite(falling.measured)
    assert both.sum() > 50
    assert np.mean(rising.measured[both] - falling.measured[both]) > 1.0  # N: pulling takes more START for one END
    left = [np.nanmean(np.abs(getattr(rising, which) - rising.measured)) for which in ("before", "after")]
    assert left[1] < left[0]


def test_each_model_s_loop_is_over_its_own_end(found: Findings, measured: Table) -> None:
    (end,) = found.traces["tension_end_n"]
    low = dataclasses.replace(end, before=0.2 * end.measured)  # the reference condition's END gain is a fifth lower
    changed = dataclasses.replace(found, traces={**found.traces, "tension_end_n": [low]})
    plot = residual_picture.loop_plot(changed)
    assert plot is not None
    peak, reference = (np.max(np.asarray(series.x, np.float64)) for series in plot.series[:2])
    assert reference == pytest.approx(0.8 * peak)
    page = build(changed, [measured], [])
    (drawn,) = [one for one in json.loads(page.html().split('id="page-data">')[1].split("</script>")[0])["plots"]
                if one["loop"]]
    assert len({series["x"] for series in drawn["series"]}) > 1


def test_figures_are_exported_as_pictures_and_tables(found: Findings, tmp_path: Path) -> None:
    folder = tmp_path / "figures"
    made = figure_export.write(found, folder)
    names = sorted(path.name for path in made)
    assert names == sorted(figure_export.NAMES) == sorted(path.name for path in folder.iterdir())
    assert (folder / "loop.png").read_bytes().startswith(b"\x89PNG")
    (row,) = list(csv.DictReader((folder / "causes.csv").read_text().splitlines()))
    assert (row["effect"], row["parameter"]) == ("cable_friction", "mu1")
    assert float(row["old"]) < float(row["new"])
    assert len(list(csv.DictReader((folder / "residual.csv").read_text().splitlines()))) > 10
    with pytest.raises(InputError, match="give another folder or --overwrite"):
        figure_export.write(found, folder)
    figure_export.write(found, folder, overwrite=True)
    with pytest.raises(InputError, match="is a file; give a folder"):
        figure_export.write(found, folder / "loop.png")


def test_a_rig_of_another_kind_is_told_what_it_can_record(found: Findings, measured: Table) -> None:
    rig = dataclasses.replace(found, bench=None, reference="healthy", verdict="ambiguous", experiment="two_peaks",
                              rivals=[*found.rivals, "load_dependent_friction"])
    (told,) = (line for line in headline(rig) if line.startswith("To separate them"))
    assert told.startswith("To separate them, record the same strokes at three loads and at three speeds. Look at half")
    html = build(rig, [dataclasses.replace(measured, turning=True)], []).html()
    assert '"angle (\\u00b0)"' in html
    assert 'aria-label="drive, axis, START, transmission, joint, END; changed: transmission"' in html
    assert "likely range" not in html


def test_what_is_unexplained_is_told_by_place_and_size(found: Findings, measured: Table) -> None:
    strange = dataclasses.replace(found, verdict="unexplained", causes=[], rivals=[])
    html = build(strange, [measured], []).html()
    # the fixture's figures: 0.5 with what is named, over a floor of 0.25
    assert "2 times that of reference trials" in html
    assert re.search(r"Half of its square lies at \d+ … \d+ % of gait and START at", html)


def test_a_fault_of_the_wire_is_told_as_one(measured: Table) -> None:
    cause = {"effect": "lost_pdo", "site": "bus", "gain_percent": 100.0, "parameters": {
        "lost_share": {"value": 0.05, "low": 0.04, "high": 0.06, "unit": ""}}}
    told = Findings("ambiguous", [cause], ["lost_pdo", "late_pdo"], "bus_log", {"bus": Figures("s", None, 1e-3, 1e-3)},
                    part="wire", evidence={})
    html = build(told, [measured], []).html()
    assert "do not separate it from: late PDO" in html
    assert "Mend the wire or the converter, record again" in html
    assert "against what a sound wire and converter give" in html


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
    assert browser.run("[...document.querySelectorAll('.wide')].filter(t => t.scrollWidth > t.clientWidth).length") == 0
    tall = """[...document.querySelectorAll('dd, td, .value')].filter(cell => /^[−\\d.]/.test(cell.textContent)
        && cell.offsetHeight > Math.max(cell.offsetWidth, 24)).map(cell => cell.textContent)"""
    assert browser.run(tall) == []
    legends = set(browser.run("[...document.querySelectorAll('.legend')].map(l => l.innerText.trim())"))
    assert "" not in legends


def test_the_changed_part_is_marked_and_nothing_is_drawn_twice(found: Findings, measured: Table, browser: Any,
                                                               tmp_path: Path) -> None:
    write(dataclasses.replace(found, rivals=["cable_friction"]), [measured], [], tmp_path / "a.html")
    browser.open(tmp_path / "a.html")
    red = browser.run("""[...document.querySelectorAll('svg.bench rect')].filter(
        box => box.getAttribute('stroke-width') > 2).map(box => box.parentNode.querySelector('text').textContent)""")
    assert red == ["cable"]
    lines = "bowden.page.plots.filter(plot => plot.loop).flatMap(plot => plot.series.map(line => plot.chart.width))"
    assert len(browser.run(lines)) == 4
    assert min(browser.run(lines)) > 200
    nothing = dataclasses.replace(found, verdict="none", causes=[], rivals=[], experiment=None)
    write(nothing, [measured], [], tmp_path / "b.html")
    browser.open(tmp_path / "b.html")
    assert len(browser.run(lines)) == 3
    assert "with what is named" not in browser.run("document.body.innerText")


def test_the_page_is_written_whole_and_loads_nothing(found: Findings, measured: Table, tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.html"
    assert write(found, [measured], [], path) == path.stat().st_size
    html = path.read_text(encoding="utf-8")
    assert "default-src 'none'" in html
    moved = {"from": 1.34e-5, "to": 3.67e-5, "low": 3.27e-5, "high": 4.07e-5, "unit": "m/N", "sessions": 3.9}
    html = build(dataclasses.replace(found, evidence={**found.evidence, "shifts": {"cable_compliance": moved}}),
                 [measured], []).html()
    assert re.search(r"cable compliance<.*?<td>µm/N</td>.*?13\.4<.*?36\.7<.*?32\.7<.*?40\.7<", html)
    assert not re.search(r"<(?:script|link|img)[^>]+(?:src|href)=", html)


def test_a_refused_diagnosis_has_a_page_too(measured: Table) -> None:
    html = build(Findings("refused", warnings=["velocity is no derivative"]), [measured], []).html()
    assert "velocity is no derivative" in html
    assert "contradict themselves" in html


def test_bins_hold_the_mean_and_the_spread() -> None:
    along = np.repeat([0.0, 1.0], 50)
    centres, mean, square = residuals.binned(along, np.tile([3.0, 1.0], 50), bins=2)
    np.testing.assert_allclose(centres, [0.25, 0.75])
    np.testing.assert_allclose(mean, 2.0)
    np.testing.assert_allclose(square, np.sqrt(5.0))
    assert np.isnan(residuals.binned(np.append(along, 9.0), np.zeros(101), bins=9)[1][-1])


@pytest.mark.parametrize(("warning", "reason"), [
    ("a.csv: has no column servo_position_m; record it.", "Columns are missing"),
    ("a.csv: is of another rig; name trials with --healthy.", "Reference trials of this rig are missing"),
    ("a.csv: 2 cycles; expected at least 3, so that some stay unseen.", "The trials are too short"),
    ("a.csv: velocity is no derivative.", "These data contradict themselves")])
def test_each_reason_of_a_refusal_has_its_words(warning: str, reason: str) -> None:
    found = Findings("refused", warnings=[warning])
    first = next(headline(found))
    assert first.startswith(reason)
    assert warning in first


def test_a_nominal_trial_has_no_gain(found: Findings) -> None:
    nominal = Page("a")
    nominal.section("b")
    figure_tables.relations(nominal, dataclasses.replace(found, candidates=[{"effect": "slack"}]))
    assert '<span title="tension_start_n">START (measured)</span>' in nominal.html()
    assert "gain (%)" not in nominal.html()
