"""`bowden node` about nodes that refuse, are absent, do not obey or are guarded, and another master's bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bowden.testing import CanBus
from eds.cia301 import Abort
from eds.dictionary import packaged

Run = Callable[..., Any]


@pytest.fixture
def typed(bowden: Run, can_bus: CanBus) -> Run:
    """Type a command about the bus of the test."""
    can_bus.open()
    at = "--interface", "bowden", "--channel", can_bus.channel
    return lambda *words: bowden("node", *words, *at)


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    """The knee drive's EDS with a writable string above 0x1FFF, node guarding, and no heartbeat."""
    path = tmp_path / "own.eds"
    objects = [(0x100C, "Guard time", 6, 0), (0x100D, "Life time factor", 5, 0), (0x2100, "Text", 9, "")]
    path.write_text(packaged("knee_drive").read_text() + "".join(
        f"\n[{index:X}]\nParameterName={name}\nObjectType=7\nDataType={kind}\nAccessType=rw\nDefaultValue={value}\n"
        for index, name, kind, value in objects))
    return path


@pytest.mark.parametrize("way", [(), ("--block",)], ids=["segmented", "block"])
@pytest.mark.parametrize("size", [7, 20, 500])
def test_the_first_abort_of_a_transfer_is_the_answer(
        typed: Run, can_bus: CanBus, eds: Path, way: tuple[str, ...], size: int) -> None:
    can_bus.add_node(eds, 5).refuse(0x2100, Abort.INVALID_VALUE)
    told = typed("write", 5, "2100", "x" * size, "--type", "str", *way)
    assert told.status == 2
    assert "object 0x2100:00: refused with 0x06090030, invalid value for parameter; see the device's manual." in (
        told.stderr)


def test_advice_fits_the_case(typed: Run, can_bus: CanBus) -> None:
    can_bus.add_node("knee_drive", 5)
    assert "supply and cable" in typed("read", 6, "1000").stderr
    for words, advice in ((("read", 5, "4444"), "bowden node objects"), (("read", 5, "1018:09"), "sub-index"),
                          (("write", 5, "1000", "1", "--type", "u32"), "write another object"),
                          (("write", 5, "1017", "1", "--type", "u32"), "--type")):
        told = typed(*words)
        assert (told.status, advice in told.stderr, "cable" in told.stderr) == (2, True, False), told.stderr


def test_nmt_reports_a_node_that_does_not_obey_or_is_absent(typed: Run, can_bus: CanBus) -> None:
    can_bus.add_node("knee_drive", 5)
    assert typed("write", 5, "1017", "100").status == 0
    told = typed("nmt", 7, "start")
    assert (told.status, told.stdout) == (1, "7: start sent; no node shows its state.\n")
    can_bus.faults.drop(0x000, None)
    told = typed("nmt", 5, "start")
    assert (told.status, told.stdout) == (1, "5: start sent; PRE-OPERATIONAL.\n")
    told = typed("nmt", "all", "stop")
    assert (told.status, told.stdout) == (1, "all: stop sent; 5 PRE-OPERATIONAL.\n")
    can_bus.faults.clear()
    assert typed("nmt", 5, "start").status == 0


@pytest.mark.parametrize(("cob_id", "data", "sign"), [
    (0x080, b"", "it sends SYNC"), (0x205, b"\x06\0", "it sends RPDO 205h to node 5"),
    (0x764, b"\x05", "node 100 has a heartbeat and answers no SDO"), (0x000, b"\x01\x09", "NMT"),
    (0x609, bytes(8), "SDO requests to node 9")])
def test_a_master_at_work_is_noticed(typed: Run, can_bus: CanBus, cob_id: int, data: bytes, sign: str) -> None:
    def work() -> None:
        can_bus.send(cob_id, data)
        can_bus.after(0.1, work)

    can_bus.add_node("knee_drive", 5)
    work()
    for words in (("write", 5, "6065", "100"), ("nmt", "all", "stop")):
        told = typed(*words)
        assert (told.status, sign in told.stderr) == (2, True), told.stderr
    assert can_bus.nodes[5][0x6065] != 100


def test_nodes_with_heartbeats_are_no_master(typed: Run, can_bus: CanBus) -> None:
    for node_id in (5, 9):
        can_bus.add_node("knee_drive", node_id)
        assert typed("write", node_id, "1017", "100").status == 0
    assert typed("write", 5, "6065", "100").status == 0


def test_a_node_without_a_heartbeat_is_guarded(typed: Run, can_bus: CanBus, eds: Path) -> None:
    node = can_bus.add_node(eds, 5)
    assert typed("nmt", 5, "start").stdout == "5: start sent; OPERATIONAL.\n"
    told = typed("guard", 5, "--period", "100", "--for", "1")
    assert (told.status, told.stdout.splitlines()) == (0, ["   0.000  OPERATIONAL", "11 remote frames, 0 unanswered."])
    answers = [frame.data[0] for frame in can_bus.frames(0x705) if not frame.remote][1:]
    assert answers == [0x05 | 0x80 * (place % 2) for place in range(12)]
    can_bus.after(0.35, node.power_off)
    told = typed("guard", 5, "--period", "100", "--for", "1")
    assert told.status == 1
    assert "lost: 3 remote frames without an answer" in told.stdout
    assert typed("nmt", 5, "start").status == 1
