"""Benches of several force paths: a lost node, or a limit of one path, lets every path go.

The rows of the fault matrix that concern a node run on two legs and on two ropes on one joint: each node is cut off
while the first path's rope is taut.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bowden as api
from bowden.bench import configuration
from bowden.bench.buses import simulated
from eds.declaration import DeclaredBench, packaged
from trial.read import Trial
from trial.read import open as opened

SHAPES = ("bench_two_legs", "bench_antagonists")
Command = Callable[..., tuple[int, str, str]]
GAIT: dict[str, Any] = {"peak_n": 20, "period_s": 1, "cycles": 1, "settle": 0}


@pytest.fixture(scope="module", params=SHAPES)
def walked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[DeclaredBench, Path]:
    """A bench, and a folder with its configuration and a trial of one gait cycle."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "bench.toml").write_text(configuration.as_template(shape=request.param))
    api.run(api.Experiment(**GAIT, configuration=folder / "bench.toml"), output=folder / "trial.mcap")
    return packaged(request.param), folder


def stopped(folder: Path, fault: dict[str, Any] | None = None, file: str = "bench.toml", **changed: float
            ) -> tuple[str, Trial]:
    """Run the trial again, with a fault or `changed` options; return the reason of the stop, and the trial."""
    output = folder / "stopped.mcap"
    found = api.run(api.Experiment(**GAIT | changed, configuration=folder / file), output=output, overwrite=True,
                    bus=simulated(faults=[fault] if fault else []))
    assert found.outcome == "stopped"
    return str(found.figures["stop_reason"]), opened(output)


def let_go(bench: DeclaredBench, trial: Trial, lost: int = 0) -> None:
    """Assert that every load cell but a lost one reads a slack rope, and every drive but a lost one is disabled.

    A rope is slack below 5 N (`safe_stop.SLACK_N`); that of a lost servo is left as it is, here at 5 to 6 N.
    """
    for path in bench.force_paths:
        nodes = bench.nodes_of(path)
        slack_n = 6.0 if nodes.servo == lost else 5.0
        for node, column in ((nodes.start, "tension_start_n"), (nodes.end, "tension_end_n")):
            assert node == lost or trial.columns[f"{path.name}.{column}"][-1] < slack_n, (path.name, column)
        for node in {nodes.servo, nodes.knee} - {lost}:
            last = trial.frames[trial.frames["can_id"] == 0x180 + node]["data"][-1]
            assert last[0] & 0x4F == 0x40, (path.name, node)  # SWITCH ON DISABLED


@pytest.mark.exhaustive
@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("number", range(2))
def test_a_node_of_one_path_cut_off_lets_every_path_go(
    walked: tuple[DeclaredBench, Path], number: int, place: int
) -> None:
    bench, folder = walked
    first, path = bench.force_paths[0], bench.force_paths[number]
    columns = opened(folder / "trial.mcap").columns
    taut = int(np.nanargmax(np.where(columns[f"{first.name}.cycle"] == 0, columns[f"{first.name}.tension_end_n"], 0)))
    lost = bench.nodes_of(path)[place]
    reason, trial = stopped(folder, {"kind": "cut", "node": lost, "start_s": float(columns["time_s"][taut])})
    device = next(device.name for device in bench.devices if device.node_id == lost)
    told = next(one.name for one in bench.force_paths if lost in bench.nodes_of(one))
    assert re.fullmatch(rf"inputs too old: {device} missed \d+ cycles in a row.* \(force path {told}\)", reason)
    let_go(bench, trial, lost)


