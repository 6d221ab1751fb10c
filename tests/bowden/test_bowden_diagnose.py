"""`bowden diagnose` as it is typed: bad data, what is said where, many trials."""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trial as recorded
from bowden.cli.app import run
from physics.effects.catalogue import CATALOGUE
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

Run = Callable[..., Any]
Columns = dict[str, np.ndarray]
TENSIONS = ("time_s", "cycle", "gait_percent", "servo_position_m", "servo_velocity_m_s", "knee_angle_rad",
            "tension_start_n", "tension_end_n")
"""Columns of the force path, without the drive's force."""
KEYS = ("verdict", "causes", "class", "experiment", "relations", "warnings", "detection_limit", "seconds")


@pytest.fixture(scope="module")
def whole() -> Columns:
    """Four gait cycles at 100 Hz of the bench written apart, its END sensor 3 N off."""
    return {name: values[::10] for name, values in trial(Bench(end_offset=3.0), seed=1, cycles=4).items()}


@pytest.fixture(scope="module")
def walked(whole: Columns) -> Columns:
    """The same with the columns of the force path."""
    return {name: whole[name] for name in TENSIONS}


def written(path: Path, columns: Columns) -> Path:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return path


def cut(columns: Columns, cycles: int) -> Columns:
    return {name: values[columns["cycle"] < cycles] for name, values in columns.items()}


def velocity_in_millimetres(columns: Columns) -> Columns:
    return {**columns, "servo_velocity_m_s": 1e3 * columns["servo_velocity_m_s"]}


def slow_clock(columns: Columns) -> Columns:
    return {**columns, "time_s": 1.25 * columns["time_s"]}


def without_end(level: float) -> Callable[[Columns], Columns]:
    return lambda columns: {**columns, "tension_end_n": np.full(columns["time_s"].size, level)}


def nothing_at_all(columns: Columns) -> Columns:
    return {name: values if name in ("time_s", "cycle", "gait_percent") else np.full(values.size, np.nan)
            for name, values in columns.items()}


def without_cycles_to_2_5_s(columns: Columns) -> Columns:
    rows = columns["time_s"] <= columns["time_s"][0] + 2.5
    return {name: values[rows] for name, values in columns.items() if name not in ("cycle", "gait_percent")}


def holes(columns: Columns) -> Columns:
    end = columns["tension_end_n"].copy()
    end[::3] = np.nan
    return {**columns, "tension_end_n": end}


@pytest.mark.parametrize(("spoilt", "says"), [
    (lambda columns: cut(columns, 2), "2 cycles; expected at least 3"),
    (without_cycles_to_2_5_s, ": 2.5 s; expected at least 3 s"),
    (without_end(7.0), "tension_end_n is constant at 7"),
    (nothing_at_all, "has no column"),
    (holes, "tension_end_n lacks "),
], ids=["two cycles", "2.5 s", "constant", "everything NaN", "a third missing"])
def test_where_nothing_can_be_said_it_is_refused(
    spoilt: Callable[[Columns], Columns], says: str, walked: Columns, bowden: Run, here: Path
) -> None:
    told = bowden("diagnose", written(here / "bad.csv", spoilt(walked)), "--json", "-o", "extended.toml")
    assert told.status == 2
    result = json.loads(told.stdout)
    assert (result["verdict"], result["causes"], result["class"]) == ("refused", [], [])
    assert any("bad.csv" in text and says in text for text in result["warnings"])
    assert not (here / "extended.toml").exists()


@pytest.mark.parametrize(("spoilt", "says"), [
    pytest.param(velocity_in_millimetres, "servo_velocity_m_s is 1000 times the derivative of servo_position_m: it is "
                 "in mm/s", marks=pytest.mark.exhaustive),
    pytest.param(slow_clock, "the clock of time_s runs 1.25 times too slow", marks=pytest.mark.exhaustive),
    pytest.param(without_end(np.nan), "tension_end_n is empty", marks=pytest.mark.exhaustive),
], ids=["velocity", "clock", "no END"])
def test_another_unit_or_clock_is_warned_of_with_its_factor(
    spoilt: Callable[[Columns], Columns], says: str, walked: Columns, bowden: Run, here: Path
) -> None:
    told = bowden("diagnose", written(here / "odd.csv", spoilt(walked)), "--json")
    assert told.status == 0, told.stderr
    assert any(says in text for text in json.loads(told.stdout)["warnings"])


@pytest.mark.exhaustive
def test_a_clock_is_told_from_other_files_where_no_velocity_tells_it(walked: Columns, bowden: Run, here: Path) -> None:
    plain = {name: values for name, values in walked.items() if name != "servo_velocity_m_s"}
    written(here / "a.csv", plain)
    written(here / "b.csv", {**plain, "tension_end_n": plain["tension_end_n"] + 0.1})
    late = written(here / "late.csv", {**slow_clock(plain), "tension_end_n": plain["tension_end_n"] + 0.2})
    told = bowden("diagnose", "a.csv", "b.csv", "--holdout", late, "--json")
    assert any("late.csv" in text and "off by a factor of 1.25" in text
               for text in json.loads(told.stdout)["warnings"])


