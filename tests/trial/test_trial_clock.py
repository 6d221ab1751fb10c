"""Stamps of foreign clocks: what is mended, how, and that it is counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from parameters import InputError
from trial.convert import frames

S = 1_000_000_000


def test_a_clock_set_back_goes_on_where_it_stood() -> None:
    mended = frames.mend(np.array([5 * S, 6 * S, 1 * S, 2 * S, 3 * S], np.int64))
    assert mended.times.tolist() == [5 * S, 6 * S, 6 * S, 7 * S, 8 * S]
    assert (mended.steps, mended.shift_ns) == (1, 0)


def test_frames_logged_out_of_order_keep_their_stamps() -> None:
    times = np.array([S, S + 500, S + 200, S + 900], np.int64)
    mended = frames.mend(times)
    assert (mended.times.tolist(), mended.steps, mended.shift_ns) == (times.tolist(), 0, 0)


def test_negative_times_are_shifted_to_zero() -> None:
    assert frames.mend(np.array([-3, 5], np.int64)).times.tolist() == [0, 8]
    assert frames.mend(np.array([-3, 5], np.int64)).shift_ns == 3


def test_coarse_stamps_are_spread_between_those_that_rise() -> None:
    times = np.repeat(np.array([0, 10, 20, 60], np.int64), [4, 4, 4, 2])
    spread, replaced = frames.rising(times)
    assert spread.tolist() == [0, 2, 5, 7, 10, 12, 15, 17, 20, 30, 40, 50, 60, 62]
    assert replaced == 10


def test_an_epoch_loses_no_nanosecond() -> None:
    epoch = 1_700_000_000_123_456_789
    spread, _ = frames.rising(np.array([epoch, epoch, epoch + 7], np.int64))
    assert spread[0] == epoch
    assert spread[2] == epoch + 7


@given(st.lists(st.integers(0, 10**17), max_size=60))
def test_times_rise_whatever_came_in(stamps: list[int]) -> None:
    given_times = np.array(stamps, np.int64)
    times, replaced = frames.rising(given_times)
    assert (np.diff(times) > 0).all()
    assert np.count_nonzero(times != given_times) <= len(times) if replaced else np.array_equal(times, given_times)


@pytest.mark.parametrize("times", [
    [0, 4 * 10**18, 0, 4 * 10**18, 0, 5 * S],  # its leaps add up to more than int64 holds
    [-9 * 10**18, 9 * 10**18],
])
def test_a_clock_that_leaps_beyond_int64_is_refused(times: list[int]) -> None:
    with pytest.raises(InputError, match=r"own\.log: its clock leaps to and fro"):
        frames.mend(np.array(times, np.int64), "own.log")


def test_a_coarse_clock_whose_last_stamps_go_on_beyond_int64_is_refused() -> None:
    with pytest.raises(InputError, match="its clock leaps to and fro"):
        frames.rising(np.array([0, 3 * 10**18, *[3 * 10**18] * 10], np.int64))
