"""The operator's release after an emergency stop: what was stopped is released, and nothing is enabled by it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import can
import pytest

from eds.bench.bench_network import KNEE, SERVO, Network, WireLayout, wire
from eds.cia402 import State, state_of
from master.network.acknowledge import RELEASE, acknowledge
from master.network.bringup import BringUpError
from master.network.link import Link

if TYPE_CHECKING:
    from conftest import Composer

STOP = {"kind": "emergency_stop", "node": KNEE, "start_s": 0.1}
BOTH = [{**STOP, "stop_s": 0.2}, {**STOP, "node": SERVO, "stop_s": 5.0}]


def told(link: Link) -> dict[str, str]:
    return {one.drive: one.became for one in acknowledge(link, wire(Network()))}


@pytest.fixture
def link(composer: Composer) -> Link:
    made, _ = composer.link(faults=BOTH)
    made.wait(300_000_000)
    return made


def test_a_drive_whose_input_is_free_again_is_released_once(link: Link) -> None:
    assert told(link) == {"servo": "still active", "knee": "released"}
    assert told(link) == {"servo": "still active", "knee": "nothing to release"}
    link.wait(5_000_000_000)
    assert told(link)["servo"] == "released"


def test_nothing_is_enabled_by_it(link: Link) -> None:
    link.wait(5_000_000_000)
    told(link)
    states = {state_of(int.from_bytes(link.sdo_read(node, 0x6041), "little")) for node in (SERVO, KNEE)}
    assert states <= {State.SWITCH_ON_DISABLED, State.FAULT}


def test_a_bench_that_another_master_runs_is_let_be(composer: Composer) -> None:
    link, tap = composer.link(faults=BOTH)
    tap.send_periodic(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False), 0.1)
    with pytest.raises(BringUpError, match="another master"):
        told(link)


def test_a_device_without_the_object_is_said_to_have_none(link: Link) -> None:
    right = wire(Network())
    knee = right.nodes[KNEE]
    entries = {at: entry for at, entry in knee.dictionary.entries.items() if at >> 8 != RELEASE}
    bare = knee._replace(dictionary=replace(knee.dictionary, entries=entries))
    found = acknowledge(link, WireLayout(Network(), {**right.nodes, KNEE: bare}))
    assert found[1] == ("knee", "no such object")
