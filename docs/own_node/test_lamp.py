"""Tests of a master against the node that an EDS describes; copy this folder and replace EDS, numbers and names."""

import canopen
import pytest

NODE, BRIGHTNESS = 5, 0x2000


@pytest.fixture
def lamp(canopen_node):
    """Node 5, which boots at 0 ns of bus time."""
    return canopen_node("eds/lamp.eds", node_id=NODE)


@pytest.fixture
def master(can_bus, lamp):
    """python canopen's client of the node, in bus time: waits pass at once and end at the same nanosecond each run."""
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open())
        node = network.add_node(NODE, canopen.ObjectDictionary())
        node.nmt.wait_for_bootup(timeout=1)
        yield node
        network.disconnect()


def test_the_eds_has_no_fault(lamp):
    assert lamp.eds_faults == []


def test_a_value_is_written_and_read(lamp, master):
    master.sdo.download(BRIGHTNESS, 0, b"\x32")
    assert lamp["Brightness"] == 50
    assert master.sdo.upload(BRIGHTNESS, 0) == b"\x32"


def test_a_value_beyond_its_limit_is_refused(lamp, master):
    with pytest.raises(canopen.SdoAbortedError, match="0x06090031"):
        master.sdo.download(BRIGHTNESS, 0, b"\x65")
    assert lamp["Brightness"] == 0


def test_a_pdo_sets_the_value_and_another_shows_it(can_bus, lamp, master):
    master.nmt.state = "OPERATIONAL"
    master.network.send_message(0x200 + NODE, b"\x07")
    can_bus.run(0.01)
    assert lamp["Brightness"] == 7
    assert can_bus.frames(cob_id=0x180 + NODE)[-1].data == b"\x07"


def test_a_lost_answer_is_asked_for_again(can_bus, lamp, master):
    lost = can_bus.faults.drop(cob_id=0x580 + NODE)
    with pytest.raises(canopen.SdoCommunicationError):
        master.sdo.upload(BRIGHTNESS, 0)
    assert lost.struck == 1
    assert master.sdo.upload(BRIGHTNESS, 0) == b"\x00"
