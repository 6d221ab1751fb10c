"""What compiled code reads out of the kernel's memory, against the struct module; no kernel is asked."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eds.bench.bench_network import END, KNEE, SERVO, START
from eds.cia301 import HEARTBEAT_BASE, SYNC_COB_ID, TPDO_BASE
from master.network import kernel_frames as frames
from trial.mcap_file.cdr import ERROR, EXTENDED, FRAME_ROW, REMOTE

SLOT = struct.Struct("=IB3x8s16xqq16xI76x")
"""struct can_frame; its ancillary data: a time stamp, the count of lost frames."""
HEADER = struct.Struct("@QIxxxxQQQQixxxxIxxxx")
"""struct mmsghdr (recvmmsg(2))."""
TIMES = st.integers(0, 4 * 10**9 * 10**9)
Frame = tuple[int, bytes, int, int, int]
"""Identifier with the kernel's flags, data, time stamp, whence (`WHENCE`), lost frames (0: not told)."""
WHENCE = {0: 0, 1: frames.HERE, 2: frames.HERE | frames.OWN}
"""Flags of a message: from another computer, from this one, from the socket itself."""
NODES = (SERVO, KNEE, START, END)
WANTED = np.array([TPDO_BASE + node for node in NODES]), np.array([8, 6, 2, 2])

@st.composite
def kernel_frames(draw: Any) -> Frame:
    can_id = draw(st.sampled_from([SYNC_COB_ID, 0x201, 0x181]) | st.integers(0, 0x7FF)
                  | st.integers(0, 0x1FFFFFFF).map(lambda each: each | frames.EFF))
    flags = draw(st.sampled_from([0, 0, frames.RTR, frames.ERR]))
    return (can_id | flags, draw(st.binary(max_size=8)), draw(TIMES), draw(st.integers(0, 2)),
            draw(st.just(0) | st.integers(1, 2**32 - 1)))


def memory(batch: list[Frame]) -> tuple[Any, Any]:
    """Slots and headers as the kernel leaves them; bytes behind a frame's data are not zero."""
    slots = bytearray().join(
        SLOT.pack(can_id, len(data), data + b"\xa5" * (8 - len(data)), *divmod(time_ns, 10**9), lost)
        for can_id, data, time_ns, _, lost in batch)
    headers = bytearray().join(
        HEADER.pack(0, 0, 0, 1, 0, 56 if lost else 32, WHENCE[here], 16)
        for _, _, _, here, lost in batch)
    return (np.frombuffer(slots, np.uint64).reshape(-1, frames.SLOT),
            np.frombuffer(headers, np.uint64).reshape(-1, frames.HEADER))


def row(frame: Frame) -> tuple[Any, ...]:
    can_id, data, time_ns, here, _ = frame
    remote = can_id & frames.RTR != 0
    flags = REMOTE * remote | EXTENDED * (can_id & frames.EFF != 0) | ERROR * (can_id & frames.ERR != 0)
    payload = bytes(8) if remote else data.ljust(8, b"\0")
    return time_ns, can_id & 0x1FFFFFFF, flags, len(data), 0, here > 0, list(payload)


@settings(deadline=None)  # memory is mapped and a function loaded in the first example
@given(st.lists(kernel_frames(), min_size=1, max_size=32), st.integers(0, 5))
def test_rows_are_what_the_structs_hold(batch: list[Frame], at: int) -> None:
    block = np.zeros((at + len(batch), frames.ROW), np.uint64)
    told = np.full(frames.TOLD, -1, np.int64)
    told[frames.TAKEN] = at
    frames.rows(*memory(batch), len(batch), block, told)
    frames.mark(block, at + len(batch), 0x201, told)
    found = block[at:].view(FRAME_ROW)[:, 0]
    assert [(*each.tolist()[:6], each["data"].tolist()) for each in found] == [row(frame) for frame in batch]
    last = {can_id: (time_ns, n) for n, (can_id, _, time_ns, _, _) in enumerate(batch)}
    assert told[frames.SYNC_END] == at + last.get(SYNC_COB_ID, (-1, -2 - at))[1] + 1
    assert told[frames.MARKED_NS] == last.get(0x201, (-1, 0))[0]
    assert told[frames.TAKEN] == at + len(batch)


STAMPED = struct.Struct("=IB3x8s QII qq QII 32x qq QII I12x")
"""A slot with the adapter's time stamp: a header and a stamp of the kernel, of the adapter, and the lost frames."""


def stamped(*batch: tuple[int, int, bool]) -> tuple[list[int], Any]:
    """Return the time stamps of frames whose stamps of kernel and adapter, and origin, are given; the clock's state."""
    state = np.zeros(frames.TOLD, np.int64)
    found = []
    for kernel_ns, hardware_ns, here in batch:
        lost = 7
        slots = np.frombuffer(bytearray(STAMPED.pack(
            0x181, 8, bytes(8), 32, 1, 35, *divmod(kernel_ns, 10**9), 64, 1, frames.SO_TIMESTAMPING,
            *divmod(hardware_ns, 10**9), 20, 1, 40, lost)), np.uint64).reshape(1, -1)
        headers = np.frombuffer(bytearray(HEADER.pack(
            0, 0, 0, 1, 0, 120, frames.HERE if here else 0, 16)), np.uint64).reshape(1, -1)
        frames.settle(slots, headers, 1, state)
        block, told = np.zeros((1, frames.ROW), np.uint64), np.zeros(frames.TOLD, np.int64)
        frames.rows(slots, headers, 1, block, told)
        assert (headers[0, 5], slots[0, 8]) == (56, lost), "the count of lost frames is where it is without the stamp"
        found.append(int(block[0, 0]))
    return found, state


