"""Rigs of other kinds through the command line: a drive axis, a series-elastic actuator, a run-up, a seal."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bowden
from bowden.cli.app import run
from diagnosis.finder import Finder
from estimation.data.table import table
from parameters import InputError
from tests.diagnosis import rigs

pytestmark = pytest.mark.exhaustive

FORCE = "servo_force_n"


def diagnosed(*arguments: object) -> dict[str, Any]:
    """What `bowden diagnose … --json` prints."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        assert run(["diagnose", *map(str, arguments), "--json"]) == 0
    result: dict[str, Any] = json.loads(told.getvalue())
    return result


def fitted(folder: Path, *trials: object) -> dict[str, Any]:
    """What `bowden fit … --json` prints."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        assert run(["fit", *map(str, trials), "-o", str(folder / "rig.toml"), "--overwrite", "--json"]) == 0
    result: dict[str, Any] = json.loads(told.getvalue())
    return result


def named(result: dict[str, Any]) -> set[str]:
    return {cause["effect"] for cause in result["causes"]}


def value(result: dict[str, Any], parameter: str) -> float:
    return float(next(c["parameters"][parameter]["value"] for c in result["causes"] if parameter in c["parameters"]))


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two trials of a bare axis, then one of the same and one with 25 kg on it."""
    folder = tmp_path_factory.mktemp("axis")
    return [rigs.write(folder / f"axis_{seed}.csv", rigs.drive_axis(seed, load))
            for seed, load in ((1, 0.0), (2, 0.0), (3, 0.0), (4, 25.0))]


def test_all_of_an_axis_is_identified(axis: list[Path], tmp_path: Path) -> None:
    bare = fitted(tmp_path, axis[0], axis[1])
    told = {name: one["value"] for name, one in bare["constants"].items()}
    assert {"drive_inertia", "drive_viscous", "drive_coulomb", "drive_viscous_asymmetry"} <= set(bare["rig"])
    assert told["drive_inertia"] == pytest.approx(60.0, rel=0.03)
    assert told["drive_viscous"] == pytest.approx(180.0, rel=0.05)
    assert told["drive_coulomb"] == pytest.approx(18.0, rel=0.05)
    assert told["drive_viscous_asymmetry"] == pytest.approx(0.15, rel=0.2)
    # the current's noise is 0.8 N; its filter of 100 Hz is late by 2 ms, at every one of eighty ramps
    assert bare["relations"][FORCE]["unseen"] < 2.5


def test_a_load_on_the_axis_is_found_beside_bare_trials(axis: list[Path]) -> None:
    loaded = diagnosed(axis[3], "--healthy", axis[0], "--healthy", axis[1])
    assert named(loaded) == {"drive_inertia"}
    assert value(loaded, "drive_inertia") == pytest.approx(85.0, rel=0.03)


def test_held_out_trials_that_are_predicted_worse_are_said(axis: list[Path]) -> None:
    told = diagnosed(axis[3], "--healthy", axis[0], "--healthy", axis[1], "--holdout", axis[2])
    assert any("the trials held out are predicted worse" in said for said in told["warnings"])


def test_the_same_axis_again_is_the_same(axis: list[Path]) -> None:
    again = diagnosed(axis[2], "--healthy", axis[0], "--healthy", axis[1])
    assert again["verdict"] == "none"


