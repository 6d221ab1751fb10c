"""A whole trial over the kernel's CAN, bench and master two processes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.socketcan import rig

pytestmark = pytest.mark.guest("native", "icount")

RMSE_TOLERANCE = 1.0
"""Percent points between the kernel's bus and ours at 100 Hz: the guest's scheduler delays some targets a cycle."""


def test_forty_newton_at_100_hz(tmp_path: Path) -> None:
    gait = ("--rate", 100, "--peak", 40, "--cycles", 3)
    with rig.bench(tmp_path, "vcan0", "--rate", 100):
        told = rig.trial(tmp_path, "vcan0", *gait).wait()
    assert told.status == 0, told
    assert told.result["outcome"] == "completed"
    virtual = rig.bowden(tmp_path, "trial", "-o", tmp_path / "virtual.mcap", *gait).wait()
    assert abs(told.result["relative_rmse_percent"] - virtual.result["relative_rmse_percent"]) < RMSE_TOLERANCE
    assert told.result["max_idle_tension_n"] < 1.0
    assert told.result["true_relative_rmse_percent"] is None
