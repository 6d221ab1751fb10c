"""The controllers as pure functions: what each adds, what none may know, and the impedance law against theory."""

from __future__ import annotations

import math

import numpy as np
import pytest

from master import settings
from master.control import paper
from master.control.gait_table import (
    GaitTable,
    directions,
    fabric_exponent,
    samples_of,
    slack_share,
    stretch,
    swing,
    tabulate,
)
from master.motion import gait
from parameters import InputError
from physics import laws
from physics.calibration import Calibration, nominal
from physics.reference import paper_reference

RATE = 1000
SAMPLES = 2000


def table(peak_n: float = 40.0, calibration: Calibration | None = None) -> GaitTable:
    knee, desired = gait.sampled(paper_reference(peak_n, 2.0), SAMPLES)
    return tabulate(calibration or nominal(), knee, desired, 1.0 / RATE, 4e-3)


def configured(name: str, impedance: settings.Impedance | None = None) -> paper.PaperConfig:
    listens, compensates = name in ("impedance", "paper"), name in ("friction", "paper")
    return paper.configure(nominal(), table(), impedance or settings.Impedance(), compensates=compensates,
                           listens=listens)


def seen(sample: int, start_n: float, knee_rad: float) -> paper.ControllerInput:
    return paper.ControllerInput(sample, 0.0, 0.0, knee_rad, start_n)


def at_percent(percent: float) -> int:
    return round(percent * SAMPLES / 100)


def test_seen_has_no_end() -> None:
    assert not [name for name in paper.ControllerInput._fields if "end" in name]


