"""The rope's tension, kept within its limit by the servo itself, whatever the master asks."""

from __future__ import annotations

import struct

import pytest

from eds.cia402 import Mode, State, Status
from tests.nodes.drive_rig import SERVO, DriveRig, servo_mass

ENABLED = State.OPERATION_ENABLED
LIMIT_N = 90.0
STIFF, SOFT = 27_000.0, 3_000.0
"""N/m: a rope stuck in its sheath, and the slackest part of the fabric."""


def rope_rig(mode: Mode, stiffness: float) -> DriveRig:
    rig = DriveRig(SERVO, servo_mass(stiffness, 0.005))
    rig.setup(but=[(0x1400, 5), (0x2017, 0)])
    rig.run(5)
    rig.write(0x6060, 0, mode)
    rig.to(ENABLED)
    return rig


def ask_for_too_much(rig: DriveRig, mode: Mode) -> None:
    index, value = {Mode.CSP: (0x607A, 190_000), Mode.CSV: (0x60FF, 100_000), Mode.CST: (0x6071, 2000)}[mode]
    rig.write(index, 0, value)


@pytest.mark.parametrize("stiffness", [STIFF, SOFT])
@pytest.mark.parametrize("mode", [Mode.CSP, Mode.CSV, Mode.CST])
def test_tension_stops_at_its_limit(mode: Mode, stiffness: float) -> None:
    rig = rope_rig(mode, stiffness)
    rig.write(0x2013, 0, 0)
    ask_for_too_much(rig, mode)
    highest = 0.0
    for _ in range(1500):
        rig.run(1)
        highest = max(highest, rig.plant.tension)
    # START is a millisecond old and the drum has mass: a tenth of the limit, on the stuck rope, is what that takes
    assert highest <= 1.1 * LIMIT_N
    assert rig.plant.tension == pytest.approx(LIMIT_N, rel=0.05)
    assert rig.state() is ENABLED
    assert rig.statusword() & Status.INTERNAL_LIMIT


def test_the_drum_pays_out_when_the_knee_loads_the_rope() -> None:
    rig = rope_rig(Mode.CSP, SOFT)
    rig.write(0x607A, 0, 30_000)
    rig.run(1000)
    assert rig.plant.tension == pytest.approx(75.0, rel=0.02)
    for _ in range(1000):
        rig.plant.slack -= 30e-6
        rig.run(1)
        assert rig.plant.tension < 1.1 * LIMIT_N
    assert rig.plant.position < 0.02
    assert not rig.statusword() & Status.FOLLOWS_COMMAND
    assert rig.state() is ENABLED


def test_the_axis_returns_to_its_target_when_the_rope_is_free_again() -> None:
    rig = rope_rig(Mode.CSP, SOFT)
    rig.write(0x607A, 0, 60_000)
    rig.run(1000)
    rig.plant.slack = 0.04
    rig.run(1000)
    assert rig.plant.position == pytest.approx(0.06, rel=0.01)
    assert rig.statusword() & Status.FOLLOWS_COMMAND


def test_above_the_trip_level_the_drive_faults_and_lets_go() -> None:
    rig = rope_rig(Mode.CSP, SOFT)
    rig.feeds_tension = False
    rig.send(0x183, struct.pack("<h", 11_001))
    assert rig.state() is State.FAULT
    rig.run(0.25)
    assert rig.torque == 0.0
    assert rig.emergencies() == [0xFF01]
    assert rig.read(0x603F) == 0xFF01
    rig.control(0x00)
    rig.control(0x80)
    assert rig.state() is State.FAULT
    rig.send(0x183, struct.pack("<h", 10_000))
    rig.control(0x00)
    rig.control(0x80)
    assert rig.state() is State.SWITCH_ON_DISABLED


def test_the_statusword_warns_above_the_limit() -> None:
    rig = rope_rig(Mode.CSP, SOFT)
    rig.feeds_tension = False
    for tension, warns in ((8_990, False), (9_010, True), (8_950, True), (8_890, False)):
        rig.send(0x183, struct.pack("<h", tension))
        assert bool(rig.statusword() & Status.WARNING) is warns


def test_the_limit_is_an_object() -> None:
    rig = rope_rig(Mode.CSV, SOFT)
    rig.write(0x2012, 0, 3000)
    ask_for_too_much(rig, Mode.CSV)
    rig.run(1500)
    assert rig.plant.tension == pytest.approx(30.0, rel=0.05)


def test_without_a_trusted_tension_the_torque_is_bounded() -> None:
    rig = DriveRig(SERVO, servo_mass(SOFT, 0.005))
    rig.feeds_tension = False
    rig.run(1)
    rig.write(0x6060, 0, Mode.CST)
    rig.to(ENABLED)
    rig.write(0x6071, 0, 1500)
    rig.run(5)
    assert rig.torque == pytest.approx(0.4)
    rig.write(0x2015, 0, 50)
    rig.run(5)
    assert rig.torque == pytest.approx(0.1)
