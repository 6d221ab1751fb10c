"""A bench model loads into simulator, controller and diagnosis; what was measured on a bench simulates that bench."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from physics import bench_model, calibration
from physics.conversions import SIMULATED, UNRELATED
from physics.parameters import BY_PLANT
from trial import read as trials

if TYPE_CHECKING:
    from conftest import Told

    from trial.read import Trial

Run = Callable[..., "Told"]
NOISE_N = 0.15
SIGNALS = ("tension_start_n", "tension_end_n", "servo_position_m")
EFFECTS = '[found]\nverdict = "found"\n\n[effects.slack]\nslack = { value = 1e-3, low = 0.9e-3, high = 1.1e-3 }\n'


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with model.toml, identified on bench 3."""
    from bowden.cli.app import run

    folder = tmp_path_factory.mktemp("measured")
    assert run(["identify", "all", "--serial", "3", "--json", "-o", str(folder / "model.toml")]) == 0
    return folder


@pytest.fixture(scope="module")
def measured(identified: Path) -> Path:
    """The directory with real.mcap beside the model, a trial of bench 3."""
    from bowden.cli.app import run

    assert run(["trial", "--serial", "3", "--calibration", str(identified / "model.toml"), "--cycles", "4", "--json",
                "-o", str(identified / "real.mcap")]) == 0
    return identified


def gait(trial: Trial) -> dict[str, np.ndarray]:
    """The second gait cycle, by signal."""
    rows = np.flatnonzero(trial.columns["cycle"] == 1)
    return {name: trial.columns[name][rows] for name in SIGNALS}


def apart(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    return {name: float(np.sqrt(np.nanmean((one[name] - other[name]) ** 2))) for name in SIGNALS}


@pytest.mark.exhaustive
def test_what_was_measured_simulates_the_bench_it_was_measured_on(bowden: Run, measured: Path, here: Path) -> None:
    """RMS over a gait cycle: 0.35 N and 0.15 mm, and END, noise aside, nearer than the nominal simulation's.

    Each side's sensors have a noise of 0.15 N: 0.21 N of a difference.  END's own gain and zero (0.5 %, 0.1 N) no
    identification measures, and the model takes END's for true.  Zero and slack stretch of the rope are what
    homing repeats, 0.1 mm; over the stiffness at little load 0.3 N, of which the controller takes its share.
    """
    model, real = measured / "model.toml", gait(trials.open(measured / "real.mcap"))
    told = {}
    for name, bench in {"of the model": ("--plant-model", model, "--calibration", model), "nominal": ()}.items():
        run = bowden("trial", "--serial", 0, *bench, "--cycles", 2, "--json", "-o", f"{name}.mcap")
        assert run.status == 0, run
        told[name] = apart(real, gait(trials.open(here / f"{name}.mcap")))
    assert told["of the model"]["tension_start_n"] < 0.35
    assert told["of the model"]["tension_end_n"] < 0.35
    assert told["of the model"]["servo_position_m"] < 0.15e-3
    beyond = {name: math.sqrt(max(found["tension_end_n"] ** 2 - 2.0 * NOISE_N**2, 0.0)) for name, found in told.items()}
    assert beyond["of the model"] < 0.6 * beyond["nominal"]


@pytest.mark.exhaustive
def test_one_file_loads_in_simulator_and_controller(bowden: Run, identified: Path, here: Path) -> None:
    model = here / "extended.toml"
    model.write_text((identified / "model.toml").read_text() + "\n" + EFFECTS)
    run = bowden("trial", "--serial", 0, "--plant-model", model, "--calibration", model, "--controller", "extended",
                 "--cycles", 1, "--settle", 0, "--period", 1.1, "--json", "-o", "both.mcap")
    assert run.status == 0, run
    assert trials.open(here / "both.mcap").metadata["controller_model"] == "slack"


@pytest.mark.exhaustive
def test_the_same_file_is_read_by_a_diagnosis(bowden: Run, measured: Path, here: Path) -> None:
    model = here / "extended.toml"
    model.write_text((measured / "model.toml").read_text() + "\n" + EFFECTS)
    told = bowden("diagnose", measured / "real.mcap", "--calibration", model, "--json")
    assert told.status == 0, told
    assert json.loads(told.stdout)["verdict"] != "refused"


@pytest.mark.exhaustive
def test_a_model_comes_back_from_its_file(identified: Path, tmp_path: Path) -> None:
    model = bench_model.read(identified / "model.toml", bench="virtual 3")
    path = tmp_path / "again.toml"
    path.write_text(dataclasses.replace(
        bench_model.of_calibration(model.calibration), effects={"slack": {"slack": 1e-3}}).text())
    again = bench_model.read(path)
    assert again.values == model.values
    assert again.evidence.keys() == model.evidence.keys()
    assert again.effects == {"slack": {"slack": 1e-3}}
    assert again.at_work() == {"slack": 1e-3}
    assert calibration.read(path).cable_exponent == model.calibration.cable_exponent
    simulated = {*BY_PLANT.values(), *(name for form in (*SIMULATED, *UNRELATED) for name in form.of)}
    assert set(model.values) - simulated == {
        "stretch_short", "stretch_wide", "identified_to", "swing_p", "home_preload", "fabric_breakaway", "servo_delay",
        "start_lag", "viscous_tension", "homed_friction", "homed_softness"}


@pytest.mark.parametrize(("text", "said"), [
    ("", "states neither parameters nor effects"),
    ("[plant]\nmu1 = 0.1\n",
     "unknown table plant; expected [parameters], [scalars], [constants], [discrepancy], [effects], [found]"),
    ("version = 9\n[effects.slack]\nslack = 1e-3\n", "version = 9, expected 2"),
    ("version = 2\n[parameters.mu9]\nvalue = 1.0\n", "unknown parameter mu9"),
    ("version = 2\n[parameters.mu2]\nvalue = 7.0\n", "mu2 = 7.0 is outside 0 … 1"),
])
def test_what_is_no_bench_model_is_refused(bowden: Run, here: Path, text: str, said: str) -> None:
    (here / "model.toml").write_text(text)
    told = bowden("trial", "--calibration", "model.toml", "-o", "t.mcap")
    assert told.status == 2
    assert said in told.stderr
    assert not (here / "t.mcap").exists()
