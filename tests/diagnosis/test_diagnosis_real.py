"""A real cable drive, fitted on one half of its runs and judged on the other."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from diagnosis.finder import diagnose
from diagnosis.findings import Findings

DATA = Path(__file__).parents[3] / "shared" / "data" / "cable_drive"

pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.skipif(not DATA.is_dir(), reason="the cable drive's recordings are not beside the repository")]


@pytest.fixture(scope="module")
def found() -> Findings:
    fit, check = (sorted((DATA / part).glob("*.csv.gz")) for part in ("fit", "check"))
    return diagnose(fit, holdout=check, lowpass=20.0)


def test_start_follows_from_end_and_motion_on_runs_never_fitted(found: Findings) -> None:
    held = found.relations["friction"].holdout_after
    assert held is not None
    assert held <= 1.8


def test_the_jaw_angle_follows_from_rope_and_tension_on_runs_never_fitted(found: Findings) -> None:
    held = found.relations["kinematics"].holdout_after
    assert held is not None
    assert math.degrees(held) <= 0.40


def test_the_known_causes_are_named_and_no_other(found: Findings) -> None:
    assert found.verdict == "found"
    assert {cause["effect"] for cause in found.causes} == {"presliding", "cable_friction", "stiffness"}
    assert all(cause["gain_percent"] > 8.0 for cause in found.causes)


def test_what_could_not_be_checked_is_said(found: Findings) -> None:
    assert found.lowpass_hz == 20.0
    assert not found.relations["drive_force"].checked
    assert any("no calibration fits this rig" in text for text in found.warnings)
    assert any("unexplained" in text for text in found.warnings)