def test_one_file_as_trial_and_holdout_is_refused(walked: Columns, bowden: Run, here: Path) -> None:
    written(here / "a.csv", walked)
    told = bowden("diagnose", "a.csv", "--holdout", written(here / "b.csv", walked), "--json")
    assert told.status == 2
    assert "the same data as a.csv" in json.loads(told.stdout)["warnings"][0]


@pytest.fixture(scope="module")
def diagnosed(walked: Columns, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the diagnosis of three gait cycles, low-passed at 20 Hz: table, JSON, bench model and page."""
    folder = tmp_path_factory.mktemp("diagnosed")
    arguments = ("diagnose", written(folder / "a.csv", cut(walked, 3)), "--lowpass", 20, "-o", folder / "extended.toml",
                 "--report", folder / "page.html", "--json")
    with (folder / "diagnosis.json").open("w", encoding="utf-8") as file, contextlib.redirect_stdout(file):
        assert run([str(argument) for argument in arguments]) == 0
    return folder


def test_json_has_the_keys_and_the_low_pass_is_stated_in_every_file(diagnosed: Path) -> None:
    result = json.loads((diagnosed / "diagnosis.json").read_text(encoding="utf-8"))
    assert tuple(result) == (*KEYS, "lowpass_hz", "simulation", "errors", "unexplained", "part", "evidence")
    assert result["lowpass_hz"] == 20.0
    assert set(result["relations"]) == {"tension_start_n", "tension_end_n"}
    assert set(result["relations"]["tension_start_n"]) == {
        "unit", "floor", "rmse_before", "rmse_session", "rmse_after", "holdout_before", "holdout_session",
        "holdout_after", "gain_percent", "low", "high"}
    assert all(set(row) == {"reference", "session", "named", "gain_percent", "gain_interval"}
               for row in result["errors"].values())
    assert set(result["causes"][0]) == {
        "effect", "site", "parameters", "gain_percent", "was", "at_peak_n", "probability"}
    assert "lowpass_hz = 20.0" in (diagnosed / "extended.toml").read_text(encoding="utf-8")
    assert "low-passed at 20 Hz" in (diagnosed / "page.html").read_text(encoding="utf-8")


@pytest.mark.exhaustive
def test_the_terminal_states_the_low_pass(diagnosed: Path, bowden: Run) -> None:
    told = bowden("diagnose", diagnosed / "a.csv", "--lowpass", 20)
    assert "(low-pass 20 Hz)" in told.stdout


@pytest.mark.exhaustive
def test_the_same_files_give_the_same_bytes_in_any_process(whole: Columns, here: Path) -> None:
    # sums in the order of a set of names would differ in the last digit, and a fit from there in more
    good = {**whole, "tension_end_n": whole["tension_end_n"] - 3.0}
    asked = [sys.executable, "-c", "import bowden.cli; bowden.cli.main()", "diagnose", written(here / "a.csv", whole),
             "--healthy", written(here / "b.csv", good), "--json"]
    told = [json.loads(subprocess.run(
        asked, env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True, text=True).stdout)
        for seed in ("1", "2")]
    assert {**told[0], "seconds": None} == {**told[1], "seconds": None}


@pytest.mark.exhaustive
def test_each_trial_is_told_for_itself_by_several_processes(walked: Columns, bowden: Run, here: Path) -> None:
    written(here / "long.csv", walked)
    written(here / "short.csv", cut(walked, 2))
    told = bowden("diagnose", "long.csv", "short.csv", "none.csv", "--each", "--workers", 2, "--json")
    assert told.status == 1
    result = json.loads(told.stdout)["trials"]
    assert list(result) == ["long.csv", "short.csv", "none.csv"]
    assert [one["verdict"] == "refused" for one in result.values()] == [False, True, True]
    assert tuple(result["long.csv"]) == (*KEYS, "lowpass_hz", "simulation", "errors", "unexplained", "part", "evidence")
    assert "no such file" in result["none.csv"]["warnings"][0]


@pytest.mark.parametrize(("lacking", "says"), [
    (("servo_position_m", "servo_velocity_m_s", "servo_target_m"), "has no column servo_position_m"),
    (("tension_start_n",), "has no column tension_start_n"),
    (("knee_angle_rad", "knee_target_rad"), "has no column knee_angle_rad"),
    (("tension_start_n", "tension_end_n", "knee_angle_rad", "knee_target_rad", "gait_percent", "cycle"), "--healthy"),
], ids=["no encoder", "no START", "no knee", "bare axis"])
def test_a_column_that_nothing_can_do_without_is_named(
    lacking: tuple[str, ...], says: str, whole: Columns, bowden: Run, here: Path
) -> None:
    left = {name: values for name, values in whole.items() if name not in lacking}
    told = bowden("diagnose", written(here / "part.csv.gz", left), "--json")
    assert told.status == 2, told.stderr
    assert says in json.loads(told.stdout)["warnings"][0]


@pytest.mark.exhaustive
def test_without_end_it_is_said_what_end_would_tell(whole: Columns, bowden: Run, here: Path) -> None:
    left = {name: values for name, values in whole.items() if name not in ("tension_end_n", "servo_force_n")}
    result = json.loads(bowden("diagnose", written(here / "part.csv.gz", left), "--json").stdout)
    assert set(result["relations"]) == {"tension_start_n"}
    assert any("With tension_end_n recorded these could be told" in text for text in result["warnings"])


@pytest.mark.parametrize(("arguments", "says"), [
    (["a.csv", "--each", "-o", "x.toml"], "leave -o out"),
    (["a.csv", "--workers", "2"], "--workers belongs to --each"),
    (["a.csv", "--scheduler", "127.0.0.1:9"], "--scheduler belongs to --each"),
])
def test_what_each_trial_for_itself_cannot_have(arguments: list[str], says: str, bowden: Run, here: Path) -> None:
    told = bowden("diagnose", *arguments)
    assert (told.status, told.stdout) == (2, "")
    assert says in told.stderr


def test_what_is_found_runs_in_the_simulator_and_in_the_controller(diagnosed: Path, bowden: Run, here: Path) -> None:
    model = diagnosed / "extended.toml"
    told = bowden("trial", "--serial", 0, "--cycles", 1, "--period", 1.1, "--settle", 0, "--controller", "extended",
                  "--controller-model", model, "--plant-model", model, "--json", "-o", "t.mcap")
    assert told.status == 0, told.stderr
    result = json.loads(told.stdout)
    assert result["outcome"] == "completed"
    # END reads 3 N more than the bench has: the sensor's figures tell of it, the true ones do not
    assert result["max_idle_tension_n"] - result["true_max_idle_tension_n"] == pytest.approx(3.0, abs=0.7)


@pytest.mark.exhaustive
def test_a_softer_path_is_named_although_homing_moves_the_zero(here: Path, bowden: Run) -> None:
    gait = ("trial", "--serial", 7, "--cycles", 8, "--period", 1.3, "--json")
    (here / "softer.toml").write_text("[effects.stiffness]\nstiffness_scale = 0.75\n", encoding="utf-8")
    for day, more in enumerate(((), ("--peak", 45), ("--plant-model", "softer.toml")), start=1):
        assert bowden(*gait, "--day", day, *more, "-o", f"{day}.mcap").status == 0
    told = json.loads(bowden("diagnose", "3.mcap", "--healthy", "1.mcap", "--healthy", "2.mcap", "--json").stdout)
    assert told["class"][0] == "stiffness"
    change = told["causes"][0]
    found = change["parameters"]["stiffness_scale"]["value"] / change["was"]["stiffness_scale"]
    # days 1 and 2 have 0.90 and 0.92; three times the 3 % by which sessions differ
    assert found == pytest.approx(0.75 / 0.91, abs=0.09)


@pytest.mark.exhaustive
def test_a_dask_cluster_tells_each_trial_too(walked: Columns, bowden: Run, here: Path) -> None:
    dask = pytest.importorskip("distributed")
    short = written(here / "short.csv", cut(walked, 2))
    with dask.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        told = bowden("diagnose", short, "--each", "--scheduler", cluster.scheduler_address, "--json")
    assert told.status == 2, told.stderr
    assert "2 cycles" in json.loads(told.stdout)["trials"][str(short)]["warnings"][0]


def nominal(path: Path, columns: Columns) -> Path:
    """Write a trial that ran on the packaged calibration."""
    recorder = recorded.Recorder(path, metadata={"calibration": "nominal"}, attachments={}, threaded=False)
    for row in range(columns["time_s"].size):
        values = {name: float(column[row]) for name, column in columns.items()}
        recorder.cycle(round(values["time_s"] * 1e9), [values.get(name, math.nan) for name in recorded.COLUMNS])
    recorder.close({})
    return path


@pytest.mark.slow
def test_on_the_packaged_calibration_no_cause_is_named_anywhere(here: Path, bowden: Run, walked: Columns) -> None:
    """A trial that ran on it, END 3 N off: terminal and page ask for an identification first."""
    nominal(here / "a.mcap", walked)
    status, out, err = bowden("diagnose", "a.mcap", "--report", "a.html", "-o", "a.toml")
    assert (status, err) == (0, "")
    said = " ".join(out.split())
    assert "Run bowden identify first" in said
    assert "end_offset" not in said
    page = unescape((here / "a.html").read_text()).partition("<main>")[2]
    assert "Run bowden identify first" in page
    assert [name for name in CATALOGUE if f">{name}<" in page] == []
    assert "[effects." not in (here / "a.toml").read_text()


@pytest.mark.exhaustive
def test_on_the_packaged_calibration_json_and_each_name_no_cause(here: Path, bowden: Run, walked: Columns) -> None:
    nominal(here / "a.mcap", walked)
    told = json.loads(bowden("diagnose", "a.mcap", "--json").stdout)
    assert (told["causes"], told["class"], told["experiment"]) == ([], [], None)
    assert "end_offset" in {one["effect"] for one in told["candidates"]}
    each = bowden("diagnose", "a.mcap", "--each", "--workers", 1).stdout
    assert "run bowden identify first" in " ".join(each.split())
