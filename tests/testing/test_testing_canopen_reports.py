"""Reports about python canopen as deterministic tests against the pinned version; what fails there is expected to."""

from __future__ import annotations

import time
from collections.abc import Callable

import canopen
import pytest

from bowden.testing import CanBus, CanopenNode
from bowden.testing.conversation import SdoAnswer, SdoStep, converse

AddNode = Callable[..., CanopenNode]
DATA = bytes(n % 251 for n in range(3000))


@pytest.mark.parametrize("after", [1, 2, 6, 20, 28])
def test_546_a_lost_segment_of_a_block_upload_is_sent_again(
    can_bus: CanBus, canopen_node: AddNode, after: int,
) -> None:
    canopen_node("own.eds", 5)["Firmware"] = DATA[:200]
    lost = can_bus.faults.drop(cob_id=0x585, after=after)
    assert converse(can_bus, 5, [SdoStep(0x2002, 0, None, True)]) == [SdoAnswer(DATA[:200])]
    assert lost.struck == 1


def written_in_chunks(bus: CanBus, size: int) -> None:
    """Write 3000 bytes by block download without CRC, `size` bytes at a time."""
    with bus.virtual_time():
        network = canopen.Network(bus.open())
        sdo = network.add_node(5, canopen.ObjectDictionary()).sdo
        with sdo.open(0x2002, 0, "wb", size=len(DATA), block_transfer=True, request_crc_support=False) as stream:
            for at in range(0, len(DATA), size):
                stream.write(DATA[at:at + size])
        network.disconnect()


@pytest.mark.xfail(strict=True, raises=canopen.SdoCommunicationError,
                   reason="canopen #618: a block download in chunks of 1024 bytes ends early")
def test_618_a_block_download_in_chunks_of_1024_bytes(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    written_in_chunks(can_bus, 1024)
    assert node["Firmware"] == DATA


def test_618_a_block_download_in_one_piece(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    written_in_chunks(can_bus, 7 * 1024)
    assert node["Firmware"] == DATA


@pytest.mark.xfail(strict=True, reason="the last sub-block is not sent again: the client ends the transfer instead")
def test_a_lost_segment_of_the_last_sub_block_of_a_download_is_sent_again(
    can_bus: CanBus, canopen_node: AddNode,
) -> None:
    node = canopen_node("own.eds", 5)
    can_bus.faults.drop(cob_id=0x605, after=1)
    converse(can_bus, 5, [SdoStep(0x2002, 0, DATA[:100], True)])
    assert node["Firmware"] == DATA[:100]


@pytest.mark.xfail(strict=True, reason="canopen #543: the library has no heartbeat consumer; the last state stays")
def test_543_a_node_whose_heartbeat_stopped_is_noticed(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open())
        remote = network.add_node(5, canopen.ObjectDictionary())
        remote.nmt.state = "OPERATIONAL"
        time.sleep(0.1)
        assert remote.nmt.state == "OPERATIONAL"
        node.power_off()
        time.sleep(10.0)
        state = remote.nmt.state
        network.disconnect()
    assert state != "OPERATIONAL"


def received(bus: CanBus, add: AddNode, rx_queue: int) -> int:
    """Return how many of 65 nodes' heartbeats reach a callback of a program that computes for 9 ms meanwhile."""
    heard: set[int] = set()
    for node_id in range(1, 66):
        add("own.eds", node_id)
    with bus.virtual_time():
        network = canopen.Network(bus.open(rx_queue=rx_queue))
        for node_id in range(1, 66):
            network.subscribe(0x700 + node_id, lambda can_id, _data, _time: heard.add(can_id))
        bus.run(0.009)
        time.sleep(0.0005)
        network.check()
        network.disconnect()
    return len(heard)


@pytest.mark.xfail(strict=True, reason="canopen #523: frames that a full receive queue loses are lost without an error")
def test_523_a_busy_program_with_65_nodes_and_a_short_queue_is_told_of_lost_frames(
    can_bus: CanBus, canopen_node: AddNode,
) -> None:
    assert received(can_bus, canopen_node, rx_queue=32) == 65


def test_523_a_busy_program_with_65_nodes_and_a_long_queue_gets_every_frame(
    can_bus: CanBus, canopen_node: AddNode,
) -> None:
    assert received(can_bus, canopen_node, rx_queue=1000) == 65
