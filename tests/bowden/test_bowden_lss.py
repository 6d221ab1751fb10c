"""`bowden lss` over the wire: devices without a node id get one; configured ones get another, and a bit rate."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import bowden as library
from bowden.testing import CanBus
from eds.cia305 import LssAddress
from tests.foreign.lss_slave import EagerLssSlave

Run = Callable[..., Any]


@pytest.fixture
def typed(bowden: Run, can_bus: CanBus) -> Run:
    """Type a command about the bus of the test."""
    can_bus.open()
    at = "--interface", "bowden", "--channel", can_bus.channel
    return lambda *words: bowden("lss", *words, *at)


def found(told: Any) -> Any:
    assert told.status == 0, told.stderr
    return json.loads(told.stdout)


def test_unconfigured_devices_are_found_and_stay_so(typed: Run, can_bus: CanBus) -> None:
    assert typed("scan").stdout == "0 unconfigured devices.\n"
    nodes = [can_bus.add_node("knee_drive", 255, serial=serial) for serial in (0x2A, 0xFFFFFFFF)]
    can_bus.add_node("tension_sensor", 3)
    assert typed("scan").stdout.splitlines() == [
        "B0DE00:2:10000:2A  vendor 0x00B0DE00 product 0x00000002 revision 0x00010000 serial 0x0000002A",
        "B0DE00:2:10000:FFFFFFFF  vendor 0x00B0DE00 product 0x00000002 revision 0x00010000 serial 0xFFFFFFFF",
        "2 unconfigured devices."]
    assert [one["serial"] for one in found(typed("scan", "--json"))["unconfigured"]] == [0x2A, 0xFFFFFFFF]
    assert [node.node_id for node in nodes] == [255, 255]


def test_a_device_gets_a_node_id_and_keeps_it(typed: Run, can_bus: CanBus) -> None:
    node = can_bus.add_node("knee_drive", 255, serial=7)
    assert typed("assign", 5, "--store").stdout == "B0DE00:2:10000:7 is node 5, stored; booted.\n"
    assert (node.node_id, node.state.name) == (5, "PRE_OPERATIONAL")
    node.power_off()
    node.power_on()
    assert node.node_id == 5
    assert typed("assign", 6, "--node", 5).stdout == "B0DE00:2:10000:7 is node 6; booted.\n"
    node.power_off()
    node.power_on()
    assert node.node_id == 5, "node id 6 was not stored"
    assert typed("assign", 6, "--identity", "b0de00:2:10000:7").status == 0
    assert typed("store", "--node", 6).stdout == "B0DE00:2:10000:7: node id and bit rate stored.\n"
    node.power_off()
    node.power_on()
    assert node.node_id == 6


def test_a_bit_rate_is_switched(typed: Run, can_bus: CanBus) -> None:
    node = can_bus.add_node("knee_drive", 5)
    assert typed("bitrate", 500_000, "--node", 5, "--activate", 10).stdout == (
        "B0DE00:2:10000:0: 500000 bit/s, in force in 10 ms.\n")
    can_bus.run(0.1)
    assert node.device.lss.bitrate == 500_000
    assert typed("store", "--node", 5).status == 2, "it is off the bus, whose bit rate is another"
    can_bus.bitrate = 500_000
    assert typed("store", "--node", 5).status == 0


def test_of_several_devices_one_is_named(typed: Run, can_bus: CanBus) -> None:
    for serial in (1, 2):
        can_bus.add_node("knee_drive", 255, serial=serial)
    told = typed("assign", 5)
    assert (told.status, "B0DE00:2:10000:1, B0DE00:2:10000:2" in told.stderr) == (2, True)
    assert typed("assign", 5, "--identity", "B0DE00:2:10000:2").status == 0
    assert [node.device.objects.number(0x101804) for node in can_bus.nodes.values() if node.node_id == 5] == [2]
    assert typed("assign", 6).status == 0


@pytest.mark.parametrize("words", [
    ("assign", 5), ("assign", 0), ("assign", 128), ("assign", 9, "--identity", "1:2:3"), ("assign", 9, "--node", 77),
    ("assign", 9, "--identity", "1:2:3:4"), ("bitrate", 300_000, "--node", 5), ("store",), ("assign", 9)])
def test_bad_input_is_one_sentence(typed: Run, can_bus: CanBus, words: tuple[object, ...]) -> None:
    node = can_bus.add_node("knee_drive", 5)
    told = typed(*words)
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told
    assert ("outside 1 … 127" in told.stderr) == (words[1:] in ((0,), (128,))), told
    assert (node.node_id, node.device.lss.pending) == (5, 5)


def test_while_another_master_lives_no_node_is_assigned(typed: Run, can_bus: CanBus) -> None:
    def beat() -> None:
        can_bus.send(0x77F, b"\x05")
        can_bus.after(0.5, beat)

    node = can_bus.add_node("knee_drive", 255)
    beat()
    for words in (("assign", 5), ("store",), ("bitrate", 500_000)):
        told = typed(*words)
        assert (told.status, "another master" in told.stderr) == (2, True), words
    assert node.node_id == 255
    assert typed("assign", 5, "--force").status == 0


def test_a_device_that_cannot_store_says_so(typed: Run, can_bus: CanBus, here: Path) -> None:
    can_bus.add_node("knee_drive", 255, store=here / "absent" / "node.json")
    told = typed("assign", 5, "--store")
    assert (told.status, told.stdout) == (2, "")
    assert told.stderr.startswith("bowden: LSS store configuration: it cannot store node id and bit rate (code 2)")


def test_lss_in_python(can_bus: CanBus) -> None:
    node = can_bus.add_node("knee_drive", 255)
    can_bus.open()
    with library.Lss(bus=library.simulated(channel=can_bus.channel)) as lss:
        (address,) = lss.scan()
        lss.choose(address=address)
        lss.configure_node_id(5)
    can_bus.run(0.01)
    assert node.node_id == 5


def test_a_slave_that_answers_every_fastscan_in_configuration_is_found_once_and_assigned(
        typed: Run, can_bus: CanBus) -> None:
    slave = EagerLssSlave(can_bus, LssAddress(0x1AB, 0x2CD, 3, 0x45))
    told = found(typed("scan", "--json"))
    assert [one["identity"] for one in told["unconfigured"]] == ["1AB:2CD:3:45"]
    assert told["note"].startswith("1AB:2CD:3:45 answers every fastscan while it is in configuration")
    assert typed("assign", 9).stdout == "1AB:2CD:3:45 is node 9; booted.\n"
    assert slave.node_id == 9


def test_an_identity_that_no_inquiry_confirms_ends_the_scan(typed: Run, can_bus: CanBus) -> None:
    EagerLssSlave(can_bus, LssAddress(1, 2, 3, 4), inquiries=LssAddress(1, 2, 3, 5))
    told = found(typed("scan", "--json"))
    assert told["unconfigured"] == []
    assert told["note"].startswith("the identity 1:2:3:4 is confirmed by no device")
    refused = typed("assign", 9)
    assert (refused.status, "confirmed by no device" in refused.stderr) == (2, True)
