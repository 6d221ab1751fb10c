"""LSS slave (CiA 305): states, selection by identity, fastscan, node id, bit timing, store, inquire."""

from __future__ import annotations

import struct
from pathlib import Path

import canopen
import pytest

from bowden.testing import CanBus
from eds.cia301 import NmtCommand, NmtState
from eds.cia305 import LssCommand as Lss
from nodes.core.device import Device
from tests.nodes.core_client import EDS, MS, NODE, Bus, Process

IDENTITY = tuple(Bus().read(0x1018, sub, "I") for sub in range(1, 5))


def silent(store: Path | None = None, *, node_id: int = 255) -> Bus:
    """A device without a node id, powered."""
    bus = Bus(Device(EDS, node_id, Process(), store=store), on=False)
    bus.device.power_on(0)
    return bus


def asked(bus: Bus, command: int, *data: int) -> list[bytes]:
    """Answers to one request, as the bytes after the identifier 7E4h."""
    frames = bus.send(0x7E5, bytes((command, *data)).ljust(8, b"\0"))
    return [frame.data for frame in frames if frame.can_id == 0x7E4]


def numbered(bus: Bus, command: int, number: int) -> list[bytes]:
    return asked(bus, command, *number.to_bytes(4, "little"))


def selected(bus: Bus, identity: tuple[int, ...] = IDENTITY) -> list[bytes]:
    return [answer for part, n in enumerate(identity) for answer in numbered(bus, Lss.SELECT_VENDOR + part, n)]


def padded(*data: int) -> bytes:
    return bytes(data).ljust(8, b"\0")


def test_without_a_node_id_only_lss_is_heard() -> None:
    bus = silent()
    assert bus.run(3000 * MS) == []
    assert bus.device.filters == {0x7E5}
    assert bus.send(0, "8100") == bus.send(0x600 + 255 - 0x80, "4000100000000000") == []
    assert asked(bus, Lss.IDENTIFY_UNCONFIGURED) == [padded(0x50)]


def test_an_assigned_node_boots_when_it_is_switched_to_waiting() -> None:
    bus = silent()
    assert selected(bus) == [padded(0x44)]
    assert asked(bus, Lss.CONFIGURE_NODE_ID, NODE) == [padded(0x11)]
    assert [(f.can_id, f.data) for f in bus.send(0x7E5, padded(4, 0))] == [(0x705, b"\0")]
    assert bus.device.state is NmtState.PRE_OPERATIONAL
    assert bus.read(0x1800, 1, "I") & 0x7FF == 0x185
    assert asked(bus, Lss.IDENTIFY_UNCONFIGURED) == []


def test_a_configured_node_takes_its_new_id_at_the_next_reset() -> None:
    bus = Bus()
    assert selected(bus) == [padded(0x44)]
    assert asked(bus, Lss.CONFIGURE_NODE_ID, 9) == [padded(0x11)]
    assert asked(bus, Lss.INQUIRE_NODE_ID) == [padded(0x5E, NODE)]
    assert bus.send(0x7E5, padded(4, 0)) == []
    assert [f.can_id for f in bus.nmt(NmtCommand.RESET_COMMUNICATION)] == [0x709]
    assert bus.device.objects.number(0x180001) & 0x7F == 9
    assert [f.can_id for f in bus.nmt(NmtCommand.RESET_NODE, 9)] == [0x705], "it was not stored"


@pytest.mark.parametrize("node_id", [0, 128, 254])
def test_a_node_id_out_of_range_is_refused(node_id: int) -> None:
    bus = silent()
    selected(bus)
    assert asked(bus, Lss.CONFIGURE_NODE_ID, node_id) == [padded(0x11, 1)]
    assert bus.send(0x7E5, padded(4, 0)) == []


def test_a_stored_node_id_and_bit_timing_outlast_a_power_cycle(tmp_path: Path) -> None:
    bus = silent(tmp_path / "node.json")
    selected(bus)
    asked(bus, Lss.CONFIGURE_NODE_ID, NODE)
    assert asked(bus, Lss.CONFIGURE_BIT_TIMING, 0, 2) == [padded(0x13)]
    assert asked(bus, Lss.STORE) == [padded(0x17)]
    again = silent(tmp_path / "node.json")
    again.run(0)
    assert [f.can_id for _at, f in again.sent] == [0x705]
    assert again.device.lss.bitrate == 500_000


def test_parameters_stored_before_a_renumbering_stay(tmp_path: Path) -> None:
    bus = Bus(store=tmp_path / "node.json")
    bus.write(0x1017, 0, 77, "H")
    bus.write(0x1010, 1, 0x65766173, "I")
    selected(bus)
    for request in ((Lss.CONFIGURE_NODE_ID, 9), (Lss.STORE,)):
        asked(bus, *request)
    bus.nmt(NmtCommand.RESET_NODE)
    again = silent(tmp_path / "node.json", node_id=NODE)
    assert (again.device.node_id, again.device.objects.number(0x101700)) == (9, 77)
    assert again.device.objects.number(0x180001) & 0x7F == 9
    assert [frame for _at, frame in again.run(0) if frame.can_id == 0x89] == []


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    bus = silent(tmp_path / "absent" / "node.json")
    selected(bus)
    assert asked(bus, Lss.STORE) == [padded(0x17, 2)]


