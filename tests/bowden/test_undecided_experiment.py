"""The proposed experiment decides; one that does not is said first, with the reason, and is not proposed again."""

from __future__ import annotations

from pathlib import Path

import pytest

import bowden

WALK = bowden.Experiment(period_s=1.1, cycles=4, settle=0)
CHANGED = {"effects": {"fabric_friction": {"mu2": 0.4}}}


@pytest.mark.exhaustive
def test_an_experiment_splits_the_ambiguity_set_and_one_that_does_not_is_reported_first(tmp_path: Path) -> None:
    healthy = [bowden.run(WALK, bus=bowden.simulated(serial=3, seed=seed)) for seed in (1, 2)]
    finder = bowden.Diagnosis().fit(healthy)
    worn = bowden.run(WALK, bus=bowden.simulated(serial=3, seed=5, plant_model=CHANGED))
    alone = finder.diagnose(worn)
    assert (alone.verdict, alone.experiment) == ("ambiguous", "locked_angles")
    assert {"fabric_friction", "fabric_wrap"} <= set(alone.rivals)
    assert "undecided" not in alone.as_json()
    angles, step = (bowden.run(bowden.Experiment(name=name), bus=bowden.simulated(
        serial=3, seed=5, plant_model=CHANGED)) for name in ("locked_angles", "step"))
    both = finder.diagnose([worn, angles])
    assert "fabric_friction" in both.rivals
    assert set(both.rivals) <= set(alone.rivals)
    told = both.as_json()["undecided"]
    assert told.startswith("locked_angles did not decide between ")
    assert both.experiment != "locked_angles"
    both.report(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Locked_angles did not decide between" in page
    # the step moves the rope faster than the gaits do, and takes no effect away
    strained = finder.diagnose([worn, step])
    assert set(strained.rivals) == set(alone.rivals)
