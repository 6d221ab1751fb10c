"""What a sweep varies: names, values, grids, draws, and what is refused before anything runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from bowden.bench import configuration
from bowden.sweep import rows as sweep_rows
from bowden.sweep.row_trial import bench_of, digest
from bowden.sweep.rows import Departure, motion
from parameters import InputError
from physics.reference import paper_reference

SECTIONS = configuration.read(None)


def rows(*axes: str, draws: tuple[str, ...] = (), count: int = 1, seed: int = 0, **fixed: Any) -> list[sweep_rows.Row]:
    return sweep_rows.rows(SECTIONS, {f"files.{name}": value for name, value in fixed.items()},
                           [sweep_rows.axis(text) for text in axes], [sweep_rows.draw(text) for text in draws], count,
                           seed)


def test_a_grid_is_every_combination_and_every_row_is_whole() -> None:
    found = rows("peak=40,50", "serial=1-3", "day=1", "plant.mu1=0.1")
    assert [(row["gait.peak_n"], row["bench.serial"]) for row in found] == [
        (peak, serial) for peak in (40.0, 50.0) for serial in (1, 2, 3)]
    assert {"bench.seed", "impedance.damping_n_s_m", "network.rate_hz", "files.knee", "departure.tempo"} < set(found[0])
    assert all(row["plant.mu1"] == 0.1 and row["bench.day"] == 1 for row in found)


def test_draws_are_the_same_at_every_point_of_the_grid_and_again() -> None:
    wanted = ("impedance.damping_n_s_m=10:1000:log", "bench.seed=0:9")
    found = rows("serial=1,2", draws=wanted, count=3, seed=4)
    drawn = [(row["impedance.damping_n_s_m"], row["bench.seed"]) for row in found]
    assert drawn[:3] == drawn[3:]
    assert len(set(drawn)) == 3
    assert all(10 <= damping <= 1000 and isinstance(seed, int) and 0 <= seed <= 9 for damping, seed in drawn)
    assert drawn == [(row["impedance.damping_n_s_m"], row["bench.seed"])
                     for row in rows("serial=1,2", draws=wanted, count=3, seed=4)]


@pytest.mark.parametrize(("axes", "said"), [
    (["paek=40"], "did you mean peak"),
    (["peak=forty"], "'forty' is not a number"),
    (["serial=1.5"], "'1.5' is not a whole number"),
    (["peak=40,40"], "none of them twice"),
    (["peak"], "expected NAME=VALUE"),
    (["peak=40", "gait.peak_n=50"], "gait.peak_n: is varied twice"),
    (["peak=90"], "peak_n = 90.0 is outside 1 … 85 N"),
    (["controller=best"], "controller 'best' is not installed"),
    (["cycles=1"], "settle = 1 leaves none of 1 cycles"),
    (["plant.mu1=7"], "mu1 = 7.0 is outside"),
    (["bench.steady=plant.theta1_rad"], "plant.theta1_rad is nothing that a day changes"),
    (["calibration=absent.toml"], "absent.toml: no such file"),
    (["serial=1-2000", "seed=1-2000"], "4000000 trials, expected at most 1000000"),
    (["rate=2000"], "rate_hz"),
])
def test_bad_axes_are_refused_in_a_sentence(axes: list[str], said: str) -> None:
    with pytest.raises(InputError) as told:
        rows(*axes)
    assert said in str(told.value)


@pytest.mark.parametrize("text", ["peak=60:40", "peak=-1:1:log", "peak=1:2:lin", "controller=a:b", "peak=40"])
def test_bad_draws_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--draw"):
        sweep_rows.draw(text)


def test_a_row_has_the_stride_of_its_knee_file_unless_the_period_is_varied(tmp_path: Path) -> None:
    knee = tmp_path / "knee.csv"
    lines = [f"{t / 100:g},{-0.5 + 0.4 * math.cos(2 * math.pi * t / 150):.6f}" for t in range(300)]
    knee.write_text("\n".join(["time_s,knee_angle_rad", *lines]) + "\n")
    assert rows("serial=1", knee=str(knee))[0]["gait.period_s"] == pytest.approx(1.5, abs=0.02)
    assert rows("period=3", knee=str(knee))[0]["gait.period_s"] == 3.0


def test_a_calibration_belongs_to_a_bench_whatever_the_day_and_the_gait() -> None:
    one, other = rows("serial=4", "day=0,1", "peak=40,60")[::3]
    assert bench_of(one) == bench_of(other)
    assert digest(one) != digest(other)
    assert bench_of(one) != bench_of(rows("serial=4", "plant.mu1=0.1")[0])


def test_a_departing_knee_is_off_by_its_angle_and_runs_at_its_tempo() -> None:
    reference = paper_reference(40.0, 2.0)
    assert motion(reference, Departure()) is None
    moved = motion(reference, Departure(angle_rad=0.1, tempo=1.1))
    assert moved is not None
    assert moved.period_s == pytest.approx(2.0 / 1.1)
    for phase in (0.0, 0.13, 0.25, 0.5, 0.75):
        expected = reference.knee_angle(phase) + 0.1 * math.sin(2 * math.pi * phase)
        assert moved.knee_angle(phase) == pytest.approx(expected, abs=1e-6)
        before, after = (moved.knee_angle(phase + step) for step in (-1e-4, 1e-4))
        assert moved.knee_velocity(phase) == pytest.approx((after - before) / (2e-4 * moved.period_s), abs=1e-3)
