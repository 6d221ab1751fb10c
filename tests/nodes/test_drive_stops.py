"""Stops that really stop: ramps, option codes, lost connections and the emergency stop, seen at frames and plant."""

from __future__ import annotations

import struct

import pytest

from eds.cia301 import NmtCommand
from eds.cia402 import Input, State, Status, Stop
from tests.nodes.drive_rig import KNEE, MS, SERVO, TICK_NS, DriveRig

ENABLED, DISABLED = State.OPERATION_ENABLED, State.SWITCH_ON_DISABLED
SPEED = 0.2
"""m/s of rope; at 1 m/s² (0x6084) it takes 200 ms to stop, at 5 m/s² (0x6085) 40 ms."""


def running_servo() -> DriveRig:
    """A servo in CSV at 0.2 m/s, START heard, without the PDO deadlines that a silent master would miss."""
    rig = DriveRig(SERVO)
    rig.setup(but=[(0x1400, 5)])
    rig.run(5)
    rig.write(0x6060, 0, 9)
    rig.to(ENABLED)
    rig.write(0x60FF, 0, 200_000)
    rig.run(150)
    assert rig.plant.velocity == pytest.approx(SPEED, rel=0.01)
    return rig


def stop_of(rig: DriveRig, within_ms: int = 400) -> tuple[float, float]:
    """Return time to 1 % of the speed, s, and the greatest deceleration, m/s², over 2 ms."""
    speeds = [rig.plant.velocity]
    for _ in range(within_ms):
        rig.run(1)
        speeds.append(rig.plant.velocity)
    took = next(n for n, v in enumerate(speeds) if abs(v) < 0.01 * SPEED) * 1e-3
    return took, max(a - b for a, b in zip(speeds, speeds[2:], strict=False)) / 2e-3


@pytest.mark.parametrize(("option", "took_s"), [(1, 0.2), (2, 0.04)])
def test_quick_stop_decelerates_by_its_ramp_then_disables(option: int, took_s: float) -> None:
    rig = running_servo()
    rig.write(0x605A, 0, option)
    rig.control(0x02)
    assert rig.state() is State.QUICK_STOP_ACTIVE
    took, hardest = stop_of(rig)
    # the velocity loop rounds the ramp's ends: 100 Hz are 5 ms of settling and a tenth of overshoot
    assert took == pytest.approx(took_s, abs=0.02)
    assert hardest == pytest.approx(SPEED / took_s, rel=0.25)
    assert rig.state() is DISABLED
    assert rig.torque == 0.0


def test_quick_stop_option_0_lets_go_at_once() -> None:
    rig = running_servo()
    rig.write(0x605A, 0, 0)
    rig.control(0x02)
    assert rig.state() is DISABLED
    rig.run(50)
    assert rig.torque == 0.0
    assert rig.plant.velocity == pytest.approx(SPEED, rel=0.01)


@pytest.mark.parametrize("option", [5, 6])
def test_quick_stop_5_and_6_hold_the_knee_until_it_is_enabled_or_disabled(option: int) -> None:
    rig = DriveRig(KNEE).enabled()
    rig.write(0x605A, 0, option)
    rig.plant.velocity = 0.5
    rig.control(0x02)
    rig.run(300)
    assert rig.state() is State.QUICK_STOP_ACTIVE
    held = rig.plant.position
    rig.plant.load = 2.0
    rig.run(500)
    assert rig.torque == pytest.approx(2.0, rel=0.05)
    assert rig.plant.position == pytest.approx(held, abs=2e-3)
    rig.control(0x0F)
    assert rig.state() is ENABLED


@pytest.mark.parametrize("commanded", [False, True], ids=["by 0x6007", "held before the master was lost"])
def test_the_knees_hold_ends_ten_seconds_after_its_master_was_lost(commanded: bool) -> None:
    rig = DriveRig(KNEE).enabled()
    rig.write(0x605A, 0, Stop.QUICK_STOP_RAMP_HOLD)
    assert rig.read(0x2018) == 10_000
    rig.target = 0
    rig.run(50)
    rig.plant.load = 2.0
    if commanded:
        rig.control(0x02)
    rig.run(2_000 if commanded else 0)
    rig.master_lives = False
    rig.run(9_900)
    assert rig.state() is State.QUICK_STOP_ACTIVE
    assert rig.torque == pytest.approx(2.0, rel=0.05)
    rig.run(400)  # 0x1016 takes 250 ms to miss the master; its targets are missed after 100 ms
    assert rig.state() is State.SWITCH_ON_DISABLED
    assert rig.torque == 0.0


