"""`bowden fit` on rigs of other kinds: their constants, and how well they predict what the fit had not seen."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bowden
from bowden.cli.app import run
from estimation import bench_fit
from estimation.data.table import table
from parameters import InputError
from tests.diagnosis import rigs

Columns = dict[str, np.ndarray]
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
RATE_HZ = 100.0  # of all columns of the fit by hand

MADE: dict[str, tuple[Callable[[], Columns], dict[str, float]]] = {
    "axis": (lambda: rigs.drive_axis(3), {"drive_inertia": 60.0, "drive_viscous": 180.0, "drive_offset": -3.0}),
    "pendulum": (lambda: rigs.pendulum(3), {"unbalance": 0.5 * 9.81 * 0.15, "drive_inertia": 0.5 * 0.15**2 + 2e-3}),
    "motor": (lambda: rigs.run_up(3), {"drive_inertia": 3.2e-4}),
    "elastic": (lambda: rigs.series_elastic(3), {
        "rope_per_knee": 0.08, "drive_inertia": 4.0, "drive_coulomb": 6.0, "drive_viscous": 40.0}),
}


@cache
def fitted(name: str) -> bench_fit.FittedBench:
    """Fit a made rig, once for all tests that read the fit."""
    return bench_fit.fit([table(f"{name}.csv", MADE[name][0]())])


@pytest.mark.parametrize("name", MADE)
@pytest.mark.slow
def test_the_intervals_hold_what_the_rig_was_made_with(name: str) -> None:
    found, true = fitted(name), MADE[name][1]
    assert found.rig is not None
    for constant, value in true.items():
        told = found.constants[constant]
        assert told.low <= value <= told.high, constant
        # one trial is one session: its parts of the friction may each be of another size in the next
        assert told.high - told.low < 2.0 * abs(value) or constant == "drive_offset"


def terms(columns: Columns, position: str) -> np.ndarray:
    """What an engineer would fit an axis by: acceleration, speed, its sign, a constant, a weight's sine and cosine."""
    at, step = columns[position], float(columns["time_s"][1] - columns["time_s"][0])
    speed = np.gradient(at, step)
    return np.column_stack([np.gradient(speed, step), speed, np.tanh(speed / 0.01), np.abs(speed), np.ones_like(at),
                            np.sin(at), np.cos(at)])


@pytest.mark.parametrize(("name", "position", "force"), [
    ("axis", "servo_position_m", "servo_force_n"), ("pendulum", "servo_position_rad", "servo_torque_nm")])
def test_what_it_had_not_seen_is_predicted_as_well_as_by_least_squares_by_hand(name: str, position: str, force: str
                                                                               ) -> None:
    columns = MADE[name][0]()
    told = fitted(name).relations["servo_force_n"]["unseen"]
    slow = rigs.decimated(columns, round(1.0 / RATE_HZ / float(columns["time_s"][1])))
    x, y = terms(slow, position), slow[force]
    seen = round(0.6 * y.size)  # the part that `bench_fit` fits; it tests the fit on the rest
    by_hand = y[seen:] - x[seen:] @ np.linalg.lstsq(x[:seen], y[:seen], rcond=None)[0]
    assert told <= 1.1 * float(np.sqrt(np.mean(by_hand**2)))


def test_the_command_tells_a_rig_and_its_file_is_refused_where_a_bench_is_wanted(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trial = rigs.write(tmp_path / "swung.csv", rigs.pendulum(3))
    model = tmp_path / "rig.toml"
    assert run(["fit", str(trial), "-o", str(model), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"drive_coulomb", "drive_inertia", "drive_viscous", "unbalance"} <= set(told["rig"])
    assert told["constants"]["drive_inertia"]["unit"] == "kg·m²"
    assert run(["fit", str(trial), "-o", str(model), "--overwrite"]) == 0
    assert "A rig of another kind than the bench; terms found: " in capsys.readouterr().out
    for command in (["diagnose", str(trial), "--calibration"], ["simulate", str(trial), "--model"],
                    ["trial", "-o", str(tmp_path / "trial.mcap"), "--plant-model"]):
        assert run([*command, str(model)]) == 2
        said = capsys.readouterr().err
        assert said.startswith("bowden: ")
        assert "a rig of another kind" in said
        assert said.count("\n") == 1


def test_the_library_fits_a_rig_and_a_gait_of_no_stretching_rope_is_refused() -> None:
    still = rigs.run_up(3)
    with pytest.raises(InputError, match="no signal can be predicted"):
        bench_fit.fit([table("angle.csv", {n: still[n] for n in ("time_s", "servo_position_rad")})])
    time = np.arange(0.0, 6.0, 0.01)
    walked = {"time_s": time, "gait_percent": 100.0 * (time % 1.0), "servo_position_m": 0.02 * np.sin(time),
              "tension_start_n": 30.0 * np.sin(7.0 * time)}
    with pytest.raises(InputError, match="a gait, but no rope that a tension stretches"):
        bench_fit.fit([table("walk.csv", walked)])


REAL = [("pneumatic_seal", "oring257_*bar_fit", "tension_start_n", 0.12),
        ("cable_drive/fit", "sine_*", "tension_start_n", 0.15), ("tribometer", "fit", "servo_force_n", 0.15)]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("folder", "files", "relation", "share"), REAL)
def test_measured_rigs_are_fitted(folder: str, files: str, relation: str, share: float) -> None:
    """`share`: of the spread on the last part of each trial; a bound of regression, a quarter above what it is."""
    trials = sorted((SHARED / folder).glob(f"{files}.csv.gz"))
    if not trials:
        pytest.skip("the measured data are not beside the repository")
    found = bowden.fit(trials)
    row = bench_fit.fit(trials).relations[relation]
    assert found.fitted["terms"]
    assert row["unseen"] <= share * row["spread"]
    assert all(told["interval"][0] <= told["value"] <= told["interval"][1] for told in found.rig.values())