@given(st.lists(st.tuples(st.integers(200_000, 1_200_000), st.integers(0, 800_000)), min_size=2, max_size=30))
def test_the_adapters_time_stamps_lose_the_jitter_of_the_kernels(frames_: list[tuple[int, int]]) -> None:
    """The adapter's clock began an hour ago; the kernel is late by 0.1 ms, and by more now and then."""
    at_ns, batch = 3600 * 10**9, [(1_700_000_000 * 10**9 + 100_000, 3600 * 10**9, True)]
    for after_ns, late_ns in frames_:
        at_ns += after_ns
        batch.append((1_700_000_000 * 10**9 + at_ns - 3600 * 10**9 + 100_000 + late_ns, at_ns, False))
    found, state = stamped(*batch)
    for stamp, (kernel_ns, hardware_ns, _) in zip(found, batch, strict=True):
        elapsed_ns = hardware_ns - batch[0][1]
        assert 0 <= stamp - (batch[0][0] + elapsed_ns) <= elapsed_ns / frames.DRIFT
        assert stamp <= kernel_ns
    assert state[frames.WORST_NS] <= max(late for _, late in frames_)


def test_the_kernels_time_stamps_stay_until_own_frames_have_the_adapters_too() -> None:
    assert stamped((1_000_900, 500, False), (2_000_000, 1_000_000, False))[0] == [1_000_900, 2_000_000]
    (_, _, third), _ = stamped((1_000_900, 500, False), (2_000_000, 1_000_000, True), (3_900_000, 2_000_000, False))
    assert 3_000_000 <= third <= 3_000_200


def test_an_adapter_whose_clock_begins_anew_is_followed() -> None:
    second = 10**9
    found, _ = stamped((10 * second, 9 * second, True), (12 * second, second // 2, True))
    assert found == [10 * second, 12 * second]


SYNC: Frame = SYNC_COB_ID, b"", 1000, True, 0
INPUTS: list[Frame] = [(TPDO_BASE + node, bytes([node] * size), 1000 + node, False, 0)
                       for node, size in zip(NODES, (8, 6, 2, 2), strict=True)]
BEAT: Frame = HEARTBEAT_BASE + KNEE, b"\x05", 1500, False, 0


def heeded(*batches: list[Frame]) -> tuple[int, Any]:
    told = np.full(frames.HEEDED, -1, np.int64)
    told[frames.BEATS] = 0
    status = frames.WAITING
    for batch in batches:
        status = frames.heed(*memory(batch), len(batch), *WANTED, told)
    return status, told


@settings(deadline=None)
@given(st.permutations(INPUTS), st.integers(0, 5), st.integers(0, 6))
def test_a_cycle_is_whole_once_sync_and_every_input_have_come(
    inputs: list[Frame], split: int, beat: int
) -> None:
    batch = [SYNC, *inputs]
    batch.insert(beat, BEAT)
    status, told = heeded(batch[:split], batch[split:])
    assert (status, told[frames.AT_NS]) == (frames.DONE, 1000)
    found = struct.unpack("<" + "q8s" * 4, told[frames.FRAMES:].tobytes())
    for (_, data, time_ns, _, _), stamp, got in zip(INPUTS, found[::2], found[1::2], strict=True):
        assert (stamp, got[:len(data)]) == (time_ns, data)
    assert told[frames.BEATS] == 1
    assert told[frames.BEAT:frames.BEAT + 3].tolist() == [BEAT[0], BEAT[2], 5]
    assert heeded([each for each in batch if each is not inputs[0]])[0] == frames.WAITING


@pytest.mark.parametrize("place", range(6))
def test_what_the_socket_itself_has_sent_is_passed_over(place: int) -> None:
    for frame in ((0x201, bytes(8), 1, 2, 0), (HEARTBEAT_BASE + 127, b"\5", 1, 2, 0)):
        batch: list[Frame] = [SYNC, *INPUTS]
        batch.insert(place, frame)
        assert heeded(batch)[0] == frames.DONE


STRANGE: list[tuple[str, Frame]] = [
    ("a second SYNC", SYNC), ("an input twice", INPUTS[2]), ("EMCY", (0x81, bytes(8), 1, False, 0)),
    ("boot-up", (HEARTBEAT_BASE + KNEE, b"\0", 1, False, 0)),
    ("another node", (HEARTBEAT_BASE + 9, b"\5", 1, False, 0)),
    ("another master", (HEARTBEAT_BASE + 127, b"\5", 1, False, 0)), ("targets", (0x201, bytes(8), 1, False, 0)),
    ("targets from here", (0x201, bytes(8), 1, 1, 0)),
    ("an extended frame", (SYNC_COB_ID | frames.EFF, b"", 1, False, 0)),
    ("an error frame", (0x20000004, bytes(8), 1, False, 0)), ("SDO", (0x581, bytes(8), 1, False, 0)),
    ("a remote frame", (TPDO_BASE + END | frames.RTR, bytes(2), 1, False, 0)),
]


@pytest.mark.parametrize(("what", "frame"), STRANGE, ids=[what for what, _ in STRANGE])
def test_whatever_else_comes_is_left_to_be_received_singly(what: str, frame: Frame) -> None:
    assert heeded([SYNC, *INPUTS[:3], frame, INPUTS[3]])[0] == frames.STRANGE


def test_a_foreign_sync_a_short_input_and_one_before_sync_are_left_too() -> None:
    assert heeded([(*SYNC[:3], False, 0), *INPUTS])[0] == frames.STRANGE
    assert heeded([SYNC, (INPUTS[0][0], bytes(7), 1, False, 0), *INPUTS[1:]])[0] == frames.STRANGE
    assert heeded([INPUTS[0], SYNC, *INPUTS[1:]])[0] == frames.STRANGE
