"""Data that contradict themselves are refused or warned of, with the column and the factor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from diagnosis.finder import diagnose
from estimation.data.integrity import between, examine, shared_rows
from estimation.data.scales import against_range
from estimation.data.table import Table, low_passed, table
from parameters import InputError


def moved(cycles: int = 6, **changed: np.ndarray) -> Table:
    """A rope and a knee that move together, with tensions, at 250 Hz."""
    time = np.arange(cycles * 250) / 250.0
    turn = 2.0 * np.pi * time
    rng = np.random.default_rng(0)
    rope = 0.01 * np.sin(turn)
    columns = {
        "time_s": time, "cycle": np.floor(time), "servo_position_m": rope, "knee_angle_rad": rope / 0.0404 - 0.5,
        "servo_velocity_m_s": 0.02 * np.pi * np.cos(turn), "tension_end_n": 20.0 + 15.0 * np.sin(turn),
        "tension_start_n": 22.0 + 16.0 * np.sin(turn) + rng.normal(0.0, 0.1, time.size)}
    return table("made.csv", columns | changed)


def refusal(given: Table) -> str:
    found = diagnose([given])
    assert found.verdict == "refused"
    assert found.as_json()["causes"] == []
    return found.warnings[0]


def test_time_that_does_not_rise_is_refused_with_its_row() -> None:
    time = np.arange(1500) / 250.0
    time[700] = time[698]
    assert "row 702" in refusal(moved(time_s=time))


@pytest.mark.parametrize(("unit", "factor"), [("deg", 57.3), ("mm", 1000.0)])
def test_another_unit_is_refused_with_the_factor(unit: str, factor: float) -> None:
    name = "knee_angle_rad" if unit == "deg" else "servo_position_m"
    told = "57.2958" if unit == "deg" else "1000"
    assert f"probably {unit}: divide it by {told}" in refusal(moved(**{name: factor * moved()[name]}))


def test_time_in_milliseconds_is_refused_with_the_factor_though_the_trial_looks_long() -> None:
    assert "if it is in milliseconds, divide it by 1000" in refusal(moved(time_s=4.0 * np.arange(1500)))


def test_forces_in_kilonewton_are_refused_beside_a_reference() -> None:
    small = moved(tension_start_n=1e-3 * moved()["tension_start_n"])
    (found,) = against_range([small], [moved()])
    assert "tension_start_n reaches only 0.038" in found.text
    assert "is it in kN?" in found.text
    assert not list(against_range([moved(tension_start_n=0.1 * moved()["tension_start_n"])], [moved()]))


def test_too_few_cycles_are_refused() -> None:
    assert "2 cycles" in refusal(moved(cycles=2))


def test_a_velocity_that_is_no_derivative_is_refused() -> None:
    noise = np.random.default_rng(1).normal(size=1500)
    assert "servo_velocity_m_s" in refusal(moved(servo_velocity_m_s=noise))


def test_a_velocity_in_other_units_is_warned_of_with_the_factor() -> None:
    said = examine(moved(servo_velocity_m_s=1000.0 * moved()["servo_velocity_m_s"]))
    assert [f.refuses for f in said] == [False]
    assert "mm/s" in said[0].text


def test_a_clock_off_by_a_quarter_is_warned_of_with_the_factor() -> None:
    said = examine(moved(time_s=1.25 * np.arange(1500) / 250.0))
    assert any("1.25" in f.text for f in said)


@pytest.mark.parametrize("level", [3.0, math.nan])
def test_a_signal_that_holds_nothing_is_said_and_not_used(level: float) -> None:
    said = examine(moved(tension_end_n=np.full(1500, level)))
    assert len(said) == 1
    assert "not used" in said[0].text


def test_the_same_data_twice_are_refused_as_holdout() -> None:
    found = diagnose([moved()], holdout=[moved()])
    assert found.verdict == "refused"
    assert "the same data" in found.warnings[0]


def another(given: Table, name: str, **changed: np.ndarray) -> Table:
    """Another recording of the same: the same motion, other noise."""
    noise = np.random.default_rng(len(name)).normal(0.0, 0.1, len(given))
    return table(name, {**given.columns, "tension_start_n": given["tension_start_n"] + noise, **changed})


def test_a_part_of_another_recording_is_said_and_refused_as_holdout() -> None:
    whole = moved()
    part = table("part.csv", {name: values[25:] for name, values in whole.columns.items()})
    (finding,) = between([whole, part], [], [])
    assert "100 % of the rows of part.csv are in made.csv, too" in finding.text
    assert not finding.refuses
    refused = diagnose([whole], holdout=[part])
    assert refused.verdict == "refused"
    assert "a holdout trial must be another recording" in refused.warnings[0]
    assert shared_rows(whole, another(whole, "other.csv")) == 0.0


def test_a_force_an_order_of_magnitude_beyond_the_healthy_trials_is_refused() -> None:
    healthy = another(moved(), "healthy.csv")
    start = moved()["tension_start_n"]
    refused = diagnose([another(moved(), "wide.csv", tension_start_n=np.where(start < 10.0, start + 655.36, start))],
                       healthy=[healthy])
    assert refused.verdict == "refused"
    assert "wide.csv: tension_start_n reaches 665 N, in the healthy trials at most 38" in refused.warnings[0]
    threefold = another(moved(), "three.csv", tension_start_n=3.0 * start, tension_end_n=3.0 * moved()["tension_end_n"])
    assert list(against_range([threefold], [healthy])) == []


def test_a_low_pass_at_or_above_half_the_rate_is_refused() -> None:
    with pytest.raises(InputError, match="125 Hz"):
        low_passed(moved(), 125.0)


def test_a_low_pass_moves_no_phase() -> None:
    given = moved()
    filtered = low_passed(given, 20.0)
    inner = slice(250, -250)
    assert np.abs(filtered["servo_position_m"] - given["servo_position_m"])[inner].max() < 1e-5
    assert np.array_equal(filtered["cycle"], given["cycle"])
