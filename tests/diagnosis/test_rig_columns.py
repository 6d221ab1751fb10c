"""Columns of rigs as logs have them: wrapped, without sign, blank at rest, at other rates, with lost rows."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from diagnosis.finder import Finder
from estimation import rig_fit
from estimation.data import integrity
from estimation.data.table import Table, table
from estimation.rig_model import RigModel
from tests.diagnosis import rigs

INERTIA = 0.0205


@cache
def known() -> Finder:
    """Return a diagnosis of the motor whose reference trials are not fitted until they are needed."""
    return Finder().examine([table(f"motor_{seed}.csv", rigs.motor(seed)) for seed in (1, 2)])


def refusal(columns: rigs.Columns) -> str:
    found = known().diagnose([table("motor_3.csv", columns)])
    assert found.verdict == "refused"
    return found.warnings[0]


def test_a_wrapped_angle_is_refused_by_the_name_of_its_column() -> None:
    columns = rigs.motor(3)
    wrapped = np.mod(columns["servo_position_rad"], 2.0 * np.pi)
    assert "servo_position_rad wraps round" in refusal({**columns, "servo_position_rad": wrapped})


def test_a_torque_without_sign_is_refused_by_the_name_of_its_column() -> None:
    columns = rigs.motor(3)
    assert "servo_torque_nm has no sign" in refusal({**columns, "servo_torque_nm": np.abs(columns["servo_torque_nm"])})


def test_a_torque_that_is_blank_at_rest_is_taken() -> None:
    columns = rigs.motor(3)
    speed = np.abs(np.gradient(columns["servo_position_rad"], columns["time_s"]))
    blank = {**columns, "servo_torque_nm": np.where(speed < 0.05, np.nan, columns["servo_torque_nm"])}
    given = table("motor_3.csv", blank)
    assert not any(finding.refuses for finding in integrity.examine(given))
    used = integrity.usable(given)
    assert np.isfinite(used["servo_force_n"]).all()
    recorded, whole = (RigModel([t]).record(t) for t in (used, table("motor_3.csv", columns)))
    assert 0.8 * whole.bins < recorded.bins < whole.bins
    assert np.isfinite(recorded.data).all()


def test_a_torque_that_is_blank_in_motion_is_refused() -> None:
    columns = rigs.motor(3)
    blank = np.where(np.random.default_rng(0).random(columns["time_s"].size) < 0.4, np.nan, columns["servo_torque_nm"])
    given = table("motor_3.csv", {**columns, "servo_torque_nm": blank})
    assert any(finding.refuses for finding in integrity.examine(given))


@pytest.mark.exhaustive
@pytest.mark.parametrize(("share", "burst"), [(0.0, 12), (0.01, 1), (0.01, 12), (0.03, 12)])
def test_lost_rows_leave_the_inertia_and_its_interval_as_they_are(share: float, burst: int) -> None:
    given: Table = table("motor_1.csv", rigs.lossy(rigs.motor(1), share, 1, burst))
    found = rig_fit.fit([given], [given], [given]).constants["drive_inertia"]
    # with derivatives across gaps of 60 ms it was 1.9e-7 [1.7e-7, 2.0e-7]
    assert found.low <= INERTIA <= found.high
    assert found.value == pytest.approx(INERTIA, rel=0.03)


@pytest.mark.exhaustive
def test_friction_at_steady_speeds_is_seen_by_two_reference_trials_that_repeat() -> None:
    trial = table("motor_4.csv", rigs.motor(4, coulomb=0.625))
    found = known().diagnose([trial])
    assert found.verdict == "found"
    assert found.rivals == ["drive_coulomb"]
    assert known().diagnose([table("motor_3.csv", rigs.motor(3))]).verdict == "none"
