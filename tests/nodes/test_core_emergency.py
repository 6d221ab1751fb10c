"""EMCY: messages, 0x1001, 0x1003, 0x1014, 0x1015 (CiA 301, 7.2.7 and 7.5.2.2–4, 17, 18).

An application's error has no frame that causes it: here, and only here, tests call the device as a profile does.
"""

from __future__ import annotations

import struct

import pytest

from eds.cia301 import Abort, Emcy, NmtCommand
from tests.nodes.core_client import MS, AbortedError, Bus


def told(bus: Bus) -> list[str]:
    bus.run(0)
    found = [frame.data.hex() for _at, frame in bus.sent if frame.can_id == 0x85]
    bus.sent.clear()
    return found


def test_an_error_is_told_once_while_it_lasts_and_once_when_it_goes() -> None:
    bus = Bus()
    for _ in range(3):
        bus.device.emergency(0x2310, 0x02, b"\xAA\xBB\xCC\xDD\xEE\xFF")
    assert told(bus) == ["102303aabbccddee"]
    assert bus.read(0x1001, 0, "B") == 0x03
    bus.device.recover(0x2310)
    bus.device.recover(0x2310)
    assert told(bus) == ["0000000000000000"]
    assert bus.read(0x1001, 0, "B") == 0


def test_of_two_errors_the_one_left_is_named() -> None:
    bus = Bus()
    bus.device.emergency(0x2310, 0x02)
    bus.device.emergency(0x4310, 0x08)
    assert bus.read(0x1001, 0, "B") == 0x0B
    told(bus)
    bus.device.recover(0x2310)
    assert told(bus) == ["0000091043000000"]
    bus.device.recover(0x4310)
    assert told(bus) == ["0000000000000000"]


def test_history_newest_first() -> None:
    bus = Bus()
    assert bus.read(0x1003, 0, "B") == 0
    with pytest.raises(AbortedError) as empty:
        bus.read(0x1003, 1)
    assert empty.value.code == Abort.NO_DATA
    for code in (0x1000, 0x2310, 0x4310, 0x5441, 0x8611):
        bus.device.emergency(code, 1, struct.pack("<H", code + 1))
        bus.device.recover(code)
    assert bus.read(0x1003, 0, "B") == 4
    assert [bus.read(0x1003, sub, "I") for sub in (1, 2, 3, 4)] == [0x86128611, 0x54425441, 0x43114310, 0x23112310]


def test_history_is_cleared_by_zero_only() -> None:
    bus = Bus()
    bus.device.emergency(0x1000, 1)
    assert bus.refused(0x1003, 0, 1, "B") == Abort.INVALID_VALUE
    assert bus.refused(0x1003, 1, 0, "I") == Abort.READ_ONLY
    assert bus.read(0x1003, 1, "I") == 0x1000
    bus.write(0x1003, 0, 0, "B")
    assert bus.read(0x1003, 0, "B") == 0
    with pytest.raises(AbortedError):
        bus.read(0x1003, 1)
    assert bus.read(0x1001, 0, "B") == 1


def test_inhibit_time_in_100_us() -> None:
    bus = Bus()
    bus.write(0x1015, 0, 100, "H")
    bus.device.emergency(0x1000, 1)
    bus.device.emergency(0x2310, 3)
    bus.device.recover(0x1000)
    frames = [(at, f.data[:3].hex()) for at, f in bus.run(100 * MS) if f.can_id == 0x85]
    assert frames == [(0, "001001"), (10 * MS, "102303"), (20 * MS, "000003")]
    told(bus)
    bus.device.recover(0x2310)
    assert told(bus) == ["0000000000000000"]


def test_what_waits_too_long_gives_way_to_the_newer() -> None:
    bus = Bus()
    bus.write(0x1015, 0, 100, "H")
    for code in range(0x1000, 0x1020):
        bus.device.emergency(code, 1)
    codes = [struct.unpack("<H", f.data[:2])[0] for _at, f in bus.run(1000 * MS) if f.can_id == 0x85]
    assert codes == [0x1000, *range(0x1010, 0x1020)]


def test_another_cob_id() -> None:
    bus = Bus()
    bus.write(0x1014, 0, 0x80000085, "I")
    bus.write(0x1014, 0, 0x95, "I")
    bus.device.emergency(0x1000, 1)
    assert [f.can_id for _at, f in bus.run(0)] == [0x95]


def test_without_a_cob_id_the_register_still_tells() -> None:
    bus = Bus()
    bus.write(0x1014, 0, 0x80000085, "I")
    bus.device.emergency(0x1000, 1)
    assert bus.run(100 * MS) == []
    assert bus.read(0x1001, 0, "B") == 1
    assert bus.read(0x1003, 1, "I") == 0x1000


@pytest.mark.parametrize("word", [0x20000085, 0x885, 0x000, 0x07F, 0x101, 0x585, 0x705])
def test_cob_ids_that_no_emcy_may_have(word: int) -> None:
    bus = Bus()
    bus.write(0x1014, 0, 0x80000085, "I")
    assert bus.refused(0x1014, 0, word, "I") == Abort.INVALID_VALUE


def test_the_cob_id_of_an_emcy_that_exists() -> None:
    bus = Bus()
    assert bus.refused(0x1014, 0, 0x86, "I") == Abort.INVALID_VALUE
    bus.write(0x1014, 0, 0x80000085, "I")
    assert bus.refused(0x1014, 0, 0x80, "I") == Abort.INCOMPATIBLE
    assert bus.refused(0x1014, 0, 0x185, "I") == Abort.INCOMPATIBLE


def test_reset_node_forgets_errors_reset_communication_only_its_own() -> None:
    bus = Bus()
    bus.start()
    bus.device.emergency(Emcy.OVERCURRENT, 0x02)
    bus.send(0x205, "")
    assert bus.read(0x1001, 0, "B") == 0x13
    bus.nmt(NmtCommand.RESET_COMMUNICATION)
    assert bus.read(0x1001, 0, "B") == 0x03
    assert bus.read(0x1003, 0, "B") == 0
    bus.nmt(NmtCommand.RESET_NODE)
    assert bus.read(0x1001, 0, "B") == 0


def test_bus_off_acts_as_0x1029_says_and_recovery_is_told() -> None:
    bus = Bus()
    bus.start()
    bus.device.bus_off(bus.now_ns)
    assert ("lost", Emcy.BUS_OFF_RECOVERED, 0) in bus.process.told
    assert bus.sync() == []
    bus.sent.clear()
    bus.device.bus_recovered(bus.now_ns)
    assert told(bus) == ["4081110000000000", "0000000000000000"]
