"""SYNC objects 0x1005, 0x1006, 0x1007, 0x1019: consumer, producer, rules of writing (CiA 301, 7.2.5, 7.5.2.5–7, 22)."""

from __future__ import annotations

import pytest

from eds.cia301 import Abort, NmtCommand
from tests.nodes.core_client import MS, Bus

MAKING = 0x40000000


def syncs(bus: Bus, for_ns: int) -> list[tuple[int, bytes]]:
    return [(at, frame.data) for at, frame in bus.run(for_ns) if frame.can_id == 0x80]


def test_another_cob_id() -> None:
    bus = Bus()
    bus.write(0x1005, 0, 0x90, "I")
    bus.start()
    assert bus.sync() == []
    assert [f.can_id for f in bus.send(0x90)] == [0x185, 0x285]


def test_producer_keeps_its_period_and_obeys_itself() -> None:
    bus = Bus()
    bus.write(0x1006, 0, 5000, "I")
    assert syncs(bus, 20 * MS) == []
    bus.write(0x1005, 0, MAKING | 0x80, "I")
    assert syncs(bus, 21 * MS) == [(n * 5 * MS, b"") for n in (1, 2, 3, 4)]
    bus.start()
    bus.sent.clear()
    bus.run(5 * MS)
    assert [f.can_id for _at, f in bus.sent] == [0x80, 0x185, 0x285]


def test_periods_too_short_to_make() -> None:
    bus = Bus()
    assert bus.refused(0x1006, 0, 99, "I") == Abort.TOO_LOW
    bus.write(0x1006, 0, 100, "I")


def test_producer_counts_from_one_to_the_overflow() -> None:
    bus = Bus()
    bus.write(0x1019, 0, 3, "B")
    bus.write(0x1006, 0, 1000, "I")
    bus.write(0x1005, 0, MAKING | 0x80, "I")
    assert [data[0] for _at, data in syncs(bus, 5 * MS)] == [1, 2, 3, 1, 2]
    bus.nmt(NmtCommand.STOP)
    assert syncs(bus, 5 * MS) == []
    bus.start()
    assert [data[0] for _at, data in syncs(bus, 2 * MS)] == [1, 2]


def test_producer_stops_when_told() -> None:
    bus = Bus()
    bus.write(0x1006, 0, 1000, "I")
    bus.write(0x1005, 0, MAKING | 0x80, "I")
    bus.write(0x1006, 0, 0, "I")
    assert syncs(bus, 5 * MS) == []
    bus.write(0x1006, 0, 1000, "I")
    assert len(syncs(bus, 5 * MS)) == 5
    bus.write(0x1005, 0, 0x80, "I")
    assert syncs(bus, 5 * MS) == []


def test_a_producer_hears_no_other_sync() -> None:
    bus = Bus()
    bus.write(0x1005, 0, MAKING | 0x80, "I")
    bus.start()
    assert bus.sync() == []


@pytest.mark.parametrize("word", [0x20000080, 0x00000880, 0x000, 0x07F, 0x101, 0x601, 0x7FF])
def test_cob_ids_that_no_sync_may_have(word: int) -> None:
    assert Bus().refused(0x1005, 0, word, "I") == Abort.INVALID_VALUE


@pytest.mark.parametrize("word", [0x185, 0x205, 0x85])
def test_cob_ids_that_this_device_uses_already(word: int) -> None:
    assert Bus().refused(0x1005, 0, word, "I") == Abort.INCOMPATIBLE


def test_the_cob_id_of_a_sync_that_is_made_here() -> None:
    bus = Bus()
    bus.write(0x1005, 0, MAKING | 0x80, "I")
    assert bus.refused(0x1005, 0, MAKING | 0x90, "I") == Abort.INVALID_VALUE
    bus.write(0x1005, 0, 0x80, "I")
    bus.write(0x1005, 0, MAKING | 0x90, "I")


@pytest.mark.parametrize("value", [1, 241, 255])
def test_counter_overflows_that_are_reserved(value: int) -> None:
    assert Bus().refused(0x1019, 0, value, "B") == Abort.INVALID_VALUE


@pytest.mark.parametrize("value", [0, 2, 240])
def test_counter_overflows_that_are_not(value: int) -> None:
    bus = Bus()
    bus.write(0x1019, 0, value, "B")
    assert bus.read(0x1019, 0, "B") == value


def test_the_counter_does_not_change_while_a_period_is_set() -> None:
    bus = Bus()
    bus.write(0x1006, 0, 1000, "I")
    assert bus.refused(0x1019, 0, 10, "B") == Abort.DEVICE_STATE
    bus.write(0x1006, 0, 0, "I")
    bus.write(0x1019, 0, 10, "B")


def test_no_sync_is_obeyed_outside_operational() -> None:
    bus = Bus()
    assert bus.sync() == []
    bus.nmt(NmtCommand.STOP)
    assert bus.sync() == []
    bus.start()
    assert bus.sync() != []
