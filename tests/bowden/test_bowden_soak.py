"""`bowden doctor --soak`: round trips of a bus in a report, and the bound of a rate."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bowden.bench.examination import upper_bound
from bowden.testing import CanBus

Run = Callable[..., Any]


@pytest.fixture
def soaked(bowden: Run, can_bus: CanBus) -> Run:
    """Soak the bus of the test, with a node that answers after 2 ms, for 0.6 s."""
    can_bus.open()
    can_bus.add_node("knee_drive", 5).station.turnaround_ns = 2_000_000
    at = "--interface", "bowden", "--channel", can_bus.channel
    return lambda *words: bowden("doctor", "--soak", "0.01", *words, *at)


def test_the_report_has_the_round_trips_and_their_bounds(soaked: Run, here: Path) -> None:
    told = soaked("-o", "soak.md", "--json")
    assert told.status == 0, told.stderr
    trips = json.loads(told.stdout)["round_trips_ns"]["5"]
    assert 40 < len(trips) <= 60
    assert all(2_200_000 < trip < 2_400_000 for trip in trips), "turnaround, and two frames of up to 135 bits"
    report = Path("soak.md").read_text()
    assert f"| SDO round trip, node 5 | {len(trips)} | 2" in report
    assert f"| 500 | {len(trips)} | {len(trips)} | 100000.0 |" in report
    assert f"| 250 | 0 | {len(trips)} | {1e5 * (1 - 0.05 ** (1 / len(trips))):.1f} |" in report
    assert soaked("-o", "soak.md").status == 2, "an existing report is kept"


def test_errors_and_silence_end_with_1(soaked: Run, can_bus: CanBus) -> None:
    can_bus.faults.drop(0x585, count=1, after=20)
    told = soaked("--json")
    assert (told.status, json.loads(told.stdout)["unanswered"]) == (1, 1)


@pytest.mark.parametrize(("events", "trials", "bound"), [
    (0, 1778, 1.6835e-3), (1, 400, 1.1800e-2), (4, 402, 2.2615e-2), (10, 20, 0.69805), (20, 20, 1.0)])
def test_the_bound_is_that_of_clopper_and_pearson(events: int, trials: int, bound: float) -> None:
    assert upper_bound(events, trials) == pytest.approx(bound, rel=1e-3)


def test_a_report_needs_a_soak(bowden: Run, here: Path) -> None:
    told = bowden("doctor", "-o", "soak.md")
    assert (told.status, told.stderr.count("\n")) == (2, 1)
