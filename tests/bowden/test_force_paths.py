"""Benches of several force paths run from their packaged declarations: two legs, and two ropes on one joint."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import bowden as api
from bowden import model_files
from bowden.bench import configuration
from bowden.bench.buses import simulated
from eds.declaration import MIRROR_RAD, packaged
from trial.read import Trial, one_path, path_names
from trial.read import open as opened

Command = Callable[..., tuple[int, str, str]]
SHAPES = {"bench_two_legs": ("left", "right"), "bench_antagonists": ("flexor", "extensor")}


@pytest.fixture(scope="module", params=[pytest.param("bench_two_legs", marks=pytest.mark.slow), "bench_antagonists"])
def ran(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the configuration of a shape, a trial of one gait cycle, and its figures as JSON."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "bench.toml").write_text(configuration.as_template(shape=request.param))
    told = api.run(api.Experiment(peak_n=20, period_s=1, cycles=1, settle=0, configuration=folder / "bench.toml"),
                   output=folder / "trial.mcap")
    (folder / "figures.json").write_text(json.dumps({**told.figures, "shape": request.param}))
    return folder


ONE_SHAPE = pytest.mark.parametrize(
    "ran", [pytest.param("bench_two_legs", marks=pytest.mark.exhaustive), "bench_antagonists"], indirect=True)
"""Tests that run another trial: on one shape in `make test`, on both in CI."""


@pytest.fixture
def figures(ran: Path) -> dict[str, object]:
    """The figures of the trial."""
    return dict(json.loads((ran / "figures.json").read_text()))


@pytest.fixture
def recorded(ran: Path) -> Trial:
    """The trial."""
    return opened(ran / "trial.mcap")


def test_every_path_follows_its_force(figures: dict[str, object]) -> None:
    assert (figures["outcome"], figures["missed_cycles"], figures["stale_inputs"]) == ("completed", 0, 0)
    paths = figures["paths"]
    assert isinstance(paths, dict)
    assert tuple(paths) == SHAPES[str(figures["shape"])]
    assert all(found["true_relative_rmse_percent"] < 8.0 for found in paths.values())


def test_a_path_s_columns_read_like_those_of_a_single_one(recorded: Trial) -> None:
    path = path_names(recorded)[1]
    assert f"{path}.tension_start_n" in recorded.columns
    found = one_path(recorded, path)
    assert (found.columns["tension_start_n"] == recorded.columns[f"{path}.tension_start_n"]).all()
    assert {"time_s", "sync_jitter_ns", "servo_target_m", "end_pdo_age_ns"} <= found.columns.keys()
    assert not any("." in name for name in found.columns)


def test_the_joint_of_an_antagonist_is_counted_mirrored(figures: dict[str, object], recorded: Trial) -> None:
    flexes, extends = (recorded.columns[f"{name}.knee_angle_rad"] for name in path_names(recorded))
    both = flexes + extends
    if figures["shape"] == "bench_antagonists":
        assert np.allclose(both, MIRROR_RAD, atol=1e-9)
    else:
        assert np.ptp(both) > 0.5  # the legs walk half a gait cycle apart


def test_the_controller_s_steps_are_made_again(ran: Path, recorded: Trial, bowden: Command) -> None:
    for path in path_names(recorded):
        status, out, _ = bowden("replay", ran / "trial.mcap", "--onto", "controller", "--path", path, "--json")
        assert (status, json.loads(out)["same"]) == (0, True)


def test_a_path_has_its_report(ran: Path, recorded: Trial, bowden: Command) -> None:
    page = ran / "report.html"
    assert bowden("report", ran / "trial.mcap", "--path", path_names(recorded)[1], "-o", page)[0] == 0
    assert "relative RMSE" in page.read_text()
    assert bowden("report", ran / "trial.mcap", "-o", ran / "both.html")[0] == 0
    sections = re.findall(r"<h2>([^<]*)</h2>", (ran / "both.html").read_text())
    assert [f"{name}: Force" in sections for name in path_names(recorded)] == [True, True]


def test_a_path_must_be_named(ran: Path, recorded: Trial, bowden: Command) -> None:
    one, other = path_names(recorded)
    for command in (("diagnose",), ("simulate",), ("replay", "--onto", "controller")):
        status, out, err = bowden(command[0], ran / "trial.mcap", *command[1:])
        assert (status, out) == (2, "")
        assert f"records the force paths {one}, {other}; name one with --path" in err
    assert bowden("simulate", ran / "trial.mcap", "--path", other)[0] == 0
    assert bowden("logbook", "init", ran / "book")[0] == 0
    assert f"a logbook follows one; say bowden logbook init DIR --path {one}" in bowden(
        "logbook", "add", ran / "book", ran / "trial.mcap")[1]
    status, _, err = bowden("report", ran / "trial.mcap", "--path", "middle", "-o", ran / "none.html")
    assert status == 2
    assert f"has no path middle; expected one of {one}, {other}" in err


@ONE_SHAPE
@pytest.mark.slow
def test_a_lost_node_of_one_path_lets_both_paths_go(ran: Path, recorded: Trial, figures: dict[str, object]) -> None:
    """START of the second path loses its power while the first rope is taut: both end slack, every drive disabled."""
    bench = packaged(str(figures["shape"]))
    one, other = bench.force_paths
    taut = int(np.nanargmax(recorded.columns[f"{one.name}.tension_end_n"]
                            * (recorded.columns[f"{one.name}.cycle"] == 0)))
    fault = {"kind": "power_off", "node": bench.nodes_of(other).start, "start_s": 1e-9 * int(recorded.time_ns[taut])}
    found = api.run(api.Experiment(peak_n=20, period_s=1, cycles=2, configuration=ran / "bench.toml"),
                    bus=simulated(faults=[fault]), output=ran / "stopped.mcap")
    assert found.outcome == "stopped"
    assert other.start in str(found.figures["stop_reason"])
    stopped = opened(ran / "stopped.mcap")
    end = stopped.columns[f"{one.name}.tension_end_n"]
    assert (end.max(), end[-1]) == (pytest.approx(20.0, abs=4.0), pytest.approx(0.0, abs=5.0))
    for node in {node for path in bench.force_paths for node in bench.nodes_of(path)[:2]}:
        (last,) = stopped.frames[stopped.frames["can_id"] == 0x180 + node]["data"][-1:]
        assert last[0] & 0x4F == 0x40  # SWITCH ON DISABLED


def test_a_calibration_is_missing_for_a_path(ran: Path, bowden: Command) -> None:
    status, out, err = bowden("trial", "--config", ran / "bench.toml", "--calibration", ran / "none.toml",
                              "-o", ran / "other.mcap")
    assert (status, out) == (2, "")
    assert "none." in err


@ONE_SHAPE
def test_a_dry_run_and_its_picture_have_every_path(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("trial", "--config", ran / "bench.toml", "--dry-run", "--period", "1", "--cycles", "1",
                            "--settle", "0", "--picture", ran / "dry.svg", "-o", ran / "dry.mcap", "--json")
    assert (status, json.loads(out)["outcome"]) == (0, "completed")
    recorded = opened(ran / "dry.mcap")
    assert all(np.nanmax(recorded.columns[f"{name}.tension_start_n"]) < 2.0 for name in path_names(recorded))
    assert all(f"{name}: " in (ran / "dry.svg").read_text() for name in path_names(recorded))


@pytest.mark.exhaustive
def test_an_experiment_of_the_catalogue_runs_on_each_path_in_turn(ran: Path, bowden: Command) -> None:
    status, _, err = bowden("trial", "--config", ran / "bench.toml", "--experiment", "locked_angles", "-o",
                            ran / "angles.mcap", "--json")
    assert status == 0, err
    recorded = opened(ran / "angles.mcap")
    pulled = [recorded.columns[f"{name}.tension_start_n"] > 20.0 for name in path_names(recorded)]
    assert all(each.any() for each in pulled)
    assert not np.logical_and(*pulled).any()


@ONE_SHAPE
def test_commissioning_names_a_path(ran: Path, recorded: Trial, bowden: Command) -> None:
    status, out, err = bowden("tare", "start", "--config", ran / "bench.toml", "--interface", "bowden", "--channel",
                              f"tare {ran.name}")
    assert (status, out) == (2, "")
    assert "--path is missing: the bench has the force paths" in err
    status, out, _ = bowden("tare", "start", "--config", ran / "bench.toml", "--interface", "bowden", "--channel",
                            f"tare {ran.name}", "--path", path_names(recorded)[1], "--json")
    assert (status, json.loads(out)["outcome"]) == (0, "completed")


@ONE_SHAPE
@pytest.mark.slow
def test_every_path_is_identified_in_turn(ran: Path, bowden: Command) -> None:
    status, out, _ = bowden("identify", "sensors", "--config", ran / "bench.toml", "-o", ran / "own.toml", "--json")
    assert status == 0
    for path, found in json.loads(out)["paths"].items():
        assert found["calibration"] == str(ran / f"own.{path}.toml")
        assert f'bench = "virtual 1 {path}"' in (ran / f"own.{path}.toml").read_text()
        assert found["scalars"]["start_offset"]["value"] == pytest.approx(0.0, abs=0.5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("shape", SHAPES)
def test_an_effect_is_named_with_its_path(shape: str, tmp_path: Path, bowden: Command) -> None:
    """Path k of bench 1 is drawn as bench 1 + 1000 k: benches of a single path are identified, ten times as fast."""
    (tmp_path / "bench.toml").write_text(configuration.as_template(shape=shape))
    one, other = SHAPES[shape]
    for number, path in enumerate((one, other)):
        single = configuration.as_template().replace("rate_hz = 1000", "rate_hz = 500")
        (tmp_path / "single.toml").write_text(single)
        known = api.identify("all", bus=simulated(1 + 1000 * number), config=tmp_path / "single.toml")
        model_files.write(dataclasses.replace(known, bench=f"virtual 1 {path}"), tmp_path / f"own.{path}.toml")
    (tmp_path / "gain.toml").write_text(f"[path.{other}.end_sensor]\ngain = 1.06\n")
    status, out, _ = bowden(
        "trial", "--config", tmp_path / "bench.toml", "--calibration", tmp_path / "own.toml", "--controller",
        "extended", "--peak", 40, "--cycles", 6, "--plant-model", tmp_path / "gain.toml", "-o",
        tmp_path / "trial.mcap", "--json")
    paths = json.loads(out)["paths"]
    assert (status, [found["true_relative_rmse_percent"] < 0.3 for found in paths.values()]) == (0, [True, True])
    found = {}
    for path in paths:
        _, out, _ = bowden("diagnose", tmp_path / "trial.mcap", "--path", path, "--json")
        found[path] = {each["effect"] for each in json.loads(out)["causes"]}
    assert found == {one: set(), other: {"end_gain"}}
