"""Store 0x1010, restore 0x1011, verify 0x1020 (CiA 301, 7.5.2.13, 14, 23): signatures, groups, the file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from eds.cia301 import SIGNATURE_LOAD as LOAD
from eds.cia301 import SIGNATURE_SAVE as SAVE
from eds.cia301 import Abort, NmtCommand
from nodes.core.device import Device
from tests.nodes.core_client import EDS, Bus, Process


def configured(store: Path | None) -> Bus:
    bus = Bus(store=store)
    bus.write(0x1017, 0, 77, "H")
    bus.write(0x2000, 0, -7, "h")
    bus.write(0x2001, 0, 0.1, "f")
    bus.write(0x2002, 0, b"north bench")
    bus.write(0x6203, 0, 12, "H")
    bus.write(0x6200, 0, 3, "B")
    return bus


def configuration(bus: Bus) -> list[object]:
    return [bus.read(0x1017, 0, "H"), bus.read(0x2000, 0, "h"), bus.read(0x2002), bus.read(0x6203, 0, "H")]


STORED = [77, -7, b"north bench", 12]
DEFAULT = [0, 0, b"unnamed", 1]


@pytest.mark.parametrize("how", ["reset node", "power cycle"])
def test_saved_values_come_back(tmp_path: Path, how: str) -> None:
    bus = configured(tmp_path / "servo.json")
    bus.write(0x1010, 1, SAVE, "I")
    bus.write(0x2000, 0, 1, "h")
    if how == "power cycle":
        bus = Bus(store=tmp_path / "servo.json")
    else:
        bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == STORED
    assert bus.read(0x2001, 0, "f") == pytest.approx(0.1)
    assert bus.read(0x6200, 0, "B") == 0


def test_without_a_file_they_survive_a_reset() -> None:
    bus = configured(None)
    bus.write(0x1010, 1, SAVE, "I")
    bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == STORED


def test_unsaved_values_are_lost(tmp_path: Path) -> None:
    configured(tmp_path / "servo.json")
    assert configuration(Bus(store=tmp_path / "servo.json")) == DEFAULT


@pytest.mark.parametrize(("group", "kept"), [
    (1, STORED), (2, [77, 0, b"unnamed", 1]), (3, [0, 0, b"unnamed", 12]), (4, [0, -7, b"north bench", 1]),
])
def test_groups_are_saved_apart(group: int, kept: list[object]) -> None:
    bus = configured(None)
    bus.write(0x1010, group, SAVE, "I")
    bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == kept


@pytest.mark.parametrize(("group", "kept"), [
    (1, DEFAULT), (2, [0, -7, b"north bench", 12]), (3, [77, -7, b"north bench", 1]), (4, [77, 0, b"unnamed", 12]),
])
def test_groups_are_restored_apart_and_only_with_the_next_reset(group: int, kept: list[object]) -> None:
    bus = configured(None)
    bus.write(0x1010, 1, SAVE, "I")
    bus.write(0x1011, group, LOAD, "I")
    assert configuration(bus) == STORED
    bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == kept


def test_reset_communication_brings_stored_communication_values() -> None:
    bus = configured(None)
    bus.write(0x1010, 1, SAVE, "I")
    bus.write(0x1017, 0, 0, "H")
    bus.write(0x2000, 0, 50, "h")
    bus.nmt(NmtCommand.RESET_COMMUNICATION)
    assert configuration(bus) == [77, 50, b"north bench", 12]


@pytest.mark.parametrize(("index", "word"), [(0x1010, LOAD), (0x1010, 1), (0x1011, SAVE), (0x1011, 0)])
def test_a_wrong_signature_does_nothing(index: int, word: int) -> None:
    bus = configured(None)
    if index == 0x1011:
        bus.write(0x1010, 1, SAVE, "I")
    assert bus.refused(index, 1, word, "I") == Abort.NOT_STORED
    bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == (STORED if index == 0x1011 else DEFAULT)


@pytest.mark.parametrize("index", [0x1010, 0x1011])
def test_reading_tells_what_the_device_can_do(index: int) -> None:
    bus = configured(None)
    bus.write(0x1010, 1, SAVE, "I")
    assert bus.read(index, 1, "I") == 1
    assert bus.refused(index, 5, SAVE, "I") == Abort.NO_SUBINDEX


def test_a_mapping_is_stored_and_in_force_after_power_on(tmp_path: Path) -> None:
    bus = Bus(store=tmp_path / "servo.json")
    bus.remap(0x1800, [0x60020010, 0x60000008], 0x1F5, 1)
    bus.write(0x1010, 2, SAVE, "I")
    bus = Bus(store=tmp_path / "servo.json")
    bus.start()
    assert [f.data for f in bus.sync() if f.can_id == 0x1F5] == [bytes(3)]


DAMAGE = {
    "not JSON": "{",
    "not an object": "[]",
    "no values": '{"device": [5, 11591168, 49374]}',
    "another device": '{"device": [6, 11591168, 49374], "values": {}}',
    "unknown object": '{"device": [5, 11591168, 49374], "values": {"300000": "00"}}',
    "read-only object": '{"device": [5, 11591168, 49374], "values": {"100000": "00000000"}}',
    "process data": '{"device": [5, 11591168, 49374], "values": {"620000": "01"}}',
    "wrong length": '{"device": [5, 11591168, 49374], "values": {"101700": "01"}}',
    "beyond limits": '{"device": [5, 11591168, 49374], "values": {"200000": "ff7f"}}',
    "no hex": '{"device": [5, 11591168, 49374], "values": {"101700": "zz"}}',
    "a number": '{"device": [5, 11591168, 49374], "values": {"101700": 5}}',
    "null": '{"device": [5, 11591168, 49374], "values": null}',
    "a good value beside a bad one": '{"device": [5, 11591168, 49374], "values": {"620300": "0900", "101700": "01"}}',
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_damaged_file_is_not_used_and_told(tmp_path: Path, name: str) -> None:
    file = tmp_path / "servo.json"
    file.write_text(DAMAGE[name], encoding="utf-8")
    bus = Bus(on=False, store=file)
    bus.device.power_on(0)
    assert [(f.can_id, f.data[:3].hex()) for _at, f in bus.run(0) or bus.sent] == [(0x705, "00"), (0x85, "206321")]
    assert configuration(bus) == DEFAULT
    bus.write(0x1010, 1, SAVE, "I")
    assert "values" in json.loads(file.read_text(encoding="utf-8"))


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    file = tmp_path / "servo.json"
    file.write_bytes(b"\xff\xfe\x00")
    assert configuration(Bus(store=file)) == DEFAULT


def test_a_mapping_that_makes_no_sense_is_a_pdo_that_does_not_exist(tmp_path: Path) -> None:
    file = tmp_path / "servo.json"
    file.write_text('{"device": [5, 11591168, 49374], "values": {"1A0001": "08000030"}}', encoding="utf-8")
    bus = Bus(store=file)
    assert bus.read(0x1800, 1, "I") == 0x80000185
    bus.start()
    assert 0x185 not in [f.can_id for f in bus.sync()]


def test_a_place_that_cannot_be_written_is_a_hardware_error(tmp_path: Path) -> None:
    bus = configured(tmp_path / "no such directory" / "servo.json")
    assert bus.refused(0x1010, 1, SAVE, "I") == Abort.HARDWARE
    bus.nmt(NmtCommand.RESET_NODE)
    assert configuration(bus) == DEFAULT


def test_0x1020_vouches_until_the_configuration_changes() -> None:
    bus = configured(None)
    bus.write(0x1020, 1, 20000, "I")
    bus.write(0x1020, 2, 5, "I")
    bus.write(0x1010, 1, SAVE, "I")
    bus.nmt(NmtCommand.RESET_NODE)
    assert [bus.read(0x1020, sub, "I") for sub in (1, 2)] == [20000, 5]
    bus.write(0x2000, 0, -7, "h")
    bus.write(0x6200, 0, 9, "B")
    bus.write(0x1010, 1, SAVE, "I")
    assert [bus.read(0x1020, sub, "I") for sub in (1, 2)] == [20000, 5]
    bus.write(0x2000, 0, -8, "h")
    bus.write(0x1010, 1, SAVE, "I")
    bus.nmt(NmtCommand.RESET_NODE)
    assert [bus.read(0x1020, sub, "I") for sub in (1, 2)] == [0, 0]


def test_what_the_application_does_not_want_stored() -> None:
    class Forgetful(Process):
        unstored = frozenset({0x620300})

    bus = Bus(Device(EDS, 5, Forgetful()))
    bus.write(0x6203, 0, 12, "H")
    bus.write(0x1010, 1, SAVE, "I")
    bus.nmt(NmtCommand.RESET_NODE)
    assert bus.read(0x6203, 0, "H") == 1
