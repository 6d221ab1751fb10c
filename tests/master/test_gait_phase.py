"""The phase from the knee angle alone, on drawn walks: its error, its loss and return, and the force asked for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.strides import strides_of
from master.control import gait_phase
from master.control.gait_phase import Reading
from master.control.gait_table import GaitTable, tabulate
from master.settings import Walk
from physics import stride_walk
from physics.calibration import nominal
from physics.laws import Array, desired_force
from physics.reference import recorded_angle
from physics.stride_walk import Stride, StrideWalk, Variation
from tests.stride_files import strides
from trial.curves import read_strides

GAIT = Path(__file__).parents[3] / "shared" / "data" / "gait"
SAMPLES, PERIOD_S = 1200, 1e-3
NEVER_SURE = Reading(0.0, 0.0, 0.29, 0.0, False, False)


def lap_of(played: Sequence[Stride]) -> Array:
    angle = recorded_angle(*stride_walk.mean(played))[0][:-1]
    return np.interp(np.arange(SAMPLES), np.arange(1001) * SAMPLES / 1000, np.append(angle, angle[0]))


@cache
def lap() -> Array:
    return lap_of(strides(6))


def table(knee_rad: Array | None = None) -> GaitTable:
    desired = desired_force(np.arange(SAMPLES) * 100.0 / SAMPLES, 40.0)
    return tabulate(nominal(), lap() if knee_rad is None else knee_rad, desired, PERIOD_S, 2e-3)


@cache
def felt(seed: int, stumbles: int = 0, stops: int = 0, sits: int = 0) -> tuple[StrideWalk, list[Reading], Array]:
    return followed(strides(6), Variation(12, seed, 0.08, 0.1, stumbles, stops, sits))


def followed(played: Sequence[Stride], variation: Variation) -> tuple[StrideWalk, list[Reading], Array]:
    """Return a walk, its readings, and the share of the force by control cycle."""
    mean = lap_of(played)
    walk = stride_walk.walk(played, variation, mean, PERIOD_S, 1000, 0)
    config, memory, readings, share, shares, gait = (
        gait_phase.configure(mean, PERIOD_S, Walk().departure_rad), gait_phase.initial(), [], -1.0, [], table(mean))
    for angle in walk.knee_rad.tolist():
        reading, memory = gait_phase.step(config, memory, angle)
        share = gait_phase.follow(share, reading, gait)
        readings.append(reading)
        shares.append(share)
    return walk, readings, np.array(shares)


@pytest.mark.parametrize("seed", range(4))
def test_the_phase_is_off_by_less_than_one_and_a_half_percent(seed: int) -> None:
    walk, readings, shares = felt(seed)
    walked = slice(walk.before, walk.before + walk.samples)
    phase = 100.0 * np.array([one.phase for one in readings])[walked]
    error = np.mod(phase - walk.percent[walked] + 50.0, 100.0) - 50.0
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert all(one.known for one in readings[walked])
    assert (shares[walked] == 1.0).all()


@pytest.mark.parametrize(("kind", "count"), [("stop", {"stops": 1}), ("sit", {"sits": 1})])
def test_a_wearer_who_rests_is_asked_for_no_force(kind: str, count: dict[str, int]) -> None:
    walk, readings, shares = felt(11, **count)
    (rest,) = [one for one in walk.played if one.kind == kind]
    begin, end = walk.before + rest.begin, walk.before + rest.begin + rest.samples
    asked = desired_force(100.0 * np.array([one.phase for one in readings]), 40.0) * np.maximum(shares, 0.0)
    assert np.count_nonzero(asked[begin:end] > 3.0) < 100, "ms of more than 3 N"
    assert not any(one.known for one in readings[begin + 300:end - 300])
    assert shares[begin + 500] == -1.0
    assert (shares[end + 2 * SAMPLES:end + 3 * SAMPLES] == 1.0).all() or end + 3 * SAMPLES > walk.samples


@pytest.mark.parametrize("seed", range(20, 24))
def test_a_stumble_costs_the_phase_or_leaves_it_right(seed: int) -> None:
    walk, readings, shares = felt(seed, stumbles=1)
    (trip,) = [one for one in walk.played if one.kind == "stumble"]
    after = slice(walk.before + trip.begin + trip.samples + SAMPLES, walk.before + walk.samples)
    phase = 100.0 * np.array([one.phase for one in readings])
    error = np.abs(np.mod(phase - walk.percent + 50.0, 100.0) - 50.0)
    asked = (shares > 0.0) & (np.arange(len(shares)) >= walk.before)
    assert error[after][asked[after]].max(initial=0.0) < 6.0


@pytest.mark.slow
@pytest.mark.skipif(not GAIT.is_dir(), reason="../shared/data/gait is absent")
@pytest.mark.parametrize("seed", [2003, 2010, 2016, 2017])
def test_a_stumble_of_a_recorded_stride_is_pulled_for_less_than_a_tenth_of_a_second(seed: int, tmp_path: Path) -> None:
    played = [Stride(one.percent, one.values, float("nan"))
              for one in read_strides(strides_of(GAIT, tmp_path / "strides.csv"))]
    walk, readings, shares = followed(played, Variation(60, seed, 0.08, 0.1, stumbles=14))
    pulled = desired_force(100.0 * np.array([one.phase for one in readings]), 40.0) * np.maximum(shares, 0.0) > 3.0
    trips = [slice(walk.before + one.begin, walk.before + one.begin + one.samples)
             for one in walk.played if one.kind == "stumble"]
    assert len(trips) == 14
    assert max(np.count_nonzero(pulled[trip] & np.isnan(walk.percent[trip])) for trip in trips) < 100, "ms"


def test_a_cycle_without_an_angle_leads_the_phase_on() -> None:
    config, memory = gait_phase.configure(lap(), PERIOD_S, Walk().departure_rad), gait_phase.initial()
    for i in range(2 * SAMPLES):
        reading, memory = gait_phase.step(config, memory, lap()[i % SAMPLES])
    for _ in range(10):
        reading, memory = gait_phase.step(config, memory, float("nan"))
    assert reading.known
    assert (reading.phase * SAMPLES) % SAMPLES == pytest.approx(9, abs=3)


def test_a_step_changes_no_memory_that_it_is_given() -> None:
    config, memory = gait_phase.configure(lap(), PERIOD_S, Walk().departure_rad), gait_phase.initial()
    before = memory.copy()
    gait_phase.step(config, memory, -0.5)
    assert np.array_equal(memory, before)


def test_the_force_falls_in_sixty_milliseconds_and_begins_where_the_rope_is_slack() -> None:
    gait, share, shares = table(), 1.0, []
    for _ in range(250):
        share = gait_phase.follow(share, NEVER_SURE, gait)
        shares.append(share)
    assert shares[59] == pytest.approx(0.0, abs=1e-9)
    assert shares[-1] == -1.0
    sure = NEVER_SURE._replace(known=True, doubt=0.005)
    assert gait_phase.follow(-1.0, sure._replace(phase=0.2), gait) == -1.0
    assert gait_phase.follow(-1.0, sure._replace(phase=0.6), gait) == 1.0
    assert gait_phase.follow(-1.0, sure._replace(phase=0.6, doubt=0.2), gait) == -1.0
