"""The drive's loops: bandwidth on the nominal bench, limits without wind-up."""

import cmath
import math

import pytest

from physics import laws
from physics.drive_loops import (
    DRIVE_TICK_NS,
    FOLLOWING_ERROR,
    KNEE_GAINS,
    LIMITED,
    SERVO_GAINS,
    VELOCITY_DEMAND,
    loop,
    loop_state,
    velocity_loop,
)
from physics.plant.bench_plant import create
from physics.reference import paper_reference

TICK_S = DRIVE_TICK_NS * 1e-9


def _gain_at(frequency: float, *, taut: bool) -> float:
    """Return |x/target| of the servo under a 0.5 mm sine, rope taut at about 33 N or slack, from its last half."""
    knee = laws.knee_angle(13.0)
    plant = create({"start_knee_rad": knee, "start_slack_m": 0.0 if taut else 20e-3}, 0)
    seen = plant.reset(0)
    servo, held = loop_state(), loop_state()
    servo_gains, knee_gains = SERVO_GAINS.vector(), KNEE_GAINS.vector()
    start = seen.servo_position_m
    base = start + (8e-3 if taut else 0.0)
    lead, count = 1600, 1600 * 2
    response = wanted = 0j
    for k in range(lead + count):
        turn = 2 * math.pi * frequency * max(0, k - lead) * TICK_S
        target = start + (base - start) * min(1.0, 1.3 * k / lead) + 0.5e-3 * math.sin(turn)
        torque = loop(servo, servo_gains, seen.servo_position_m, seen.servo_velocity_m_s, target, 0.0, TICK_S)
        hold = loop(held, knee_gains, seen.knee_motor_rad, seen.knee_motor_rad_s, knee, 0.0, TICK_S)
        seen = plant.advance((k + 1) * DRIVE_TICK_NS, torque, hold)
        if k >= lead + count // 2:
            response += (seen.servo_position_m - base) * cmath.exp(-1j * turn)
            wanted += (target - base) * cmath.exp(-1j * turn)
    return abs(response / wanted)


@pytest.mark.parametrize("taut", [True, False])
def test_position_bandwidth_is_about_25_hz(taut: bool) -> None:
    # −3 dB is 0.707; a bandwidth between 20 and 31 Hz crosses it between these two
    assert _gain_at(20.0, taut=taut) > 0.707
    assert _gain_at(31.25, taut=taut) < 0.707


def test_knee_follows_the_paper_reference_within_a_tenth_of_a_degree() -> None:
    reference = paper_reference(40.0, 2.0)
    plant = create({"start_knee_rad": reference.knee_angle(0.0), "start_slack_m": 80e-3}, 0)
    seen = plant.reset(0)
    state, gains = loop_state(), KNEE_GAINS.vector()
    worst = 0.0
    for cycle in range(2000):
        target = reference.knee_angle((cycle + 1) / 2000)
        before = reference.knee_angle(cycle / 2000)
        for tick in range(4):
            demand = before + (target - before) * (tick + 1) / 4
            rate = (target - before) / 1e-3
            torque = loop(state, gains, seen.knee_motor_rad, seen.knee_motor_rad_s, demand, rate, TICK_S)
            seen = plant.advance(cycle * 1_000_000 + (tick + 1) * DRIVE_TICK_NS, 0.0, torque)
        if cycle > 300:
            worst = max(worst, abs(target - seen.knee_motor_rad))
    assert math.degrees(worst) < 0.1


def test_torque_limit_is_kept_and_does_not_wind_up() -> None:
    state, gains = loop_state(), SERVO_GAINS.vector()
    for _ in range(4000):
        assert abs(loop(state, gains, 0.0, 0.0, 1.0, 0.0, TICK_S)) <= SERVO_GAINS.torque_limit
    assert state[LIMITED] == 1.0
    # one tick after the error is gone the demand is what a fresh loop would ask, up to what was left in the integrals
    assert loop(state, gains, 1.0, 0.0, 1.0, 0.0, TICK_S) == pytest.approx(0.0, abs=0.02 * SERVO_GAINS.torque_limit)


def test_velocity_demand_is_limited() -> None:
    state, gains = loop_state(), SERVO_GAINS.vector()
    loop(state, gains, 0.0, 0.0, -5.0, 0.0, TICK_S)
    assert state[VELOCITY_DEMAND] == -SERVO_GAINS.velocity_limit
    assert state[FOLLOWING_ERROR] == -5.0


def test_velocity_loop_brakes_to_rest() -> None:
    state, gains = loop_state(), SERVO_GAINS.vector()
    assert velocity_loop(state, gains, 0.1, 0.0, TICK_S) < 0.0
    assert velocity_loop(state, gains, -0.1, 0.0, TICK_S) > 0.0
    assert abs(velocity_loop(state, gains, -50.0, 0.0, TICK_S)) <= SERVO_GAINS.torque_limit
