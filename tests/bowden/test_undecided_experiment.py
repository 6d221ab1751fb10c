"""The proposed experiment decides; one that does not is said first, with the reason, and is not proposed again."""

from __future__ import annotations

from pathlib import Path

import pytest

import bowden

WALK = bowden.Experiment(period_s=1.1, cycles=4, settle=0)
CHANGED = {"effects": {"load_dependent_friction": {"load_slope": 0.7}}}


@pytest.mark.exhaustive
def test_the_proposed_experiment_decides_and_another_one_that_does_not_is_said_first(tmp_path: Path) -> None:
    healthy = [bowden.run(WALK, bus=bowden.simulated(serial=3, seed=seed)) for seed in (1, 2)]
    finder = bowden.Diagnosis().fit(healthy)
    worn = bowden.run(WALK, bus=bowden.simulated(serial=3, seed=5, plant_model=CHANGED))
    alone = finder.diagnose(worn)
    assert (alone.verdict, alone.experiment) == ("ambiguous", "two_peaks")
    assert "undecided" not in alone.as_json()
    peaks = bowden.run(bowden.Experiment(name="two_peaks"), bus=bowden.simulated(serial=3, seed=5, plant_model=CHANGED))
    assert finder.diagnose([worn, peaks]).rivals == ["load_dependent_friction"]
    step = bowden.run(bowden.Experiment(name="step"), bus=bowden.simulated(serial=3, seed=5, plant_model=CHANGED))
    both = finder.diagnose([worn, step])
    told = both.as_json()["undecided"]
    assert told.startswith("step did not decide between stribeck, load_dependent_friction: ")
    assert "record it healthy, too" in told
    assert both.experiment != "step"
    before = alone.causes[0]["parameters"]
    assert all(before[name]["low"] <= one["value"] <= before[name]["high"]
               for name, one in both.causes[0]["parameters"].items())
    both.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Step did not decide between" in page
