"""The trial end to end, by its command line: figures, file, repeatability."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from mcap.reader import make_reader

import trial as trials
from bowden.cli.app import run

KEYS = [
    "trial", "peak_n", "period_s", "cycles", "rate_hz", "serial", "controller", "calibration",
    "relative_rmse_percent", "relative_rmse_window_percent", "max_idle_tension_n", "peak_jump_n",
    "true_relative_rmse_percent", "true_relative_rmse_window_percent", "true_max_idle_tension_n",
    "true_peak_jump_n", "missed_cycles", "stale_inputs", "bus_load_percent", "bus_load_bound_percent",
    "simulated_s", "wall_s", "outcome", "stop_reason",
]
ROOT = Path(__file__).parents[2]
GAIT = ROOT.parent / "shared" / "data" / "gait"


def command(*arguments: object, cwd: Path, hash_seed: str = "0") -> subprocess.CompletedProcess[str]:
    """Run `bowden` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", "from bowden.cli import main; main()", *map(str, arguments)],
        cwd=cwd, env=os.environ | {"PYTHONHASHSEED": hash_seed}, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A 40 N trial of two cycles and its `--json`."""
    path = tmp_path_factory.mktemp("trial") / "one.mcap"
    with redirect_stdout(io.StringIO()) as out:
        assert run(["trial", "--cycles", "2", "--json", "-o", str(path)]) == 0
    assert out.getvalue().count("\n") == 1
    result: dict[str, Any] = json.loads(out.getvalue())
    return path, result


def test_the_json_has_exactly_the_published_keys(recorded: tuple[Path, dict[str, Any]]) -> None:
    assert list(recorded[1]) == KEYS


def test_a_nominal_trial_completes_without_a_miss(recorded: tuple[Path, dict[str, Any]]) -> None:
    result = recorded[1]
    assert (result["outcome"], result["stop_reason"]) == ("completed", None)
    assert (result["missed_cycles"], result["stale_inputs"]) == (0, 0)
    assert (result["calibration"], result["controller"], result["serial"]) == ("nominal", "paper", 1)


def test_the_measured_load_lies_below_the_computed_bound(recorded: tuple[Path, dict[str, Any]]) -> None:
    result = recorded[1]
    assert 0 < result["bus_load_percent"] < result["bus_load_bound_percent"] <= 60


def test_the_figures_are_those_of_the_columns(recorded: tuple[Path, dict[str, Any]]) -> None:
    path, result = recorded
    columns = trials.open(path).columns
    scored = columns["cycle"] == 1
    error = columns["tension_end_n"][scored] - columns["desired_force_n"][scored]
    assert scored.sum() == 2000
    assert result["relative_rmse_percent"] == pytest.approx(100 * np.sqrt(np.mean(error**2)) / 40, rel=1e-12)


def test_every_signal_has_a_unit_and_the_trial_names_what_made_it(recorded: tuple[Path, dict[str, Any]]) -> None:
    opened = trials.open(recorded[0])
    assert set(opened.units) == set(opened.columns)
    assert all(opened.units.values())
    assert {"bench.toml", "calibration.toml", "packages.txt", "servo_drive.eds", "knee_drive.eds",
            "tension_sensor.eds"} <= set(opened.attachments)
    assert opened.metadata["controller"] == "paper"


def test_the_trial_names_the_commit_that_made_it(recorded: tuple[Path, dict[str, Any]]) -> None:
    asked = subprocess.run(["git", "-C", str(ROOT), "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    if asked.returncode or not (ROOT / ".git").exists():
        pytest.skip(f"no repository that git reads, so that trials have no commit: {asked.stderr.strip()}")
    assert trials.open(recorded[0]).metadata["commit"].rstrip("+") == asked.stdout.strip()


def test_foreign_readers_read_it(recorded: tuple[Path, dict[str, Any]]) -> None:
    with recorded[0].open("rb") as file:
        counts = {channel.topic for _, channel, _ in make_reader(file).iter_messages()}
    assert counts == {"/can/frames", "/cycle", "/events"}
    with can.LogReader(recorded[0]) as reader:
        first = next(iter(reader))
    assert first.timestamp >= 0


def test_nothing_of_the_truth_is_in_the_trial(recorded: tuple[Path, dict[str, Any]]) -> None:
    path, _ = recorded
    opened = trials.open(path)
    assert not [name for name in (*opened.columns, *opened.metadata, *opened.attachments)
                if "true" in name or "serial" in name or "truth" in name]
    assert path.with_name("one.truth.mcap").exists()


def test_a_trial_imports_no_library_that_it_does_not_use(tmp_path: Path) -> None:
    code = "import sys; from bowden.cli.app import run; run(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    words = ("trial", "--cycles", 1, "--settle", 0, "--json", "-o", "one.mcap")
    told = subprocess.run([sys.executable, "-c", code, *map(str, words)], cwd=tmp_path, capture_output=True, text=True,
                          check=True)
    used = {"bowden.pages.figures", "bowden.trials.session", "master.motion.experiment_run", "virtual_bus.bus"}
    spared = {"asammdf", "bowden.live.feeds", "bowden.watch.watch_process", "matplotlib", "pandas", "pyarrow", "rich",
              "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.stats"}
    assert json.loads(told.stdout)["outcome"] == "completed"
    assert (used | spared) & set(told.stderr.split()) == used


@pytest.mark.parametrize("more", [(), pytest.param(("--settle", 0), marks=pytest.mark.exhaustive)])
def test_the_only_cycle_is_in_the_figures(here: Path, bowden: Callable[..., Any], more: tuple[object, ...]) -> None:
    told = bowden("trial", "--cycles", 1, *more, "--period", 1.1, "--json", "-o", "one.mcap")
    assert told.status == 0, told.stderr
    assert json.loads(told.stdout)["relative_rmse_percent"] > 0
    assert ("settle = 1 leaves none of 1 cycles; the figures leave out 0." in told.stderr) == (not more)


@pytest.mark.exhaustive
def test_one_seed_one_file_in_any_process(tmp_path: Path) -> None:
    short = ("trial", "--cycles", 1, "--settle", 0, "--period", 1.1, "--json")
    files = []
    for name, hash_seed in (("a", "1"), ("elsewhere", "2")):
        told = command(*short, "--seed", 5, "-o", f"{name}.mcap", cwd=tmp_path, hash_seed=hash_seed)
        assert told.returncode == 0, told.stderr
        files.append((tmp_path / f"{name}.mcap").read_bytes())
    assert run([str(word) for word in (*short, "--seed", 6, "-o", tmp_path / "c.mcap")]) == 0
    files.append((tmp_path / "c.mcap").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


@pytest.mark.skipif(not GAIT.is_dir(), reason="../shared/data/gait is absent: real knee motion is no part of this")
@pytest.mark.slow
def test_a_real_knee_cycle_runs(tmp_path: Path) -> None:
    told = command("trial", "--knee", GAIT / "cycle_01.csv", "--cycles", 2, "--json", "-o", "knee.mcap", cwd=tmp_path)
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["outcome"] == "completed"
    knee = trials.open(tmp_path / "knee.mcap").columns["knee_target_rad"]
    assert np.abs(np.diff(knee)).max() < 0.02  # 20 rad/s at 1 kHz: no step
