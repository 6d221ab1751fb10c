"""What a drive refuses of a master: steps no speed allows, set-points and power without a heartbeat, no motion."""

from __future__ import annotations

import struct

import pytest

from eds.cia402 import Mode, State, Status
from tests.nodes.drive_rig import KNEE, SERVO, DriveRig, servo_mass

ENABLED = State.OPERATION_ENABLED


@pytest.mark.parametrize(("node_id", "limit"), [(SERVO, 10_000), (KNEE, 9_000)])
def test_a_step_beyond_what_the_speed_limit_allows_is_refused(node_id: int, limit: int) -> None:
    """The bench's set-up allows ten milliseconds of the greatest speed; the last target holds, EMCY 8612h says so."""
    rig = DriveRig(node_id).enabled()
    assert rig.read(0x2017) == limit
    rig.target = 0
    rig.run(20)
    rig.target = limit + 500
    rig.run(50)
    assert rig.emergencies() == [0x8612]
    assert rig.read(0x1001) == 0x21  # generic, and the device profile's own bit
    assert abs(rig.read(0x6064)) < 50
    assert rig.state() is ENABLED
    rig.target = 200
    rig.run(200)
    assert rig.emergencies() == [0]
    assert rig.read(0x6064) == pytest.approx(200, abs=20)


def test_a_new_mode_ends_the_refusal_of_a_step() -> None:
    """The step was a CSP target's; the mode that opens next begins without its EMCY."""
    rig = DriveRig(KNEE).enabled()
    rig.target = 50_000
    rig.run(20)
    assert rig.emergencies() == [0x8612]
    rig.write(0x6060, 0, Mode.CSV)
    rig.run(500)
    assert rig.read(0x6061) == Mode.CSV
    assert rig.emergencies() == [0]


def test_a_step_within_the_limit_is_drawn_out() -> None:
    rig = DriveRig(SERVO).enabled()
    rig.target = 9_000
    rig.run(400)
    assert rig.emergencies() == []
    assert rig.read(0x6064) == pytest.approx(9_000, rel=0.01)


def test_without_a_step_limit_any_target_is_taken() -> None:
    rig = DriveRig(SERVO)
    rig.setup(but=[(0x2017, 0)])
    rig.run(5)
    rig.to(ENABLED)
    rig.target = 50_000
    rig.run(600)
    assert rig.emergencies() == []
    assert rig.read(0x6064) == pytest.approx(50_000, rel=0.01)


@pytest.mark.parametrize("node_id", [SERVO, KNEE])
def test_no_drive_is_enabled_for_a_master_that_was_never_heard(node_id: int) -> None:
    rig = DriveRig(node_id)
    rig.master_lives = False
    rig.setup()
    rig.run(5)
    for word in (0x06, 0x07, 0x0F):
        rig.control(word)
    assert rig.state() is State.SWITCHED_ON
    rig.send(0x77F, b"\x05")
    rig.control(0x0F)
    assert rig.state() is ENABLED


@pytest.mark.parametrize(("mode", "index"), [(Mode.CSP, 0x607A), (Mode.CSV, 0x60FF), (Mode.CST, 0x6071)])
def test_set_points_are_taken_only_while_the_masters_heartbeat_lives(mode: Mode, index: int) -> None:
    """With 0x6007 = 0 the drive stays enabled when its master is lost; it moves nothing until the master is back."""
    rig = DriveRig(SERVO)
    rig.setup(but=[(0x1400, 5), (0x6007, 0)])
    rig.write(0x6007, 0, 0)
    rig.write(0x1029, 1, 1)
    rig.run(5)
    rig.write(0x6060, 0, mode)
    rig.to(ENABLED)
    rig.master_lives = False
    rig.run(400)
    assert rig.emergencies() == [0x8130]
    rig.write(index, 0, 2000 if mode is not Mode.CST else 100)
    rig.run(100)
    assert abs(rig.plant.position) < 1e-4
    rig.send(0x77F, b"\x05")
    rig.write(index, 0, 2000 if mode is not Mode.CST else 100)
    rig.run(100)
    assert rig.plant.position > 1e-4


def test_a_following_error_counts_while_the_tension_bound_acts() -> None:
    """Far below its limit the bound is no more than a speed limit: a servo that does not move has lost its track."""
    rig = DriveRig(SERVO, servo_mass(3_000.0, 0.0))
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.to(ENABLED)
    rig.write(0x6072, 0, 100)
    rig.write(0x607A, 0, 60_000)
    rig.run(60)
    assert rig.statusword() & Status.FOLLOWING_ERROR
    rig.run(100)
    assert rig.state() is State.FAULT
    assert rig.emergencies() == [0x8611]


