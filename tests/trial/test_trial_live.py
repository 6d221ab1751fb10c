"""The player as a table of states on a handed-in clock, its tape, and the follower of a running bus."""

from __future__ import annotations

import math

import numpy as np
import pytest
from example_trials import PERIOD_NS
from hypothesis import given
from hypothesis import strategies as st

from eds.bench.bench_network import Network, wire
from trial import decode
from trial.convert.frames import rows_of
from trial.decode import Follower
from trial.mcap_file import cdr
from trial.playback import LONGEST_NS, SPEEDS, TRANSITIONS, Playback, PlayerControl, PlayerStatus, ready

FIRST, LAST = 1_000_000_000, 3_000_000_000
MS = 1_000_000
VIEWERS = PlayerControl.PLAY, PlayerControl.PAUSE, PlayerControl.WATCH
ALL = frozenset((cdr.CYCLE, cdr.FRAMES, cdr.EVENTS))


def playing(speed: float = 1.0) -> Playback:
    return ready(FIRST, LAST, 0, speed).commanded(0, PlayerControl.WATCH)


def test_it_waits_at_the_start_until_somebody_watches() -> None:
    waiting = ready(FIRST, LAST, 0)
    assert (waiting.status, waiting.advanced(50 * MS).at_ns) == (PlayerStatus.READY, FIRST)
    begun = waiting.advanced(50 * MS).commanded(50 * MS, PlayerControl.WATCH)
    assert begun.status is PlayerStatus.PLAYING
    assert begun.advanced(60 * MS).at_ns == FIRST + 10 * MS


def test_every_pair_of_status_and_control_does_what_the_table_says() -> None:
    for status in PlayerStatus:
        for control in PlayerControl:
            one = Playback(FIRST, LAST, FIRST, 0, FIRST, 0, status)
            assert one.commanded(0, control).status is TRANSITIONS.get((status, control), status)


def test_pause_holds_and_play_goes_on_where_it_stood() -> None:
    paused = playing().advanced(100 * MS).commanded(100 * MS, PlayerControl.PAUSE)
    later = paused.advanced(150 * MS)
    assert later.at_ns == FIRST + 100 * MS
    assert later.commanded(150 * MS, PlayerControl.PLAY).advanced(160 * MS).at_ns == FIRST + 110 * MS


@pytest.mark.parametrize(("asked", "stands"), [(2_000_000_000, 2_000_000_000), (0, FIRST), (9_000_000_000, LAST)])
def test_a_seek_stays_inside_the_trial(asked: int, stands: int) -> None:
    assert playing().commanded(0, PlayerControl.PAUSE, seek_ns=asked).at_ns == stands


@pytest.mark.parametrize(("asked", "speed"), [(4.0, 4.0), (0.0, 1.0), (-2.0, 1.0), (math.nan, 1.0), (math.inf, 1.0),
                                              (1e9, SPEEDS[1]), (1e-9, SPEEDS[0])])
def test_a_speed_is_taken_held_or_left(asked: float, speed: float) -> None:
    assert playing().commanded(0, PlayerControl.PLAY, speed=asked).speed == speed


def test_at_the_end_it_stops_and_begins_again() -> None:
    ended = playing(100.0).advanced(30 * MS)
    assert (ended.status, ended.at_ns) == (PlayerStatus.ENDED, LAST + 1)
    again = ended.commanded(30 * MS, PlayerControl.PLAY)
    assert (again.status, again.at_ns) == (PlayerStatus.PLAYING, FIRST)
    back = ended.commanded(30 * MS, PlayerControl.PAUSE, seek_ns=FIRST + 5)
    assert (back.status, back.at_ns) == (PlayerStatus.PAUSED, FIRST + 5)


def test_who_looks_too_seldom_plays_slower() -> None:
    assert playing().advanced(LONGEST_NS + 700 * MS).at_ns == FIRST + LONGEST_NS


@given(st.lists(st.tuples(st.integers(0, 300 * MS), st.sampled_from(VIEWERS), st.floats(0.1, 20)), max_size=60))
def test_whatever_is_pressed_every_moment_is_played_once(steps: list[tuple[int, PlayerControl, float]]) -> None:
    now, clock, reached = playing(), 0, FIRST
    for wait, control, speed in steps:
        clock += wait
        later = now.advanced(clock)
        assert now.at_ns == reached
        assert later.at_ns >= now.at_ns
        if later.status is PlayerStatus.ENDED:
            assert later.at_ns == LAST + 1
            return
        reached = later.at_ns
        now = later.commanded(clock, control, speed=speed)


def log(cycles: int) -> list[tuple[int, int, bytes]]:
    """A bench's frames with a missing TPDO, a short one and a sensor without a value."""
    bench, found = wire(Network()), []
    rng = np.random.default_rng(3)
    for cycle in range(cycles):
        start = 5_000_000 + cycle * PERIOD_NS + int(rng.integers(0, 900))
        found.append((start, decode.SYNC, b""))
        for place, plan in enumerate((*bench.tpdo.values(), bench.targets)):
            if rng.random() < 0.1:
                continue
            data = rng.integers(0, 256, plan.size, dtype=np.uint8).tobytes()
            if plan.cob_id == 0x183 and cycle % 7 == 0:
                data = (decode.NO_TENSION & 0xFFFF).to_bytes(2, "little")
            found.append((start + 100_000 * (place + 1), plan.cob_id, data[:1] if rng.random() < 0.1 else data))
    return found


def test_following_a_bus_gives_the_rows_that_decoding_its_log_gives() -> None:
    frames, bench = log(200), wire(Network())
    whole = decode.cycles(rows_of([(at, can_id, 0, len(data), 0, False, data) for at, can_id, data in frames]), bench)
    follower = Follower(bench)
    done = [row for row in (follower.frame(*frame) for frame in (*frames, (10**12, decode.SYNC, b""))) if row]
    assert [at for at, _ in done] == whole.time_ns.tolist()
    assert set(whole.columns) == set(follower.names)
    for place, name in enumerate(follower.names):
        followed = np.array([values[place] for _, values in done])
        if name in ("time_s", "servo_velocity_m_s"):  # decode takes differences of times as floats
            np.testing.assert_allclose(followed, whole.columns[name], rtol=1e-9, err_msg=name)
        else:
            np.testing.assert_array_equal(followed, whole.columns[name], err_msg=name)
