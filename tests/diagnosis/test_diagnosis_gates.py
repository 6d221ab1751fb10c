"""Files that are wrong are refused with the column, and no bench is called faulty for them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from diagnosis.finder import diagnose
from estimation.bench_fit import turned
from estimation.data.table import Table, table
from tests.hidden.bench import Bench
from tests.hidden.walk import trial

Change = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


def walked(seed: int) -> Table:
    return table(f"walk_{seed}.csv", trial(Bench(), seed=seed, cycles=4))


def changed(name: str, values: Callable[[np.ndarray], np.ndarray]) -> Callable[[Table], Table]:
    return lambda given: dataclasses.replace(given, columns={**given.columns, name: values(given[name])})


def copied(given: Table) -> Table:
    return dataclasses.replace(given, columns={**given.columns, "tension_end_n": given["tension_start_n"]})


@pytest.mark.parametrize(("wrong", "column"), [
    (changed("knee_angle_rad", lambda v: -v), "knee_angle_rad has the other sign"),
    (changed("servo_position_m", lambda v: 10.0 * v), "servo_position_m moves 10 times"),
    (copied, "tension_end_n equals tension_start_n"),
    (changed("tension_end_n", np.zeros_like), "tension_end_n stays within 0 N"),
])
def test_a_wrong_column_is_refused_by_name(wrong: Callable[[Table], Table], column: str) -> None:
    found = diagnose([wrong(walked(1))], healthy=[walked(2)])
    assert found.verdict == "refused"
    assert column in found.warnings[0]


@pytest.mark.slow
def test_healthy_trials_that_do_not_fit_teach_nothing() -> None:
    rng = np.random.default_rng(0)
    noisy = changed("tension_start_n", lambda v: v + 30.0 * np.sin(np.cumsum(0.05 * rng.normal(size=v.size))))
    found = diagnose([walked(1)], healthy=[noisy(walked(2))])
    assert found.verdict == "refused"
    assert "do not fit" in found.warnings[0]


def test_without_end_no_friction_is_named_and_what_end_would_tell_is_said() -> None:
    without = [dataclasses.replace(t, columns={n: v for n, v in t.columns.items() if n != "tension_end_n"})
               for t in (walked(1), walked(2))]
    found = diagnose([without[0]], healthy=[without[1]])
    assert found.verdict == "none"
    assert any("tension_end_n recorded" in w and "cable_friction" in w for w in found.warnings)


@pytest.mark.exhaustive
def test_the_top_line_is_what_the_simulation_of_this_bench_misses() -> None:
    told = diagnose([walked(1)], healthy=[walked(2)]).simulation
    assert told is not None
    # another structure of plant, two sensors with 0.1 N of noise
    assert told["before_rms_n"] < 1.0
    assert told["after_rms_n"] is None
    assert told["session_rms_n"] < 1.5 * told["before_rms_n"]
    assert 0.0 < told["healthy_rms_n"] < 1.5 * told["before_rms_n"]


@pytest.mark.exhaustive
def test_a_rope_that_is_counted_the_other_way_is_diagnosed_alike() -> None:
    trial, good = walked(1), walked(2)
    other_way = diagnose([turned(trial)], healthy=[turned(good)])
    assert other_way.verdict == diagnose([trial], healthy=[good]).verdict != "refused"
