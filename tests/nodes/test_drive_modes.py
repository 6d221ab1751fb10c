"""CSP, CSV and CST, their limits and their errors, by frames and by what the mass does."""

from __future__ import annotations

import itertools
import math
import struct

import pytest

from eds.cia402 import Mode, State, Status
from physics.drive_loops import KNEE_GAINS, SERVO_GAINS, Gains
from tests.nodes.drive_rig import KNEE, SERVO, DriveRig, lag_of

ENABLED = State.OPERATION_ENABLED
TAIL = 0.03
"""Share of a step that the position integral still has to take back after 0.2 s: K_I/K_P is 2.4 1/s."""
MDEG = math.pi / 180e3


def in_mode(mode: Mode, node_id: int = SERVO) -> DriveRig:
    rig = DriveRig(node_id)
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.write(0x6060, 0, mode)
    rig.to(ENABLED)
    return rig


# ---- units ----


def test_servo_reads_micrometres_tenths_of_newton_and_increments() -> None:
    rig = in_mode(Mode.CST)
    rig.plant.load = 30.0
    rig.plant.position = 0.0123456
    rig.write(0x6071, 0, 300)
    rig.run(1)
    assert rig.torque == pytest.approx(0.6)
    latched = rig.plant.position
    _word, position, torque = struct.unpack("<HiH", rig.frames(0x181)[-1])
    assert position == pytest.approx(latched * 1e6, abs=1)
    assert torque == 300
    # 131072 increments a revolution of 125663.7 µm
    assert rig.node[0x6063] == pytest.approx(rig.plant.position * 131072 / 0.1256637, abs=1)


def test_knee_reads_millidegrees_at_the_knee_and_turns_motor_torque_by_its_reducer() -> None:
    rig = in_mode(Mode.CST, KNEE)
    rig.plant.position = -0.5
    rig.plant.load = 3.2
    rig.write(0x6071, 0, 500)
    rig.run(0.25)
    assert rig.torque == pytest.approx(0.5 * 0.320 * 20)
    # an increment is 4.5 mdeg: 4000 a motor revolution, 20 of them a turn of the knee
    assert rig.read(0x6064) == pytest.approx(-0.5 / MDEG, abs=4.5)
    assert rig.read(0x6063) == pytest.approx(-0.5 / (2 * math.pi) * 80_000, abs=1)


@pytest.mark.parametrize(("node_id", "gains"), [(SERVO, SERVO_GAINS), (KNEE, KNEE_GAINS)])
def test_default_gains_are_the_ones_that_physics_declares(node_id: int, gains: Gains) -> None:
    rig = DriveRig(node_id)
    assert rig.read(0x60FB, 1) == 1e3 * gains.position_gain
    assert rig.read(0x60FB, 2) == 1e3 * gains.position_integral
    assert rig.read(0x60F9, 1) == 1e3 * gains.velocity_gain
    assert rig.read(0x60F9, 2) == 1e3 * gains.velocity_integral


def test_polarity_turns_position_and_velocity() -> None:
    rig = DriveRig(SERVO)
    rig.plant.position, rig.plant.velocity = 0.01, 0.0
    rig.write(0x607E, 0, 0xC0)
    rig.run(0.25)
    assert rig.read(0x6064) == -10_000
    assert rig.refused(0x607E, 0, 0x80) == 0x06090030
    rig.to(ENABLED)
    assert rig.refused(0x607E, 0, 0) == 0x08000022
    rig.write(0x607A, 0, -12_000)
    rig.run(300)
    assert rig.plant.position == pytest.approx(0.012, abs=TAIL * 0.002)


# ---- CSP ----


def csp_response(frequency_hz: int, feed_forward: int) -> tuple[float, float]:
    rig = DriveRig(SERVO)
    rig.setup()
    rig.write(0x60FB, 3, feed_forward)
    rig.run(5)
    rig.to(ENABLED)
    positions, targets = [], []
    for n in range(400 + 1000):
        target = 1000 * math.sin(2 * math.pi * frequency_hz * n * 1e-3)
        rig.target = round(target)
        rig.run(1)
        if n >= 400:
            positions.append(rig.plant.position * 1e6)
            targets.append(target)
    return lag_of(positions, targets, 1e-3, frequency_hz)


def test_csp_has_the_bandwidth_of_a_25_hz_drive() -> None:
    # −3 dB is 0.707: a bandwidth between 20 and 31 Hz lies between these two
    assert csp_response(20, 0)[0] > 0.707
    assert csp_response(31, 0)[0] < 0.707


def test_velocity_feed_forward_takes_the_lag_away() -> None:
    _, without = csp_response(5, 0)
    _, with_it = csp_response(5, 1000)
    assert -without / (2 * math.pi * 5) == pytest.approx(0.010, abs=0.002)
    assert -with_it / (2 * math.pi * 5) < 0.003


