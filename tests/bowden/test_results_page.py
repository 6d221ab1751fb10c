"""docs/results.md: medians, worst benches and targets from rows; the page is what its table says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import pytest

from benchmarks import frame, reproduce
from benchmarks.reproduce import CONTROLLERS, PEAKS_N, PERIODS_S, Result
from physics import laws
from physics.plant.bench_plant import NOMINAL


def result(experiment: str, controller: str, serial: int, rmse: float, **more: object) -> Result:
    given = {"case": "", "peak_n": 40.0, "period_s": 2.0, "window": 2 * rmse, "idle": 0.2, "jump": 0.3,
             "outcome": "completed"} | more
    return Result(experiment=experiment, controller=controller, serial=serial, rmse=rmse,
                  **given)  # type: ignore[arg-type]


def good() -> list[Result]:
    """Five benches whose extended controller has 0.1 × serial %, all targets met."""
    grid = [result("grid", controller, serial, 0.1 * serial if controller == "extended" else 2.0 + serial, peak_n=peak,
                   period_s=period)
            for controller, peak, period, serial in itertools.product(CONTROLLERS, PEAKS_N, PERIODS_S, range(1, 6))]
    blind = [result("START ignored", "extended", serial, 0.5 * serial) for serial in range(1, 6)]
    departing = [result("departure", "extended", 1, 1.2, case=case) for case in reproduce.DEPARTURES]
    return grid + blind + departing + [
        result("share", "extended", serial, 0.05 * serial, case=case)
        for case in reproduce.SHARES for serial in (1, 2, 3)]


def verdicts(results: Iterable[Result]) -> list[bool]:
    return [target.met for target in reproduce.targets(list(results))]


def test_medians_and_worst_are_of_the_benches_of_a_cell() -> None:
    targets = reproduce.targets(good())
    assert [target.found for target in targets] == pytest.approx([0.3, 0.3, 0.5, 0.2, 0.2, 0.75, 1.2, 0])
    assert all(verdicts(good()))
    assert "| 2 | 40 | 2.53 | 5.00 / 7.00 | 5.00 / 7.00 | 5.00 / 7.00 | 5.00 / 7.00 | 0.30 / 0.50 |" in (
        reproduce.tables(good())["grid"])


@pytest.mark.parametrize(("row", "change", "missed"), [
    (lambda r: r.period_s == 2.0 and r.peak_n == 60.0, {"rmse": 0.6}, {0}),
    (lambda r: r.period_s == 1.1 and r.peak_n == 50.0, {"rmse": 0.7}, {1}),
    (lambda r: r.period_s == 2.0 and r.serial == 5, {"rmse": 1.1}, {2}),
    (lambda r: r.serial == 4, {"idle": 0.51}, {4}),
    (lambda r: r.period_s == 4.0, {"jump": 0.95}, {5}),
])
def test_a_target_that_is_missed_is_said_to_be(row: object, change: dict[str, float], missed: set[int]) -> None:
    assert callable(row)
    changed = [r._replace(**change) if r.experiment == "grid" and r.controller == "extended" and row(r) else r  # type: ignore[arg-type]
               for r in good()]
    assert {i for i, met in enumerate(verdicts(changed)) if not met} == missed
    assert "**not met**" in reproduce.tables(changed)["targets"]


def test_a_trial_that_stopped_counts_against_every_target_it_is_in() -> None:
    stopped = [r._replace(outcome="stopped", rmse=math.inf, idle=math.inf, jump=math.inf)
               if (r.controller, r.serial, r.peak_n) == ("extended", 5, 40.0) and r.experiment == "grid" else r
               for r in good()]
    assert verdicts(stopped) == [True, True, False, False, False, False, True, True]
    assert "0.30 / stopped" in reproduce.tables(stopped)["grid"]
    delayed = [r._replace(outcome="stopped") if r.case.startswith("delay") else r for r in good()]
    assert verdicts(delayed)[-1] is False


def test_missing_rows_meet_no_target() -> None:
    assert not any(verdicts([r for r in good() if r.controller != "extended"])[:7])


def test_the_nominal_friction_keeps_the_task_as_hard_as_the_papers() -> None:
    knee = float(laws.knee_angle(laws.FORCE_PEAK_PERCENT))
    cable, fabric = NOMINAL.mu1 * NOMINAL.theta1_rad, NOMINAL.mu2 * (NOMINAL.wrap_rad + NOMINAL.fabric_wrap * abs(knee))
    assert 0.20 <= cable + fabric <= 0.25


def test_every_wanted_row_is_another_trial_on_day_one_or_as_its_case_says() -> None:
    wanted = reproduce.wanted([1, 2])
    keys = [tuple(sorted(each.row.items())) for each in wanted]
    assert len(set(keys)) == len(keys) == 2 * (5 * 9 + 6 + 4 + 9)
    days = {each.case: each.row["bench.day"] for each in wanted}
    assert {case for case, day in days.items() if day != 1} == set(list(reproduce.SHARES)[-2:])
    learning = [each.row for each in wanted if each.row["gait.controller"] == "extended"]
    assert max(int(row["gait.settle"]) for row in learning) <= 10


def test_the_page_in_the_docs_is_what_its_table_says() -> None:
    text = frame.filled(reproduce.PAGE, reproduce.tables(reproduce.read(reproduce.TABLE)))
    assert reproduce.PAGE.read_text(encoding="utf-8") == text
