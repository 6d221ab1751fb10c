"""CiA 406: a joint's angle in counts, its direction, its preset, and the TPDO of a bench without a knee drive."""

from __future__ import annotations

import math
import struct

import pytest

import eds
from eds.bench.bench_network import KNEE, Network
from eds.declaration import packaged
from nodes import JointEncoder
from physics.plant.bench_plant import Outputs
from tests.nodes.drive_rig import NodeBus

COUNTS = 65536


class Joint(NodeBus):
    """An encoder on a joint that stands at an angle, rad."""

    application: JointEncoder

    def __init__(self) -> None:
        super().__init__(KNEE, wire=eds.wire(Network(bench=packaged("bench_no_knee_drive"))))

    def at(self, angle_rad: float) -> Joint:
        self.application.feel(self.now_ns, Outputs(0.0, 0.0, 0.0, 0.0, angle_rad, 0.0, 0.0))
        return self


def test_flexion_counts_below_zero_and_within_one_revolution() -> None:
    joint = Joint().at(-math.pi / 2.0)
    assert joint.read(0x6020, 1) == -COUNTS // 4
    assert joint.read(0x6004) == 3 * COUNTS // 4


def test_the_direction_turns_round() -> None:
    joint = Joint().at(-math.pi / 2.0)
    joint.write(0x6000, 0, 1)
    assert joint.read(0x6020, 1) == COUNTS // 4


@pytest.mark.parametrize("preset", [0, -100, 2000])
def test_the_position_takes_the_preset_where_the_joint_stands(preset: int) -> None:
    joint = Joint().at(0.3)
    joint.write(0x6010, 1, preset)
    assert joint.read(0x6020, 1) == preset
    assert joint.at(0.3 + math.pi / 2.0).read(0x6020, 1) == pytest.approx(preset + COUNTS // 4, abs=1)


def test_the_tpdo_carries_the_angle_at_sync() -> None:
    joint = Joint().at(-1.0)
    joint.setup()
    (data,) = [frame.data for frame in joint.sync() if frame.cob_id == 0x180 + KNEE]
    assert struct.unpack("<i", data) == (round(-1.0 / (2.0 * math.pi) * COUNTS),)
