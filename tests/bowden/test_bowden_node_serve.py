"""`bowden node serve`: a node on a python-can bus of other programs, its values, profile, faults, and bad input."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from bowden.testing import CanBus

Run = Callable[..., Any]
READ_1000 = bytes.fromhex("4000100000000000")


@pytest.fixture
def served(bowden: Run, can_bus: CanBus) -> Run:
    """Serve a node on the bus of the test, in its time, whose frames a script of `can_bus.after` sends."""
    can_bus.open()

    def run(*words: object) -> Any:
        with can_bus.virtual_time():
            return bowden("node", "serve", *words, "--interface", "bowden", "--channel", can_bus.channel)

    return run


def test_a_node_boots_answers_and_moves_on_another_bus(served: Run, can_bus: CanBus) -> None:
    for at_s, cob_id, data in ((0.1, 0x605, READ_1000), (0.2, 0x605, bytes.fromhex("4064600000000000")),
                               (0.3, 0x000, b"\x01\x05"), (0.4, 0x205, b"\x06\x00")):
        can_bus.after(at_s, lambda cob_id=cob_id, data=data: can_bus.send(cob_id, data))
    told = served("knee_drive", "--node-id", 5, "--profile", 402, "--set", "6064=1234", "--set", "607C=7",
                  "--serial", 9, "--for", 1, "--json")
    assert told.status == 0, told.stderr
    assert json.loads(told.stdout)["state"] == "OPERATIONAL"
    assert can_bus.frames(0x705)[0].data == b"\0"
    answers = [frame.data.hex() for frame in can_bus.frames(0x585)]
    assert answers[0] == "4300100092010200"
    assert can_bus.frames(0x185)[-1].data[:2] == b"\x31\x02", "the drive obeyed: ready to switch on"


def test_frames_of_both_ways_are_dropped_delayed_and_changed(served: Run, can_bus: CanBus) -> None:
    for place in range(5):
        can_bus.after(0.1 * (place + 1), lambda: can_bus.send(0x605, READ_1000))
    told = served("knee_drive", "--node-id", 5, "--fault", "drop=585,count=1", "--fault", "drop=605,count=1,after=1",
                  "--fault", "delay=585,ms=20,count=1,after=1", "--fault", "corrupt=585,bit=32,count=1,after=1",
                  "--for", 1, "--json")
    assert told.status == 0, told.stderr
    assert json.loads(told.stdout)["faults"] == [1, 1, 1, 1]
    answers = [(round(frame.time_ns / 1e6), frame.data[4]) for frame in can_bus.frames(0x585)]
    assert answers == [(320, 0x92), (400, 0x93), (500, 0x92)]


@pytest.mark.parametrize("words", [
    ("knee_drive", "--node-id", 5, "--profile", 403), ("knee_drive", "--node-id", 5, "--set", "6064"),
    ("knee_drive", "--node-id", 5, "--set", "5999=1"), ("knee_drive", "--node-id", 5, "--fault", "melt=585"),
    ("knee_drive", "--node-id", 5, "--fault", "delay=585"), ("absent.eds", "--node-id", 5),
    ("knee_drive", "--node-id", 200)])
def test_bad_input_is_one_sentence(served: Run, words: tuple[object, ...]) -> None:
    told = served(*words, "--for", 0.01)
    assert (told.status, told.stdout, told.stderr.count("\n")) == (2, "", 1), told


def test_without_a_bus_nothing_is_served(bowden: Run) -> None:
    told = bowden("node", "serve", "knee_drive", "--node-id", 5)
    assert (told.status, "add --interface" in told.stderr) == (2, True)
