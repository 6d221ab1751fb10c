"""Any frame, in any order: no exception, nothing outside the tables, and the device still works afterwards."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from eds.cia301 import Abort, Emcy, Frame, NmtCommand, NmtState
from eds.dictionary import read
from tests.nodes.core_client import EDS, MS, NODE, AbortedError, Bus

ENTRIES = sorted(read(EDS, NODE).entries)
ABORTS = frozenset(Abort)
OBJECTS = st.sampled_from(ENTRIES) | st.integers(0, 0xFFFFFF)
IDS = st.sampled_from([0x000, 0x080, 0x085, 0x185, 0x205, 0x285, 0x305, 0x405, 0x505, 0x585, 0x605, 0x705, 0x77F])
STARTS = st.sampled_from([0x00, 0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x40, 0x60, 0x70, 0x80, 0x81, 0xA0, 0xA1,
                          0xA2, 0xA3, 0xA4, 0xC0, 0xC1, 0xC2, 0xC4, 0xC6, 0xE0]) | st.integers(0, 255)
WORDS = st.sampled_from([0, 1, 2, 254, 255, 0x80000000, 0x40000080, 0x185, 0x80000185, 0x205, 0x80000205, 0x60000008,
                         0x62000008, 0x00050008, 0x65766173, 0x64616F6C, 0x007F0064]) | st.integers(0, 0xFFFFFFFF)


class AnyFrame(RuleBasedStateMachine):
    """What a hostile bus may do to one device."""

    @initialize()
    def begin(self) -> None:
        self.bus = Bus()
        self.bus.write(0x1017, 0, 50, "H")

    @rule(can_id=IDS | st.integers(0, 0x7FF), data=st.binary(max_size=8),
          flag=st.sampled_from(["", "", "", "remote", "extended", "error"]), dlc=st.none() | st.integers(0, 15))
    def any_frame(self, can_id: int, data: bytes, flag: str, dlc: int | None) -> None:
        self.bus.send(can_id, data, **({flag: True} if flag else {}), dlc=dlc)

    @rule(start=STARTS, about=OBJECTS, word=WORDS)
    def sdo(self, start: int, about: int, word: int) -> None:
        frame = bytes((start, about >> 8 & 0xFF, about >> 16, about & 0xFF)) + struct.pack("<I", word)
        state = self.bus.device.state
        answers = [f for f in self.bus.send(0x605, frame) if f.can_id == 0x585]
        if state is NmtState.STOPPED:
            assert answers == []
        assert len(answers) <= 1

    @rule(start=STARTS, rest=st.binary(max_size=12), times=st.integers(1, 130))
    def sdo_repeated(self, start: int, rest: bytes, times: int) -> None:
        for number in range(times):
            self.bus.send(0x605, bytes((start + number & 0xFF,)) + rest[:7].ljust(7, b"\0"))

    @rule(about=st.sampled_from([at for at in ENTRIES if 0x1400 <= at >> 8 <= 0x1BFF]), word=WORDS)
    def pdo_parameter(self, about: int, word: int) -> None:
        size = self.bus.device.objects.entries[about].data_type.size
        head = 0x23 | (4 - size) << 2
        self.bus.send(0x605, bytes((head, about >> 8 & 0xFF, about >> 16, about & 0xFF)) + struct.pack("<I", word))

    @rule(command=st.sampled_from(list(NmtCommand)))
    def nmt(self, command: NmtCommand) -> None:
        self.bus.nmt(command)

    @rule(for_us=st.integers(0, 200_000))
    def time_passes(self, for_us: int) -> None:
        stopped = self.bus.device.state is NmtState.STOPPED
        frames = self.bus.run(for_us * 1000)
        assert not stopped or {frame.can_id for _at, frame in frames} <= {0x705}

    @rule(code=st.sampled_from([code for code in Emcy if code]), gone=st.booleans())
    def application_error(self, code: Emcy, gone: bool) -> None:
        if gone:
            self.bus.device.recover(code)
        else:
            self.bus.device.emergency(code, code.register)

    @invariant()
    def nothing_outside_the_tables(self) -> None:
        if not hasattr(self, "bus"):
            return
        assert self.bus.device.state in NmtState
        for _at, frame in self.bus.sent:
            well_formed(frame)
        self.bus.sent.clear()

    def teardown(self) -> None:
        if hasattr(self, "bus"):
            still_works(self.bus)


def well_formed(frame: Frame) -> None:
    """A frame that a device may send."""
    assert 0 <= frame.can_id <= 0x7FF
    assert len(frame.data) <= 8
    assert (frame.remote, frame.extended, frame.error) == (False, False, False)
    if frame.can_id == 0x585:
        assert len(frame.data) == 8
        if frame.data[0] == 0x80:
            assert int.from_bytes(frame.data[4:], "little") in ABORTS
    if frame.can_id == 0x705:
        assert frame.data in (b"\0", b"\4", b"\5", b"\x7f")


def still_works(bus: Bus) -> None:
    """After a restore and a reset it is as good as new."""
    bus.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bus.alive()
    bus.write(0x1011, 1, b"load")
    bus.nmt(NmtCommand.RESET_NODE)
    bus.start()
    bus.sent.clear()
    bus.send(0x205, "0700000000")
    assert bus.read(0x6200, 0, "B") == 7
    assert 0x185 in [frame.can_id for frame in bus.sync()]
    assert bus.read(0x1008) == b"Core under test"
    with pytest.raises(AbortedError) as refused:
        bus.read(0x3000)
    assert refused.value.code == Abort.NO_OBJECT


AnyFrame.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestAnyFrame = AnyFrame.TestCase


@pytest.mark.exhaustive
def test_a_minute_of_full_bus_load() -> None:
    """60 s of frames of every kind, back to back at 1 Mbit/s: 0.1 ms each."""
    chance = random.Random(1)
    bus = Bus()
    heads = [0x00, 0x10, 0x20, 0x21, 0x23, 0x2B, 0x2F, 0x40, 0x60, 0x70, 0xA0, 0xA4, 0xA3, 0xA1, 0xC2, 0xC6, 0xC1, 0xE0]
    frames = [Frame(chance.choice([0x205, 0x305, 0x405, 0x80, 0x77F, 0x701, chance.randrange(0x800)]),
                    chance.randbytes(chance.choice([0, 1, 2, 5, 6, 8]))) for _ in range(2000)]
    for _ in range(4000):
        about = chance.choice(ENTRIES)
        head = bytes((chance.choice(heads), about >> 8 & 0xFF, about >> 16, about & 0xFF))
        frames.append(Frame(0x605, head + chance.randbytes(4)))
    frames += [Frame(0, bytes((command, NODE))) for command in NmtCommand for _ in range(20)]
    frames += [Frame(0, bytes((NmtCommand.START, 0)))] * 200
    device, answers = bus.device, 0
    for now_ns in range(0, 60_000 * MS, 100_000):
        device.receive(chance.choice(frames), now_ns)
        due_ns = device.next_ns()
        if due_ns is not None and due_ns <= now_ns:
            device.poll(now_ns)
        if device.outbox:
            answers += len(device.outbox)
            for frame in device.outbox:
                well_formed(frame)
            device.outbox.clear()
        bus.now_ns = now_ns
    assert answers > 100_000
    still_works(bus)