def test_targets_are_interpolated_between_syncs() -> None:
    rig = DriveRig(SERVO).enabled()
    rig.target = 0
    rig.run(20)
    demands = []
    for n in range(1, 8):
        rig.target = 400 * n
        for _ in range(4):
            rig.run(0.25)
            demands.append(rig.node[0x6062])
    steps = [b - a for a, b in itertools.pairwise(demands[8:])]
    assert steps == [100] * len(steps)
    assert rig.read(0x606B) == 400_000


@pytest.mark.parametrize(("value", "index", "period_s"), [(4, -3, 0.004), (20, -4, 0.002), (1, -2, 0.01)])
def test_interpolation_period(value: int, index: int, period_s: float) -> None:
    rig = DriveRig(SERVO)
    rig.write(0x60C2, 1, value)
    rig.write(0x60C2, 2, index)
    rig.run(1)
    rig.to(ENABLED)
    rig.write(0x607A, 0, 1000)
    rig.run(1e3 * period_s - 1.0)
    assert 0 < rig.node[0x6062] < 1000
    rig.run(1.5)
    assert rig.node[0x6062] == 1000


def test_a_target_from_before_the_enabling_moves_nothing() -> None:
    rig = DriveRig(SERVO)
    rig.write(0x607A, 0, 50_000)
    rig.run(1)
    rig.to(ENABLED)
    rig.run(200)
    assert rig.plant.position == pytest.approx(0.0, abs=1e-6)
    assert rig.read(0x6062) == 0


def test_position_offset_is_added() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x60B0, 0, 500)
    rig.write(0x607A, 0, 1000)
    rig.run(300)
    assert rig.plant.position == pytest.approx(1.5e-3, rel=TAIL)


def test_position_limits_hold_the_target_back() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x607D, 2, 10_000)
    rig.write(0x607A, 0, 12_000)
    rig.run(400)
    assert rig.plant.position == pytest.approx(0.010, rel=TAIL)
    assert rig.statusword() & Status.INTERNAL_LIMIT
    assert rig.refused(0x607D, 1, 10_001) == 0x06090036
    assert rig.refused(0x607D, 2, -200_001) == 0x06090036


@pytest.mark.parametrize("mode", [Mode.CSV, Mode.CST])
def test_position_limits_stop_a_velocity_and_a_torque(mode: Mode) -> None:
    rig = in_mode(mode)
    rig.write(0x607D, 2, 30_000)
    rig.write(0x2012, 0, 0)
    rig.write(0x60FF if mode is Mode.CSV else 0x6071, 0, 200_000 if mode is Mode.CSV else 50)
    rig.run(1500)
    # in CST what is left at the limit is 50 ‰, 5 N, against 31/0.02 · 125 N/m of the bound's own stiffness
    assert 0.0299 <= rig.plant.position <= 0.0301
    assert rig.statusword() & Status.INTERNAL_LIMIT


def test_max_motor_speed_draws_out_a_step() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x6080, 0, 24)
    rig.write(0x6065, 0, 0xFFFFFFFF)
    rig.write(0x607A, 0, 50_000)
    speeds = []
    for _ in range(1500):
        rig.run(1)
        speeds.append(rig.plant.velocity)
    # 24 1/min of a drum of 125.66 mm: 50.27 mm/s
    assert max(speeds) == pytest.approx(0.05027, rel=0.02)
    assert rig.plant.position == pytest.approx(0.05, abs=1e-4)


def test_max_torque_bounds_the_torque() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x6072, 0, 150)
    rig.write(0x6065, 0, 0xFFFFFFFF)
    rig.write(0x607A, 0, 100_000)
    rig.torques.clear()
    rig.run(300)
    assert max(rig.torques) == pytest.approx(0.3)
    assert min(rig.torques) >= -0.3


def test_torque_limits_per_direction() -> None:
    rig = in_mode(Mode.CST)
    rig.write(0x60E0, 0, 100)
    rig.write(0x60E1, 0, 50)
    for asked, given in ((400, 0.2), (-400, -0.1)):
        rig.write(0x6071, 0, asked)
        rig.run(1)
        assert rig.torque == pytest.approx(given)
        assert rig.statusword() & Status.INTERNAL_LIMIT


def test_following_error_is_a_fault_after_its_time() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x6065, 0, 1000)
    rig.write(0x6066, 0, 50)
    rig.write(0x6072, 0, 0)
    rig.write(0x607A, 0, 2000)
    rig.run(20)
    assert rig.read(0x60F4) == 2000
    assert rig.statusword() & Status.FOLLOWING_ERROR
    assert rig.state() is ENABLED
    rig.run(50)
    assert rig.state() is State.FAULT
    assert rig.emergencies() == [0x8611]
    assert rig.read(0x603F) == 0x8611


