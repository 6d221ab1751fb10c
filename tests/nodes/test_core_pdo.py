"""PDOs: transmission types, timers, lengths, deadlines, dummies, SYNC order (CiA 301, 7.2.2 and 7.5.2.35–38)."""

from __future__ import annotations

import struct

import pytest

from eds.cia301 import Abort, Emcy, NmtCommand
from tests.nodes.core_client import MS, NODE, Bus

TPDO1, TPDO2, TPDO3 = 0x185, 0x285, 0x385
RPDO1, RPDO2 = 0x205, 0x305
IN_8, IN_32, IN_16, OUT_8, OUT_32, OUT_16 = (
    0x60000008, 0x60010020, 0x60020010, 0x62000008, 0x62010020, 0x62020010)


def ids(frames) -> list[int]:  # type: ignore[no-untyped-def]
    return [frame.can_id for frame in frames]


def emcys(bus: Bus) -> list[tuple[int, int]]:
    """(error code, error register) of the EMCYs since the last look."""
    found = [struct.unpack("<HB", frame.data[:3]) for _at, frame in bus.sent if frame.can_id == 0x80 + NODE]
    bus.sent.clear()
    return found


def operational(*setup: tuple[int, list[int], int, int]) -> Bus:
    bus = Bus()
    for row in setup:
        bus.remap(*row)
    bus.start()
    bus.sent.clear()
    return bus


# ---- SYNC-driven ----

def test_at_a_sync_inputs_are_latched_and_sent_before_outputs_are_taken_over() -> None:
    bus = operational()
    bus.process.inputs = {0x600000: 3}
    bus.send(RPDO2, "ffffffff 0700")
    assert bus.read(0x6202, 0, "h") == 0
    frames = bus.sync()
    assert [f.data for f in frames if f.can_id == TPDO1] == [struct.pack("<Bi", 3, 1)]
    assert bus.read(0x6202, 0, "h") == 7


def test_an_output_taken_over_at_a_sync_is_first_seen_in_the_next() -> None:
    bus = operational((0x1402, [OUT_8], 0x405, 1), (0x1800, [OUT_8], TPDO1, 1))
    bus.send(0x405, "05")
    assert [f.data for f in bus.sync() if f.can_id == TPDO1] == [b"\x00"]
    assert bus.process.told[-1] == ("written", 0x620000, 5, 0)
    assert [f.data for f in bus.sync() if f.can_id == TPDO1] == [b"\x05"]


@pytest.mark.parametrize("every", [1, 2, 3, 240])
def test_type_n_is_sent_with_every_nth_sync(every: int) -> None:
    bus = operational((0x1800, [IN_8], TPDO1, every))
    sent = [TPDO1 in ids(bus.sync()) for _ in range(2 * every)]
    assert sent == ([False] * (every - 1) + [True]) * 2


def test_type_0_is_sent_at_the_sync_after_a_change() -> None:
    bus = operational()
    assert TPDO2 in ids(bus.sync())
    assert TPDO2 not in ids(bus.sync())
    bus.process.inputs = {0x600200: 9}
    assert [f.data for f in bus.sync() if f.can_id == TPDO2] == [b"\x09\x00"]
    assert TPDO2 not in ids(bus.sync())


@pytest.mark.parametrize("kind", [0, 1, 240])
def test_synchronous_rpdos_are_taken_over_at_the_next_sync(kind: int) -> None:
    bus = operational((0x1402, [OUT_8], 0x405, kind))
    bus.send(0x405, "09")
    bus.send(0x405, "0a")
    assert bus.read(0x6200, 0, "B") == 0
    bus.sync()
    assert bus.read(0x6200, 0, "B") == 10


@pytest.mark.parametrize("kind", [254, 255])
def test_event_driven_rpdos_are_taken_over_at_once(kind: int) -> None:
    bus = operational((0x1402, [OUT_8], 0x405, kind))
    bus.send(0x405, "09")
    assert bus.read(0x6200, 0, "B") == 9
    assert bus.process.told[-1] == ("written", 0x620000, 9, 0)


# ---- event-driven ----

