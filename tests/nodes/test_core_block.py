"""SDO block transfer: blocks, repetition, CRC, and the abort for each misuse (CiA 301, 7.2.4.3.9–14)."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eds.cia301 import Abort
from tests.nodes.core_client import MS, AbortedError, Bus, crc

TRACE = "032000"
DATA = bytes(range(200)) * 6


def segments(data: bytes, first: int = 0, count: int = 127) -> list[bytes]:
    """The segments of one block, numbered from 1, the last of the data flagged."""
    block = []
    for number in range(count):
        at = (first + number) * 7
        if at >= len(data):
            break
        last = 0x80 if at + 7 >= len(data) else 0
        block.append(bytes((number + 1 | last,)) + data[at:at + 7].ljust(7, b"\0"))
    return block


def begin_download(bus: Bus, size: int | None, crc_on: bool = True) -> None:
    head = 0xC0 | (4 if crc_on else 0) | (2 if size is not None else 0)
    answer = bus.request(bytes((head,)) + bytes.fromhex(TRACE) + struct.pack("<I", size or 0))
    assert answer == b"\xA4" + bytes.fromhex(TRACE) + b"\x7F\0\0\0"


def download(bus: Bus, data: bytes, crc_on: bool = True) -> None:
    begin_download(bus, len(data), crc_on)
    first, total = 0, -(-len(data) // 7)
    while first < total:
        block = segments(data, first)
        answers = [bus.request(segment) for segment in block]
        assert answers[:-1] == [None] * (len(block) - 1)
        assert answers[-1] == bytes((0xA2, len(block), 127, 0, 0, 0, 0, 0))
        first += len(block)
    assert end_download(bus, data) == b"\xA1" + bytes(7)


def end_download(bus: Bus, data: bytes, check: bytes | None = None) -> bytes | None:
    unused = -len(data) % 7
    return bus.request(bytes((0xC1 | unused << 2,)) + (crc(data) if check is None else check) + bytes(5))


def begin_upload(bus: Bus, block: int = 127, threshold: int = 0, crc_on: bool = True) -> bytes | None:
    return bus.request(bytes((0xA0 | (4 if crc_on else 0),)) + bytes.fromhex(TRACE) + bytes((block, threshold, 0, 0)))


def upload_block(bus: Bus, request: str) -> list[bytes]:
    """Send start or acknowledgement; return the segments of the block that follows."""
    bus.sent.clear()
    assert bus.request(request) in (None, bus.sent[0][1].data if bus.sent else None)
    bus.run(50 * MS)
    return [frame.data for _at, frame in bus.sent if frame.can_id == 0x585]


@settings(max_examples=25, deadline=None)
@given(st.binary(min_size=1, max_size=2000), st.booleans())
def test_there_and_back(data: bytes, crc_on: bool) -> None:
    bus = Bus()
    download(bus, data, crc_on)
    assert begin_upload(bus, 50, crc_on=crc_on) == b"\xC6" + bytes.fromhex(TRACE) + struct.pack("<I", len(data))
    got, block = b"", upload_block(bus, "a300000000000000")
    while block[0][0] & 0xE3 != 0xC1:
        assert [segment[0] & 0x7F for segment in block] == list(range(1, len(block) + 1))
        got += b"".join(segment[1:] for segment in block)
        block = upload_block(bus, bytes((0xA2, len(block), 50)).hex() + "0000000000")
    assert block == [bytes((0xC1 | (-len(data) % 7) << 2,)) + (crc(data) if crc_on else b"\0\0") + bytes(5)]
    assert got[:len(data)] == data
    assert bus.request("a100000000000000") is None
    assert bus.read(0x2003) == data


def test_a_block_that_lost_a_segment_is_repeated_from_there() -> None:
    bus = Bus()
    begin_download(bus, len(DATA))
    block = segments(DATA)
    answers = [bus.request(segment) for segment in block if segment[0] != 40]
    assert answers[-1] == bytes((0xA2, 39, 127, 0, 0, 0, 0, 0))
    for segment in segments(DATA, 39):
        answer = bus.request(segment)
    assert answer[1] == 127
    for segment in segments(DATA, 39 + 127):
        answer = bus.request(segment)
    assert end_download(bus, DATA) == b"\xA1" + bytes(7)
    assert bus.read(0x2003) == DATA


def test_a_lost_first_segment_is_acknowledged_as_zero() -> None:
    bus = Bus()
    begin_download(bus, 14)
    block = segments(DATA[:14])
    assert bus.request(block[1])[:2] == b"\xA2\0"
    assert [bus.request(segment) for segment in block][-1][:2] == b"\xA2\2"
    assert end_download(bus, DATA[:14]) == b"\xA1" + bytes(7)


def test_an_uploaded_block_is_repeated_from_what_was_acknowledged() -> None:
    bus = Bus()
    download(bus, DATA)
    begin_upload(bus, 10)
    first = upload_block(bus, "a300000000000000")
    assert len(first) == 10
    again = upload_block(bus, "a2040a0000000000")
    assert [s[1:] for s in again[:6]] == [s[1:] for s in first[4:]]
    assert [s[0] for s in again] == list(range(1, 11))
    nothing = upload_block(bus, "a2000a0000000000")
    assert nothing == again


def test_a_short_object_is_uploaded_the_normal_way_under_the_threshold() -> None:
    bus = Bus()
    bus.write(0x2003, 0, b"0123456789")
    assert begin_upload(bus, threshold=10) == bytes.fromhex("41" + TRACE + "0a000000")
    assert bus.request("6000000000000000")[1:] == b"0123456"
    bus.alive()
    assert begin_upload(bus, threshold=9)[0] == 0xC6
    bus.alive()
    assert bus.request("a400100004040000")[0] == 0x43


def test_upload_segments_leave_room_for_pdos() -> None:
    """Segments are paced, so that a block of 127 does not stand in the queue before a TPDO."""
    bus = Bus()
    download(bus, DATA)
    begin_upload(bus)
    bus.sent.clear()
    bus.request("a300000000000000")
    bus.run(50 * MS)
    times = [at for at, frame in bus.sent if frame.can_id == 0x585]
    assert len(times) == 127
    assert {b - a for a, b in pairwise(times)} == {200_000}


def phase_download(bus: Bus) -> None:
    begin_download(bus, 14)


def phase_download_end(bus: Bus) -> None:
    begin_download(bus, 14)
    for segment in segments(DATA[:14]):
        bus.request(segment)


def phase_download_unsized_end(bus: Bus) -> None:
    begin_download(bus, None)
    for segment in segments(DATA[:14]):
        bus.request(segment)


def phase_upload(bus: Bus) -> None:
    bus.write(0x2003, 0, DATA)
    begin_upload(bus, 4)


def phase_upload_sent(bus: Bus) -> None:
    phase_upload(bus)
    upload_block(bus, "a300000000000000")


def phase_upload_end(bus: Bus) -> None:
    bus.write(0x2003, 0, b"12345678")
    begin_upload(bus, 4)
    upload_block(bus, "a300000000000000")
    assert bus.request("a202040000000000")[0] & 0xE3 == 0xC1


def phase_idle(bus: Bus) -> None:
    pass


MISUSE = [
    ("unknown object, download", phase_idle, "c600300000000000", Abort.NO_OBJECT),
    ("unknown object, upload", phase_idle, "a40030007f000000", Abort.NO_OBJECT),
    ("unknown sub-index", phase_idle, "a40320017f000000", Abort.NO_SUBINDEX),
    ("read-only object", phase_idle, "c600100004000000", Abort.READ_ONLY),
    ("write-only object", phase_idle, "a40420007f000000", Abort.WRITE_ONLY),
    ("wrong announced size", phase_idle, "c600200003000000", Abort.TOO_LONG),
    ("announced size below the type's", phase_idle, "c600200001000000", Abort.TOO_SHORT),
    ("more than the device holds", phase_idle, "c603200001000100", Abort.MEMORY),
    ("end without a transfer", phase_idle, "c100000000000000", Abort.COMMAND),
    ("start without a transfer", phase_idle, "a300000000000000", Abort.COMMAND),
    ("acknowledgement without a transfer", phase_idle, "a2017f0000000000", Abort.COMMAND),
    ("segment number 0", phase_download, "0000000000000000", Abort.SEQUENCE),
    ("something else than the end", phase_download_end, "4000100000000000", Abort.COMMAND),
    ("CRC wrong", phase_download_end, "c1ffff0000000000", Abort.CRC),
    ("fewer than announced", phase_download_end, "cd00000000000000", Abort.TOO_SHORT),
    ("start twice", phase_upload_sent, "a300000000000000", Abort.COMMAND),
    ("acknowledgement before the start", phase_upload, "a2017f0000000000", Abort.COMMAND),
    ("end before the data", phase_upload_sent, "a100000000000000", Abort.COMMAND),
    ("acknowledged more than was sent", phase_upload_sent, "a205040000000000", Abort.SEQUENCE),
    ("next block size 0", phase_upload_sent, "a204000000000000", Abort.BLOCK_SIZE),
    ("next block size 128", phase_upload_sent, "a204800000000000", Abort.BLOCK_SIZE),
    ("acknowledgement after the end", phase_upload_end, "a201040000000000", Abort.COMMAND),
    ("frame too short", phase_download, "01", Abort.COMMAND),
]


@pytest.mark.parametrize(("phase", "frame", "code"), [row[1:] for row in MISUSE],
                         ids=[row[0] for row in MISUSE])
def test_misuse(phase, frame: str, code: Abort) -> None:  # type: ignore[no-untyped-def]
    bus = Bus()
    phase(bus)
    with pytest.raises(AbortedError) as refused:
        bus.request(frame)
    assert refused.value.code == code
    if phase is not phase_idle:
        assert refused.value.key == 0x200300
    assert bus.read(0x1000, 0, "I") == 0x000F0191


@pytest.mark.parametrize("block", [0, 128, 255])
def test_block_size(block: int) -> None:
    bus = Bus()
    bus.write(0x2003, 0, DATA)
    with pytest.raises(AbortedError) as refused:
        begin_upload(bus, block)
    assert refused.value.code == Abort.BLOCK_SIZE


def test_more_segments_than_announced() -> None:
    bus = Bus()
    begin_download(bus, 14)
    for segment in segments(DATA[:21])[:2]:
        bus.request(segment)
    with pytest.raises(AbortedError) as refused:
        bus.request(segments(DATA[:21])[2])
    assert refused.value.code == Abort.TOO_LONG


def test_more_than_the_object_holds_by_blocks() -> None:
    bus = Bus()
    assert bus.request("c400200000000000")[0] == 0xA4
    bus.request("8100000000000000")
    with pytest.raises(AbortedError) as refused:
        bus.request("c100000000000000")
    assert refused.value.code == Abort.TOO_LONG


def test_a_value_refused_at_the_end() -> None:
    bus = Bus()
    assert bus.request("c200200002000000")[0] == 0xA4
    bus.request("81ff7f0000000000")
    with pytest.raises(AbortedError) as refused:
        bus.request("d500000000000000")
    assert refused.value.code == Abort.TOO_HIGH


@pytest.mark.parametrize("phase", [phase_download, phase_download_end, phase_upload, phase_upload_sent,
                                   phase_upload_end])
def test_a_silent_client_is_told_so(phase) -> None:  # type: ignore[no-untyped-def]
    bus = Bus()
    phase(bus)
    frames = [frame.data for _at, frame in bus.run(3000 * MS)]
    assert frames == [b"\x80" + bytes.fromhex(TRACE) + struct.pack("<I", Abort.TIMEOUT)]
    bus.alive()


@pytest.mark.parametrize("phase", [phase_download, phase_download_end, phase_upload, phase_upload_sent,
                                   phase_upload_end])
def test_the_clients_abort_ends_it(phase) -> None:  # type: ignore[no-untyped-def]
    bus = Bus()
    phase(bus)
    assert bus.request("8003200000000408") is None
    assert bus.run(3000 * MS) == []
    assert bus.read(0x1000, 0, "I") == 0x000F0191


@pytest.mark.parametrize("size", [65536, 65537])
def test_more_than_the_device_holds_without_saying_so(size: int) -> None:
    bus = Bus()
    data = bytes(size)
    begin_download(bus, None)
    code = 0
    try:
        for first in range(0, -(-size // 7), 127):
            for segment in segments(data, first):
                bus.request(segment)
        end_download(bus, data)
    except AbortedError as aborted:
        code = aborted.code
    assert code == (Abort.MEMORY if size > 65536 else 0)
    bus.alive()