@pytest.mark.parametrize("text", ["", "{}", '{"node_id": 300, "bitrate": null}', '{"node_id": 4, "bitrate": 7}'])
def test_a_damaged_file_counts_as_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "node.json.lss").write_text(text)
    assert silent(tmp_path / "node.json").device.node_id == 255


@pytest.mark.parametrize("wrong", range(4))
def test_one_wrong_number_selects_nobody(wrong: int) -> None:
    bus = silent()
    assert selected(bus, tuple(n + (at == wrong) for at, n in enumerate(IDENTITY))) == []
    assert asked(bus, Lss.CONFIGURE_NODE_ID, 5) == [], "still waiting"


def test_the_parts_of_the_identity_come_in_their_order() -> None:
    bus = silent()
    for part in (1, 0, 2, 3):
        assert numbered(bus, Lss.SELECT_VENDOR + part, IDENTITY[part]) == []


def test_global_switch_inquires_and_waits_again() -> None:
    bus = Bus()
    assert asked(bus, Lss.INQUIRE_NODE_ID) == []
    asked(bus, Lss.SWITCH_GLOBAL, 1)
    assert [int.from_bytes(asked(bus, Lss.INQUIRE_VENDOR + part)[0][1:5], "little") for part in range(4)] == [*IDENTITY]
    asked(bus, Lss.SWITCH_GLOBAL, 0)
    assert asked(bus, Lss.INQUIRE_VENDOR) == []


def test_a_bit_timing_is_switched_after_its_delay() -> None:
    bus = silent()
    asked(bus, Lss.SWITCH_GLOBAL, 1)
    assert asked(bus, Lss.CONFIGURE_BIT_TIMING, 0, 5) == asked(bus, Lss.CONFIGURE_BIT_TIMING, 1, 2) == [padded(0x13, 1)]
    assert asked(bus, Lss.CONFIGURE_BIT_TIMING, 0, 3) == [padded(0x13)]
    assert asked(bus, Lss.ACTIVATE_BIT_TIMING, 20, 0) == []
    bus.run(19 * MS)
    assert bus.device.lss.bitrate is None
    bus.run(MS)
    assert (bus.device.lss.bitrate, bus.device.lss.muted) == (250_000, True)
    bus.run(20 * MS)
    assert not bus.device.lss.muted


def test_a_range_of_identities_is_asked_for() -> None:
    vendor, product, revision, serial = IDENTITY
    bounds = [vendor, product, 0, revision, serial, serial + 9]
    for wrong, change in ((None, 0), (0, 1), (3, -1), (4, 1)):
        bus = Bus()
        asked_for = [n + change * (at == wrong) for at, n in enumerate(bounds)]
        if min(asked_for) < 0:
            continue
        answers = [a for at, n in enumerate(asked_for) for a in numbered(bus, Lss.IDENTIFY_VENDOR + at, n)]
        assert answers == ([padded(0x4F)] if wrong is None else []), wrong


def test_frames_of_another_length_change_nothing() -> None:
    bus = silent()
    assert bus.send(0x7E5, b"\x4c") == bus.send(0x7E5, b"") == []


def test_a_configured_node_does_not_answer_fastscan() -> None:
    assert asked(Bus(), Lss.FASTSCAN, *struct.pack("<IBBB", 0, 128, 0, 0)) == []


def test_canopens_master_finds_and_assigns_our_device(can_bus: CanBus) -> None:
    """python canopen's `LssMaster` waits in bus time: fastscan, node id, bit timing, store, inquire, selection."""
    node = can_bus.add_node("knee_drive", 255, serial=0x80000001)
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open())
        lss = network.lss
        found, identity = lss.fast_scan()
        assert (found, identity) == (True, [0xB0DE00, 2, 0x10000, 0x80000001])
        lss.configure_node_id(7)
        lss.configure_bit_timing(0)
        lss.store_configuration()
        assert lss.inquire_node_id() == 255
        assert lss.inquire_lss_address(0x5D) == 0x80000001
        lss.send_switch_state_global(lss.WAITING_STATE)
        remote = network.add_node(7, canopen.ObjectDictionary())
        remote.nmt.wait_for_bootup(timeout=1)
        assert lss.send_switch_state_selective(*identity)
        with pytest.raises(canopen.lss.LssError):
            lss.configure_node_id(128)
        network.disconnect()
    assert (node.node_id, node.state) == (7, NmtState.PRE_OPERATIONAL)


def test_two_unconfigured_devices_are_found_one_after_the_other(can_bus: CanBus) -> None:
    for serial in (5, 6):
        can_bus.add_node("knee_drive", 255, serial=serial)
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open())
        found = [network.lss.fast_scan() for _ in range(3)]
        network.disconnect()
    assert [identity and identity[3] for _, identity in found] == [5, 6, None]
