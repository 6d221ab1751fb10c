"""Frame bits: CRC check value, stuffing, the worst case, and the compiled count against the written-out frame."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eds.cia301 import Frame
from virtual_bus.wire import bit_counts, bits

IDS = st.integers(0, 0x7FF)
DATA = st.binary(max_size=8) | st.integers(0, 8).flatmap(
    lambda n: st.sampled_from([b"\x00", b"\xff", b"\x0f", b"\x78", b"\x1e"]).map(lambda b: b * n)
)


def frames() -> st.SearchStrategy[Frame]:
    base = st.tuples(IDS, DATA).map(lambda t: Frame(*t))
    extended = st.tuples(st.integers(0, 0x1FFFFFFF), DATA).map(lambda t: Frame(*t, extended=True))
    remote = st.tuples(IDS, st.integers(0, 8)).map(lambda t: Frame(t[0], remote=True, dlc=t[1]))
    return base | extended | remote


def test_crc_has_the_catalogued_check_value() -> None:
    """CRC-15/CAN of the nine characters 123456789 is 0x059E in every catalogue of CRCs."""
    message = [byte >> place & 1 for byte in b"123456789" for place in reversed(range(8))]
    assert bits.crc15(message) == 0x059E


def test_a_frame_written_out_by_hand() -> None:
    """Identifier 0 without data: from SOF to the CRC 34 zeros, a stuff bit after every fifth."""
    assert bits.sequence(Frame(0)) == [0, 0, 0, 0, 0, 1] * 6 + [0] * 4 + [1] * 10
    assert bits.frame_bits(Frame(0)) == 50


def test_stuff_bits_count_towards_the_next_run() -> None:
    """Five zeros, a stuff bit 1, and four more ones make five: another stuff bit, 0."""
    assert bits.sequence(Frame(0b00001111000, remote=True, dlc=0))[:11] == [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0]


@given(frames())
def test_the_count_is_the_length_of_the_sequence(frame: Frame) -> None:
    assert bits.frame_bits(frame) == len(bits.sequence(frame))


@given(st.lists(frames(), max_size=20))
def test_many_frames_at_once_count_as_each_does(many: list[Frame]) -> None:
    dlc = [len(frame.data) if frame.dlc is None else frame.dlc for frame in many]
    data = np.frombuffer(b"".join(frame.data.ljust(8, b"\xaa") for frame in many), np.uint8).reshape(-1, 8)
    counts = bit_counts.bits_of(
        [frame.can_id for frame in many], dlc, data, [frame.remote for frame in many],
        [frame.extended for frame in many])
    assert counts.tolist() == [bits.frame_bits(frame) for frame in many]


@given(frames())
def test_six_equal_bits_never_follow_each_other_before_the_trailer(frame: Frame) -> None:
    stuffed = bits.sequence(frame)[: -bits.TRAILER_BITS]
    assert max(len(list(run)) for _, run in itertools.groupby(stuffed)) <= 5


@given(frames())
def test_a_receiver_gets_the_fields_and_a_crc_that_agrees(frame: Frame) -> None:
    plain = destuff(bits.sequence(frame)[: -bits.TRAILER_BITS])
    value, width = bits.header(frame)
    assert int("".join(map(str, plain[:width])), 2) == value
    assert bits.crc15(plain) == 0  # the remainder of a message with its own CRC behind it
    payload = plain[width:-15]
    assert int("".join(map(str, payload)) or "0", 2) == int.from_bytes(b"" if frame.remote else frame.data, "big")


def destuff(stuffed: list[int]) -> list[int]:
    plain: list[int] = []
    run, last = 0, -1
    for bit in stuffed:
        if run == 5:
            run, last = 1, bit
            continue
        run = run + 1 if bit == last else 1
        last = bit
        plain.append(bit)
    return plain


@given(IDS, DATA)
def test_no_frame_exceeds_the_worst_case(can_id: int, data: bytes) -> None:
    least, most = 47 + 8 * len(data), 55 + 10 * len(data)
    assert least <= bits.frame_bits(Frame(can_id, data)) + bits.INTERMISSION_BITS <= most


@given(IDS, IDS, st.booleans(), st.booleans())
def test_arbitration_is_what_a_wired_and_decides(a: int, b: int, remote_a: bool, remote_b: bool) -> None:
    """The frame whose first differing bit is dominant wins."""
    one, other = Frame(a, remote=remote_a), Frame(b, remote=remote_b)
    if (a, remote_a) != (b, remote_b):
        assert (bits.arbitration(one) < bits.arbitration(other)) == (bits.sequence(one) < bits.sequence(other))


@given(IDS, st.integers(0, 0x1FFFFFFF))
def test_base_format_wins_over_extended_with_the_same_beginning(base: int, extended: int) -> None:
    one, other = Frame(base), Frame(base << 18 | extended & 0x3FFFF, extended=True)
    assert bits.arbitration(one) < bits.arbitration(other)
    assert bits.sequence(one) < bits.sequence(other)


def test_first_difference_is_where_the_written_frames_part() -> None:
    assert bits.first_difference(Frame(0x100, b"\x00"), Frame(0x500, b"\x00")) == 2
