"""Thinning never hides an extreme or a gap; packing never merges neighbours in time."""

from __future__ import annotations

import base64

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trial.report.page import Pool, broken, thinned


@given(st.lists(st.floats(-1e6, 1e6) | st.just(float("nan")), min_size=1, max_size=400), st.integers(1, 60))
def test_thinning_keeps_extremes_and_place(values: list[float], bins: int) -> None:
    column, x = np.array(values), np.arange(len(values)) * 0.5
    along, (drawn,) = thinned(x, [column], bins)
    assert len(along) == len(drawn) <= max(2 * bins, len(column))
    assert (np.diff(along) >= 0).all()
    assert along[0] == x[0]
    assert along[-1] == x[-1]
    np.testing.assert_array_equal(np.isfinite(drawn).any(), np.isfinite(column).any())
    if np.isfinite(column).any():
        assert np.nanmax(drawn) == np.nanmax(column)
        assert np.nanmin(drawn) == np.nanmin(column)


def test_a_bin_without_a_known_value_stays_unknown() -> None:
    column = np.ones(100)
    column[40:60] = np.nan
    along, (drawn,) = thinned(np.arange(100.0), [column], 10)
    assert np.isnan(drawn[(along >= 41) & (along <= 58)]).all()
    assert not np.isnan(drawn[(along < 39) | (along > 60)]).any()


def test_a_line_breaks_where_rows_are_missing() -> None:
    along, (drawn,) = broken(np.array([0.0, 1, 2, 7, 8]), [np.arange(5.0)], 2.5)
    np.testing.assert_array_equal(along, [0, 1, 2, 4.5, 7, 8])
    np.testing.assert_array_equal(drawn, [0, 1, 2, np.nan, 3, 4])


def test_time_is_packed_in_double_precision_only_where_it_must_be() -> None:
    pool = Pool()
    short, long = np.arange(1000) * 1e-3, 40_000 + np.arange(1000) * 1e-3
    assert [pool.packed[pool.abscissa(values)]["type"] for values in (short, long)] == ["f4", "f8"]
    back = np.frombuffer(base64.b64decode(pool.packed[1]["data"]), "<f8")
    np.testing.assert_array_equal(back, long)


def test_equal_arrays_are_packed_once() -> None:
    pool = Pool()
    assert pool.ordinate(np.zeros(10)) == pool.ordinate(np.zeros(10))
    assert pool.ordinate(np.ones(10)) == 1
    assert len(pool.packed) == 2
