"""bus.yml of ros2_canopen: read, written without loss, put into nodes, and made of the nodes of a bus.

The five files are written after the forms that public configurations have.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from bowden.testing import CanBus
from eds import packaged
from eds.files import bus_yml
from parameters import InputError

Run = Callable[..., Any]
FILES = sorted(Path(__file__).with_name("bus_files").glob("*.yml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_file_is_written_without_loss(path: Path, tmp_path: Path) -> None:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    bus_yml.write(tmp_path / "bus.yml", bus_yml.read(path).content)
    assert yaml.safe_load((tmp_path / "bus.yml").read_text(encoding="utf-8")) == content


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_devices_node_ids_eds_pdos_and_writes_survive(path: Path, tmp_path: Path) -> None:
    before = bus_yml.read(path)
    assert before.devices
    bus_yml.write(tmp_path / "bus.yml", bus_yml.of_devices(before.devices, before.master))
    after = bus_yml.read(tmp_path / "bus.yml")
    assert (after.devices, after.master) == (before.devices, before.master)


def test_what_a_file_holds() -> None:
    arm = bus_yml.read(next(path for path in FILES if path.stem == "arm"))
    assert [(one.name, one.node_id, one.eds) for one in arm.devices] == [
        ("shoulder", 3, "knee_drive.eds"), ("elbow", 4, "knee_drive.eds"), ("wrist", 5, "knee_drive.eds")]
    wrist = arm.devices[2]
    assert wrist.writes == ((0x6065, 0, 1000), (0x6060, 0, 8))
    assert wrist.other["heartbeat_producer"] == 500
    assert wrist.pdos == (
        bus_yml.BusPdo("rpdo1", True, "auto", mapping=((0x6040, 0), (0x607A, 0))),
        bus_yml.BusPdo("tpdo1", True, "auto", 1, mapping=((0x6041, 0), (0x6064, 0))),
        bus_yml.BusPdo("tpdo2", False))
    text = bus_yml.text_of(arm.content)
    assert "index: 0x6041" in text


@pytest.fixture
def typed(bowden: Run, can_bus: CanBus, here: Path) -> Run:
    """Type a command about the bus of the test, in a folder that has the EDS files."""
    for name in ("knee_drive", "servo_drive", "tension_sensor"):
        shutil.copy(packaged(name), here)
    can_bus.open()
    at = "--interface", "bowden", "--channel", can_bus.channel
    return lambda *words: bowden("node", *words, *at)


def test_a_file_is_put_into_its_nodes(typed: Run, can_bus: CanBus, here: Path) -> None:
    nodes = [can_bus.add_node("knee_drive", node_id) for node_id in (3, 4, 5)]
    shutil.copy(next(path for path in FILES if path.stem == "arm"), here / "bus.yml")
    told = typed("apply", "bus.yml")
    assert told.status == 0, told.stderr
    assert told.stdout.splitlines()[0].startswith(
        "shoulder, node 3: 6065:00 Following error window = 1000; 6060:00 Modes of operation = 8; ")
    assert [node[0x1017] for node in nodes] == [1000, 1000, 500]
    assert [(node[0x6065], node["1A00:00"], node["1800:02"], node["1801:01"] >> 31) for node in nodes] == [
        (1000, 2, 1, 1)] * 3
    assert [node["1600:02"] >> 16 for node in nodes] == [0x607A] * 3


def test_nodes_become_a_file_that_puts_them_back(typed: Run, can_bus: CanBus, here: Path) -> None:
    nodes = [can_bus.add_node("knee_drive", 5), can_bus.add_node("tension_sensor", 9)]
    assert typed("pdo", 5, "--map", "tpdo1=6041,6064", "--set", "tpdo1.type=1").status == 0
    assert typed("write", 9, "1017", "250").status == 0
    def communication() -> list[dict[str, Any]]:
        return [{f"{at:06X}": value for at, value in node.device.values.items() if at >> 8 < 0x2000} for node in nodes]

    before = communication()
    assert typed("export", "-o", "bus.yml").stdout == "bus.yml: 2 nodes.\n"
    knee, sensor = bus_yml.read(here / "bus.yml").devices
    assert (knee.eds, sensor.eds, sensor.other["heartbeat_producer"]) == ("knee_drive.eds", "tension_sensor.eds", 250)
    assert typed("nmt", "all", "reset").status == 0
    assert json.loads(typed("apply", "bus.yml", "--json").stdout)["devices"][1]["node"] == 9
    after = communication()
    assert [{at: value for at, value in values.items() if value != old[at]}
            for values, old in zip(after, before, strict=True)] == [{}, {}]


def test_while_another_master_lives_nothing_is_written(typed: Run, can_bus: CanBus, here: Path) -> None:
    def beat() -> None:
        can_bus.send(0x77F, b"\x05")
        can_bus.after(0.5, beat)

    beat()
    shutil.copy(next(path for path in FILES if path.stem == "smallest"), here / "bus.yml")
    told = typed("apply", "bus.yml")
    assert (told.status, "another master" in told.stderr) == (2, True)


@pytest.mark.parametrize("text", [
    "", "[1, 2]", "a: [", "master: 3\n", "master: {}\nnodes: [3]\n", "master: {}\ndrive: 5\n",
    "master: {}\ndrive: {node_id: x}\n", "master: {}\na: {node_id: 2}\nb: {node_id: 2}\n",
    "master: {}\ndrive: {node_id: 2, sdo: 5}\n", "master: {}\ndrive: {node_id: 2, sdo: [{value: 3}]}\n",
    "master: {}\ndrive: {node_id: 2, tpdo: 3}\n", "master: {}\ndrive: {node_id: 2, tpdo: {1: {mapping: 3}}}\n",
    "master: {}\ndefaults: true\n", "master: {}\ndrive: {node_id: 2, tpdo: {x: {enabled: true}}}\n",
    "master: {}\ndrive: {node_id: 2, dcf: absent.eds}\n",
    "master: {}\ndrive: {node_id: 2, dcf: knee_drive.eds, sdo: [{index: 0x6065, sub_index: 0, value: -1}]}\n",
    "master: {}\ndrive: {node_id: 2, dcf: knee_drive.eds, sdo: [{index: 0x9999, sub_index: 0, value: 1}]}\n"])
def test_bad_files_are_one_sentence(typed: Run, can_bus: CanBus, here: Path, text: str) -> None:
    can_bus.add_node("knee_drive", 2)
    (here / "bus.yml").write_text(text)
    told = typed("apply", "bus.yml")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told


KEYS = st.sampled_from(["node_id", "dcf", "sdo", "tpdo", "rpdo", "mapping", "index", "enabled", "1", "period"])
CONTENT = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 70_000) | st.text("abx0:", max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4), max_leaves=12)


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(st.sampled_from(["nodes", "defaults", "options", "drive"]), CONTENT, max_size=4))
def test_no_content_brings_the_reader_down(content: dict[str, Any]) -> None:
    try:
        found = bus_yml.BusYml("bus.yml", {"master": {}, **content}).devices
    except InputError:
        return
    again = bus_yml.BusYml("bus.yml", yaml.safe_load(bus_yml.text_of(bus_yml.of_devices(found, {}))))
    assert again.devices == found