def test_a_hold_time_of_zero_has_no_end_and_a_master_that_comes_back_in_time_keeps_the_hold() -> None:
    rig = DriveRig(KNEE).enabled()
    rig.write(0x605A, 0, Stop.QUICK_STOP_RAMP_HOLD)
    rig.write(0x2018, 0, 0)
    rig.target = 0
    rig.run(50)
    rig.master_lives = False
    rig.run(11_000)
    assert rig.state() is State.QUICK_STOP_ACTIVE
    rig.write(0x2018, 0, 1_000)
    rig.master_lives = True
    rig.run(300)
    rig.control(0x0F)
    assert rig.state() is ENABLED
    rig.run(2_000)
    assert rig.state() is ENABLED


@pytest.mark.parametrize("option", [3, 4])
def test_stops_the_drive_lacks_are_refused(option: int) -> None:
    rig = DriveRig(KNEE)
    assert rig.refused(0x605A, 0, option) == 0x06090030


@pytest.mark.parametrize("option", [5, 6])
def test_the_servo_has_no_stop_that_holds_the_rope(option: int) -> None:
    assert DriveRig(SERVO).refused(0x605A, 0, option) == 0x06090031


@pytest.mark.parametrize(("index", "word", "goal"), [
    (0x605B, 0x06, State.READY_TO_SWITCH_ON), (0x605C, 0x07, State.SWITCHED_ON)])
def test_shutdown_and_disable_operation_by_their_options(index: int, word: int, goal: State) -> None:
    rig = running_servo()
    rig.write(index, 0, 1)
    rig.control(word)
    assert rig.state() is ENABLED
    took, _ = stop_of(rig)
    assert took == pytest.approx(0.2, abs=0.02)
    assert rig.state() is goal
    assert rig.torque == 0.0
    rig = running_servo()
    rig.write(index, 0, 0)
    rig.control(word)
    assert rig.state() is goal
    rig.run(50)
    assert rig.plant.velocity == pytest.approx(SPEED, rel=0.01)


def test_enable_operation_calls_off_a_disable_that_still_brakes() -> None:
    rig = running_servo()
    rig.write(0x605C, 0, 1)
    rig.control(0x07)
    rig.run(50)
    rig.control(0x0F)
    rig.run(300)
    assert rig.state() is ENABLED
    rig.write(0x60FF, 0, 100_000)
    rig.run(100)
    assert rig.plant.velocity == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize(("option", "took_s"), [(1, 0.2), (2, 0.04)])
def test_halt_stops_by_its_option_and_stays_enabled(option: int, took_s: float) -> None:
    rig = running_servo()
    rig.write(0x605D, 0, option)
    rig.control(0x10F)
    took, _ = stop_of(rig)
    assert took == pytest.approx(took_s, abs=0.02)
    assert rig.state() is ENABLED
    assert rig.statusword() & Status.TARGET_REACHED
    rig.write(0x60FF, 0, 50_000)
    rig.run(50)
    assert rig.plant.velocity == pytest.approx(0.0, abs=1e-3)
    rig.control(0x0F)
    rig.write(0x60FF, 0, 50_000)
    rig.run(100)
    assert rig.plant.velocity == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(("option", "took_s"), [(1, 0.2), (2, 0.04)])
def test_fault_reaction_really_decelerates(option: int, took_s: float) -> None:
    rig = running_servo()
    rig.write(0x605E, 0, option)
    rig.write(0x6007, 0, 1)
    rig.master_lives = False
    while rig.state() is ENABLED:
        rig.run(1)
    assert rig.state() is State.FAULT_REACTION_ACTIVE
    took, hardest = stop_of(rig)
    assert took == pytest.approx(took_s, abs=0.02)
    assert hardest == pytest.approx(SPEED / took_s, rel=0.25)
    assert rig.state() is State.FAULT
    assert rig.emergencies() == [0x8130]
    assert rig.read(0x603F) == 0x8130


def test_fault_reaction_0_lets_the_rope_go() -> None:
    rig = running_servo()
    rig.write(0x6007, 0, 1)
    assert rig.read(0x605E) == 0
    rig.master_lives = False
    rig.run(400)
    assert rig.state() is State.FAULT
    assert rig.torque == 0.0
    assert rig.plant.velocity == pytest.approx(SPEED, rel=0.01)


@pytest.mark.parametrize(("option", "state"), [
    (0, ENABLED), (1, State.FAULT), (2, DISABLED), (3, DISABLED)])
def test_abort_connection_option(option: int, state: State) -> None:
    rig = running_servo()
    rig.write(0x6007, 0, option)
    rig.master_lives = False
    rig.run(700)
    assert rig.state() is state


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL, NmtCommand.RESET_COMMUNICATION,
                                     NmtCommand.RESET_NODE])
