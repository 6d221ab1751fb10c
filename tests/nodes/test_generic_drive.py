"""The CiA 402 drive behind any EDS: states, stops, and each mode, over the wire; and the CiA 401 module."""

from __future__ import annotations

from pathlib import Path

import pytest

import nodes
from bowden.testing import CanBus, CanopenNode
from eds.cia402 import Mode, State, next_controlword, state_of

VENDOR = """[DeviceInfo]
ProductName=Vendor drive

[1000]
ParameterName=Device type
DataType=7
AccessType=ro
DefaultValue=0x20192
"""


def eds_of(path: Path, objects: dict[tuple[int, int], int], values: dict[tuple[int, int], int] | None = None) -> Path:
    """Write an EDS with objects of given data types; no unit object (60A8h, 6076h) and no gains."""
    text = VENDOR
    for (index, sub), kind in objects.items():
        name = f"{index:X}sub{sub:X}" if (index, 1) in objects else f"{index:X}"
        text += (f"\n[{name}]\nParameterName=o{index:X}\nObjectType=7\nDataType={kind}\nAccessType=rw\nPDOMapping=1\n"
                 f"DefaultValue={(values or {}).get((index, sub), 0)}\n")
    path.write_text(text)
    return path


DRIVE = {(0x1014, 0): 7, (0x6040, 0): 6, (0x6041, 0): 6, (0x605A, 0): 3, (0x6060, 0): 2, (0x6061, 0): 2,
         (0x6064, 0): 4, (0x606C, 0): 4,
         (0x6071, 0): 3, (0x6077, 0): 3, (0x607A, 0): 4, (0x607C, 0): 4, (0x6081, 0): 7, (0x6083, 0): 7, (0x6084, 0): 7,
         (0x6085, 0): 7, (0x6098, 0): 2, (0x60FF, 0): 4, (0x603F, 0): 6, (0x6007, 0): 3}
START = {(0x605A, 0): 2, (0x1014, 0): 0x85, (0x6083, 0): 100_000}


class Driven:
    """A drive on a bus and its master, which writes by SDO."""

    def __init__(self, bus: CanBus, eds: Path) -> None:
        self.bus = bus
        self.application = nodes.GenericDrive()
        self.node: CanopenNode = bus.add_node(eds, 5, profile=self.application)
        bus.run(0.01)

    def write(self, index: int, value: int) -> None:
        entry = self.node.dictionary.entries[index << 8]
        size = entry.data_type.size
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        self.bus.send(0x605, bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, 0)) + data)
        self.bus.run(0.001)
        assert self.bus.frames(0x585)[-1].data[0] == 0x60, self.bus.frames(0x585)[-1]

    def go(self, goal: State) -> None:
        for _ in range(8):
            state = state_of(self.node[0x6041])
            assert state is not None
            if state is goal:
                return
            self.write(0x6040, next_controlword(state, goal))
        raise AssertionError(f"{goal} was not reached")

    def status(self, bit: int) -> int:
        return self.node[0x6041] >> bit & 1


@pytest.fixture
def driven(can_bus: CanBus, tmp_path: Path) -> Driven:
    return Driven(can_bus, eds_of(tmp_path / "vendor.eds", DRIVE, START))


def test_it_walks_through_its_states_and_stops(driven: Driven) -> None:
    assert state_of(driven.node[0x6041]) is State.SWITCH_ON_DISABLED
    driven.write(0x6060, Mode.PROFILE_VELOCITY)
    driven.go(State.OPERATION_ENABLED)
    driven.write(0x60FF, 1000)
    driven.bus.run(0.05)
    assert (driven.node[0x606C], driven.status(10), driven.status(12)) == (1000, 1, 0)
    driven.write(0x6040, 0x0002)
    driven.bus.run(0.02)
    assert state_of(driven.node[0x6041]) is State.SWITCH_ON_DISABLED
    assert driven.node[0x606C] == 0
    driven.go(State.OPERATION_ENABLED)
    driven.application.fault(0x3210, driven.bus.now_ns)
    driven.node._settle()
    driven.bus.run(0.001)
    assert (state_of(driven.node[0x6041]), driven.node[0x603F]) == (State.FAULT, 0x3210)
    assert driven.bus.frames(0x085)[-1].data[:2] == b"\x10\x32"
    driven.write(0x6040, 0)
    driven.go(State.OPERATION_ENABLED)
    assert driven.node[0x603F] == 0


