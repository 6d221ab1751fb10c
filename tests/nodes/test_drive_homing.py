"""Homing: at the present position, and to a preload that START feels (CiA 402 mode 6, methods 35, 37, −1)."""

from __future__ import annotations

import struct

import pytest

from eds.cia301 import NmtCommand
from eds.cia402 import HomingMethod, Mode, State, Status
from tests.nodes.drive_rig import KNEE, SERVO, DriveRig, servo_mass

ENABLED = State.OPERATION_ENABLED
BITS = Status.TARGET_REACHED | Status.HOMING_ATTAINED | Status.HOMING_ERROR
DONE = Status.TARGET_REACHED | Status.HOMING_ATTAINED
START = 0x1F


def homing_rig(method: int, node_id: int = SERVO, stiffness: float = 3000.0, slack: float = 0.01) -> DriveRig:
    rig = DriveRig(node_id, servo_mass(stiffness, slack) if node_id == SERVO else None)
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.write(0x6098, 0, method)
    rig.write(0x6060, 0, Mode.HOMING)
    rig.to(ENABLED)
    return rig


def bits(rig: DriveRig) -> int:
    return rig.statusword() & BITS


@pytest.mark.parametrize("method", [35, 37])
@pytest.mark.parametrize("node_id", [SERVO, KNEE])
def test_the_present_position_becomes_home(method: int, node_id: int) -> None:
    rig = homing_rig(method, node_id)
    rig.write(0x607C, 0, 1234)
    assert bits(rig) == Status.TARGET_REACHED
    rig.control(START)
    assert bits(rig) == DONE
    assert rig.read(0x6064) == pytest.approx(1234, abs=5)
    before = rig.plant.position
    rig.run(50)
    assert rig.plant.position == pytest.approx(before, abs=1e-5)


def test_method_37_works_without_power() -> None:
    rig = DriveRig(SERVO)
    rig.plant.position = 0.02
    rig.run(1)
    assert rig.read(0x6064) == 20_000
    rig.write(0x6060, 0, Mode.HOMING)
    rig.write(0x6098, 0, 37)
    rig.control(0x10)
    assert bits(rig) == DONE
    assert rig.read(0x6064) == 0


def test_homing_moves_the_position_limits_and_targets_with_it() -> None:
    rig = homing_rig(37, slack=1.0)
    rig.write(0x607C, 0, 190_000)
    rig.control(START)
    rig.write(0x6060, 0, Mode.CSP)
    rig.run(20)
    rig.write(0x607A, 0, 205_000)
    rig.run(400)
    assert rig.read(0x6064) == pytest.approx(200_000, rel=0.005)
    assert rig.statusword() & Status.INTERNAL_LIMIT


def test_preload_is_found_slowly_held_and_called_home() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION)
    rig.write(0x2010, 0, 1000)
    rig.control(START)
    assert bits(rig) == 0
    speeds = []
    while not bits(rig):
        rig.run(10)
        speeds.append(rig.plant.velocity)
        assert len(speeds) < 2000
    assert bits(rig) == DONE
    assert max(speeds) == pytest.approx(0.005, rel=0.1)
    assert rig.plant.tension == pytest.approx(10.0, abs=0.7)
    assert rig.read(0x6064) == pytest.approx(0, abs=5)
    rig.run(500)
    assert rig.plant.tension == pytest.approx(10.0, abs=0.7)
    assert rig.state() is ENABLED


def test_preload_homing_takes_a_rope_that_is_too_tight_back() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION, slack=-0.01)
    rig.write(0x2010, 0, 1000)
    rig.run(10)
    rig.control(START)
    rig.run(8000)
    assert bits(rig) == DONE
    assert rig.plant.tension == pytest.approx(10.0, abs=0.7)


def test_no_rope_within_the_travel_is_a_homing_error_not_a_fault() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION, slack=1.0)
    rig.write(0x2016, 0, 10_000)
    rig.control(START)
    rig.run(2500)
    assert bits(rig) == Status.HOMING_ERROR | Status.TARGET_REACHED
    assert rig.plant.position == pytest.approx(0.010, abs=5e-4)
    assert rig.state() is ENABLED
    assert rig.emergencies() == [0x8613]
    assert rig.read(0x1001) == 0x21


