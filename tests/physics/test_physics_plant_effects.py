"""Each physical effect is at work in the plant, with the size that its law says, and absent at its neutral value."""

import math

import numpy as np
import pytest

from physics.plant.bench_plant import NOMINAL, create
from tests.physics.plant_rig import FIT_KNEE, Rig

X, V, KNEE, START, END, TRUE_END = 0, 1, 4, 5, 6, 7
RATIO = math.exp(NOMINAL.mu1 * NOMINAL.theta1_rad + NOMINAL.mu2 * (NOMINAL.wrap_rad + abs(FIT_KNEE)))


def _ratio(start_n: float, speed: float, **parameters: float) -> float:
    row = Rig(**parameters).pull_to(start_n, speed)[-1]
    return float(row[START] / row[END])


def test_bend_follows_the_knee() -> None:
    knee = math.radians(-60.0)
    bent = _ratio(40.0, 0.03, knee_rad=knee, cable_bend=0.4)
    straight = _ratio(40.0, 0.03, knee_rad=knee)
    expected = NOMINAL.mu1 * NOMINAL.theta1_rad * 0.4 * abs(knee)
    # 1 %: the knee yields by a few tenths of a degree
    assert math.log(bent / straight) == pytest.approx(expected, rel=0.01)


def test_wrap_follows_the_knee() -> None:
    knee = math.radians(-60.0)
    more = math.log(_ratio(40.0, 0.03, knee_rad=knee, fabric_wrap=1.5) / _ratio(40.0, 0.03, knee_rad=knee))
    assert more == pytest.approx(NOMINAL.mu2 * 0.5 * abs(knee), rel=0.01)


def test_load_dependence_turns_at_40_n() -> None:
    light, heavy = (math.log(_ratio(load, 0.03, load_slope=0.4)) / math.log(RATIO) for load in (15.0, 70.0))
    assert light < 0.85
    assert heavy > 1.1
    # START is above and END below 40 N by the exponent itself
    assert math.log(_ratio(45.0, 0.03, load_slope=0.4)) / math.log(RATIO) == pytest.approx(1.0, abs=0.02)


def test_viscous_drag_is_proportional_to_speed() -> None:
    def extra(speed: float) -> float:
        row = Rig(viscous=20.0, mu1=0.0, mu2=0.0).pull_to(30.0, speed)[-1]
        return float(row[START] - row[END])

    # the rope behind the drum is slower than the drum by what it stretches
    assert extra(0.04) == pytest.approx(20.0 * 0.04, rel=0.15)
    assert extra(0.08) / extra(0.04) == pytest.approx(2.0, rel=0.03)


def test_stribeck_breaks_away() -> None:
    parameters = {"stribeck_ratio": 2.0, "stribeck_speed_m_s": 0.01}
    creeping, sliding = _ratio(30.0, 0.002, **parameters), _ratio(30.0, 0.1, **parameters)
    assert math.log(creeping) / math.log(RATIO) == pytest.approx(2.0, abs=0.15)
    assert math.log(sliding) / math.log(RATIO) == pytest.approx(1.0, abs=0.05)


def test_friction_drifts_with_time() -> None:
    rig = Rig(friction_drift=0.5, friction_drift_s=1.0)
    rig.run(1.0)
    row = rig.pull_to(40.0, 0.05)[-1]
    seconds = rig.now_ns * 1e-9
    assert math.log(row[START] / row[END]) / math.log(RATIO) == pytest.approx(1.0 + 0.5 * seconds, rel=0.01)


def test_presliding_sets_the_travel_of_a_reversal() -> None:
    def travel(delta: float) -> float:
        rig = Rig(presliding_m=delta, fabric_presliding_m=delta)
        rig.pull_to(50.0, 0.02)
        rig.run(0.1)
        peak = rig.seen
        fall = rig.run(0.6, -0.01)
        return peak.servo_position_m - float(fall[np.argmax(fall[:, START] < fall[:, END] * 0.95), X])

    assert travel(0.4e-3) > travel(0.1e-3) + 0.1e-3


@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_stiffness_scales_the_stretch(scale: float) -> None:
    def stretch(**parameters: float) -> float:
        row = Rig(mu1=0.0, mu2=0.0, **parameters).pull_to(40.0, 0.02)[-1]
        return float(row[X] - NOMINAL.rope_per_knee * (row[KNEE] - FIT_KNEE)) - NOMINAL.encoder_zero_m

    assert stretch(stiffness_scale=scale) == pytest.approx(stretch() / scale, rel=0.01)


def test_shape_changes_the_quadratic_part() -> None:
    row = Rig(mu1=0.0, mu2=0.0, stiffness_shape=-0.5).pull_to(40.0, 0.02)[-1]
    freed = row[X] - NOMINAL.rope_per_knee * (row[KNEE] - FIT_KNEE) - NOMINAL.encoder_zero_m
    assert freed == pytest.approx(NOMINAL.stretch_b * 40.0 + 0.5 * NOMINAL.stretch_a * 1600.0, rel=0.01)


def test_creep_relaxes_and_recovers() -> None:
    rig = Rig(creep_compliance=0.03e-3, creep_s=0.3)
    rig.pull_to(40.0, 0.1)
    early = rig.run(0.05)[-1, END]
    late = rig.run(1.0)[-1, END]
    assert late < early - 2.0
    # held long enough, γ = J·T of the fabric's mean tension, between END and what START leaves of friction
    assert rig.plant.truth()["true_creep_m"] == pytest.approx(0.03e-3 * late * math.sqrt(1.1), rel=0.06)
    rig.run(0.1, -0.15)
    rig.run(1.5)
    assert rig.plant.truth()["true_creep_m"] < 0.02e-3


