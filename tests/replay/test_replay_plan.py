"""Which frames are played, when, and what restores the bus: pure, from rows."""

from __future__ import annotations

import numpy as np
import pytest

from bowden.replay.player import Selection, nmt_states, nodes_of, plan, restoration
from eds.cia301 import Frame, NmtCommand, NmtState
from parameters import InputError
from trial.convert.frames import rows_of
from trial.mcap_file.cdr import ERROR, EXTENDED, REMOTE

MS = 1_000_000
START_ALL, STOP_2 = bytes((NmtCommand.START, 0)), bytes((NmtCommand.STOP, 2))


def row(at_ms: float, can_id: int, data: bytes = b"", *, sent: bool = False, flags: int = 0, channel: int = 0):
    return round(at_ms * MS) + 7_000, can_id, flags, len(data), channel, sent, data


RECORDING = rows_of([
    row(0, 0x701, b"\x00"), row(0, 0x702, b"\x00"), row(1, 0x000, START_ALL, sent=True),
    row(2, 0x080, sent=True), row(2.1, 0x181, b"\x01"), row(2.2, 0x182, b"\x02"), row(2.3, 0x201, b"\x03", sent=True),
    row(3, 0x080, sent=True), row(3.1, 0x181, b"\x04"), row(3.2, 0x182, b"\x05"), row(3.3, 0x201, b"\x06", sent=True),
    row(4, 0x000, STOP_2, sent=True), row(4.5, 0x088, b"\x02\x00", flags=ERROR),
    row(5, 0x080, sent=True), row(5.1, 0x181, b"\x07"), row(6, 0x701, b"\x7f"), row(7, 0x18DAF110, flags=EXTENDED),
    row(8, 0x181, b"\x00\x00", flags=REMOTE, channel=1),
])


def ids(selection: Selection) -> list[int]:
    return plan(RECORDING, selection).frames["can_id"].tolist()


def test_everything_but_error_frames_is_played_in_its_own_time() -> None:
    whole = plan(RECORDING, Selection())
    assert len(whole) == len(RECORDING) - 1
    assert whole.left_out == {"error_frames": 1}
    kept = RECORDING[RECORDING["flags"] != ERROR]
    assert whole.times.tolist() == (kept["time_ns"] - RECORDING["time_ns"][0]).tolist()
    assert whole.length_ns == 8 * MS


@pytest.mark.parametrize(("selection", "expected"), [
    (Selection(nodes=frozenset({2})), [0x702, 0x182, 0x182]),
    (Selection(nodes=frozenset({0})), [0x000, 0x080, 0x080, 0x000, 0x080]),
    (Selection(cob_ids=frozenset({0x201, 0x702})), [0x702, 0x201, 0x201]),
    (Selection(direction="tx"), [0x000, 0x080, 0x201, 0x080, 0x201, 0x000, 0x080]),
    (Selection(direction="rx", nodes=frozenset({1})), [0x701, 0x181, 0x181, 0x181, 0x701, 0x181]),
    (Selection(channels=frozenset({1})), [0x181]),
    (Selection(from_s=0.0031, to_s=0.0033), [0x181, 0x182, 0x201]),
])
def test_filters_and_window_choose(selection: Selection, expected: list[int]) -> None:
    assert ids(selection) == expected


def test_the_window_begins_at_zero_and_keeps_what_was_before() -> None:
    part = plan(RECORDING, Selection(from_s=0.003, to_s=0.005))
    assert part.times.tolist() == [0, 100_000, 200_000, 300_000, 1_000_000, 2_000_000]
    assert part.length_ns == 2 * MS
    assert len(part.before) == 7


def test_a_lead_sends_earlier_never_before_the_window() -> None:
    part = plan(RECORDING, Selection(from_s=0.003, to_s=0.005), lead_ns=100_000)
    assert part.times.tolist() == [0, 0, 100_000, 200_000, 900_000, 1_900_000]


def test_nodes_are_those_of_the_predefined_connection_set() -> None:
    assert nodes_of(RECORDING).tolist() == [1, 2, 0, 0, 1, 2, 1, 0, 1, 2, 1, 0, 8, 0, 1, 1, -1, 1]


def test_nmt_states_follow_commands_and_heartbeats() -> None:
    operational, stopped, pre = NmtState.OPERATIONAL, NmtState.STOPPED, NmtState.PRE_OPERATIONAL
    booted = NmtState.INITIALISING
    assert nmt_states(RECORDING[:2]) == {1: booted, 2: booted}
    assert nmt_states(RECORDING[:3]) == {1: operational, 2: operational}
    assert nmt_states(RECORDING[:12]) == {1: operational, 2: stopped}
    assert nmt_states(RECORDING) == {1: pre, 2: stopped}


def test_the_bus_is_restored_by_nmt_commands_and_the_last_pdo_of_each_cob_id() -> None:
    part = plan(RECORDING, Selection(from_s=0.004))
    assert restoration(part, 1) == [
        (Frame(0x000, bytes((NmtCommand.START, 1))), 0), (Frame(0x000, bytes((NmtCommand.STOP, 2))), 0),
        (Frame(0x181, b"\x04"), 0), (Frame(0x182, b"\x05"), 0), (Frame(0x201, b"\x06"), 0),
    ]
    assert restoration(part, 0)[1][0].data == bytes((NmtCommand.START, 2))
    masters = plan(RECORDING, Selection(from_s=0.0035, direction="rx"))
    assert [frame.can_id for frame, _ in restoration(masters, 0)] == [0x000, 0x000, 0x181, 0x182]


@pytest.mark.parametrize(("selection", "why"), [
    (Selection(from_s=1.0), "recording's length"), (Selection(from_s=0.005, to_s=0.004), "from ≤ to"),
    (Selection(from_s=-0.1), "0 ≤ from"), (Selection(direction="up"), "rx, tx or both"),
    (Selection(nodes=frozenset({9})), "no recorded frame passes"),
])
def test_what_cannot_be_played_is_refused(selection: Selection, why: str) -> None:
    with pytest.raises(InputError, match=why):
        plan(RECORDING, selection)
    with pytest.raises(InputError, match="holds no CAN frames"):
        plan(RECORDING[:0], selection)


def test_a_filter_that_only_meets_error_frames_has_nothing_to_play() -> None:
    with pytest.raises(InputError, match="no recorded frame passes"):
        plan(RECORDING, Selection(cob_ids=frozenset({0x088})))
    assert np.count_nonzero(RECORDING["can_id"] == 0x088) == 1
