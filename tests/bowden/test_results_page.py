"""docs/results.md: medians, worst benches and targets from rows; the page is what its table says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from pathlib import Path

import pytest

from benchmarks import reproduce
from benchmarks.reproduce import CONTROLLERS, PEAKS_N, PERIODS_S, Result
from physics.plant.bench_plant import NOMINAL

DOCS = Path(__file__).parents[2] / "docs"


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
        reproduce.page(good()))


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
    assert "**not met**" in reproduce.page(changed)


def test_a_trial_that_stopped_counts_against_every_target_it_is_in() -> None:
    stopped = [r._replace(outcome="stopped", rmse=math.inf, idle=math.inf, jump=math.inf)
               if (r.controller, r.serial, r.peak_n) == ("extended", 5, 40.0) and r.experiment == "grid" else r
               for r in good()]
    assert verdicts(stopped) == [True, True, False, False, False, False, True, True]
    assert "0.30 / stopped" in reproduce.page(stopped)
    delayed = [r._replace(outcome="stopped") if r.case == "delay" else r for r in good()]
    assert verdicts(delayed)[-1] is False


def test_missing_rows_meet_no_target() -> None:
    assert not any(verdicts([r for r in good() if r.controller != "extended"])[:7])


def test_the_plant_of_the_page_keeps_the_nominal_friction() -> None:
    text = reproduce.plant()
    exponent = float(text.split("together ")[1].split(";")[0])
    assert 0.20 <= exponent <= 0.25
    assert f"{NOMINAL.supply_v:g} V" in text


def test_every_wanted_row_is_another_trial_on_day_one_or_as_its_case_says() -> None:
    wanted = reproduce.wanted([1, 2])
    keys = [tuple(sorted(each.row.items())) for each in wanted]
    assert len(set(keys)) == len(keys) == 2 * (5 * 9 + 6 + 4 + 9) + 9
    days = {each.case: each.row["bench.day"] for each in wanted}
    assert {case for case, day in days.items() if day != 1} == {"the whole day", "model structure"}
    learning = [each.row for each in wanted if each.row["gait.controller"] == "extended"]
    assert max(int(row["gait.settle"]) for row in learning) <= 10


def test_the_benches_that_jump_are_those_whose_sources_are_told_apart() -> None:
    found = reproduce.grid(reproduce.read(DOCS / "results.csv"), "extended", 40.0, 1.1)
    above = {r.serial for r in found if reproduce.jump(r) > reproduce.JUMP_BOUND}
    assert above <= set(reproduce.JUMPING)


def test_the_page_in_the_docs_is_what_its_table_says() -> None:
    text = reproduce.page(reproduce.read(DOCS / "results.csv"))
    assert (DOCS / "results.md").read_text(encoding="utf-8") == text