def test_profile_position_takes_set_points_in_turn(driven: Driven) -> None:
    driven.write(0x6060, Mode.PROFILE_POSITION)
    driven.write(0x6081, 10_000)
    driven.go(State.OPERATION_ENABLED)
    driven.write(0x607A, 1000)
    driven.write(0x6040, 0x1F)
    assert (driven.status(12), driven.status(10)) == (1, 0)
    driven.write(0x6040, 0x0F)
    assert driven.status(12) == 0
    driven.write(0x607A, 500)
    driven.write(0x6040, 0x5F)
    assert driven.status(12) == 1, "a relative set-point waits for the first one"
    driven.write(0x6040, 0x0F)
    driven.bus.run(0.05)
    assert 0 < driven.node[0x6064] < 1000
    driven.bus.run(1.0)
    assert (driven.node[0x6064], driven.node[0x606C], driven.status(10)) == (1500, 0, 1)
    seconds = 1000 / 10_000 + 500 / 10_000
    assert seconds < 0.25, "the profile's velocity bounds the motion"


def test_cyclic_modes_follow_and_modes_that_it_lacks_are_refused(driven: Driven) -> None:
    driven.write(0x6060, Mode.CSP)
    driven.go(State.OPERATION_ENABLED)
    for target in (10, 25, -7):
        driven.write(0x607A, target)
        assert (driven.node[0x6064], driven.status(12)) == (target, 1)
    driven.write(0x6060, Mode.CSV)
    driven.write(0x60FF, 2000)
    driven.bus.run(0.1)
    assert driven.node[0x606C] == 2000
    assert driven.node[0x6064] == pytest.approx(-7 + 200, abs=6)
    driven.write(0x6060, Mode.CST)
    driven.write(0x6071, 250)
    assert driven.node[0x6077] == 250
    driven.bus.run(2.0)
    assert driven.node[0x606C] == pytest.approx(2500, abs=1)
    driven.bus.send(0x605, bytes((0x2F, 0x60, 0x60, 0, Mode.VELOCITY, 0, 0, 0)))
    driven.bus.run(0.001)
    assert driven.bus.frames(0x585)[-1].data.hex() == "8060600030000906"
    driven.write(0x6060, Mode.CSV)
    driven.write(0x60FF, 0)
    assert driven.node[0x606C] == 0


def test_a_stopped_node_reacts_as_6007_selects(driven: Driven) -> None:
    for reaction, state, error in ((1, State.FAULT, 0x1000), (2, State.SWITCH_ON_DISABLED, 0), (0, None, 0)):
        driven.bus.send(0x000, b"\x80\x05")
        driven.bus.run(0.01)
        driven.write(0x6040, 0)
        driven.go(State.OPERATION_ENABLED)
        driven.write(0x6007, reaction)
        driven.bus.send(0x000, b"\x02\x05")
        driven.bus.run(0.01)
        assert state_of(driven.node[0x6041]) is (state or State.OPERATION_ENABLED)
        assert driven.node[0x603F] == error


def test_homing_sets_the_position(driven: Driven) -> None:
    driven.write(0x6060, Mode.HOMING)
    driven.write(0x607C, 4711)
    driven.go(State.OPERATION_ENABLED)
    for method, after_s in ((35, 0.0), (1, 0.2)):
        driven.write(0x6098, method)
        driven.write(0x6040, 0x0F)
        driven.write(0x6040, 0x1F)
        if after_s:
            assert driven.status(12) == 0
        driven.bus.run(after_s)
        assert (driven.node[0x6064], driven.status(12), driven.status(13)) == (4711, 1, 0)


def test_an_own_drive_behind_a_vendor_eds_is_named(can_bus: CanBus, tmp_path: Path) -> None:
    from parameters import InputError

    with pytest.raises(InputError, match=r"vendor\.eds: .*; for any EDS there is nodes\.GenericDrive\(\)"):
        can_bus.add_node(eds_of(tmp_path / "vendor.eds", DRIVE), 5, profile=nodes.KneeDrive())


def test_outputs_of_a_module_are_its_inputs(can_bus: CanBus, tmp_path: Path) -> None:
    kinds = {0x6000: 5, 0x6200: 5, 0x6206: 5, 0x6207: 5, 0x6401: 3, 0x6411: 3}
    objects = {(index, sub): kind if sub else 5 for index, kind in kinds.items() for sub in (0, 1, 2)}
    eds = eds_of(tmp_path / "io.eds", objects, {(0x6206, 1): 0x0F, (0x6207, 1): 0x05})
    node = can_bus.add_node(eds, 6, profile=nodes.IoModule())
    can_bus.run(0.01)
    can_bus.send(0x606, bytes.fromhex("2f006201a3000000"))
    can_bus.send(0x606, bytes.fromhex("2b116402fe7f0000"))
    can_bus.run(0.01)
    assert (node[0x6000, 1], node[0x6401, 2]) == (0xA3, 0x7FFE)
    can_bus.send(0x000, b"\x02\x06")
    can_bus.run(0.01)
    assert node[0x6000, 1] == 0xA5, "the error value for the bits of 6206h, the others keep theirs"