def test_a_rope_at_its_tension_limit_is_no_following_error() -> None:
    rig = DriveRig(SERVO, servo_mass(3_000.0, 0.0))
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.to(ENABLED)
    rig.write(0x607A, 0, 60_000)
    rig.run(1500)
    assert rig.state() is ENABLED
    assert rig.plant.tension == pytest.approx(90.0, rel=0.05)


def test_the_knee_keeps_its_angle_and_speed_limits() -> None:
    rig = DriveRig(KNEE)
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.to(ENABLED)
    rig.write(0x6065, 0, 0xFFFFFFFF)
    speeds = []
    for target, held in ((90_000, 15_000), (-150_000, -95_000)):
        rig.send(0x201, struct.pack("<ii", 0, target))
        rig.write(0x607A, 0, target)
        for _ in range(800):
            rig.run(1)
            speeds.append(abs(rig.plant.velocity))
        assert rig.read(0x6064) == pytest.approx(held, abs=150)
    assert max(speeds) < 1.15 * 15.71


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.5])
def test_a_velocity_that_contradicts_the_position_is_a_fault(share: float) -> None:
    """Reversed, zero or half: the loop would shake the rope; the drive faults (7305h) within 0.5 mm of such a way."""
    rig = DriveRig(SERVO).enabled()
    rig.run(20)
    rig.velocity_share = share
    for target in range(0, 4_000, 200):
        rig.target = target
        rig.run(1)
    rig.run(50)
    assert 0x7305 in rig.emergencies()
    assert rig.state() is State.FAULT
    assert rig.torque == 0.0


def test_an_encoder_whose_scale_is_off_is_a_fault_within_a_degree_of_the_leg() -> None:
    """A swing of 60° in 1.2 s; the velocity is the rotor's, and the encoder counts 13 % too much."""
    rig = DriveRig(KNEE).enabled()
    rig.run(20)
    rig.velocity_share = 1.0 / 1.13
    for step in range(1, 1201):
        rig.target = -50 * step
        rig.run(1)
        if rig.state() is State.FAULT:
            break
    assert rig.emergencies() == [0x7305]
    assert rig.state() is State.FAULT
    assert 0.13 / 1.13 * abs(rig.read(0x6064)) < 1_000


def test_a_servo_with_two_phases_swapped_is_let_go_before_the_drum_has_speed() -> None:
    """The loop pushes away from where it holds; a following error let the drum gain 0.8 m/s."""
    rig = DriveRig(SERVO).enabled()
    rig.run(20)
    rig.torque_share = -1.0
    rig.plant.velocity = 1e-4
    rig.run(60)
    assert rig.emergencies() == [0x7122]
    assert rig.state() is State.FAULT
    assert 0.0 < rig.plant.velocity < 0.05


def test_a_rope_that_pulls_the_drum_out_is_no_swapped_stage() -> None:
    rig = DriveRig(SERVO, servo_mass(stiffness=5_000.0)).enabled()
    for target in range(0, 8_000, 200):
        rig.target = target
        rig.run(1)
    rig.plant.load = 300.0
    rig.run(5)
    rig.plant.load = 0.0
    rig.run(30)
    assert 0x7122 not in rig.emergencies()


def test_a_torque_that_lags_its_demand_is_no_swapped_stage() -> None:
    """The drum pays out fast, is stopped at once and bounces: the torque still pushes when its demand has turned."""
    rig = DriveRig(SERVO).enabled()
    rig.lag_s = 1.5e-3
    for target in range(0, -18_000, -220):
        rig.target = target
        rig.run(1)
    rig.target = -16_000
    rig.run(40)
    assert rig.emergencies() == []


def test_the_greatest_speed_is_no_contradiction() -> None:
    rig = DriveRig(SERVO).enabled()
    for target in range(0, 100_000, 900):
        rig.target = target
        rig.run(1)
    assert rig.emergencies() == []


def test_a_narrow_following_window_does_not_narrow_the_contradiction() -> None:
    rig = DriveRig(SERVO).enabled()
    rig.write(0x6065, 0, 100)
    rig.write(0x6066, 0, 10)
    for target in range(0, 15_000, 900):
        rig.target = target
        rig.run(1)
    rig.run(50)
    assert rig.emergencies() == [0x8611]
