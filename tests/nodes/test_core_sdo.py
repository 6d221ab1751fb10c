"""SDO server, expedited and segmented: what it answers, and the abort for each misuse (CiA 301, 7.2.4)."""

from __future__ import annotations

import io
import struct

import canopen
import pytest
from canopen.sdo import SdoClient
from hypothesis import given, settings
from hypothesis import strategies as st

from eds.cia301 import Abort, NmtCommand
from tests.nodes.core_client import EDS, MS, NODE, AbortedError, Bus


class StockBus:
    """canopen's own SDO client, whose frames meet the device at once: no thread, no wall time."""

    def __init__(self) -> None:
        self.bus = Bus()
        self.client = SdoClient(0x600 + NODE, 0x580 + NODE, canopen.import_od(str(EDS), NODE))
        self.client.network = self

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.bus.sent.clear()
        self.bus.send(can_id, bytes(data))
        self.bus.run(40 * MS)
        for _at, frame in self.bus.sent:
            self.client.on_response(frame.can_id, frame.data, 0.0)


@pytest.mark.parametrize(("index", "code", "value"), [
    (0x2000, "h", -77), (0x2001, "f", 1.5), (0x6203, "H", 65535), (0x1006, "I", 0xFFFFFFFF),
])
def test_expedited(index: int, code: str, value: float) -> None:
    bus = Bus()
    bus.write(index, 0, value, code)
    assert bus.read(index, 0, code) == value


@settings(max_examples=40, deadline=None)
@given(st.binary(min_size=1, max_size=300))
def test_segmented_there_and_back(data: bytes) -> None:
    bus = Bus()
    bus.write(0x2003, 0, data)
    assert bus.read(0x2003, 0) == data


def test_segments_byte_by_byte() -> None:
    """CiA 301, figures 37–40: toggle from 0, n unused bytes, c on the last segment."""
    bus = Bus()
    assert bus.request("21032000 0a000000") == bytes.fromhex("6003200000000000")
    assert bus.request("0001020304050607") == bytes.fromhex("2000000000000000")
    assert bus.request("1908090a00000000") == bytes.fromhex("3000000000000000")
    assert bus.request("4003200000000000") == bytes.fromhex("410320000a000000")
    assert bus.request("6000000000000000") == bytes.fromhex("0001020304050607")
    assert bus.request("7000000000000000") == bytes.fromhex("1908090a00000000")


def test_download_without_announced_sizes() -> None:
    bus = Bus()
    assert bus.request("2202200000000000")[0] == 0x60
    assert bus.read(0x2002) == bytes(4)
    bus.request("2000200000000000")
    bus.request(bytes((0x0B, 0x2A, 0)) + bytes(5))
    assert bus.read(0x2000, 0, "h") == 42
    bus.request("22002000feff0000")
    assert bus.read(0x2000, 0, "h") == -2


def test_stock_client_reads_and_writes() -> None:
    stock = StockBus()
    assert stock.client.upload(0x1008, 0) == b"Core under test"
    stock.client.download(0x2002, 0, b"a longer name than before")
    assert stock.client.upload(0x2002, 0) == b"a longer name than before"
    with pytest.raises(canopen.SdoAbortedError) as refused:
        stock.client.upload(0x2222, 0)
    assert refused.value.code == Abort.NO_OBJECT


@pytest.mark.parametrize("size", [1, 6, 7, 8, 888, 889, 890, 2000, 7000])
def test_stock_client_in_blocks(size: int) -> None:
    stock = StockBus()
    data = bytes(n * 31 % 251 for n in range(size))
    with stock.client.open(0x2003, 0, "wb", size=size, block_transfer=True) as out:
        out.write(data)
    with stock.client.open(0x2003, 0, "rb", block_transfer=True) as into:
        assert isinstance(into, io.BufferedReader)
        assert into.read() == data


# ---- one row for each misuse: frames sent before, the frame, the abort ----

