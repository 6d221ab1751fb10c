"""The safety monitor alone, in CI: faults that move the leg or the rope most keep the limb within its bounds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.faults
@pytest.mark.parametrize("drive", ["own", "bought"])
@pytest.mark.parametrize(("moment", "rows"), [
    ("idle", "^knee encoder sign flipped$|^knee stage runs away$|^START × 0.5$|^servo stage shorted"),
    ("ramp", "^servo encoder frozen$|^servo stage shorted")])
def test_the_monitor_alone_keeps_the_limb_within_its_bounds(drive: str, moment: str, rows: str) -> None:
    """At ramp the rope is taut: 1 ms later END would pass 80 N."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.faults.monitor_alone", "--guards", "alone", "--drive", drive,
         "--moments", moment, "--rows", rows],
        cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("monitor: ") == rows.count("|") + 1


@pytest.mark.faults
@pytest.mark.parametrize(("creep", "gait"), [("2°/s", "paper, 1.1 s"), ("− 2°/s", "extended, 2 s")])
def test_a_creep_that_two_encoders_share_ends_at_the_persons_range(creep: str, gait: str) -> None:
    """The master's signals agree with each other, so it concludes nothing; the monitor has a knee angle of its own."""
    run = subprocess.run(
        [sys.executable, "-m", "tests.faults.monitor_alone", "--guards", "both", "--moments", "idle", "--gait", gait,
         "--rows", f"creep in agreement by {creep}$"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "monitor: knee angle beyond its bounds" in run.stdout
