"""A real cable drive, fitted on one half of its runs and judged on the other."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from diagnosis.finder import diagnose
from diagnosis.findings import Findings
from estimation import bench_fit

DATA = Path(__file__).parents[3] / "shared" / "data" / "cable_drive"

pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.skipif(not DATA.is_dir(), reason="the cable drive's recordings are not beside the repository")]


@pytest.fixture(scope="module")
def found() -> Findings:
    fit, check = (sorted((DATA / part).glob("*.csv.gz")) for part in ("fit", "check"))
    return diagnose(check, healthy=fit, lowpass=20.0)


def test_runs_of_the_same_drive_are_nothing_new(found: Findings) -> None:
    assert (found.verdict, found.lowpass_hz) == ("none", 20.0)


def test_start_follows_from_end_and_motion_on_runs_never_fitted(found: Findings) -> None:
    missed = found.relations["tension_start_n"].rmse_before
    assert missed is not None
    assert missed <= 1.8


def test_the_jaw_angle_follows_from_rope_and_tension_on_runs_never_fitted(found: Findings) -> None:
    missed = found.relations["knee_angle_rad"].rmse_before
    assert missed is not None
    assert math.degrees(missed) <= 0.48


def test_the_terms_of_the_drive_are_identified() -> None:
    told = bench_fit.fit(sorted((DATA / "fit").glob("*.csv.gz")), 20.0)
    assert told.rig is not None
    assert {"presliding", "cable_friction"} <= set(told.rig)
    assert "stiffness_scale" in told.constants
