"""docs/unseen.md: what its table says, and the benches of the last run apart from those that were developed with."""

from __future__ import annotations

import pytest

from benchmarks import family, frame
from tests.plants.draws import set_aside


def test_the_page_in_the_docs_is_what_its_table_says() -> None:
    text = frame.filled(family.PAGE, family.tables(list(family.read(family.TABLE).values())))
    assert family.PAGE.read_text(encoding="utf-8") == text


def test_nothing_is_developed_on_a_serial_that_is_set_aside() -> None:
    assert not any(map(set_aside, family.DEVELOPMENT))
    assert all(map(set_aside, family.SET_ASIDE))
    assert len(family.SET_ASIDE) + len(family.DEVELOPMENT) >= 40


def test_the_loaded_part_leaves_out_what_end_is_at_idle() -> None:
    """Three quarters of the squares at idle: of a whole RMSE of 2 % one is loaded; of another's √7 % it is 2 %."""
    walk = {family.TRUE: 2.0, family.WINDOW: (1.0 / family.LOADED) ** 0.5, "paper": 7.0**0.5}
    assert family.loaded(walk) == 1.0
    assert abs(family.loaded(walk, "paper") - 2.0) < 1e-12


def test_a_calibration_of_the_table_has_the_evidence_of_its_lag() -> None:
    """Without it homing takes START's lag for unmeasured, and corrects it by what the sensor declares."""
    for row in family.read(family.TABLE).values():
        lag = family.parsed(row["calibration"]).evidence["start_lag"]
        assert lag.low < lag.high


@pytest.mark.exhaustive
@pytest.mark.parametrize("period_s", family.PERIODS_S)
def test_a_bench_whose_start_lags_more_than_declared_is_walked_by_its_row(period_s: float) -> None:
    """Serial 20: START lags by 2.7 ms, its sensor declares 0.5 ms."""
    row = family.read(family.TABLE)["family", 20]
    walk = family.walked("family", 20, row["calibration"], "extended",
                                family.CYCLES, family.SETTLE,
                                {"gait.peak_n": row["peak_n"], "gait.period_s": period_s})
    assert walk["outcome"] == "completed", walk
    assert walk[family.TRUE] < 2.0
