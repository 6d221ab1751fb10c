"""Node and life guarding of a device (CiA 301, 7.2.8.3.2.1): 0x100C, 0x100D, remote frames and the toggle bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from bowden.testing import CanBus, CanopenNode
from tests.nodes.core_client import EDS

OBJECTS = "".join(
    f"\n[{index:X}]\nParameterName={name}\nObjectType=7\nDataType={kind}\nAccessType=rw\nDefaultValue=0\n"
    for index, name, kind in ((0x100C, "Guard time", 6), (0x100D, "Life time factor", 5)))


@pytest.fixture
def node(can_bus: CanBus, tmp_path: Path) -> CanopenNode:
    """Node 5, guarded every 100 ms, OPERATIONAL."""
    path = tmp_path / "guarded.eds"
    path.write_text(EDS.read_text() + OBJECTS)
    made = can_bus.add_node(path, 5)
    made[0x100C], made[0x100D] = 100, 3
    can_bus.send(0x000, b"\x01\x05")
    can_bus.run(0.01)
    return made


def asked(bus: CanBus) -> list[int]:
    """Answers to one remote frame."""
    since_ns = bus.now_ns
    bus.send(0x705, remote=True)
    bus.run(0.01)
    return [frame.data[0] for frame in bus.frames(0x705, since_ns=since_ns) if not frame.remote]


def test_state_and_toggle_bit_answer_a_remote_frame(can_bus: CanBus, node: CanopenNode) -> None:
    assert [asked(can_bus) for _ in range(3)] == [[0x05], [0x85], [0x05]]
    can_bus.send(0x000, b"\x02\x05")
    assert asked(can_bus) == [0x84]
    can_bus.send(0x000, b"\x82\x05")
    can_bus.run(0.01)
    assert asked(can_bus) == [0x7F], "the toggle bit begins anew with the boot-up"


def test_a_master_that_stops_asking_is_reported_and_0x1029_acts(can_bus: CanBus, node: CanopenNode) -> None:
    can_bus.run(1.0)
    assert not can_bus.frames(0x085), "life guarding begins with the first remote frame"
    since_ns = can_bus.now_ns
    asked(can_bus)
    can_bus.run(1.0)
    (emcy,) = can_bus.frames(0x085)
    assert emcy.data[:3] == b"\x30\x81\x11"
    assert emcy.time_ns - since_ns == pytest.approx(300_000_000, abs=1_000_000)
    assert node.state.name == "PRE_OPERATIONAL"
    asked(can_bus)
    assert can_bus.frames(0x085)[-1].data[:3] == b"\0\0\0"


def test_a_node_with_a_heartbeat_or_without_0x100c_is_not_guarded(can_bus: CanBus, node: CanopenNode) -> None:
    can_bus.send(0x605, bytes.fromhex("2b171000e8030000"))
    can_bus.run(0.01)
    assert asked(can_bus) == []
    can_bus.send(0x605, bytes.fromhex("2b17100000000000"))
    can_bus.run(0.01)
    assert len(asked(can_bus)) == 1
    can_bus.add_node("knee_drive", 6)
    since_ns = can_bus.now_ns
    can_bus.send(0x706, remote=True)
    can_bus.run(0.01)
    assert [frame.data for frame in can_bus.frames(0x706, since_ns=since_ns) if not frame.remote] == [b"\0"]
