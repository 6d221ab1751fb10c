"""The files that one command writes and another reads, as a user passes them on: fit, identify, diagnose, trial."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from conftest import Told

Run = Callable[..., "Told"]
pytestmark = pytest.mark.exhaustive
GAITS = ((40.0, 2.0), (50.0, 1.5), (60.0, 1.2))
"""Peak, N, and period, s, of the gait trials that `bowden fit` reads: loads and cadences of docs/results.md."""
CHANGED_GAIN = 1.06
"""Gain of START of the changed bench: twenty times the deviation between sessions."""


def figures(told: Told) -> dict[str, Any]:
    """Return the JSON of a command that succeeded."""
    assert told.status == 0, told
    return dict(json.loads(told.stdout))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with three gait trials of bench 3 by the packaged calibration, and the two files made of it.

    `model.toml` is of `bowden fit` from the trials, `calibration.toml` of `bowden identify`; `changed.mcap` is a
    trial of the bench with a plant model whose START has `CHANGED_GAIN`.
    """
    from bowden.cli.app import run

    folder = tmp_path_factory.mktemp("seams")
    trials = [str(folder / f"g{k}.mcap") for k in range(len(GAITS))]
    for path, (peak, period) in zip(trials, GAITS, strict=True):
        assert run(["trial", "--serial", "3", "--peak", str(peak), "--period", str(period), "--cycles", "3", "--json",
                    "-o", path]) == 0
    assert run(["fit", *trials, "-o", str(folder / "model.toml"), "--json"]) == 0
    assert run(["identify", "all", "--serial", "3", "-o", str(folder / "calibration.toml"), "--json"]) == 0
    (folder / "plant.toml").write_text(f"[start_sensor]\ngain = {CHANGED_GAIN}\n", encoding="utf-8")
    assert run(["trial", "--serial", "3", "--plant-model", str(folder / "plant.toml"), "--cycles", "4", "--json",
                "-o", str(folder / "changed.mcap")]) == 0
    return folder


@pytest.mark.parametrize("controller", ["extended", "paper"])
def test_a_fitted_model_controls_the_bench_about_as_well_as_an_identified_one(
    bowden: Run, bench: Path, here: Path, controller: str,
) -> None:
    """END misses the desired force by at most 1.5 times as much as by `identify`'s calibration."""
    missed = {name: figures(bowden(
        "trial", "--serial", 3, "--day", 1, "--cycles", 4, "--controller", controller, "--calibration",
        bench / f"{name}.toml", "--json", "-o", here / f"{name}.mcap"))["true_relative_rmse_percent"]
        for name in ("model", "calibration")}
    assert missed["model"] <= 1.5 * missed["calibration"]


def test_a_fitted_model_has_every_scalar_that_an_identified_one_has(bench: Path) -> None:
    from physics import bench_model

    fitted, identified = (bench_model.read(bench / f"{name}.toml") for name in ("model", "calibration"))
    assert set(identified.values) == set(fitted.values)
    assert fitted.calibration.lacking == ()
    assert fitted.discrepancy is not None


def test_a_bench_model_of_either_command_is_the_calibration_of_a_diagnosis(bowden: Run, bench: Path) -> None:
    for name in ("calibration", "model"):
        told = figures(bowden("diagnose", bench / "changed.mcap", "--calibration", bench / f"{name}.toml", "--json"))
        assert told["verdict"] in ("found", "ambiguous"), (name, told["verdict"])
        assert "start_gain" in told["class"], (name, told["class"])


def test_an_extended_model_is_simulated_and_compensated(bowden: Run, bench: Path, here: Path) -> None:
    """END misses the desired force less with the effect known to the controller than without."""
    told = figures(bowden("diagnose", bench / "changed.mcap", "--healthy", bench / "g0.mcap", "--healthy",
                          bench / "g1.mcap", "-o", here / "extended.toml", "--json"))
    assert told["verdict"] == "found"
    missed = [figures(bowden(
        "trial", "--serial", 0, "--plant-model", here / "extended.toml", "--calibration", bench / "model.toml",
        *known, "--cycles", 3, "--json", "-o", here / f"{len(known)}.mcap"))["true_relative_rmse_percent"]
        for known in (("--controller-model", here / "extended.toml"), ())]
    assert missed[0] <= 1.05 * missed[1]