def test_another_homing_takes_the_error_back() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION, slack=1.0)
    rig.write(0x2016, 0, 10_000)
    rig.control(START)
    rig.run(2500)
    assert rig.emergencies() == [0x8613]
    rig.control(0x0F)
    rig.control(START)
    assert rig.emergencies() == [0x0000]
    assert rig.read(0x1001) == 0


def test_without_start_there_is_no_preload() -> None:
    rig = DriveRig(SERVO)
    rig.write(0x6060, 0, Mode.HOMING)
    rig.run(1)
    rig.to(ENABLED)
    rig.control(START)
    rig.run(50)
    assert bits(rig) == Status.HOMING_ERROR | Status.TARGET_REACHED
    assert rig.plant.position == pytest.approx(0.0, abs=1e-4)


def test_start_lost_while_homing_takes_the_torque() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION)
    rig.control(START)
    rig.run(500)
    rig.feeds_tension = False
    rig.run(10)
    assert rig.torque == 0.0
    assert rig.state() is State.SWITCH_ON_DISABLED
    assert bits(rig) & Status.HOMING_ATTAINED == 0


def test_taking_the_start_bit_back_interrupts() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION)
    rig.control(START)
    rig.run(500)
    assert rig.refused(0x6098, 0, 37) == 0x08000022
    rig.control(0x0F)
    rig.run(100)
    assert bits(rig) == Status.TARGET_REACHED
    assert rig.plant.velocity == pytest.approx(0.0, abs=1e-4)
    rig.control(START)
    assert bits(rig) == 0


def test_homing_does_not_start_while_halted() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION)
    rig.control(0x10F)
    rig.run(100)
    rig.control(0x11F)
    rig.run(500)
    assert bits(rig) == Status.TARGET_REACHED
    assert rig.plant.position == pytest.approx(0.0, abs=1e-5)


def test_homing_starts_on_the_edge_only() -> None:
    rig = homing_rig(37)
    rig.control(START)
    rig.write(0x6060, 0, Mode.CSP)
    rig.run(20)
    rig.write(0x607A, 0, 5_000)
    rig.run(300)
    rig.write(0x6060, 0, Mode.HOMING)
    rig.control(START)
    assert rig.read(0x6064) == pytest.approx(5_000, rel=0.03)
    assert bits(rig) & Status.HOMING_ATTAINED


def test_home_outlives_a_reset_for_the_encoder_is_absolute() -> None:
    rig = homing_rig(37)
    rig.plant.position = 0.01
    rig.run(300)
    at = rig.read(0x6064)
    rig.control(START)
    rig.nmt(NmtCommand.RESET_NODE)
    assert abs(rig.read(0x6064)) < abs(at)
    rig.write(0x6060, 0, Mode.HOMING)
    assert rig.statusword() & Status.HOMING_ATTAINED


@pytest.mark.parametrize(("node_id", "method"), [(SERVO, 1), (SERVO, 34), (SERVO, 0), (KNEE, 36)])
def test_methods_the_drive_lacks_are_refused(node_id: int, method: int) -> None:
    assert DriveRig(node_id).refused(0x6098, 0, method) == 0x06090030


def test_the_knee_has_no_rope_to_home_to() -> None:
    assert DriveRig(KNEE).refused(0x6098, 0, -1) == 0x06090032


def test_preload_reads_start_s_pdo_and_nothing_else() -> None:
    rig = homing_rig(HomingMethod.PRELOAD_TENSION, slack=1.0)
    rig.feeds_tension = False
    rig.control(START)
    for n in range(3000):
        rig.bus.send(0x184, struct.pack("<h", 9000))
        rig.bus.send(0x183, struct.pack("<h", min(2000, n)))
        rig.run(1)
    assert bits(rig) == DONE