@pytest.mark.parametrize("kind", [254, 255])
def test_event_driven_tpdos_are_sent_on_start_and_on_change(kind: int) -> None:
    bus = Bus()
    bus.remap(0x1802, [OUT_8], TPDO3, kind)
    assert ids(bus.start()) == [TPDO3]
    assert bus.run(1000 * MS) == []
    assert ids(bus.send(RPDO1, "0700000000")) == [TPDO3]
    assert bus.send(RPDO1, "0700000000") == []
    bus.sent.clear()
    bus.write(0x6200, 0, 8, "B")
    assert [f.data for _at, f in bus.sent if f.can_id == TPDO3] == [b"\x08"]


def test_inhibit_time_in_100_us() -> None:
    bus = Bus()
    bus.write(0x1802, 3, 50, "H")
    bus.remap(0x1802, [OUT_8], TPDO3, 255)
    bus.start()
    assert bus.send(RPDO1, "0100000000") == []
    bus.run(2 * MS)
    assert bus.send(RPDO1, "0200000000") == []
    assert [(at, f.data) for at, f in bus.run(20 * MS)] == [(3 * MS, b"\x02")]
    assert ids(bus.send(RPDO1, "0300000000")) == [TPDO3]


def test_event_timer_in_ms() -> None:
    bus = Bus()
    bus.write(0x1802, 5, 10, "H")
    bus.remap(0x1802, [IN_8], TPDO3, 254)
    bus.start()
    bus.process.inputs = {0x600000: 4}
    assert [(at, f.can_id, f.data) for at, f in bus.run(25 * MS)] == [
        (10 * MS, TPDO3, b"\x04"), (20 * MS, TPDO3, b"\x04")]


def test_an_event_starts_the_timer_anew() -> None:
    bus = Bus()
    bus.write(0x1802, 5, 10, "H")
    bus.remap(0x1802, [OUT_8], TPDO3, 254)
    bus.start()
    bus.run(6 * MS)
    assert ids(bus.send(RPDO1, "0100000000")) == [TPDO3]
    assert [at for at, _f in bus.run(15 * MS)] == [10 * MS]


def test_inhibit_time_outlasts_the_event_timer() -> None:
    bus = Bus()
    bus.write(0x1802, 3, 100, "H")
    bus.write(0x1802, 5, 3, "H")
    bus.remap(0x1802, [OUT_8], TPDO3, 254)
    bus.start()
    assert [at for at, _f in bus.run(25 * MS)] == [10 * MS, 20 * MS]


def test_event_timers_rest_outside_operational() -> None:
    bus = Bus()
    bus.write(0x1802, 5, 10, "H")
    bus.remap(0x1802, [OUT_8], TPDO3, 254)
    bus.start()
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bus.run(100 * MS) == []


def test_remote_request() -> None:
    bus = operational()
    assert [f.data for f in bus.send(TPDO1, remote=True)] == [bytes(5)]
    assert bus.send(TPDO2, remote=True) == []
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bus.send(TPDO1, remote=True) == []


# ---- SYNC counter, window ----

def test_sync_start_value_names_the_first_sync() -> None:
    bus = Bus()
    bus.write(0x1019, 0, 4, "B")
    bus.write(0x1800, 1, 0x80000000 | TPDO1, "I")
    bus.write(0x1800, 6, 3, "B")
    bus.write(0x1800, 2, 2, "B")
    bus.write(0x1800, 1, TPDO1, "I")
    bus.start()
    sent = [TPDO1 in ids(bus.sync(counter)) for counter in (1, 2, 3, 4, 1, 2, 3)]
    assert sent == [False, False, True, False, True, False, True]


@pytest.mark.parametrize(("overflow", "data", "wrong"), [(0, "", "01"), (10, "01", ""), (10, "02", "0102")])
def test_a_sync_of_unexpected_length_is_reported_once_and_not_obeyed(overflow: int, data: str, wrong: str) -> None:
    bus = Bus()
    bus.write(0x1019, 0, overflow, "B")
    bus.start()
    bus.sent.clear()
    assert TPDO1 not in ids(bus.send(0x80, wrong) + bus.send(0x80, wrong))
    assert emcys(bus) == [(Emcy.SYNC_LENGTH, 0x11)]
    assert TPDO1 in ids(bus.send(0x80, data))
    assert emcys(bus) == [(0, 0)]


