"""The judge itself: what is asked, what is kept, what a bar counts, and the experiments of the hidden bench."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame import put
from bowden.workers import Workers
from master.motion.scripted_experiments import laps
from physics.effects.separating_experiments import SCRIPTED
from tests.hidden import bars, cases, moves, page, run
from tests.hidden.answers import After, Answer, answer, from_json
from tests.hidden.cases import Job


def said(kind: str, hidden: str, rivals: str = "", verdict: str = "", ratio: float = 2.0, after: After | None = None,
         seed: int = 1, altered: bool = False) -> Answer:
    """An answer made up: names are words."""
    names = tuple(rivals.split())
    word = verdict or ("none" if not names else "found" if len(names) == 1 else "ambiguous")
    causes = [{"effect": names[0], "site": "", "gain_percent": 50.0, "parameters": {
        "end_gain": {"value": 1.06, "low": 1.04, "high": 1.08, "unit": ""}}}] if names else []
    return Answer(Job(kind, seed, altered=altered), tuple(hidden.split()), {"end_gain": 1.05}, word, names, causes,
                  ratio, 0.95, 3.0, None, after)


def bar(told: list[Answer], name: str) -> bars.Bar:
    return next(b for b in bars.bars(told) if b.name == name)


def test_classes_names_and_what_does_not_count() -> None:
    told = [said("one", "slack", "slack"), said("one", "slack", "end_gain slack"), said("one", "slack", "end_gain"),
            said("one", "slack", "", "none"), said("one", "slack", "end_gain", ratio=1.2)]
    assert (bar(told, "right class").figure, bar(told, "right class").count) == (50.0, 4)
    assert bar(told, "first name right").figure == 25.0
    assert bar(told, "wrong name").figure == 25.0
    assert bar(told, "wrong name").met is False
    assert bar(told, "mean class size").figure == pytest.approx(4.0 / 3.0)
    assert bar(told, "right class").against == (("slack → end_gain", 1), ("slack → none", 1))
    assert bar(told, f"not counted: residual below {bars.LEAST_RATIO} healthy floors").figure == 20.0


def test_healthy_benches_are_told_apart_by_structure() -> None:
    told = [said("none", "", "slack", altered=True), said("none", ""), said("none", "", altered=True), said("none", "")]
    assert bar(told, "false alarms").figure == 25.0
    assert bar(told, "… on the plain structure").figure == 0.0
    assert bar(told, "… on altered structures").figure == 50.0


def test_the_experiment_counts_where_the_class_held_the_truth() -> None:
    alone, kept, lost = (After("step", "found", names) for names in (("slack",), ("slack", "end_gain"), ("end_gain",)))
    told = [said("one", "slack", "slack end_gain", after=after) for after in (alone, kept, lost, None)]
    told.append(said("one", "slack", "end_gain stiffness", after=alone))
    inside = bar(told, "after the experiment: truth in the class")
    assert (inside.figure, inside.count) == (pytest.approx(200.0 / 3.0), 3)
    assert bar(told, "after the experiment: truth alone").figure == pytest.approx(100.0 / 3.0)


def test_a_pair_counts_where_each_effect_by_itself_would() -> None:
    both = replace(said("two", "slack end_gain", "slack end_gain"), alone=(2.0, 1.5))
    faint = replace(said("two", "slack end_gain", "slack"), alone=(2.0, 1.1))
    counted, every = (bar([both, faint], name) for name in ("two: class", "… of all pairs with a residual: class"))
    assert (counted.figure, counted.count) == (100.0, 1)
    assert (every.figure, every.count, every.met) == (50.0, 2, None)


def test_the_effects_of_a_pair_are_hidden_by_themselves_too() -> None:
    case = cases.case(Job("two", 3, ("end_offset", "start_drift")), healthy=0, cycles=1)
    offset, drift = case.alone
    # the same seed gives the same noise: what differs is the other effect
    assert np.array_equal(offset["tension_end_n"], case.trial["tension_end_n"])
    assert not np.array_equal(offset["tension_start_n"], case.trial["tension_start_n"])
    assert np.array_equal(drift["tension_start_n"], case.trial["tension_start_n"])
    assert cases.case(Job("one", 3, ("end_offset",)), healthy=0, cycles=1).alone == ()


def test_parameters_are_off_by_a_share_of_what_was_hidden() -> None:
    found = list(bars.errors([said("one", "end_gain", "end_gain")]))
    # told 1.06 for 1.05, where 1 is healthy
    assert [(e.effect, round(e.share, 6), e.covered) for e in found] == [("end_gain", 0.2, True)]


def test_a_bar_without_cases_says_nothing() -> None:
    nothing = bar([], "two: class")
    assert math.isnan(nothing.figure)
    assert (nothing.count, nothing.met) == (0, None)


def test_the_matrix_counts_every_case_once() -> None:
    told = [said("one", "slack", "slack"), said("one", "slack", "end_gain"),
            said("wire", "lost_pdo", "", "unexplained"), said("none", ""),
            said("outside", "thump", "", "unexplained"), said("one", "slack", "", ratio=1.0)]
    rows = [line.split("|") for line in page.confusion(told) if line.startswith("| ") and "`" in line]
    numbers = {row[2].strip(" `"): [int(cell) for cell in row[3:-1] if cell.strip()] for row in rows}
    assert {name: sum(row) for name, row in numbers.items()} == {"slack": 2, "lost_pdo": 1, "thump": 1, "nothing": 1}


@pytest.mark.hidden
def test_of_a_pair_each_effect_is_measured_by_itself() -> None:
    job = next(job for job in run.jobs(False, 1000) if job.kind == "two")
    told = answer(job, cycles=5, healthy=1)
    assert len(told.alone) == len(told.hidden) == 2
    assert all(ratio > 0.0 for ratio in told.alone)


def test_a_part_of_the_jobs_is_like_the_whole() -> None:
    whole = run.jobs(False, 1000)
    assert len(whole) >= 600
    assert len({job.seed for job in whole}) == len(whole)
    assert Counter(job.kind for job in whole) == run.FULL
    tenth = Counter(job.kind for job in whole[:len(whole) // 10])
    assert all(abs(tenth[kind] - count / 10) <= 1 for kind, count in run.FULL.items())
    altered = Counter((job.kind, job.names) for job in whole if job.altered)
    every = Counter((job.kind, job.names) for job in whole)
    assert all(abs(altered[key] - count / 2) <= 0.5 for key, count in every.items())


def test_answers_are_kept_and_not_asked_again(tmp_path: Path) -> None:
    asked: list[Job] = []

    def question(job: Job) -> Answer:
        asked.append(job)
        return said(job.kind, "slack", "slack end_gain", after=After("step", "found", ("slack",)), seed=job.seed)

    @contextmanager
    def crew() -> Iterator[Workers]:
        with ThreadPoolExecutor(1) as pool:
            yield Workers(pool, 1)

    wanted = [Job("one", seed) for seed in range(5)]
    path = tmp_path / "answers.jsonl"
    first = run.answered(wanted[:3], run.Kept(path), crew, question)
    with path.open("a", encoding="utf-8") as stream:
        stream.write('{"commit": "cut off", "answer": {"job"\n')
    kept = run.Kept(path)
    told = run.answered(wanted, kept, crew, question)
    assert asked == wanted
    assert told[:3] == first
    assert first[0] == from_json(first[0].as_json())
    assert set(kept.commits) == set(wanted)


def test_the_same_job_draws_the_same_case() -> None:
    one, other = (cases.case(Job("wire", 1, ("lost_pdo",)), cycles=1) for _ in range(2))
    assert one.sizes == other.sizes
    assert all(np.array_equal(one.trial[name], other.trial[name]) for name in one.trial)
    assert not np.array_equal(one.trial["tension_end_n"], cases.case(Job("wire", 2), cycles=1).trial["tension_end_n"])


def test_a_wire_shows_the_newest_value_that_came() -> None:
    job = Job("wire", 2, ("lost_pdo",))
    case = cases.case(job, cycles=2)
    ages = case.trial["start_pdo_age_ns"]
    held = np.flatnonzero(ages > 0)
    assert np.mean(ages > 0) == pytest.approx(case.sizes["lost_share"], abs=0.02)
    start = case.trial["tension_start_n"]
    assert np.array_equal(start[held], start[held - 1])


def test_the_hidden_bench_runs_what_needs_no_hands() -> None:
    # the bus log is any gait: nothing to be run
    assert set(moves.EXPERIMENTS) == set(SCRIPTED) - {"bus_log"}


@pytest.mark.parametrize("name", ["locked_angles", "step", "unload", "two_peaks"])
def test_experiments_of_the_hidden_bench_have_the_catalogue_s_laps(name: str) -> None:
    columns = moves.run(name, cases.NOMINAL, 1)
    assert np.unique(columns["cycle"]).size - 1 == laps(name, 10)
    assert np.all(np.diff(columns["time_s"]) > 0.0)


def test_the_page_s_list_of_identifiable_effects_is_the_judge_s() -> None:
    told = run.DOCS.read_text(encoding="utf-8").split("one gait trial determines")[1].split("The list stands")[0]
    assert tuple(re.findall(r"\w+", told)) == bars.IDENTIFIABLE


def test_only_what_stands_between_the_marks_is_written(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text("before\n<!-- a: begin -->\nold\n<!-- a: end -->\nafter\n", encoding="utf-8")
    put(path, "a", "new")
    assert path.read_text(encoding="utf-8") == "before\n<!-- a: begin -->\nnew\n<!-- a: end -->\nafter\n"
    with pytest.raises(ValueError, match="lacks <!-- b: begin -->"):
        put(path, "b", "new")