@pytest.mark.exhaustive
def test_the_limit_of_one_path_stops_every_path(walked: tuple[DeclaredBench, Path]) -> None:
    """The second path's START limit lies between what its homing and its gait reach.

    It bounds the drive's speed, too (docs/drives.md): at a period of 1 s the rope would fall behind the swing.
    """
    bench, folder = walked
    path, strong = bench.force_paths[1], {"peak_n": 60, "period_s": 2}
    api.run(api.Experiment(**GAIT | strong, configuration=folder / "bench.toml"), output=folder / "strong.mcap")
    columns = opened(folder / "strong.mcap").columns
    start, gait = columns[f"{path.name}.tension_start_n"], columns[f"{path.name}.cycle"] == 0
    limit = round(0.5 * (np.nanmax(start[gait]) + np.nanmax(start[~gait])), 1)
    text = (folder / "bench.toml").read_text() + f"\n[limits.{path.start}]\nstart_n = {limit}\n"
    (folder / "own.toml").write_text(text)
    reason, trial = stopped(folder, file="own.toml", **strong)
    assert re.fullmatch(rf"START tension above its limit: [0-9.]+ N of {limit:g} N \(force path {path.name}\)", reason)
    assert trial.columns[f"{path.name}.tension_start_n"].max() < limit + 2.0
    assert (trial.columns[f"{path.name}.cycle"] == 0).any()
    let_go(bench, trial)
    attached = trial.attachments[f"{path.name}.bench.toml"].decode()
    assert f"start_n = {limit}" in attached
    assert f"[limits.{path.start}]" in trial.attachments["bench.toml"].decode()


def test_check_shows_the_limits_of_each_path(tmp_path: Path, bowden: Command) -> None:
    text = configuration.as_template(shape="bench_antagonists")
    (tmp_path / "bench.toml").write_text(
        text + "\n[limits.extensor]\nstart_n = 60\n[limits.flexor_end]\nend_n = 50\n[limits.knee]\nknee_rad_s = 9\n")
    status, out, _ = bowden("check", "config", tmp_path / "bench.toml", "--json")
    assert status == 0
    limits = json.loads(out)["limits"]
    assert [limits[path]["start_n"] for path in ("flexor", "extensor")] == [120, 60]
    assert [limits[path]["end_n"] for path in ("flexor", "extensor")] == [50, 90]
    assert [limits[path]["knee_rad_s"] for path in ("flexor", "extensor")] == [9, 9]
    out = bowden("check", "config", tmp_path / "bench.toml")[1]
    assert re.search(r"start_n \(N\)\W+120\W+60\W", out)


@pytest.mark.parametrize(("table", "sentence"), [
    ("[limits.left_leg]\nstart_n = 60", "the bench has no device, joint or force path left_leg with limits"),
    ("[limits.left_start]\nend_n = 60", "end_n is no limit of left_start; expected one of start_n, unwound_n"),
    ("[limits.left]\nstale_cycles = 3", "stale_cycles is no limit of left"),
    ("[limits.left]\nstart_n = 600", "start_n = 600 is outside 1 … 300 N"),
    ("[limits.left]\nstart_n = 60\n[limits.left_start]\nstart_n = 50",
     "limits.left.start_n and limits.left_start.start_n are both of the force path left; leave one out"),
])
def test_a_limit_of_nothing_is_refused(tmp_path: Path, bowden: Command, table: str, sentence: str) -> None:
    (tmp_path / "bench.toml").write_text(configuration.as_template(shape="bench_two_legs") + f"\n{table}\n")
    status, out, err = bowden("check", "config", tmp_path / "bench.toml")
    assert (status, out) == (2, "")
    assert sentence in err


def test_a_raised_limit_of_one_path_needs_a_reason(tmp_path: Path, bowden: Command) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(configuration.as_template(shape="bench_two_legs") + "\n[limits.right]\nend_n = 95\n")
    status, _, err = bowden("trial", "--config", file, "-o", tmp_path / "trial.mcap")
    assert status == 2
    assert "limits.right.end_n = 95 N (packaged 90)" in err


def test_a_jog_keeps_the_limits_of_its_path(tmp_path: Path, bowden: Command) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(configuration.as_template(shape="bench_two_legs") + "\n[limits.right_servo]\nrope_m_s = 0.02\n")
    jog = ("jog", "servo", "--by", "-2", "--speed", "30", "--config", file, "--interface", "bowden", "--channel", "jog")
    status, _, err = bowden(*jog, "--path", "right")
    assert status == 2
    assert "is above limits.rope_m_s, 20.0 mm/s" in err


def test_one_path_has_the_limits_of_its_devices(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text("[limits]\nend_n = 70\n[limits.start]\nstart_n = 80\n")
    limits = configuration.read(file)["limits"]
    assert (limits.start_n, limits.end_n, limits.own) == (80, 70, ())
