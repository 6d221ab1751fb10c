"""The constants of a bench from its healthy trials, and what the simulation with them says of another trial."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import bowden
from bowden.cli.app import run
from estimation import bench_fit, simulation
from estimation.data.table import Table, table
from parameters import Remark
from physics import bench_model, calibration
from physics.plant import PlantParameters, imposed
from tests.plants import draws
from tests.plants import imposed as family

NOISE_N = 0.1


def on_own_plant(seed: int, zero_m: float = 0.0, turned: bool = False) -> Table:
    """A trial of this project's own simulated bench under a walking motion, its rope counted from another zero."""
    motion = family.gait(draws.draw(1), cycles=3)
    rope = motion.rope - float(draws.draw(1).zero) + PlantParameters().encoder_zero_m
    told = imposed.simulate(PlantParameters(), imposed.motion(motion.time, rope, motion.knee))
    rng = np.random.default_rng(seed)
    columns = {"time_s": motion.time, "gait_percent": motion.percent, "cycle": motion.cycle,
               "servo_position_m": (rope + zero_m) * (-1.0 if turned else 1.0), "knee_angle_rad": motion.knee,
               "tension_start_n": told.start_n + NOISE_N * rng.normal(size=rope.size),
               "tension_end_n": told.end_n + NOISE_N * rng.normal(size=rope.size)}
    return table("walk.csv", columns)


@pytest.fixture(scope="module")
def walked() -> Table:
    return on_own_plant(1)


@pytest.mark.exhaustive
def test_a_bench_with_another_zero_and_a_rope_counted_the_other_way_is_fitted_to_its_noise() -> None:
    found = bench_fit.fit([on_own_plant(1, zero_m=0.043, turned=True)])
    assert found.pulls == -1
    assert found.values["rope_zero"] == pytest.approx(PlantParameters().encoder_zero_m + 0.043, abs=1e-3)
    for row in found.figures.values():
        assert row["rms_n"] <= 1.5 * NOISE_N + 0.005 * row["peak_n"]


@pytest.mark.exhaustive
def test_a_trial_without_end_is_fitted_and_what_it_does_not_say_is_listed(walked: Table) -> None:
    without = dataclasses.replace(walked, columns={n: v for n, v in walked.columns.items() if n != "tension_end_n"})
    found = bench_fit.fit([without])
    assert set(found.figures) == {"tension_start_n"}
    assert {"end_gain", "end_offset"} & set(found.undetermined) == {"end_gain", "end_offset"} & set(found.constants)


@pytest.fixture(scope="module")
def fitted(walked: Table, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a trial, the bench model that `bowden fit` wrote from it, and the command's JSON."""
    folder = tmp_path_factory.mktemp("fitted")
    np.savetxt(folder / "walk.csv", np.column_stack(list(walked.columns.values())), delimiter=",",
               header=",".join(walked.columns), comments="")
    with (folder / "fit.json").open("w", encoding="utf-8") as file, contextlib.redirect_stdout(file):
        assert run(["fit", str(folder / "walk.csv"), "-o", str(folder / "model.toml"), "--json"]) == 0
    return folder


@pytest.mark.slow
def test_a_model_is_read_as_it_was_written_and_as_a_calibration(fitted: Path, tmp_path: Path) -> None:
    path, model = tmp_path / "model.toml", bench_model.read(fitted / "model.toml")
    path.write_text(model.text(), encoding="utf-8")
    again = bench_model.read(path)
    assert (again.values, again.simulation, again.discrepancy) == (model.values, model.simulation, model.discrepancy)
    known = calibration.read(path)
    assert known.lacking == ()
    assert known.stiffness_b == model.values["stiffness_b"]
    assert again.simulation_values()["mu1"] == model.simulation["mu1"]


def test_a_model_with_a_table_of_constants_as_older_versions_wrote_it_opens(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_text('version = 2\nbench = ""\n[parameters.mu2]\nvalue = 0.1\nunit = ""\n[fitted]\npulls = -1\n'
                    '[constants.mu2]\nvalue = 0.2\nunit = ""\ninterval = [0.1, 0.3]\ndetermined = false\n',
                    encoding="utf-8")
    found = bench_model.read(path)
    assert found.simulation_values()["mu2"] == 0.2
    assert found.fitted["pulls"] == -1


def test_the_home_preload_of_an_older_fit_is_no_calibration_s(tmp_path: Path) -> None:
    """A fit of version 2 stated its zero at a preload of 0 N, at which no bench homes."""
    path = tmp_path / "model.toml"
    path.write_text('version = 2\n[parameters.mu1]\nvalue = 0.1\n[parameters.home_preload]\nvalue = 0.0\n[fitted]\n'
                    'pulls = 1\n', encoding="utf-8")
    with pytest.warns(Remark, match="says nothing of"):
        assert calibration.read(path).home_preload == calibration.nominal().home_preload
    assert bench_model.read(path).simulation_values()["mu1"] == 0.1


def test_the_comparison_is_told_by_phase_load_and_direction(walked: Table) -> None:
    told = simulation.simulate(walked, bench_model.BenchModel().simulation_values())
    figures = simulation.compared(walked, told)
    for row in figures.values():
        assert row["rms_n"] == pytest.approx(NOISE_N, rel=0.5)
        for part in ("by_phase", "by_load", "by_direction"):
            assert sum(one["samples"] for one in row[part]) <= len(walked)


def test_the_commands_fit_and_simulate(fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, model = fitted / "walk.csv", fitted / "model.toml"
    told = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert told["simulation"]["tension_end_n"]["rms_n"] < 0.4
    known = bowden.read_model(model)
    simulated = bowden.simulate(known, path)
    assert simulated.figures["tension_end_n"].rms < 0.4
    assert simulated.residuals["tension_start_n"].shape == simulated.time_ns.shape
    out = tmp_path / "simulated.csv"
    assert run(["simulate", str(path), "--model", str(model), "-o", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["tension_start_n"]["rms_n"] < 0.4
    assert "simulated_tension_end_n" in out.read_text(encoding="utf-8").splitlines()[0]