def test_synchronous_rpdos_after_the_window_are_dropped() -> None:
    bus = Bus()
    bus.write(0x1007, 0, 500, "I")
    bus.start()
    bus.sync()
    bus.run(MS // 2)
    bus.send(RPDO2, "000000000500")
    bus.sync()
    assert bus.read(0x6202, 0, "h") == 5
    bus.run(MS // 2 + 1)
    bus.send(RPDO2, "000000000600")
    bus.sync()
    assert bus.read(0x6202, 0, "h") == 5


# ---- lengths, deadlines, dummies, limits ----

def test_too_short_is_reported_and_ignored() -> None:
    bus = operational()
    bus.send(RPDO1, "07000000")
    bus.send(RPDO1, "")
    assert emcys(bus) == [(Emcy.PDO_TOO_SHORT, 0x11)]
    assert bus.read(0x6200, 0, "B") == 0
    bus.sent.clear()
    bus.send(RPDO1, "0100000000")
    assert emcys(bus) == [(0, 0)]


def test_too_long_is_reported_and_its_mapped_part_used() -> None:
    bus = operational()
    bus.send(RPDO1, "0702000000ffffff")
    bus.send(RPDO1, "0803000000ff")
    assert emcys(bus) == [(Emcy.PDO_TOO_LONG, 0x11)]
    assert bus.read(0x6200, 0, "B") == 8
    assert bus.read(0x6201, 0, "i") == 3
    bus.sent.clear()
    bus.send(RPDO1, "07000000")
    assert emcys(bus) == [(0, 0), (Emcy.PDO_TOO_SHORT, 0x11)]


def test_two_rpdos_fail_and_mend_apart() -> None:
    bus = operational()
    bus.send(RPDO1, "")
    bus.send(RPDO2, "")
    assert emcys(bus) == [(Emcy.PDO_TOO_SHORT, 0x11)] * 2
    bus.send(RPDO1, "0100000000")
    assert emcys(bus) == [(0, 0x11)]
    bus.send(RPDO2, "010000000000")
    assert emcys(bus) == [(0, 0)]


@pytest.mark.parametrize(("index", "rpdo", "data"), [(0x1400, RPDO1, "0100000000"), (0x1401, RPDO2, "000000000100")])
def test_deadline(index: int, rpdo: int, data: str) -> None:
    bus = Bus()
    bus.write(index, 5, 20, "H")
    bus.start()
    assert bus.run(100 * MS) == []
    for _ in range(3):
        bus.send(rpdo, data)
        assert bus.run(19 * MS) == []
    bus.send(rpdo, data)
    lost = bus.run(100 * MS)
    assert [(at, f.can_id, f.data[:3]) for at, f in lost] == [(20 * MS, 0x85, struct.pack("<HB", 0x8250, 0x11))]
    assert [t for t in bus.process.told if t[0] == "lost"] == [("lost", 0x8250, bus.now_ns - 80 * MS)]
    assert [f.data[:3] for f in bus.send(rpdo, data) if f.can_id == 0x85] == [bytes(3)]
    assert bus.run(20 * MS)


def test_the_deadline_does_not_change_the_nmt_state() -> None:
    bus = Bus()
    bus.write(0x1400, 5, 5, "H")
    bus.start()
    bus.send(RPDO1, bytes(5))
    bus.run(50 * MS)
    assert TPDO1 in ids(bus.sync())


def test_a_frame_too_short_does_not_hold_the_deadline() -> None:
    bus = Bus()
    bus.write(0x1400, 5, 20, "H")
    bus.start()
    bus.send(RPDO1, bytes(5))
    bus.run(15 * MS)
    bus.send(RPDO1, bytes(4))
    bus.sent.clear()
    bus.run(10 * MS)
    assert emcys(bus) == [(Emcy.RPDO_TIMEOUT, 0x11)]
    bus.send(RPDO1, bytes(6))
    assert (Emcy.PDO_TOO_LONG, 0x11) in emcys(bus)
    assert bus.run(19 * MS) == []


def test_the_deadline_rests_outside_operational_and_ends_with_its_parameter() -> None:
    bus = Bus()
    bus.write(0x1400, 5, 20, "H")
    bus.start()
    bus.send(RPDO1, bytes(5))
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert bus.run(100 * MS) == []
    bus.start()
    bus.send(RPDO1, bytes(5))
    bus.write(0x1400, 5, 0, "H")
    assert bus.run(100 * MS) == []


def test_dummies_are_passed_over() -> None:
    bus = operational((0x1402, [0x00050008, 0x00030010, OUT_8, 0x00070020], 0x405, 255))
    bus.send(0x405, "ffffff07ffffffff")
    assert bus.read(0x6200, 0, "B") == 7


def test_a_value_outside_its_limits_leaves_the_object_alone() -> None:
    bus = operational((0x1402, [OUT_8, OUT_16], 0x405, 255))
    bus.send(0x405, "01e803")
    bus.send(0x405, "02e903")
    assert bus.read(0x6202, 0, "h") == 1000
    assert bus.read(0x6200, 0, "B") == 2
    assert [t[:3] for t in bus.process.told if t[0] == "written"] == [
        ("written", 0x620000, 1), ("written", 0x620200, 1000), ("written", 0x620000, 2)]


def test_a_value_the_application_refuses_leaves_the_object_alone() -> None:
    bus = operational((0x1402, [0x62050010], 0x405, 255))
    bus.send(0x405, "0400")
    bus.send(0x405, "0500")
    assert bus.read(0x6205, 0, "H") == 4


def test_widths_that_struct_has_not() -> None:
    bus = operational((0x1402, [0x20050018, 0x20090001, 0x20090001, OUT_8], 0x405, 255),
                      (0x1803, [0x20080010], 0x485, 1))
    bus.send(0x405, "030201 1d00")
    assert bus.read(0x2005) == b"\x03\x02\x01"
    assert bus.read(0x2009, 0, "B") == 0
    assert bus.read(0x6200, 0, "B") == 7
    assert [f.data for f in bus.sync() if f.can_id == 0x485] == [b"\xEF\xBE"]


# ---- parameters, in the standard's order only ----

def test_remapping_in_order() -> None:
    bus = operational((0x1800, [IN_16, IN_8, IN_32], 0x1F5, 1))
    frames = bus.sync()
    assert TPDO1 not in ids(frames)
    assert [f.data for f in frames if f.can_id == 0x1F5] == [struct.pack("<hBi", 0, 0, 1)]


def test_remapping_while_operational() -> None:
    bus = operational()
    bus.remap(0x1800, [IN_16], TPDO1, 1)
    assert [f.data for f in bus.sync() if f.can_id == TPDO1] == [bytes(2)]
    bus.write(0x1800, 1, 0x80000000 | TPDO1, "I")
    assert TPDO1 not in ids(bus.sync())
    bus.write(0x1400, 1, 0x80000000 | RPDO1, "I")
    bus.send(RPDO1, "0700000000")
    assert bus.read(0x6200, 0, "B") == 0


def disabled(index: int) -> Bus:
    bus = Bus()
    bus.write(index, 1, bus.read(index, 1, "I") | 1 << 31, "I")
    return bus


def emptied(index: int) -> Bus:
    bus = disabled(index)
    bus.write(index + 0x200, 0, 0, "B")
    return bus


WORDS = [
    ("object does not exist", 0x1800, 0x30000008, Abort.NO_OBJECT),
    ("sub-index does not exist", 0x1800, 0x60000108, Abort.NO_SUBINDEX),
    ("PDOMapping is 0", 0x1800, 0x60030010, Abort.NOT_MAPPABLE),
    ("read-only into an RPDO", 0x1400, IN_8, Abort.NOT_MAPPABLE),
    ("write-only into a TPDO", 0x1800, 0x62040010, Abort.NOT_MAPPABLE),
    ("rww into a TPDO", 0x1800, OUT_32, Abort.NOT_MAPPABLE),
    ("length too short", 0x1800, 0x60010010, Abort.NOT_MAPPABLE),
    ("length too long", 0x1800, 0x60010028, Abort.NOT_MAPPABLE),
    ("length 0", 0x1800, 0x60010000, Abort.NOT_MAPPABLE),
    ("dummy into a TPDO", 0x1800, 0x00050008, Abort.NOT_MAPPABLE),
    ("dummy of no such type", 0x1400, 0x00090008, Abort.NOT_MAPPABLE),
    ("dummy the EDS does not allow", 0x1400, 0x00010001, Abort.NOT_MAPPABLE),
    ("dummy of a wrong length", 0x1400, 0x00050010, Abort.NOT_MAPPABLE),
    ("dummy with a sub-index", 0x1400, 0x00050108, Abort.NOT_MAPPABLE),
    ("a string", 0x1800, 0x20020008, Abort.NOT_MAPPABLE),
]


@pytest.mark.parametrize(("index", "word", "code"), [row[1:] for row in WORDS], ids=[row[0] for row in WORDS])
def test_words_that_cannot_be_mapped(index: int, word: int, code: Abort) -> None:
    assert emptied(index).refused(index + 0x200, 1, word, "I") == code


@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_mapping_of_a_pdo_that_exists(index: int) -> None:
    bus = Bus()
    word = bus.read(index + 0x200, 1, "I")
    assert bus.refused(index + 0x200, 0, 0, "B") == Abort.INVALID_VALUE
    assert bus.refused(index + 0x200, 1, 0x00050008, "I") == Abort.INVALID_VALUE
    bus.write(index + 0x200, 1, word, "I")


@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_entries_while_the_number_is_not_zero(index: int) -> None:
    assert disabled(index).refused(index + 0x200, 1, 0, "I") == Abort.INVALID_VALUE


def test_more_than_64_bits() -> None:
    bus = emptied(0x1800)
    for sub, word in enumerate((IN_32, IN_32, IN_8), 1):
        bus.write(0x1A00, sub, word, "I")
    assert bus.refused(0x1A00, 0, 3, "B") == Abort.PDO_LENGTH
    bus.write(0x1A00, 0, 2, "B")


def test_more_entries_than_there_are() -> None:
    assert emptied(0x1800).refused(0x1A00, 0, 9, "B") == Abort.PDO_LENGTH


def test_a_number_that_counts_empty_entries() -> None:
    bus = emptied(0x1800)
    bus.write(0x1A00, 3, 0, "I")
    assert bus.refused(0x1A00, 0, 3, "B") == Abort.NOT_MAPPABLE


def test_a_pdo_without_a_mapping_cannot_be_enabled() -> None:
    assert emptied(0x1800).refused(0x1800, 1, TPDO1, "I") == Abort.INVALID_VALUE


@pytest.mark.parametrize("index", [0x1400, 0x1800])
@pytest.mark.parametrize("cob_id", [0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF,
                                    0x701, 0x77F, 0x780, 0x7FF, 0x800, 0x20000205])
def test_cob_ids_that_no_pdo_may_have(index: int, cob_id: int) -> None:
    assert disabled(index).refused(index, 1, cob_id, "I") == Abort.INVALID_VALUE


@pytest.mark.parametrize("cob_id", [0x080, 0x085, RPDO1, TPDO2])
def test_cob_ids_that_this_device_uses_already(cob_id: int) -> None:
    assert disabled(0x1800).refused(0x1800, 1, cob_id, "I") == Abort.INCOMPATIBLE


@pytest.mark.parametrize("cob_id", [0x081, 0x100, 0x181, 0x580, 0x600, 0x680, 0x6DF, 0x700])
def test_cob_ids_that_a_pdo_may_have(cob_id: int) -> None:
    bus = disabled(0x1800)
    bus.write(0x1800, 1, cob_id, "I")
    bus.start()
    assert cob_id in ids(bus.sync())


@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_the_cob_id_of_a_pdo_that_exists(index: int) -> None:
    bus = Bus()
    assert bus.refused(index, 1, bus.read(index, 1, "I") + 1, "I") == Abort.INVALID_VALUE
    bus.write(index, 1, bus.read(index, 1, "I"), "I")


@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_transmission_types(index: int) -> None:
    bus = Bus()
    for kind in range(256):
        if 241 <= kind <= 253:
            assert bus.refused(index, 2, kind, "B") == Abort.INVALID_VALUE == 0x06090030
        else:
            bus.write(index, 2, kind, "B")
            assert bus.read(index, 2, "B") == kind


@pytest.mark.parametrize(("sub", "code"), [(3, "H"), (6, "B")])
def test_inhibit_time_and_start_value_of_a_pdo_that_exists(sub: int, code: str) -> None:
    assert Bus().refused(0x1800, sub, 5, code) == Abort.INVALID_VALUE
    bus = disabled(0x1800)
    bus.write(0x1800, sub, 5, code)
    assert bus.read(0x1800, sub, code) == 5


def test_start_value_beyond_240() -> None:
    assert disabled(0x1800).refused(0x1800, 6, 241, "B") == Abort.INVALID_VALUE


def test_reserved_sub_index_4() -> None:
    assert Bus().refused(0x1800, 4, 0, "B") == Abort.NO_SUBINDEX
