"""Heartbeat producer 0x1017 and consumer 0x1016, and what a loss does by 0x1029 (CiA 301, 7.2.8.2.2)."""

from __future__ import annotations

import struct

import pytest

from eds.cia301 import Abort, NmtCommand, NmtState
from tests.nodes.core_client import MS, Bus

MASTER = 127


def beats(bus: Bus, for_ns: int) -> list[tuple[int, int]]:
    return [(at, frame.data[0]) for at, frame in bus.run(for_ns) if frame.can_id == 0x705]


def watching(timeout_ms: int = 250, node: int = MASTER, behaviour: int = 0) -> Bus:
    bus = Bus()
    bus.write(0x1016, 1, node << 16 | timeout_ms, "I")
    bus.write(0x1029, 1, behaviour, "B")
    return bus


def state(bus: Bus) -> int:
    """The NMT state, by the next heartbeat, if the device has been told to send any."""
    return beats(bus, 100 * MS)[-1][1]


def emcys(frames) -> list[tuple[int, int, int]]:  # type: ignore[no-untyped-def]
    return [(at, *struct.unpack("<HB", f.data[:3])) for at, f in frames if f.can_id == 0x85]


def test_producer_starts_at_once_and_keeps_its_period() -> None:
    bus = Bus()
    assert beats(bus, 1000 * MS) == []
    bus.sent.clear()
    bus.write(0x1017, 0, 100, "H")
    assert [f.data for _at, f in bus.sent if f.can_id == 0x705] == [b"\x7f"]
    assert beats(bus, 350 * MS) == [(100 * MS, 127), (200 * MS, 127), (300 * MS, 127)]
    bus.start()
    assert beats(bus, 100 * MS) == [(50 * MS, 5)]
    bus.nmt(NmtCommand.STOP)
    assert beats(bus, 100 * MS) == [(50 * MS, 4)]


def test_producer_stops_with_zero() -> None:
    bus = Bus()
    bus.write(0x1017, 0, 100, "H")
    bus.write(0x1017, 0, 0, "H")
    assert beats(bus, 1000 * MS) == []


def test_a_late_poll_sends_one_heartbeat_and_keeps_the_raster() -> None:
    bus = Bus()
    bus.write(0x1017, 0, 100, "H")
    bus.run(0)
    bus.device.poll(350 * MS)
    assert len(bus.device.outbox) == 1
    assert bus.device.next_ns() == 400 * MS


def test_nobody_is_awaited_before_it_was_heard() -> None:
    bus = watching()
    bus.start()
    assert emcys(bus.run(2000 * MS)) == []


def test_a_lost_heartbeat_is_reported_once() -> None:
    bus = watching()
    bus.start()
    for _ in range(3):
        bus.send(0x77F, "05")
        assert emcys(bus.run(249 * MS)) == []
    bus.send(0x77F, "05")
    assert emcys(bus.run(2000 * MS)) == [(250 * MS, 0x8130, 0x11)]
    assert ("lost", 0x8130, bus.now_ns - 1750 * MS) in bus.process.told
    frames = bus.send(0x77F, "05")
    assert [f.data[:3] for f in frames] == [bytes(3)]
    assert emcys(bus.run(2000 * MS)) == [(250 * MS, 0x8130, 0x11)]


@pytest.mark.parametrize(("behaviour", "before", "after"), [
    (0, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL),
    (1, NmtState.OPERATIONAL, NmtState.OPERATIONAL),
    (2, NmtState.OPERATIONAL, NmtState.STOPPED),
    (0, NmtState.PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
    (1, NmtState.PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
    (2, NmtState.PRE_OPERATIONAL, NmtState.STOPPED),
    (0, NmtState.STOPPED, NmtState.STOPPED),
])
def test_error_behaviour(behaviour: int, before: NmtState, after: NmtState) -> None:
    bus = watching(behaviour=behaviour)
    bus.write(0x1017, 0, 100, "H")
    if before is not NmtState.PRE_OPERATIONAL:
        bus.nmt(NmtCommand.START if before is NmtState.OPERATIONAL else NmtCommand.STOP)
    bus.send(0x77F, "05")
    bus.run(300 * MS)
    assert state(bus) == after


@pytest.mark.parametrize("frame", ["", "0505"])
def test_a_malformed_heartbeat_does_not_count(frame: str) -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.run(200 * MS)
    bus.send(0x77F, frame)
    assert emcys(bus.run(100 * MS)) == [(50 * MS, 0x8130, 0x11)]


def test_a_boot_up_counts_as_heartbeat() -> None:
    bus = watching()
    bus.send(0x77F, "00")
    assert emcys(bus.run(300 * MS)) == [(250 * MS, 0x8130, 0x11)]


def test_several_nodes_are_watched_apart() -> None:
    bus = watching(100, 1)
    bus.write(0x1016, 2, 2 << 16 | 200, "I")
    bus.send(0x701, "05")
    bus.send(0x702, "05")
    assert emcys(bus.run(300 * MS)) == [(100 * MS, 0x8130, 0x11), (200 * MS, 0x8130, 0x11)]
    assert [f.data[:3] for f in bus.send(0x701, "05")] == [b"\0\0\x11"]
    assert [f.data[:3] for f in bus.send(0x702, "05")] == [b"\0\0\0"]


def test_a_node_is_watched_by_one_entry() -> None:
    bus = watching()
    assert bus.refused(0x1016, 2, MASTER << 16 | 100, "I") == Abort.INCOMPATIBLE
    bus.write(0x1016, 2, MASTER << 16, "I")
    bus.write(0x1016, 1, MASTER << 16 | 100, "I")


@pytest.mark.parametrize("word", [0, 250, 0x80 << 16 | 250, 0xFF << 16 | 250, MASTER << 16])
def test_entries_that_watch_nobody(word: int) -> None:
    bus = Bus()
    bus.write(0x1016, 1, word, "I")
    for can_id in (0x700, 0x77F, 0x780, 0x7FF):
        bus.send(can_id, "05")
    assert emcys(bus.run(1000 * MS)) == []


def test_a_changed_entry_begins_anew_and_forgets_the_loss() -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.run(300 * MS)
    assert bus.read(0x1001, 0, "B") == 0x11
    bus.write(0x1016, 1, MASTER << 16 | 500, "I")
    assert bus.read(0x1001, 0, "B") == 0
    assert emcys(bus.run(1000 * MS)) == []


def test_another_entry_does_not_disturb_a_running_one() -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.run(200 * MS)
    bus.write(0x1016, 2, 1 << 16 | 500, "I")
    assert emcys(bus.run(100 * MS)) == [(50 * MS, 0x8130, 0x11)]


def test_watching_goes_on_while_stopped_and_is_told_afterwards() -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.nmt(NmtCommand.STOP)
    assert emcys(bus.run(300 * MS)) == []
    assert [f.data[:2] for f in bus.start() if f.can_id == 0x85] == [b"\x30\x81"]


def test_a_heartbeat_heard_while_stopped_counts() -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.nmt(NmtCommand.STOP)
    bus.run(200 * MS)
    bus.send(0x77F, "05")
    bus.run(200 * MS)
    assert [f.can_id for f in bus.start()] == []
    assert bus.read(0x1001, 0, "B") == 0


def test_reset_communication_forgets_the_loss() -> None:
    bus = watching()
    bus.send(0x77F, "05")
    bus.run(300 * MS)
    bus.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bus.read(0x1001, 0, "B") == 0
    assert emcys(bus.run(1000 * MS)) == []
