"""A walk of strides that differ: no step in angle or speed, what is drawn lies in its bounds, one seed is one walk."""

from __future__ import annotations

import numpy as np
import pytest

from parameters import InputError
from physics import stride_walk
from physics.reference import recorded_angle
from physics.stride_walk import Variation
from tests.stride_files import strides

SAMPLES, PERIOD_S = 1200, 1e-3
SEVERAL = strides(6)


def walk(variation: Variation) -> stride_walk.StrideWalk:
    angle = recorded_angle(*stride_walk.mean(SEVERAL))[0][:-1]
    lap = np.interp(np.arange(SAMPLES), np.arange(1001) * SAMPLES / 1000, np.append(angle, angle[0]))
    return stride_walk.walk(SEVERAL, variation, lap, PERIOD_S, 1000, 400)


@pytest.mark.parametrize("seed", range(3))
def test_a_walk_has_no_step_in_angle_or_speed(seed: int) -> None:
    found = walk(Variation(16, seed, 0.08, 0.1, stumbles=1, stops=1, sits=1))
    speed = np.diff(found.knee_rad) / PERIOD_S
    assert np.abs(speed).max() < 9.0
    assert np.abs(np.diff(speed)).max() < 0.25, "rad/s in a millisecond: 250 rad/s²"


def test_periods_lie_in_their_bounds_and_the_phase_is_that_of_the_stride() -> None:
    found = walk(Variation(20, 4, 0.08, 0.1))
    lengths = [one.samples / SAMPLES for one in found.played]
    assert 0.92 <= min(lengths) < 0.97
    assert 1.03 < max(lengths) <= 1.08
    for i, one in enumerate(found.played):
        middle = one.begin + one.samples // 2
        assert found.at(middle)[1:] == (pytest.approx(50.0, abs=0.1), i)
    assert found.at(-1)[2] == found.at(found.samples)[2] == -1.0


def test_one_seed_is_one_walk_and_another_one_another() -> None:
    same, again, other = (walk(Variation(8, seed, 0.08, 0.1)) for seed in (1, 1, 2))
    assert np.array_equal(same.knee_rad, again.knee_rad)
    assert not np.array_equal(same.knee_rad[:2000 + SAMPLES], other.knee_rad[:2000 + SAMPLES])


def test_interruptions_are_as_many_as_asked_for_and_have_no_phase() -> None:
    found = walk(Variation(20, 7, 0.08, 0.1, stumbles=2, stops=2, sits=1))
    kinds = [one.kind for one in found.played]
    assert [kinds.count(kind) for kind in ("walk", "stumble", "stop", "sit")] == [18, 2, 2, 1]
    for one in found.played:
        percent = found.percent[found.before + one.begin:found.before + one.begin + one.samples]
        unknown = {"walk": 0.0, "stumble": stride_walk.TRIPPED_S, "stop": stride_walk.STILL_S,
                   "sit": stride_walk.STILL_S}[one.kind]
        assert np.isnan(percent).sum() * PERIOD_S == pytest.approx(unknown, abs=2e-3)


def test_more_interruptions_than_there_is_room_for_are_refused() -> None:
    with pytest.raises(InputError, match="at most one in 4, so 2: ask for more strides"):
        walk(Variation(8, 0, 0.08, 0.1, stumbles=2, stops=1))
