"""`bowden node` over the wire: our device behind its EDS, python canopen's own local node, and npm's canopen."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import bowden as library
from bowden.testing import CanBus
from tests.foreign.peers import CanopenLocalNode, NpmNode, npm_absent

Run = Callable[..., Any]


@pytest.fixture
def typed(bowden: Run, can_bus: CanBus) -> Run:
    """Type a command about a bus that has our knee drive as node 5 and python canopen's node as node 6."""
    can_bus.add_node("knee_drive", 5)
    can_bus.theirs = CanopenLocalNode(can_bus, 6)  # type: ignore[attr-defined]
    can_bus.open()
    at = "--interface", "bowden", "--channel", can_bus.channel
    return lambda *words: bowden("node", *words, *at)


@pytest.fixture(params=[5, 6, pytest.param(7, marks=pytest.mark.exhaustive)], ids=["ours", "canopen", "npm"])
def node(request: pytest.FixtureRequest, can_bus: CanBus) -> Iterator[int]:
    """Node id of each device; npm's joins the bus here."""
    if request.param != 7:
        yield request.param
        return
    if absent := npm_absent():
        pytest.skip(absent)
    npm = NpmNode(can_bus, 7)
    yield 7
    npm.close()


def found(told: Any) -> Any:
    assert told.status == 0, told.stderr
    return json.loads(told.stdout)


def test_scan_finds_both_and_names_the_eds_that_fits(typed: Run) -> None:
    ours, theirs = found(typed("scan", "--json"))["nodes"]
    assert (ours["node"], ours["name"], theirs["node"], theirs["name"]) == (5, "Knee drive", 6, "Knee drive")
    assert ours["state"] == "booted"
    assert theirs["identity"]["product"] == 2


def test_objects_are_read_and_written(typed: Run, node: int) -> None:
    assert found(typed("info", node, "--json"))["profile"] == "CiA 402 drive"
    assert typed("read", node, "0x1018:1").stdout == "1018:01 Identity object: Vendor-ID = 11591168 (0x00B0DE00)\n"
    assert found(typed("read", node, "position actual value", "--json"))["unit"] == "rad"
    assert typed("write", node, "6065", "2000").stdout.startswith("6065:00 Following error window = 2000 (0x000007D0)")
    assert found(typed("read", node, "6065", "--type", "u32", "--json"))["value"] == 2000
    listed = found(typed("objects", node, "--changed", "--json"))["objects"]
    assert "6065:00" in [each["object"] for each in listed]


def test_a_pdo_is_mapped_in_the_order_of_cia_301(typed: Run, can_bus: CanBus, node: int) -> None:
    since = can_bus.now_ns
    told = found(typed("pdo", node, "--map", "tpdo1=6041,6064,6077", "--set", "tpdo1.type=1", "--json"))
    (tpdo1,) = [each for each in told["pdos"] if each["pdo"] == "tpdo1"]
    assert [each["name"] for each in tpdo1["mapping"]] == [
        "Statusword", "Position actual value", "Torque actual value"]
    assert (tpdo1["valid"], tpdo1["type"]) == (True, 1)
    writes = [frame.data[1:4].hex() for frame in can_bus.frames(cob_id=0x600 + node, since_ns=since)
              if frame.data[0] >> 5 == 1]
    assert writes == ["001801", "001802", "001a00", "001a01", "001a02", "001a03", "001a00", "001801"]


def test_a_refused_mapping_leaves_the_pdo_as_it_was(typed: Run) -> None:
    before = found(typed("pdo", 5, "--json"))
    told = typed("pdo", 5, "--map", "rpdo1=6041")
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1)
    assert "the PDO is as it was" in told.stderr
    assert found(typed("pdo", 5, "--json")) == before
    assert typed("pdo", 5, "--map", "tpdo1=6064,6064,6064").status == 2
    assert typed("pdo", 5, "--set", "tpdo1.type=300").status == 2


def test_errors_are_in_words_and_cleared(typed: Run, can_bus: CanBus) -> None:
    can_bus.nodes[5].emergency(0x3210, register=0x04)
    told = typed("errors", 5)
    assert told.status == 1
    assert told.stdout.splitlines() == [
        "1001 error register: generic, voltage", "3210 DC link over-voltage", "1 errors in the history."]
    can_bus.nodes[5].recover(0x3210)
    assert typed("errors", 5, "--clear").stdout.splitlines()[1] == "0 errors in the history."