def test_leaving_operational_takes_the_servo_s_torque(command: NmtCommand) -> None:
    rig = running_servo()
    rig.nmt(command)
    rig.run(1)
    assert rig.torque == 0.0
    rig.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert rig.state() is DISABLED


def test_leaving_operational_is_told_where_0x6007_says_fault() -> None:
    rig = running_servo()
    rig.write(0x6007, 0, 1)
    rig.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert rig.emergencies() == [0x1000]
    assert (rig.state(), rig.read(0x603F)) == (State.FAULT, 0x1000)


def test_leaving_operational_at_rest_changes_nothing() -> None:
    rig = DriveRig(SERVO)
    rig.setup()
    rig.write(0x6007, 0, 1)
    rig.to(State.SWITCHED_ON)
    rig.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert rig.state() is State.SWITCHED_ON


def test_start_lost_takes_the_torque_within_its_deadline() -> None:
    rig = running_servo()
    rig.plant.load = 20.0
    rig.run(20)
    assert rig.torque > 0.1
    rig.feeds_tension = False
    lost_ns = rig.now_ns
    while rig.torque != 0.0:
        rig.run(0.25)
    assert rig.now_ns - lost_ns <= 5 * MS + MS + TICK_NS
    assert rig.state() is DISABLED
    assert 0x8250 in rig.emergencies()


def test_targets_lost_act_on_the_servo_as_the_master_lost() -> None:
    rig = DriveRig(SERVO).enabled()
    rig.target = 0
    rig.run(50)
    rig.target = None
    rig.run(99)
    assert rig.state() is ENABLED
    rig.run(3)
    assert rig.state() is DISABLED


def test_a_broken_start_sensor_is_start_lost() -> None:
    rig = running_servo()
    rig.feeds_tension = False
    rig.send(0x183, struct.pack("<h", -32768))
    assert rig.state() is DISABLED
    for _ in range(20):
        rig.send(0x183, struct.pack("<h", -32768))
        rig.control(0x06)
        rig.control(0x07)
        rig.control(0x0F)
        rig.run(1)
    assert rig.state() is State.SWITCHED_ON
    rig.feeds_tension = True
    rig.run(2)
    rig.control(0x0F)
    assert rig.state() is ENABLED


def test_emergency_stop_needs_the_operators_release() -> None:
    rig = running_servo()
    rig.application.emergency_stop(True, rig.now_ns)
    rig.settle()
    rig.run(0.25)
    assert rig.torque == 0.0
    assert rig.state() is State.FAULT
    word = rig.statusword()
    assert word & Status.STO_ACTIVE
    assert not word & Status.VOLTAGE_ENABLED
    assert rig.read(0x60FD) == Input.INTERLOCK | Input.RELEASE_OUTSTANDING
    assert rig.emergencies() == [0x5441]
    assert rig.refused(0x2020, 0, 0x736C6572) == 0x08000022
    rig.application.emergency_stop(False, rig.now_ns)
    rig.settle()
    assert rig.read(0x60FD) == Input.RELEASE_OUTSTANDING
    for word in (0x00, 0x80, 0x06, 0x07, 0x0F):
        rig.control(word)
    assert rig.state() is State.FAULT
    assert rig.refused(0x2020, 0, 1) == 0x06090030
    assert rig.read(0x2020) == 1
    rig.write(0x2020, 0, 0x736C6572)
    assert rig.read(0x2020) == 0
    rig.run(100)
    assert rig.emergencies() == [0x0000]
    rig.to(ENABLED)


def test_an_emergency_stop_outlives_a_reset() -> None:
    rig = DriveRig(KNEE)
    rig.application.emergency_stop(True, 0)
    rig.settle()
    assert rig.state() is DISABLED
    rig.nmt(NmtCommand.RESET_NODE)
    assert rig.read(0x60FD) == Input.INTERLOCK | Input.RELEASE_OUTSTANDING
    rig.application.emergency_stop(False, 0)
    rig.control(0x06)
    assert rig.state() is DISABLED
    rig.write(0x2020, 0, 0x736C6572)
    rig.control(0x06)
    assert rig.state() is State.READY_TO_SWITCH_ON


def test_an_emergency_stop_in_a_fault_reaction_ends_it() -> None:
    rig = running_servo()
    rig.write(0x605E, 0, 1)
    rig.write(0x6007, 0, 1)
    rig.master_lives = False
    while rig.state() is ENABLED:
        rig.run(1)
    rig.application.emergency_stop(True, rig.now_ns)
    rig.run(0.5)
    assert rig.torque == 0.0
    assert rig.state() is State.FAULT
