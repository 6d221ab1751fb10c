"""Experiments of a bench in the reference condition: recorded, then diagnosed, as reference trials, and for a law."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Run = Callable[..., Any]


@pytest.mark.exhaustive
@pytest.mark.parametrize("experiment", ["two_peaks", "two_speeds", "dither"])
def test_an_experiment_has_no_name_and_can_be_a_reference_trial(bowden: Run, here: Path, experiment: str) -> None:
    gaits = {"good1": (40, 2.0, 0), "good2": (32, 1.5, 0), "again": (40, 2.0, 3)}
    for name, (peak, period, seed) in gaits.items():
        assert bowden("trial", "--peak", peak, "--period", period, "--cycles", 4, "--seed", seed,
                      "-o", f"{name}.mcap").status == 0
    assert bowden("trial", "--experiment", experiment, "-o", "other.mcap").status == 0
    healthy = ("--healthy", "good1.mcap", "--healthy", "good2.mcap")
    for trials in (("other.mcap",), ("again.mcap", "other.mcap")):
        told = bowden("diagnose", *trials, *healthy, "--json")
        assert (told.status, json.loads(told.stdout)["verdict"]) == (0, "none"), told.stderr
    sought = bowden("discover", "other.mcap", *healthy)
    assert (sought.status, "all reference trials have" in sought.stderr) == (2, True)
    assert bowden("diagnose", "again.mcap", "--healthy", "good2.mcap", "--healthy", "other.mcap").status == 0
