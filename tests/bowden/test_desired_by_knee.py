"""A desired force by phase and knee angle, through the wire: a table, and a function that becomes one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bowden.cli.app import run
from physics.laws import desired_force
from tests.stride_files import written

FUNCTION = """
from physics.laws import desired_force

def by_knee(percent, knee_rad):
    return float(desired_force(percent, 30.0)) * (1.0 - min(0.2, max(-0.2, knee_rad + 0.3)))

def broken(percent, knee_rad):
    return 1.0 / (7.0 - percent)

def pushes(percent, knee_rad):
    return -1.0
"""


def wanted(percent: Any, knee_rad: Any) -> Any:
    return desired_force(percent, 30.0) * (1.0 - np.clip(knee_rad + 0.3, -0.2, 0.2))


@pytest.fixture
def function(tmp_path: Path) -> str:
    (tmp_path / "assist.py").write_text(FUNCTION, encoding="utf-8")
    return f"{tmp_path / 'assist.py'}:"


def table(path: Path, angles: range = range(-100, 25, 5)) -> Path:
    rows = [f"{percent},{degrees},{float(wanted(percent, np.radians(degrees)))!r}"
            for percent in range(100) for degrees in angles]
    path.write_text("\n".join(["gait_percent,knee_angle_deg,desired_force_n", *rows]) + "\n", encoding="utf-8")
    return path


def trial(folder: Path, capsys: pytest.CaptureFixture[str], name: str, *options: str) -> dict[str, Any]:
    status = run(["trial", "--controller", "extended", "--period", "1.2", "-o", str(folder / name), "--json",
                  *options])
    told = capsys.readouterr().out
    assert status == 0, told
    return json.loads(told)


def test_the_force_of_a_function_goes_by_phase_and_knee_angle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], function: str
) -> None:
    from trial import read

    knee = written(tmp_path / "strides.csv")
    found = trial(tmp_path, capsys, "function.mcap", "--knee", str(knee), "--strides", "4", "--seed", "2",
                  "--desired", f"{function}by_knee")
    assert found["outcome"] == "completed"
    assert found["walk"]["rmse_percent"]["worst"] < 1.2
    columns = read.open(tmp_path / "function.mcap").columns
    loaded = (columns["cycle"] >= 0) & (columns["desired_force_n"] > 5.0)
    apart = columns["desired_force_n"] - wanted(columns["gait_percent"], columns["knee_angle_rad"])
    # the force is that at the knee angle led on by a few milliseconds, on straight lines between angles
    assert np.abs(apart[loaded]).max() < 0.5
    assert np.ptp(columns["desired_force_n"][loaded] - desired_force(columns["gait_percent"], 30.0)[loaded]) > 1.5
    assert run(["replay", str(tmp_path / "function.mcap"), "--onto", "controller"]) == 0


def test_a_table_on_the_clock_is_followed_at_the_measured_angle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = trial(tmp_path, capsys, "table.mcap", "--cycles", "2", "--desired", str(table(tmp_path / "table.csv")))
    assert found["outcome"] == "completed"
    assert found["peak_n"] == pytest.approx(36.0, rel=1e-3)
    assert found["true_relative_rmse_percent"] < 1.0


@pytest.mark.parametrize(("name", "options", "sentence"), [
    ("by_knee", ["--controller", "paper"], "controller paper: follows no desired force that depends on the knee angle"),
    ("broken", [], "at 7 % of the gait and -1.75 rad it raised ZeroDivisionError"),
    ("pushes", [], "at 0 % of the gait and -1.75 rad it is -1 N, expected 0 to 1000; mend it."),
    ("lacks", [], "cannot be imported (AttributeError"),
])
def test_an_unusable_function_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], function: str, name: str, options: list[str], sentence: str
) -> None:
    assert run(["trial", "--desired", f"{function}{name}", "-o", str(tmp_path / "none.mcap"), *options]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "none.mcap").exists()


@pytest.mark.parametrize(("remove", "sentence"), [
    (slice(3, 4), "2499 rows for 100 phases and 25 knee angles; give one row for each phase and angle."),
    (slice(1 + 25 * 40, 1 + 25 * 50), "gait_percent has steps of 11 %, at most 5 are bridged; give a finer table."),
])
def test_an_incomplete_table_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], remove: slice, sentence: str
) -> None:
    path = table(tmp_path / "table.csv")
    rows = path.read_text().splitlines()
    del rows[remove]
    path.write_text("\n".join(rows) + "\n")
    assert run(["trial", "--desired", str(path), "-o", str(tmp_path / "none.mcap")]) == 2
    assert sentence in capsys.readouterr().err
