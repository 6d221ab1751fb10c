"""NMT: which service each state lets through, boot-up, both resets (CiA 301, 7.3.2)."""

from __future__ import annotations

import pytest

from eds.cia301 import Frame, NmtCommand, NmtState
from tests.nodes.core_client import MS, NODE, Bus

REACH = {
    NmtState.PRE_OPERATIONAL: (),
    NmtState.OPERATIONAL: (NmtCommand.START,),
    NmtState.STOPPED: (NmtCommand.STOP,),
}
TARGETS = {1: 5, 2: 4, 128: 127, 129: 0, 130: 0}
"""Command → state, from every state (CiA 301, figure 48); written out, not taken from the table under test."""


def in_state(state: NmtState) -> Bus:
    bus = Bus()
    bus.write(0x1017, 0, 100, "H")
    for command in REACH[state]:
        bus.nmt(command)
    bus.sent.clear()
    return bus


def state_on_the_wire(bus: Bus) -> int:
    beats = [frame.data[0] for _at, frame in bus.run(100 * MS) if frame.can_id == 0x700 + NODE]
    assert len(beats) == 1
    return beats[0]


def sdo_answers(bus: Bus) -> bool:
    return bool([f for f in bus.send(0x600 + NODE, "4000100000000000") if f.can_id == 0x580 + NODE])


def test_boot_up_is_the_first_frame_and_says_zero() -> None:
    bus = Bus(on=False)
    assert bus.send(0, "0105") == []
    bus.device.power_on(0)
    bus.run(0)
    assert [(f.can_id, f.data) for _at, f in bus.sent] == [(0x705, b"\0")]


@pytest.mark.parametrize("state", list(REACH))
@pytest.mark.parametrize("command", TARGETS)
@pytest.mark.parametrize("address", [NODE, 0])
def test_every_command_in_every_state(state: NmtState, command: int, address: int) -> None:
    bus = in_state(state)
    target = TARGETS[command]
    frames = bus.send(0, bytes((command, address)))
    boots = [f for f in frames if f.can_id == 0x705 and f.data == b"\0"]
    if target == 0:
        assert len(boots) == 1
        bus.write(0x1017, 0, 100, "H")
        bus.run(0)
        target = 127
    else:
        assert not boots
    assert state_on_the_wire(bus) == target


@pytest.mark.parametrize("frame", ["", "01", "010500", "0106", "0305", "ff05", "0005", "8105ff0000000000"])
def test_commands_that_are_malformed_or_for_others_change_nothing(frame: str) -> None:
    bus = in_state(NmtState.PRE_OPERATIONAL)
    assert bus.send(0, frame) == []
    assert state_on_the_wire(bus) == NmtState.PRE_OPERATIONAL


@pytest.mark.parametrize("state", list(REACH))
def test_states_gate_sdo(state: NmtState) -> None:
    assert sdo_answers(in_state(state)) is (state is not NmtState.STOPPED)


@pytest.mark.parametrize("state", list(REACH))
def test_states_gate_pdo(state: NmtState) -> None:
    bus = in_state(state)
    bus.send(0x205, "0700000000")
    sent = [f.can_id for f in bus.sync()]
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    operational = state is NmtState.OPERATIONAL
    assert (0x185 in sent) is operational
    assert bus.read(0x6200, 0, "B") == (7 if operational else 0)


def test_an_rpdo_that_waits_for_its_sync_is_lost_with_the_state() -> None:
    bus = in_state(NmtState.OPERATIONAL)
    bus.send(0x305, "000000000700")
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bus.start()
    bus.sync()
    assert bus.read(0x6202, 0, "h") == 0


def test_stopped_ends_a_transfer_in_silence() -> None:
    bus = in_state(NmtState.PRE_OPERATIONAL)
    bus.request("4008100000000000")
    bus.nmt(NmtCommand.STOP)
    assert [f for _at, f in bus.run(5000 * MS) if f.can_id == 0x585] == []
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bus.read(0x1008) == b"Core under test"


def test_emcy_waits_while_stopped_and_the_newest_is_told() -> None:
    bus = in_state(NmtState.OPERATIONAL)
    bus.write(0x1400, 5, 20, "H")
    bus.write(0x1401, 5, 30, "H")
    bus.send(0x205, bytes(5))
    bus.nmt(NmtCommand.STOP)
    bus.device.emergency(0x1000, 1, b"\1")
    bus.device.emergency(0xFF00, 0x81, b"\2")
    assert [f for _at, f in bus.run(50 * MS) if f.can_id == 0x85] == []
    frames = bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert [f.data.hex() for f in frames if f.can_id == 0x85] == ["00ff810200000000"]


def test_reset_communication_restores_0x1000_to_0x1fff_only() -> None:
    bus = in_state(NmtState.OPERATIONAL)
    bus.write(0x2000, 0, 42, "h")
    bus.write(0x6203, 0, 9, "H")
    bus.write(0x1400, 5, 20, "H")
    bus.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bus.read(0x1017, 0, "H") == 0
    assert bus.read(0x1400, 5, "H") == 0
    assert bus.read(0x2000, 0, "h") == 42
    assert bus.read(0x6203, 0, "H") == 9
    assert not [told for told in bus.process.told if told[0] == "reset" and told[1]]


def test_reset_node_restores_everything() -> None:
    bus = in_state(NmtState.OPERATIONAL)
    bus.write(0x2000, 0, 42, "h")
    bus.write(0x1017, 0, 50, "H")
    bus.run(10 * MS)
    bus.nmt(NmtCommand.RESET_NODE)
    assert bus.read(0x1017, 0, "H") == 0
    assert bus.read(0x2000, 0, "h") == 0
    assert ("reset", bus.now_ns) in bus.process.told


def test_reset_drops_what_was_queued() -> None:
    bus = in_state(NmtState.OPERATIONAL)
    bus.device.receive(Frame(0x80), bus.now_ns)
    bus.device.receive(Frame(0, b"\x82\x05"), bus.now_ns)
    bus.run(0)
    assert [f.can_id for _at, f in bus.sent] == [0x705]


def test_the_application_hears_every_state() -> None:
    bus = Bus()
    bus.start()
    bus.nmt(NmtCommand.STOP)
    bus.nmt(NmtCommand.RESET_COMMUNICATION)
    assert [t[1] for t in bus.process.told if t[0] == "nmt"] == [0, 127, 5, 4, 0, 127]


def test_remote_extended_and_error_frames_are_no_commands() -> None:
    bus = in_state(NmtState.PRE_OPERATIONAL)
    for flag in ("remote", "extended", "error"):
        assert bus.send(0, "0105", **{flag: True}) == []
        assert bus.send(0x605, "4000100000000000", **{flag: True}) == []
    assert state_on_the_wire(bus) == NmtState.PRE_OPERATIONAL
