"""Real knee motion through `--knee`: eleven recorded cycles that do not close, and markers with gaps."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trial as trials
from bowden.pages.figures import true_end
from parameters import InputError
from physics.reference import Reference, paper_force, recorded_angle
from trial import metrics
from trial.curves import AXES, read_curve

GAIT = Path(__file__).parents[3] / "shared" / "data" / "gait"
CYCLES = [f"cycle_{number:02d}.csv" for number in range(1, 12)]
MARKERS = "treadmill_markers.csv"

pytestmark = pytest.mark.skipif(
    not GAIT.is_dir(), reason="../shared/data/gait is absent: real knee motion is not in the repository")


def lines() -> list[list[str]]:
    with (GAIT / MARKERS).open(newline="") as file:
        return list(csv.reader(file))


def closed(name: str) -> Reference:
    curve = read_curve(GAIT / name, "knee_angle_rad")
    return Reference(1.2, recorded_angle(curve.percent, curve.values), paper_force(40.0))


@pytest.mark.parametrize("name", [*CYCLES, MARKERS])
def test_a_recorded_cycle_closes_without_a_step_and_keeps_its_middle(name: str) -> None:
    curve, reference = read_curve(GAIT / name, "knee_angle_rad"), closed(name)
    assert reference.knee_angle(0.0) == pytest.approx(reference.knee_angle(1.0 - 1e-12), abs=1e-9)
    assert reference.knee_velocity(0.0) == pytest.approx(reference.knee_velocity(1.0 - 1e-12), abs=1e-6)
    inside = (curve.percent >= 10.0) & (curve.percent <= 90.0)
    kept = [reference.knee_angle(at / 100.0) for at in curve.percent[inside]]
    # a thousand cubic cells through samples one percent apart: what is left is interpolation, 0.001° at most
    assert np.abs(kept - curve.values[inside]).max() < np.radians(0.001)


def test_lost_markers_are_bridged_and_counted() -> None:
    curve = read_curve(GAIT / MARKERS, "knee_angle_rad")
    lost = [row[1] == "" for row in lines()[1:]]
    kept = lost[lost.index(False): len(lost) - lost[::-1].index(False)]
    assert curve.bridged == sum(kept) > 0
    assert curve.trimmed == len(lost) - len(kept)
    assert curve.begins >= 7.0
    assert curve.stride_s == pytest.approx(1.19, abs=0.03)
    assert curve.strides == 2
    assert f"{curve.bridged} missing values bridged" in curve.note()


@pytest.mark.parametrize(("samples", "accepted"), [(9, True), (10, False)])
def test_a_gap_is_bridged_up_to_the_stated_length_and_refused_beyond(
    tmp_path: Path, samples: int, accepted: bool
) -> None:
    rows = lines()
    whole = next(start for start in range(20, len(rows)) if all(row[1] for row in rows[start - 1:start + samples + 1]))
    for row in rows[whole:whole + samples]:
        row[1] = ""
    path = tmp_path / "gap.csv"
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    assert AXES["time_s"].longest_gap == 0.1
    if accepted:
        assert read_curve(path, "knee_angle_rad").bridged >= samples
    else:
        with pytest.raises(InputError, match=r"at most 0\.1 s are bridged"):
            read_curve(path, "knee_angle_rad")


@pytest.mark.parametrize("name", [
    *(pytest.param(name, marks=pytest.mark.exhaustive) for name in CYCLES[1:]), CYCLES[0], MARKERS])
def test_the_bench_walks_it_and_every_stride_has_its_figures(
    bowden: Callable[..., Any], here: Path, name: str
) -> None:
    period = () if name == MARKERS else ("--period", 1.2)
    told = bowden("trial", "--knee", GAIT / name, *period, "--cycles", 2, "--json", "-o", "t.mcap")
    assert told.status == 0, told.stderr
    result = json.loads(told.stdout)
    assert (result["outcome"], result["missed_cycles"]) == ("completed", 0)
    recorded = trials.open(here / "t.mcap")
    true = true_end(here / "t.truth.mcap", recorded)
    strides = [metrics.figures(recorded.columns, peak_n=40.0, rate_hz=1000, cycles=cycle + 1, settle=cycle,
                               true_end_n=true) for cycle in (0, 1)]
    assert [stride["true_relative_rmse_percent"] is not None for stride in strides] == [True, True]
    assert strides[1] == {key: result[key] for key in strides[1]}
    # the paper's controller on a knee it was not tuned for: the force is there, no better than the paper's own figure
    assert 0.0 < strides[1]["true_relative_rmse_percent"] < 10.0

