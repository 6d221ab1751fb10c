"""EMCY codes of the drives that only rare circumstances bring about, in numbers."""

from __future__ import annotations

import struct

from tests.nodes.drive_rig import KNEE, SERVO, DriveRig


def test_a_broken_start_sensor_is_an_emcy_where_0x6007_says_fault() -> None:
    rig = DriveRig(SERVO).enabled()
    rig.write(0x6007, 0, 1)
    rig.emergencies()
    rig.feeds_tension = False
    rig.send(0x183, struct.pack("<h", -32768))
    assert rig.emergencies() == [0x5030]
    assert int(rig.read(0x1001)) == 0x21


def test_an_emergency_stop_without_power_is_an_emcy_and_no_fault() -> None:
    rig = DriveRig(KNEE)
    rig.setup()
    rig.emergencies()
    rig.application.emergency_stop(True, rig.now_ns)
    rig.settle()
    assert rig.emergencies() == [0x5441]
    assert int(rig.read(0x1001)) == 0x21
    assert rig.statusword() & 0x4F == 0x40
    rig.application.emergency_stop(False, rig.now_ns)
    rig.write(0x2020, 0, 0x736C6572)
    rig.run(101)
    assert rig.emergencies() == [0x0000]
    assert int(rig.read(0x1001)) == 0
