"""The periodic reference: exact to (1) where the force acts, closed without a step, cheap look-ups that agree."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from parameters import InputError
from physics import laws
from physics.reference import CYCLE_POINTS, Reference, paper_reference, recorded_angle, recorded_force

GAIT = Path(__file__).parents[3] / "shared" / "data" / "gait"


@pytest.fixture(scope="module")
def paper() -> Reference:
    return paper_reference(40.0, 2.0)


def test_exact_to_eq1_between_10_and_30_percent(paper: Reference) -> None:
    for percent in np.linspace(10.0, 30.0, 777):
        # cubic Hermite on 0.1 %: h⁴/384·θ'''' < 1e-9 rad
        assert paper.knee_angle(percent / 100) == pytest.approx(laws.knee_angle(float(percent)), abs=1e-9)
        assert paper.desired_force(percent / 100) == pytest.approx(laws.desired_force(float(percent), 40.0), abs=1e-6)


def test_closes_in_angle_velocity_and_acceleration(paper: Reference) -> None:
    phase = np.linspace(0.9, 1.1, 4001)
    velocity = np.array([paper.knee_velocity(p) for p in phase])
    dt = (phase[1] - phase[0]) * paper.period_s
    acceleration = np.diff(velocity) / dt
    # over one sample of 0.1 ms: continuous acceleration moves by jerk·dt; (1) itself stays below 600 rad/s³
    assert np.abs(np.diff(acceleration)).max() < 600 * 2 * dt
    assert np.abs(acceleration).max() < 40.0
    assert paper.knee_angle(1.0 - 1e-9) == pytest.approx(paper.knee_angle(1.0), abs=1e-7)


def test_departure_from_eq1_is_reported_and_small(paper: Reference) -> None:
    percent = np.linspace(0.0, 100.0, 1001)
    angles = np.array([paper.knee_angle(p / 100 - 1e-12 * (p == 100)) for p in percent])
    assert paper.departs_from_eq1_rad == pytest.approx(np.abs(angles - laws.knee_angle(percent)).max(), abs=1e-7)
    # no periodic curve can depart by less than half the mismatch of 3.19°; smoothness costs the rest
    assert math.radians(1.59) < paper.departs_from_eq1_rad < math.radians(3.5)


def test_velocity_is_the_derivative_and_at_agrees(paper: Reference) -> None:
    h = 1e-5
    for phase in (0.003, 0.12, 0.5, 0.77, 0.95, 3.25):
        slope = (paper.knee_angle(phase + h) - paper.knee_angle(phase - h)) / (2 * h * paper.period_s)
        wanted = paper.at(phase)
        assert wanted.knee_velocity_rad_s == pytest.approx(slope, abs=1e-5)
        assert wanted.knee_velocity_rad_s == paper.knee_velocity(phase)
        assert wanted.knee_angle_rad == paper.knee_angle(phase)
        assert wanted.force_n == paper.desired_force(phase)
        force_slope = (paper.desired_force(phase + h) - paper.desired_force(phase - h)) / (2 * h * paper.period_s)
        assert wanted.force_rate_n_s == pytest.approx(force_slope, abs=1e-3)


def test_phase_that_rounds_to_one_is_no_error(paper: Reference) -> None:
    assert paper.knee_angle(-1e-18) == pytest.approx(paper.knee_angle(0.0), abs=1e-9)


def test_desired_force_is_zero_outside(paper: Reference) -> None:
    for percent in (0.0, 9.99, 30.0, 55.0, 99.999):
        assert paper.at(percent / 100).force_n == 0.0
    assert paper.peak_n == 40.0


def test_recorded_cycle_keeps_its_points_and_closes() -> None:
    percent = np.arange(0.0, 100.0)
    angle = -0.5 + 0.4 * np.cos(2 * np.pi * percent / 100) + 0.0008 * percent
    closed = recorded_angle(percent, angle)[0][:-1]
    assert closed.shape == (CYCLE_POINTS,)
    np.testing.assert_allclose(closed[100:900:10], angle[10:90], atol=1e-12)
    ring = np.concatenate([closed, closed[:3]])
    # 0.08 rad taken up over 20 % bends by 4e-5 rad per step²; the step itself would be 0.08
    assert np.abs(np.diff(ring, 2)).max() < 1e-4


def test_real_cycles_close() -> None:
    files = sorted(GAIT.glob("cycle_*.csv"))
    if not files:
        pytest.skip("the recorded gait cycles are not beside the repository")
    for file in files:
        with file.open(encoding="utf-8") as text:
            rows = list(csv.DictReader(text))
        percent = np.array([float(r["gait_percent"]) for r in rows])
        angle = np.radians([float(r["knee_angle_deg"]) for r in rows])
        value, slope = recorded_angle(percent, angle)
        assert value[0] == pytest.approx(value[-1], abs=1e-12)
        assert slope[0] == pytest.approx(slope[-1], abs=1e-12)
        reference = Reference(1.2, (value, slope), recorded_force(percent, np.maximum(0.0, -angle)))
        assert reference.knee_angle(0.5) == pytest.approx(angle[50], abs=1e-9)


@pytest.mark.parametrize(
    ("percent", "angle", "says"),
    [
        (np.arange(0.0, 100.0, 20.0), np.zeros(5), "at least 8"),
        (np.array([0, 10, 20, 20, 40, 60, 80, 100.0]), np.zeros(8), "row 4 does not rise"),
        (np.linspace(0, 100, 9), np.full(9, np.nan), "row 1 is not a number"),
        (np.linspace(0, 80, 9), np.zeros(9), "one whole cycle"),
    ],
)
def test_unusable_cycles_are_refused(percent: np.ndarray, angle: np.ndarray, says: str) -> None:
    with pytest.raises(InputError, match=says):
        recorded_angle(percent, angle)
