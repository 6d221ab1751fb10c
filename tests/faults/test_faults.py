"""The matrix in CI: a share of its rows always, every row with `-m faults`; each keeps its bounds and its name."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import supervision
from eds.declaration import SHAPES
from tests.faults import cover, names
from tests.faults.argument import ACTIONS, HAZARDS
from tests.faults.judge import Verdict
from tests.faults.names import name_of
from tests.faults.page import read, write
from tests.faults.rows import ROWS
from tests.faults.stage import OF_GAIT

ROOT = Path(__file__).parents[2]
QUICK = "|".join(f"^{name}$" for name in (
    "START stuck at 0", "START × 0.5", "START cut off", "END stuck at 0", "servo encoder frozen", "servo stage dead",
    "targets lost", "knee encoder sign flipped", "rope snapped at the drum", "rope jammed in its sheath",
    "another master's targets", "foreign NMT stop", "foreign SDO write of 60B0", "SYNC doubled",
    "one knee frame of 2·10⁹ mdeg", "SIGTERM", "servo's velocity feedback reversed", "servo's velocity feedback zero",
    "an error inside a cycle", "calibration: stiffness × 0.5", "calibration: swing × 2"))

GAITS = "^paper|^friction, 2|^extended, 2"
"""Gaits of the matrix that CI runs."""


def matrix(tmp_path: Path, *arguments: str) -> list[dict[str, Any]]:
    """Run rows in a process of their own, which has one thread and may be forked."""
    path = tmp_path / "told.jsonl"
    run = subprocess.run([sys.executable, "-m", "tests.faults.run", "--kept", str(path), *arguments], cwd=ROOT,
                         capture_output=True, text=True, check=False)
    assert path.exists(), run.stdout + run.stderr
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def test_the_matrix_has_a_hundred_rows_and_each_its_own_name() -> None:
    assert len(ROWS) >= 100
    assert len({row.name for row in ROWS}) == len(ROWS)


def test_every_unsafe_control_action_has_rows_and_its_hazard_is_one_of_the_pages() -> None:
    assert {row.action for row in ROWS} == set(ACTIONS)
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    assert [hazard for hazard in HAZARDS if f"| {hazard} |" not in page] == []
    assert {action.hazard for action in ACTIONS} == set(HAZARDS)


def test_a_name_is_what_is_left_of_a_sentence_without_its_figures() -> None:
    jammed = name_of("signal implausible: START, or a path that is jammed: START against END by friction is -5.0 N, "
                     "expected about 3.4 N")
    assert jammed == names.START_OR_PATH
    lost = name_of("inputs too old: start missed 5 cycles in a row (servo: 0x8250, RPDO time-out)")
    assert lost == names.old("start")
    assert name_of("emergency message: knee: 0x7305, incremental sensor fault") == names.emergency("knee", 0x7305)


@pytest.mark.slow
def test_defects_once_found_are_said_named_and_bounded(tmp_path: Path) -> None:
    told = matrix(tmp_path, "--rows", QUICK, "--moments", "peak", "start")
    assert len(told) == QUICK.count("|") + 1
    assert [(row["name"], row["moment"], row["faults"]) for row in told if row["faults"]] == []


@pytest.mark.slow
def test_slow_faults_are_said_before_they_move_end_by_ten_newtons(tmp_path: Path) -> None:
    """A gain that fades, a sheath that slips and an encoder that creeps, in the shortest of the slow gaits."""
    rows = "START's gain|slips by 2 mm|creeps by 0.31"
    told = matrix(tmp_path, "--rows", rows, "--walks", "^paper, 1.1 s", "--moments", "idle")
    assert len(told) == rows.count("|") + 1
    assert [(row["name"], row["faults"]) for row in told if row["faults"]] == []
    assert all("against the" in row["said"] for row in told)


@pytest.mark.faults
def test_every_row_keeps_its_bounds(tmp_path: Path) -> None:
    """Every fault that begins at once, and the slow ones in five of their gaits; `make faults` runs all gaits."""
    told = matrix(tmp_path, "--walks", GAITS)
    assert [(row["name"], row["moment"], row["faults"]) for row in told if row["faults"]] == []
    assert len(told) >= 250


def test_a_knee_whose_feedback_fails_is_let_go_and_the_leg_keeps_its_bounds(tmp_path: Path) -> None:
    """A drive that braked by the failed feedback swung the leg by 84 degrees beyond its course at 990 degrees/s."""
    faults = "^knee encoder sign flipped|^knee's velocity feedback reversed"
    told = matrix(tmp_path, "--gait", "extended", "2.0", "--rows", faults, "--moments", *OF_GAIT[::4])
    assert len(told) == 2 * len(OF_GAIT[::4])
    assert [(row["name"], row["moment"], row["faults"]) for row in told if row["faults"]] == []
    assert max(row["torque_ms"] for row in told) < 5.0


@pytest.mark.slow
def test_a_jog_watches_the_axis_that_it_moves(tmp_path: Path) -> None:
    """A knee whose encoder stood still went on unwatched to 845 degrees/s, and END to 67 N."""
    told = matrix(tmp_path, "--cover", "--walks", "^jog$", "--rows", "^knee encoder frozen$")
    assert told
    assert [(row["moment"], row["faults"]) for row in told if row["faults"]] == []
    assert max(row["peak_end_n"] for row in told) < 10.0


@pytest.mark.parametrize("fault", ["Ctrl-C", "END cut off", "servo stage reversed"])
@pytest.mark.slow
def test_a_leg_in_swing_is_braked_before_it_is_let_go(tmp_path: Path, fault: str) -> None:
    """It coasted on to 22 degrees of extension."""
    told = matrix(tmp_path, "--gait", "paper", "1.1", "--rows", f"^{fault}$", "--moments", "85 %", "90 %")
    assert len(told) == 2
    assert max(row["off_deg"] for row in told) < 5.0


@pytest.mark.faults
def test_every_stop_of_the_covering_sample_keeps_its_bounds(tmp_path: Path) -> None:
    """One run in seven; `make faults` runs all of them."""
    told = matrix(tmp_path, "--cover", "--every", "7")
    assert [(row["name"], row["moment"], row["walk"], row["faults"]) for row in told if row["faults"]] == []
    assert len(told) >= 300


def test_the_covering_sample_has_every_fault_at_every_moment_in_every_controller_period_and_bench() -> None:
    sampled = cover.sample(ROWS, motions=False)
    runs = [(row.name, moment, walk) for walk, rows in sampled.items() for row in rows for moment in row.moments]
    sudden = {row.name for row in ROWS if not row.gradual and row.moments != ("start",)}
    assert {(name, moment) for name, moment, _ in runs} == {(name, moment) for name in sudden for moment in OF_GAIT}
    assert len(runs) == len(sudden) * len(OF_GAIT)
    assert {walk.controller for _, _, walk in runs} == set(cover.CONTROLLERS)
    assert {walk.period_s for _, _, walk in runs} == set(cover.PERIODS)
    assert {walk.shape for _, _, walk in runs} == set(SHAPES)


def test_a_run_of_some_rows_replaces_those_rows_alone(tmp_path: Path) -> None:
    path = tmp_path / "faults.md"
    first = Verdict("a", "peak", 0.5, True, "said", 1.0, 2.0, 0.1, 0.0, True, "", (), torque_ms=3.0)
    second = first._replace(name="b", faults=("leg off", "END"))
    write(path, [first, second], ["## The search", "", "one"])
    write(path, [first._replace(detected_ms=0.7)])
    assert read(path.with_suffix(".csv"))[0].detected_ms == 0.7
    assert read(path.with_suffix(".csv"))[1].faults == second.faults
    assert path.read_text(encoding="utf-8").endswith("## The search\n\none\n")


def test_false_alarms_are_bounded_by_count_and_by_the_tail() -> None:
    """Without an alarm by −ln 0.05; with a Pareto law of exponent 3 through the trials, by that law's own share."""
    assert supervision.most_alarms(0) == pytest.approx(2.996, abs=1e-3)
    greatest = 0.1 * (np.arange(1, 10_001) / 10_000.5) ** (-1.0 / 3.0)
    share, exponent, high = supervision.tail(greatest)
    assert exponent == pytest.approx(3.0, rel=0.02)
    assert share == pytest.approx(1e-3, rel=0.1)
    assert share < high < 2.0 * share


@pytest.mark.faults
def test_the_count_of_healthy_trials_runs() -> None:
    run = subprocess.run([sys.executable, "-m", "benchmarks.supervision", "--healthy", "1", "--jobs", "1"], cwd=ROOT,
                         capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 healthy trials, 0 stopped" in run.stdout