def test_slack_shifts_where_tension_begins() -> None:
    def begins(**parameters: float) -> float:
        plant = create({"start_knee_rad": FIT_KNEE, **parameters}, 0)
        seen, k = plant.reset(0), 0
        while seen.start_n < 1.0:
            k += 1
            seen = plant.advance(k * 250_000, 0.1, -seen.knee_motor_rad_s + 100.0 * (FIT_KNEE - seen.knee_motor_rad))
        return seen.servo_position_m

    # one tick of 250 µs at some 0.1 m/s
    assert begins(slack_m=3e-3, start_slack_m=8e-3) - begins() == pytest.approx(3e-3, abs=50e-6)


def test_moment_arm_bends_the_path() -> None:
    def position(knee_deg: float, **parameters: float) -> float:
        rig = Rig(knee_rad=math.radians(knee_deg), mu1=0.0, mu2=0.0, **parameters)
        row = rig.pull_to(20.0, 0.02)[-1]
        return float(row[X] - NOMINAL.rope_per_knee * (row[KNEE] - math.radians(knee_deg)))

    k3 = 2e-3
    for knee_deg in (-5.0, -60.0):
        knee = math.radians(knee_deg)
        moved = position(knee_deg, rope_per_knee_quadratic=k3) - position(knee_deg)
        assert moved == pytest.approx(k3 * (knee**2 - FIT_KNEE**2), abs=30e-6)


def test_eccentric_drum_modulates_the_rope() -> None:
    amplitude, phase = 0.5e-3, 1.0
    round_, out = Rig(), Rig(eccentricity_m=amplitude, eccentricity_rad=phase)
    a, b = round_.pull_to(20.0, 0.02)[-1, X], out.pull_to(20.0, 0.02)[-1, X]
    payout = amplitude * (math.sin(b / 0.02 + phase) - math.sin(phase))
    assert b + payout == pytest.approx(a, abs=20e-6)


def test_end_mass_weighs_on_a_slack_rope() -> None:
    rig = Rig(knee_rad=math.radians(-60.0), slack_m=50e-3, end_mass_kg=0.1)
    rig.run(0.3)
    assert rig.seen.end_n == pytest.approx(0.1 * 9.80665 * math.cos(rig.seen.knee_angle_rad), abs=0.01)
    swing = rig.run(0.4, knee_rad_s=2.0)
    felt = swing[:, END] - swing[:, TRUE_END] - 0.1 * 9.80665 * np.cos(swing[:, KNEE])
    # starting from rest to 2 rad/s within tens of ms: m·L·θ̈ of some tenths of a newton
    assert felt.max() > 0.2
    assert rig.plant.truth()["true_end_n"] < 0.5


def test_drive_friction_is_seen_in_torque_not_in_tension() -> None:
    def torque(direction: float, **parameters: float) -> float:
        plant = create({"start_slack_m": 100e-3, "winding_h": 0.1e-3, **parameters}, 0)
        seen, gain = plant.reset(0), 20.0
        for k in range(1, 1201):
            demand = gain * (0.05 * direction - seen.servo_velocity_m_s)
            seen = plant.advance(k * 250_000, demand, 0.0)
        return demand / 0.02

    nominal = NOMINAL.servo_coulomb_n + NOMINAL.servo_viscous * 0.05
    for direction in (1.0, -1.0):
        # a proportional loop lags by its own torque: 3 %
        assert torque(direction) == pytest.approx(direction * nominal, rel=0.03)
        assert torque(direction, servo_offset_n=5.0) == pytest.approx(direction * nominal + 5.0, rel=0.03)
        biased = NOMINAL.servo_coulomb_n * (1.0 + 0.5 * direction) + NOMINAL.servo_viscous * 0.05
        assert torque(direction, servo_asymmetry=0.5) == pytest.approx(direction * biased, rel=0.03)


def test_current_and_voltage_limit_the_servo() -> None:
    def fastest(**parameters: float) -> float:
        plant = create({"start_slack_m": 0.1, **parameters}, 0)
        for k in range(1, 401):
            seen = plant.advance(k * 250_000, -6.0, 0.0)
        return seen.servo_velocity_m_s

    def held(**parameters: float) -> float:
        plant = create({"start_slack_m": 0.1, **parameters}, 0)
        plant.advance(4_000_000, -6.0, 0.0)
        return plant.truth()["true_current_a"]

    speed = fastest()
    assert speed == pytest.approx(-48.0 / 0.9 * 0.02, rel=0.05)
    assert fastest(supply_v=24.0) == pytest.approx(0.5 * speed, rel=0.06)
    assert held() == pytest.approx(-6.0 / 0.9, rel=0.01)
    assert held(current_limit_a=2.0) == pytest.approx(-2.0, rel=0.01)
    assert abs(fastest(supply_ohm=4.0)) < abs(speed) - 0.02


def test_knee_stop_keeps_the_leg() -> None:
    plant = create({"start_slack_m": 0.5}, 0)
    for k in range(1, 4001):
        seen = plant.advance(k * 250_000, 0.0, 17.0)
    assert seen.knee_angle_rad < NOMINAL.stop_high_rad + 17.0 / NOMINAL.stop_stiffness + 0.01