def test_none_is_stretch_and_swing_alone() -> None:
    config_ = configured("none")
    i = at_percent(15)
    knee = config_.gait.knee[i]
    outputs, state, _ = paper.step(seen(i, 123.0, knee), paper.PaperState(), config_)
    desired = config_.gait.desired[i]
    swung = laws.swing_displacement(knee) - laws.swing_displacement(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
    assert outputs.servo_target_m == pytest.approx(float(laws.stiffness_displacement(desired) + swung), abs=1e-9)
    assert outputs.knee_target_rad == knee
    assert state.deviation_m == 0.0


def test_friction_adds_fl_and_ft_as_printed() -> None:
    plain, compensated = configured("none"), configured("friction")
    calibration = nominal()
    for percent in (15.0, 27.0):
        i = at_percent(percent)
        knee, desired = plain.gait.knee[i], plain.gait.desired[i]
        rope, strain = plain.gait.rope_direction[i], plain.gait.fabric_direction[i]
        more = [paper.step(seen(i, 0.0, knee), paper.PaperState(), c)[0].servo_target_m
                for c in (compensated, plain)]
        expected = laws.cable_loss(desired, calibration.cable_exponent, rope) + laws.fabric_loss(
            desired, float(fabric_exponent(calibration, knee)), strain)
        assert more[0] - more[1] == pytest.approx(calibration.cable_compliance * expected, rel=1e-9)


@pytest.mark.parametrize("name", ["none", "friction"])
def test_without_impedance_start_changes_nothing(name: str) -> None:
    config_ = configured(name)
    i = at_percent(18)
    outputs = {paper.step(seen(i, start, config_.gait.knee[i]), paper.PaperState(), config_)[0]
               for start in (0.0, 40.0, 90.0)}
    assert len(outputs) == 1


def test_estimate_inverts_friction_in_series() -> None:
    config_ = configured("paper")
    calibration = nominal()
    i = at_percent(15)
    knee = config_.gait.knee[i]
    fabric = float(fabric_exponent(calibration, knee))
    start = float(laws.series_input(40.0, calibration.cable_exponent, 1.0, fabric, 1.0))
    _, _, trace = paper.step(seen(i, start, knee), paper.PaperState(), config_)
    assert trace.estimated_end_force_n == pytest.approx(40.0, rel=1e-12)
    assert trace.friction_ratio == pytest.approx(start / 40.0, rel=1e-12)


def test_impedance_is_first_order_with_the_papers_gain_and_time_constant() -> None:
    """A held error settles at 1/K with the time constant B/K: H(0) = 3.33 mm/N, 0.33 s."""
    config_ = configured("impedance")
    i = at_percent(20) - 1
    knee, desired = config_.gait.knee[i], config_.gait.desired[i]
    exponent = math.log(paper.step(seen(i, 1.0, knee), paper.PaperState(), config_)[2].friction_ratio)
    start = (desired - 1.0) * math.exp(exponent)
    state, steps = paper.PaperState(), round(RATE / 3.0)
    for _ in range(steps):
        _, state, _ = paper.step(seen(i, start, knee), state, config_)
    expected = (1.0 - math.exp(-steps / RATE * 3.0)) / 300.0
    assert state.deviation_m == pytest.approx(expected, rel=1e-9)


def test_impedance_forgets_while_the_rope_is_slack() -> None:
    config_ = configured("paper")
    i = at_percent(60)
    _, state, _ = paper.step(seen(i, 50.0, config_.gait.knee[i]), paper.PaperState(1e-3), config_)
    assert state.deviation_m == pytest.approx(1e-3 * config_.decay)


def test_step_is_pure() -> None:
    config_ = configured("paper")
    state = paper.PaperState(1e-4)
    look = seen(at_percent(22), 33.0, -0.5)
    assert paper.step(look, state, config_) == paper.step(look, state, config_)
    assert state == paper.PaperState(1e-4)


def test_the_table_closes_and_rises_without_a_step() -> None:
    """From one sample to the next no target moves faster than the servo can follow (1 m/s)."""
    gait_ = table()
    target = np.array(gait_.stretch) + np.array(gait_.swing) - np.array(gait_.slack)
    assert np.abs(np.diff(target, append=target[0])).max() * RATE < 1.0


def test_slack_is_gone_where_force_is_desired_and_full_far_from_it() -> None:
    gait_ = table()
    slack, desired = np.array(gait_.slack), np.array(gait_.desired)
    assert slack[desired > 0.0].max() == 0.0
    assert slack[at_percent(60)] == 4e-3
    assert np.all(np.diff(slack[at_percent(30):at_percent(36)]) >= 0.0)


def test_slack_of_a_reference_without_force_is_full() -> None:
    assert slack_share(np.zeros(50), 3).min() == 1.0


def test_directions_have_hysteresis() -> None:
    speed = np.array([0.0, 2.0, 0.5, -0.5, 0.5, -2.0, -0.5, 0.5])
    assert directions(speed, 1.0).tolist() == [-1.0, 1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]
    assert directions(0.1 * speed, 1.0).tolist() == [0.0] * 8


def test_rope_and_fabric_turn_over_at_different_phases() -> None:
    """After the peak the fabric gives way at once, the rope only when the knee no longer takes it up."""
    gait_ = table()
    after = slice(at_percent(20) + 5, at_percent(30))
    rope, strain = np.array(gait_.rope_direction[after]), np.array(gait_.fabric_direction[after])
    assert 0 < int((rope != strain).sum()) < SAMPLES // 20


def test_stretch_stops_at_the_turning_point() -> None:
    calibration = nominal()
    top = calibration.turning_point_n
    assert top == pytest.approx(88.2, abs=0.1)
    assert float(stretch(calibration, top + 20.0)) == float(stretch(calibration, top))


def test_swing_is_zero_at_the_knee_of_the_stiffness_fit() -> None:
    assert float(swing(nominal(), laws.knee_angle(13.0))) == 0.0


def test_a_period_that_is_no_whole_number_of_cycles_is_refused() -> None:
    assert samples_of(1.1, 1000) == 1100
    with pytest.raises(InputError, match=r"whole number.*nearest"):
        samples_of(1.0005, 1000)
    with pytest.raises(InputError, match="at least 20"):
        samples_of(0.1, 100)