MISUSE = {
    "unknown object, read": ([], "4000300000000000", Abort.NO_OBJECT),
    "unknown object, write": ([], "2b00300000000000", Abort.NO_OBJECT),
    "unknown sub-index, read": ([], "4018100900000000", Abort.NO_SUBINDEX),
    "unknown sub-index, write": ([], "2f18100900000000", Abort.NO_SUBINDEX),
    "unknown sub-index of a variable": ([], "4000200100000000", Abort.NO_SUBINDEX),
    "read of a write-only object": ([], "4004200000000000", Abort.WRITE_ONLY),
    "write of a read-only object": ([], "2300100000000000", Abort.READ_ONLY),
    "write of a constant": ([], "2b08200000000000", Abort.READ_ONLY),
    "segmented write of a read-only object": ([], "2100100004000000", Abort.READ_ONLY),
    "too long, expedited": ([], "2300200000000000", Abort.TOO_LONG),
    "too short, expedited": ([], "2f00200000000000", Abort.TOO_SHORT),
    "too long, announced": ([], "2100200003000000", Abort.TOO_LONG),
    "too short, announced": ([], "2100200001000000", Abort.TOO_SHORT),
    "too long, by segments": (["2000200000000000"], "0300000000000000", Abort.TOO_LONG),
    "too short, by segments": (["2000200000000000"], "0d00000000000000", Abort.TOO_SHORT),
    "more than announced": (["2103200003000000"], "0100000000000000", Abort.TOO_LONG),
    "less than announced": (["2103200009000000"], "0100000000000000", Abort.TOO_SHORT),
    "more than the device holds": ([], "2103200001000100", Abort.MEMORY),
    "above HighLimit": ([], "2b00200065000000", Abort.TOO_HIGH),
    "below LowLimit": ([], "2b0020009bff0000", Abort.TOO_LOW),
    "refused by the application": ([], "2b05620001000000", Abort.INVALID_VALUE),
    "no data": ([], "4003200000000000", Abort.NO_DATA),
    "toggle wrong, download": (["2103200009000000"], "1000000000000000", Abort.TOGGLE),
    "toggle repeated, download": (["2103200009000000", "0000000000000000"], "0000000000000000", Abort.TOGGLE),
    "toggle wrong, upload": (["4008100000000000"], "7000000000000000", Abort.TOGGLE),
    "toggle repeated, upload": (["4008100000000000", "6000000000000000"], "6000000000000000", Abort.TOGGLE),
    "segment without a transfer": ([], "0000000000000000", Abort.COMMAND),
    "segment request without a transfer": ([], "6000000000000000", Abort.COMMAND),
    "unknown command": ([], "e000100000000000", Abort.COMMAND),
    "upload segment asked within a download": (["2103200009000000"], "6000000000000000", Abort.COMMAND),
    "download segment within an upload": (["4008100000000000"], "0000000000000000", Abort.COMMAND),
    "initiation within a transfer": (["4008100000000000"], "4000100000000000", Abort.COMMAND),
    "frame too short": ([], "40001000", Abort.COMMAND),
    "empty frame": ([], "", Abort.COMMAND),
    "frame too short within a transfer": (["4008100000000000"], "60", Abort.COMMAND),
}


@pytest.mark.parametrize("name", MISUSE)
def test_misuse(name: str) -> None:
    before, frame, code = MISUSE[name]
    bus = Bus()
    for request in before:
        bus.request(request)
    with pytest.raises(AbortedError) as refused:
        bus.request(frame)
    assert refused.value.code == code
    about = bytes.fromhex(before[0] if before else frame)
    if len(about) > 3 and about[0] >> 5 in (1, 2):
        assert refused.value.key == about[2] << 16 | about[1] << 8 | about[3]
    assert bus.read(0x1000, 0, "I") == 0x000F0191


@pytest.mark.parametrize("begin", ["2103200009000000", "4008100000000000"])
def test_a_silent_client_is_told_so(begin: str) -> None:
    bus = Bus()
    bus.request(begin)
    answers = bus.run(2000 * MS)
    assert answers == [(1000 * MS, answers[0][1])]
    assert answers[0][1].data == b"\x80" + bytes.fromhex(begin)[1:4] + struct.pack("<I", Abort.TIMEOUT)
    assert bus.run(2000 * MS) == []


def test_each_segment_starts_the_time_anew() -> None:
    bus = Bus()
    bus.request("2103200015000000")
    for toggle in (0, 0x10):
        assert bus.run(999 * MS) == []
        bus.request(bytes((toggle,)) + bytes(7))
    assert bus.run(999 * MS) == []
    bus.request("0100000000000000")
    assert bus.run(5000 * MS) == []


def test_the_clients_abort_is_not_answered() -> None:
    bus = Bus()
    bus.request("2103200009000000")
    assert bus.request("8003200000000408") is None
    assert bus.request("80") is None
    assert bus.read(0x1000, 0, "I") == 0x000F0191
    assert bus.run(5000 * MS) == []


def test_a_refused_write_changes_nothing() -> None:
    bus = Bus()
    bus.write(0x2000, 0, 5, "h")
    assert bus.refused(0x2000, 0, 101, "h") == Abort.TOO_HIGH
    assert bus.read(0x2000, 0, "h") == 5


def test_written_objects_reach_the_application() -> None:
    bus = Bus()
    bus.write(0x2006, 1, 3, "B")
    assert bus.process.told[-1] == ("written", 0x200601, 3, 0)


def test_sdo_in_operational() -> None:
    bus = Bus()
    bus.nmt(NmtCommand.START)
    assert bus.read(0x1008) == b"Core under test"


def test_identity_and_server_parameters() -> None:
    bus = Bus()
    assert [bus.read(0x1018, sub, "I") for sub in (1, 2, 3, 4)] == [0x00B0DE00, 0xC0DE, 1, 7]
    assert [bus.read(0x1200, sub, "I") for sub in (1, 2)] == [0x605, 0x585]
    assert bus.read(0x1000, 0, "I") == 0x000F0191