def test_nmt_moves_one_node_or_all(typed: Run, can_bus: CanBus) -> None:
    assert typed("write", 5, "1017", "100").status == 0
    assert typed("nmt", 5, "start").stdout == "5: start sent; OPERATIONAL.\n"
    assert typed("nmt", "all", "stop").stdout == "all: stop sent; 5 STOPPED.\n"
    assert can_bus.nodes[5].state.name == "STOPPED"
    assert typed("nmt", 5, "reset").stdout == "5: reset sent; booted.\n"
    assert typed("nmt", 5, "jump").status == 2


def test_while_another_master_lives_nothing_is_moved(typed: Run, can_bus: CanBus) -> None:
    def beat() -> None:
        can_bus.send(0x77F, b"\x05")
        can_bus.after(0.5, beat)

    beat()
    for words in (("write", 5, "1017", "100"), ("nmt", 5, "start"), ("pdo", 5, "--map", "tpdo1=6041"),
                  ("errors", 5, "--clear")):
        told = typed(*words)
        assert (told.status, "another master" in told.stderr) == (2, True), words
        assert typed(*words, "--force").status == 0
    assert typed("read", 5, "6041").status == 0


def test_backup_compare_restore_by_id(typed: Run, here: Path, node: int) -> None:
    assert typed("backup", node, "-o", "node.dcf").status == 0
    assert typed("compare", node, "node.dcf").stdout == "0 parameters differ.\n"
    assert typed("write", node, "6065", "2000").status == 0
    assert typed("compare", node, "node.dcf").status == 1
    if node == 5:
        assert typed("restore", node, "node.dcf").stdout.splitlines()[-1] == "1 parameters restored."
        assert typed("compare", node, "node.dcf").status == 0


def test_bytes_go_to_and_from_files(typed: Run, here: Path) -> None:
    for way in ((), ("--block",)):
        assert typed("read", 5, "1008", "-o", "name.bin", "--overwrite", *way).status == 0
        assert (here / "name.bin").read_bytes() == b"Bowden knee drive"
    (here / "two.bin").write_bytes(b"\xf4\x01")
    assert typed("write", 5, "1017", "--input", "two.bin").stdout.endswith("= 500 (0x01F4)\n")


@pytest.mark.parametrize("words", [
    ("read", 5, "no such name"), ("read", 5, "9999"), ("read", 99, "1000"), ("read", "nobody", "1000"),
    ("write", 5, "1017", "70000"), ("write", 5, "1018:01", "1"), ("write", 5, "1017"), ("write", 5, "1017", "x"),
    ("read", 5, "1017", "--type", "u7"), ("pdo", 5, "--map", "tpdo1"), ("backup", 99, "-o", "x.dcf"),
    ("info", 5, "--eds", "absent.eds")])
def test_bad_input_is_one_sentence(typed: Run, here: Path, words: tuple[object, ...]) -> None:
    told = typed(*words)
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told
    assert not list(here.iterdir())


def test_an_eds_names_its_own_emergencies(bowden: Run, here: Path) -> None:
    assert bowden("node", "emcy", "8611").stdout == "8611 following error\n"
    Path("own.eds").write_text("[1000]\nParameterName=Device type\nDataType=7\n[EmcyCodes]\n0xFF07=belt torn\n")
    assert bowden("node", "emcy", "FF07", "--eds", "own.eds").stdout == "FF07 belt torn\n"
    assert bowden("node", "emcy", "12345").status == 2


def test_a_node_in_python(can_bus: CanBus) -> None:
    can_bus.add_node("knee_drive", 5)
    can_bus.open()
    with library.Node(5, bus=library.simulated(channel=can_bus.channel)) as node:
        node.write("Following error window", 2000)
        assert node.read("6065") == 2000
        assert [word >> 16 for word in node.map_pdo("tpdo1", "6041,6064").mapping] == [0x6041, 0x6064]


def test_each_stack_is_found_read_for_errors_and_started(typed: Run, can_bus: CanBus, node: int) -> None:
    assert node in [each["node"] for each in found(typed("scan", "--json"))["nodes"]]
    assert found(typed("errors", node, "--json")) == {"node": node, "register": [], "history": []}
    since = can_bus.now_ns
    assert typed("nmt", node, "start").stdout.startswith(f"{node}: start sent")
    assert [frame.data for frame in can_bus.frames(cob_id=0, since_ns=since)] == [bytes((1, node))]
    assert typed("errors", node, "--clear").status == 0