@pytest.fixture(scope="module")
def swung(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three trials of a pendulum, then one with 20 % more mass."""
    folder = tmp_path_factory.mktemp("pendulum")
    return [rigs.write(folder / f"swung_{seed}.csv", rigs.pendulum(seed, mass))
            for seed, mass in ((1, 0.5), (2, 0.5), (3, 0.5), (4, 0.6))]


def test_another_motion_of_the_same_pendulum_is_the_same(swung: list[Path]) -> None:
    assert diagnosed(swung[2], "--healthy", swung[0], "--healthy", swung[1])["verdict"] == "none"


def test_a_mass_that_is_added_to_a_pendulum_is_told_within_five_per_cent(swung: list[Path]) -> None:
    heavier = diagnosed(swung[3], "--healthy", swung[0], "--healthy", swung[1])
    assert "unbalance" in named(heavier)
    found = next(c for c in heavier["causes"] if c["effect"] == "unbalance")["parameters"]["unbalance"]
    added = 0.1 * 9.81 * 0.15
    assert found["value"] - 0.5 * 9.81 * 0.15 == pytest.approx(added, rel=0.05)
    assert found["low"] <= 0.6 * 9.81 * 0.15 <= found["high"]


def test_without_a_reference_trial_it_is_said_in_one_sentence_what_to_give(axis: list[Path]) -> None:
    found = bowden.Diagnosis().diagnose(axis[0]).as_json()
    assert found["verdict"] == "refused"
    assert "name trials of this rig in the reference condition with --healthy" in found["warnings"][0]


@pytest.fixture(scope="module")
def elastic(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("elastic")
    return [rigs.write(folder / f"elastic_{seed}.csv", rigs.series_elastic(seed, stiffness))
            for seed, stiffness in ((1, 9e3), (2, 9e3), (3, 6e3))]


def test_a_softer_spring_is_found_beside_the_first_one(elastic: list[Path]) -> None:
    softer = diagnosed(elastic[2], "--healthy", elastic[0], "--healthy", elastic[1])
    assert named(softer) == {"stiffness"}
    assert value(softer, "stiffness_scale") == pytest.approx(1.8, rel=0.03)


def test_a_run_up_in_rad_and_newton_metres(tmp_path: Path) -> None:
    first, second, heavy = (rigs.write(tmp_path / f"run_{seed}.csv", rigs.run_up(seed, inertia))
                            for seed, inertia in ((1, 3.2e-4), (2, 3.2e-4), (3, 4.8e-4)))
    found = diagnosed(heavy, "--healthy", first, "--healthy", second)
    assert named(found) == {"drive_inertia"}
    assert value(found, "drive_inertia") == pytest.approx(4.8e-4, rel=0.07)
    units = {name: p["unit"] for c in found["causes"] for name, p in c["parameters"].items()}
    assert units["drive_inertia"] == "kg·m²"
    assert found["evidence"]["shifts"]["drive_travel"]["unit"] == "rad"
    assert found["relations"][FORCE]["unit"] == "N·m"


def test_a_turning_axis_beside_a_straight_pull_is_refused_with_what_to_do() -> None:
    time = np.arange(200) * 0.01
    with pytest.raises(InputError, match="multiply angles by the drum's radius"):
        table("mixed", {"time_s": time, "servo_position_rad": time, "tension_start_n": time})


@pytest.mark.parametrize("zero_m", [0.009, -0.009])
def test_an_encoders_zero_is_no_slack(zero_m: float) -> None:
    """A series-elastic drive whose motor encoder counts from elsewhere: nothing is wrong, and the zero is said."""
    drives = [rigs.series_elastic(seed) for seed in (1, 2, 3)]
    finder = Finder().fit([table(f"elastic_{i}", columns) for i, columns in enumerate(drives[:2])])
    found = finder.diagnose([table("moved", {**drives[2], "servo_position_m": drives[2]["servo_position_m"] + zero_m})])
    assert (found.verdict, found.causes) == ("none", [])
    assert found.evidence is not None
    shift = found.evidence["shifts"]["zero"]
    assert shift["to"] - shift["from"] == pytest.approx(zero_m, rel=0.02)


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_a_clock_that_is_off_is_no_inertia(factor: float) -> None:
    """Both from the same axis at 200 Hz; of a heavier load on a right clock the inertia is named."""
    axes = [rigs.decimated(rigs.drive_axis(seed, load), 5) for seed, load in ((1, 0.0), (2, 0.0), (3, 0.0), (4, 60.0))]
    finder = Finder().fit([table(f"axis_{i}", columns) for i, columns in enumerate(axes[:2])])
    refused = finder.diagnose([table("doubled", {**axes[2], "time_s": factor * axes[2]["time_s"]})])
    assert refused.verdict == "refused"
    assert f"divide time_s by {factor:g}" in refused.warnings[0]
    if factor > 1.0:
        heavier = finder.diagnose([table("heavier", axes[3])])
        assert "drive_inertia" in {cause["effect"] for cause in heavier.causes}


@pytest.fixture(scope="module")
def seals(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A seal on three days, and another that rubs twice as much."""
    folder = tmp_path_factory.mktemp("seal")
    return [rigs.write(folder / f"seal_{seed}.csv", rigs.seal(seed, coulomb))
            for seed, coulomb in ((1, 12.0), (2, 12.0), (3, 12.0), (4, 24.0))]


def test_the_same_seal_is_the_same_and_another_is_named(seals: list[Path]) -> None:
    known = ("--healthy", seals[0], "--healthy", seals[1])
    again, other = (diagnosed(path, *known) for path in seals[2:])
    assert again["verdict"] == "none"
    # what the healthy model misses as it was is said, and is little of the same seal and much of another
    as_it_was = [found["relations"][FORCE]["rmse_before"] for found in (again, other)]
    assert as_it_was[0] < 0.1 * as_it_was[1]
    assert all(one["low"] <= one["to"] <= one["high"] for one in other["evidence"]["shifts"].values())
    assert other["verdict"] in ("found", "ambiguous")
    assert other["causes"][0]["effect"] == "drive_coulomb"


def test_what_a_session_differs_by_is_said_though_nothing_is_named(seals: list[Path], tmp_path: Path,
                                                                   capsys: pytest.CaptureFixture[str]) -> None:
    tighter = rigs.write(tmp_path / "seal.csv", rigs.seal(5, 12.9))
    assert run(["diagnose", str(tighter), "--healthy", str(seals[0]), "--healthy", str(seals[1])]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "which is the session's" in told
    assert "The simulation of this rig misses the drive's force by" in told
    assert "drive friction" in told[told.index("constants of the rig, named or not"):]
