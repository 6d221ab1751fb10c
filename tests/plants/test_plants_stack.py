"""The family through the whole stack: devices, wire and master on benches that nobody tuned them to."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bowden.cli.app import run
from tests.plants import bench_of, stack
from tests.plants.bench import IMPLEMENTATIONS
from trial import read

PEAK_N = 40.0
PERIOD_S = 1.1


@pytest.mark.parametrize("implementation", [
    IMPLEMENTATIONS[0], *(pytest.param(name, marks=pytest.mark.exhaustive) for name in IMPLEMENTATIONS[1:])])
def test_a_cycle_on_every_method_with_the_nominal_calibration(
    implementation: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, path = tmp_path / "loop.toml", tmp_path / "one.mcap"
    model.write_text(stack.toml(3, implementation), encoding="utf-8")
    arguments = ["trial", "--peak", PEAK_N, "--period", PERIOD_S, "--cycles", 1, "--settle", 0, "--serial", 0,
                 "--plant", stack.plant_name(3, 1, implementation), "--plant-model", model, "--json", "-o", path]
    assert run([str(argument) for argument in arguments]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outcome"] == "completed", told["stop_reason"]
    columns = read.open(path).columns
    wanted = columns["desired_force_n"]
    end = columns["tension_end_n"][wanted > 0.0]
    assert end.max() == pytest.approx(PEAK_N, rel=0.15)
    # START never jumps as no rope can: lead stiffness 1/lead at 0.6 m/s, and four standard deviations of its noise
    bench = bench_of(f"{implementation}_3_day_1")
    assert np.abs(np.diff(columns["tension_start_n"])).max() < 0.6e-3 / bench.lead + 4.0 * 0.15 * 1.5
