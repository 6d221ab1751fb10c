"""Home, tare, jog and release on the virtual bench: what moves, what stays off, what is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from eds.bench.bench_network import KNEE, SERVO, Network
from eds.cia402 import State, state_of
from master.cycle.run_safely import Outcome, run_safely
from master.motion import commission
from master.settings import Homing, Limits
from parameters import InputError
from physics.calibration import nominal
from trial import read
from trial.record import Recorder

if TYPE_CHECKING:
    from conftest import Composer

ENABLED = State.OPERATION_ENABLED


class Done:
    """A procedure that was run: how it ended, what it found, and what every cycle saw."""

    def __init__(self, composer: Composer, procedure: commission.Procedure, **options: Any) -> None:
        path = Path(composer.folder, "commission.mcap")
        link, tap = composer.link(**options)
        recorder = Recorder(path, metadata={}, attachments={}, threaded=False, overwrite=True)
        self.found: Mapping[str, float] = {}
        self.outcome: Outcome = run_safely(link, tap, recorder, Network(), Limits(), lambda e: self._keep(procedure(e)))
        recorder.close({})
        composer.close()
        self.columns = read.open(path).columns

    def _keep(self, found: Mapping[str, float]) -> None:
        self.found = found

    def enabled(self, node: int) -> bool:
        """Whether a drive was ever in OPERATION ENABLED."""
        words = self.columns["servo_statusword" if node == SERVO else "knee_statusword"]
        return any(state_of(int(word)) is ENABLED for word in words)


def test_homing_leaves_the_rope_slack(composer: Composer) -> None:
    done = Done(composer, commission.home(nominal(), Homing(), 4e-3))
    assert done.outcome.reason is None
    assert abs(done.found["tension_start_n"]) < 2.0
    assert 0.0 < done.found["friction_half_width_m"] < 2e-3


@pytest.mark.parametrize("sensor", ["start", "end"])
def test_a_tared_sensor_reads_zero_and_no_drive_is_enabled(composer: Composer, sensor: str) -> None:
    model = {f"{sensor}_sensor": {"offset_n": 0.5}}
    done = Done(composer, commission.tare(sensor), plant_model=model)
    assert done.outcome.reason is None
    assert abs(done.found["before_n"]) > 0.3
    assert abs(done.found["after_n"]) < 0.03  # noise of 0.1 N over 500 readings, twice: 0.0063 N, five of them
    assert not done.enabled(SERVO)
    assert not done.enabled(KNEE)


def test_a_tension_is_not_tared_away(composer: Composer) -> None:
    done = Done(composer, commission.tare("end"), plant_model={"end_sensor": {"offset_n": 6.0}})
    assert done.outcome.reason is not None
    assert "end reads 6." in done.outcome.reason


@pytest.mark.parametrize(("axis", "node", "distance", "column"), [
    ("servo", SERVO, -2e-3, "servo_position_m"), ("knee", KNEE, -0.1, "knee_angle_rad"),
])
def test_one_axis_moves_alone(composer: Composer, axis: str, node: int, distance: float, column: str) -> None:
    done = Done(composer, commission.jog(axis, distance, 10 * abs(distance)))
    assert done.outcome.reason is None
    moved = done.columns[column][-1] - done.columns[column][0]
    assert moved == pytest.approx(distance, rel=0.02)
    assert done.enabled(node)
    assert not done.enabled(SERVO + KNEE - node)


def test_a_taut_rope_is_released_by_the_servo_alone(composer: Composer) -> None:
    def taut_then_released(exchange: Any) -> Mapping[str, float]:
        commission.home(nominal(), Homing(), -3e-3)(exchange)
        before = exchange.inputs.start_n
        return {**commission.release(Homing(), Limits())(exchange), "taut_n": before}

    done = Done(composer, taut_then_released)
    assert done.outcome.reason is None
    assert done.found["after_n"] < 2.0
    assert done.found["taut_n"] > done.found["after_n"]


@pytest.mark.parametrize(("limits", "distance"), [
    (Limits(knee_high_rad=0.02), math.radians(8.0)), (Limits(), math.radians(10.0)),
    (Limits(knee_low_rad=-0.3), -0.4)])
def test_a_jog_beyond_the_knees_limits_moves_nothing(composer: Composer, limits: Limits, distance: float) -> None:
    done = Done(composer, commission.jog("knee", distance, 0.2, limits))
    assert done.outcome.reason is not None
    assert "knee would go to" in done.outcome.reason
    assert "limits.knee_low_rad and knee_high_rad allow" in done.outcome.reason
    assert not done.enabled(KNEE)


@pytest.mark.parametrize(("axis", "name"), [("knee", "knee_rad_s"), ("servo", "rope_m_s")])
def test_a_jog_faster_than_its_limit_is_refused(axis: str, name: str) -> None:
    with pytest.raises(InputError, match=rf"is above limits\.{name}"):
        commission.jog(axis, -1e-3, 1e3)


@pytest.mark.parametrize("procedure", [
    lambda: commission.jog("arm", 1e-3, 1e-3), lambda: commission.jog("knee", 1e-3, 0.0),
    lambda: commission.tare("middle"),
])
def test_what_cannot_be_meant_is_refused(procedure: Any) -> None:
    with pytest.raises(InputError):
        procedure()