def test_a_following_error_that_passes_in_time_is_none() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x6065, 0, 1000)
    rig.write(0x6066, 0, 50)
    for _ in range(5):
        rig.write(0x6072, 0, 0)
        rig.write(0x607A, 0, rig.read(0x6064) + 1500)
        rig.run(40)
        rig.write(0x6072, 0, 2000)
        rig.run(100)
    assert rig.state() is ENABLED


def test_following_error_is_off_at_its_highest_window() -> None:
    rig = in_mode(Mode.CSP)
    rig.write(0x6065, 0, 0xFFFFFFFF)
    rig.write(0x6072, 0, 0)
    rig.write(0x607A, 0, 100_000)
    rig.run(500)
    assert rig.state() is ENABLED


# ---- CSV, CST, changes of mode ----


def test_csv_follows_a_velocity_with_its_offset() -> None:
    rig = in_mode(Mode.CSV)
    assert rig.read(0x6061) == Mode.CSV
    rig.plant.load = 10.0
    rig.write(0x60FF, 0, -20_000)
    rig.write(0x60B1, 0, 5_000)
    rig.run(300)
    assert rig.read(0x606C) == pytest.approx(-15_000, abs=100)
    assert rig.statusword() & Status.FOLLOWS_COMMAND


def test_cst_gives_a_torque_with_its_offset() -> None:
    rig = in_mode(Mode.CST)
    rig.plant.load = 15.0
    rig.write(0x6071, 0, 100)
    rig.write(0x60B2, 0, 50)
    rig.run(1)
    assert rig.torque == pytest.approx(0.3)
    assert rig.read(0x6077) == rig.read(0x6074) == 150


def test_cst_does_not_pass_the_greatest_speed() -> None:
    rig = in_mode(Mode.CST, KNEE)
    rig.write(0x607D, 1, -90_000_000)
    rig.write(0x607D, 2, 90_000_000)
    rig.write(0x6080, 0, 100)
    rig.write(0x6071, 0, 100)
    rig.run(1500)
    assert rig.plant.velocity == pytest.approx(100 * 2 * math.pi / 60 / 20, rel=0.02)


def test_a_change_of_mode_brakes_and_begins_at_rest() -> None:
    rig = in_mode(Mode.CSV)
    rig.write(0x60FF, 0, 100_000)
    rig.run(100)
    rig.write(0x607A, 0, 0)
    rig.write(0x6060, 0, Mode.CSP)
    assert rig.read(0x6061) == Mode.CSV  # it brakes; the new mode is not open
    rig.run(300)
    assert rig.read(0x6061) == Mode.CSP
    assert rig.state() is ENABLED
    assert rig.plant.velocity == pytest.approx(0.0, abs=1e-4)
    where = rig.read(0x6064)
    rig.write(0x607A, 0, where + 1000)
    rig.run(200)
    assert rig.read(0x6064) == pytest.approx(where + 1000, abs=1000 * TAIL)


@pytest.mark.parametrize("mode", [1, 2, 3, 4, 5, 7])
def test_modes_the_drive_lacks_are_refused(mode: int) -> None:
    assert DriveRig(SERVO).refused(0x6060, 0, mode) == 0x06090030


def test_mode_0_holds() -> None:
    rig = in_mode(Mode.NONE)
    rig.plant.load = 20.0
    rig.write(0x607A, 0, 10_000)
    rig.run(500)
    assert rig.plant.position == pytest.approx(0.0, abs=1e-4)


def test_supported_modes_say_what_is_taken() -> None:
    rig = DriveRig(SERVO)
    supported = int(rig.read(0x6502))
    for mode in Mode:
        if mode and supported & mode.supported_bit:
            rig.write(0x6060, 0, mode)
            assert rig.read(0x6061) == mode
    assert supported == sum(m.supported_bit for m in (Mode.HOMING, Mode.CSP, Mode.CSV, Mode.CST))


def test_no_torque_before_operation_enabled() -> None:
    rig = DriveRig(SERVO)
    rig.setup()
    rig.target = 10_000
    rig.run(20)
    rig.to(State.SWITCHED_ON)
    rig.torques.clear()
    rig.run(50)
    assert set(rig.torques) == {0.0}


def test_both_drives_take_their_own_half_of_the_targets() -> None:
    rig = DriveRig(KNEE).enabled()
    rig.target = -4500
    rig.run(500)
    assert rig.plant.position / MDEG == pytest.approx(-4500, rel=TAIL)


def test_a_new_mode_is_shown_when_it_is_open_and_its_set_point_is_then_followed() -> None:
    rig = in_mode(Mode.CSV)
    rig.write(0x60FF, 0, 100_000)
    rig.run(200)
    rig.write(0x6060, 0, Mode.CSP)
    waited = 0
    while rig.read(0x6061) != Mode.CSP:
        rig.run(1)
        waited += 1
        assert waited < 1000
    assert waited > 0
    where = rig.read(0x6064)
    rig.write(0x607A, 0, where + 500)
    rig.run(200)
    assert rig.read(0x6064) == pytest.approx(where + 500, abs=500 * TAIL + 5)
