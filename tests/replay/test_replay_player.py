"""The player's table, its times, and the virtual bus it plays on."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bowden.replay.player import Outlet, Player, Schedule, Selection, plan, play_out
from eds.cia301 import Frame
from parameters import InputError
from trial.convert.frames import rows_of
from trial.playback import TRANSITIONS, PlayerControl, PlayerStatus
from trial.read import Trial
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.station import Station

US, MS = 1_000, 1_000_000
CHANNELS = itertools.count()


def schedule(times_ms: list[float]) -> Schedule:
    rows = rows_of([(round(at * MS), 0x180 + i, 0, 1, 0, False, bytes([i])) for i, at in enumerate(times_ms)])
    return plan(rows, Selection())


class Watch:
    """A player whose frames are noted with the time they were sent at."""

    def __init__(self, times_ms: list[float], **options: float) -> None:
        self.now_ns = 1_000 * MS
        self.sent: list[tuple[float, int]] = []
        self.player = Player(schedule(times_ms), self._send, **options)  # type: ignore[arg-type]

    def _send(self, frame: Frame, channel: int) -> None:
        self.sent.append(((self.now_ns - 1_000 * MS) / MS, frame.can_id - 0x180))

    def run(self, until_ms: float = 1e6) -> list[tuple[float, int]]:
        """Let time pass to when the player wants it; returns what was sent meanwhile."""
        before = len(self.sent)
        while (due := self.player.next_ns()) is not None and due <= 1_000 * MS + until_ms * MS:
            self.now_ns = max(self.now_ns, due)
            self.player.poll(self.now_ns)
        if until_ms < 1e6:
            self.now_ns = 1_000 * MS + round(until_ms * MS)
        return self.sent[before:]


@pytest.fixture
def wire() -> Iterator[tuple[BowdenBus, list[tuple[int, Frame]]]]:
    """A bus with one listener, and what it heard."""
    heard: list[tuple[int, Frame]] = []
    bench = Bench([], master_turnaround_ns=0)
    bench.wire.attach(Station("listener", lambda frame, now_ns: heard.append((now_ns, frame))))
    bus = BowdenBus(f"replay-{next(CHANNELS)}", bench=bench)
    yield bus, heard
    bus.shutdown()


def test_the_table_has_every_status_and_control() -> None:
    assert {status for status, _ in TRANSITIONS} == set(PlayerStatus)
    assert {control for _, control in TRANSITIONS} == set(PlayerControl)


@pytest.mark.parametrize(("speed", "expected"), [
    (1.0, [(0, 0), (1, 1), (3, 2)]), (2.0, [(0, 0), (0.5, 1), (1.5, 2)]), (0.25, [(0, 0), (4, 1), (12, 2)])])
def test_frames_keep_their_times_at_any_speed(speed: float, expected: list[tuple[float, int]]) -> None:
    watch = Watch([0, 1, 3], speed=speed)
    watch.player.play(watch.now_ns)
    assert watch.run() == expected
    assert watch.player.status is PlayerStatus.ENDED


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=20), st.integers(1, 7))
@settings(deadline=None, max_examples=50)
def test_it_is_played_exactly_so_often(times_ns: list[int], loops: int) -> None:
    watch = Watch([at / MS for at in sorted(times_ns)], loops=loops)
    watch.player.play(watch.now_ns)
    sent = watch.run()
    assert [frame for _, frame in sent] == list(range(len(times_ns))) * loops
    first = [at for at, frame in sent if frame == 0]
    length = watch.player.schedule.length_ns
    assert [round((at - first[0]) * MS) for at in first] == [length * i for i in range(loops)]


def test_pause_holds_the_position_and_play_goes_on_from_it() -> None:
    watch = Watch([0, 1, 3, 6])
    player = watch.player
    player.play(watch.now_ns)
    watch.run(2)
    player.pause(watch.now_ns)
    assert player.status is PlayerStatus.PAUSED
    assert player.next_ns() is None
    assert player.position_ns(watch.now_ns + 99 * MS) == 2 * MS
    assert watch.run(50) == []
    player.play(watch.now_ns)
    assert watch.run() == [(51, 2), (54, 3)]


def test_steps_send_one_frame_each_and_end() -> None:
    watch = Watch([0, 1, 3], loops=2)
    frames = [watch.player.step() for _ in range(7)]
    assert [frame.can_id - 0x180 if frame else None for frame in frames] == [0, 1, 2, 0, 1, 2, None]
    assert watch.player.status is PlayerStatus.ENDED
    assert watch.player.step() is None
    assert watch.player.lateness().frames == 0


def test_a_step_interrupts_playing() -> None:
    watch = Watch([0, 1, 3])
    watch.player.play(watch.now_ns)
    watch.run(0.5)
    assert watch.player.step() == Frame(0x181, b"\x01")
    assert watch.player.status is PlayerStatus.PAUSED
    watch.player.play(watch.now_ns)
    assert watch.run() == [(2.5, 2)]


def test_seek_sends_the_last_pdos_and_goes_on_there() -> None:
    watch = Watch([0, 1, 3, 6])
    watch.player.play(watch.now_ns)
    watch.run(0.5)
    restored = watch.player.seek(2 * MS, watch.now_ns)
    assert [frame.can_id for frame in restored] == [0x181]  # 180h is no PDO
    assert watch.player.status is PlayerStatus.PLAYING
    assert watch.run() == [(1.5, 2), (4.5, 3)]
    watch.player.seek(3 * MS, watch.now_ns)
    assert watch.player.status is PlayerStatus.PAUSED
    watch.player.play(watch.now_ns)
    assert [frame for _, frame in watch.run()] == [2, 3]


def test_a_player_that_has_ended_sends_nothing_and_plays_again_from_the_start() -> None:
    watch = Watch([0, 1], loops=2)
    watch.player.play(watch.now_ns)
    assert [frame for _, frame in watch.run()] == [0, 1, 0, 1]
    assert watch.player.status is PlayerStatus.ENDED
    assert watch.player.next_ns() is None
    watch.player.play(watch.now_ns)
    assert [frame for _, frame in watch.run()] == [0, 1, 0, 1]


def test_lateness_is_reported_as_median_p99_and_max() -> None:
    watch = Watch([float(i) for i in range(200)])
    player = watch.player
    player.play(watch.now_ns)
    for i in range(200):
        late = 5 * US if i < 198 else 40 * US if i == 198 else 900 * US
        player.poll(1_000 * MS + i * MS + late)
    assert player.lateness() == (200, 5 * US, 5 * US, 900 * US)
    player.poll(2_000 * MS)
    assert player.status is PlayerStatus.ENDED


@pytest.mark.parametrize("options", [{"speed": 0.0}, {"speed": -1.0}, {"speed": float("nan")}, {"loops": 0}])
def test_what_cannot_be_played_is_refused(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match="expected"):
        Watch([0, 1], **options)
    with pytest.raises(InputError, match="seek to 3 s"):
        Watch([0, 1]).player.seek(3_000 * MS, 0)


def test_in_virtual_time_nothing_is_late_and_frames_are_where_they_were(
    recorded: Callable[..., Trial], wire: tuple[BowdenBus, list[tuple[int, Frame]]]
) -> None:
    bus, heard = wire
    trial = recorded()
    part = plan(trial.frames, Selection(direction="tx", from_s=5.0, to_s=5.2))
    outlet = Outlet({}, bus)
    player = Player(part, outlet.send)
    began = bus.time_ns()
    player.play(began)
    play_out(player, bus, bus.time_ns)
    assert outlet.lost == 0
    assert player.lateness()[1:] == (0, 0, 0)
    assert [frame.can_id for _, frame in heard] == part.frames["can_id"].tolist()
    assert [frame.data for _, frame in heard] == [
        row["data"][:row["dlc"]].tobytes() for row in part.frames]
    ends = np.array([at for at, _ in heard]) - began
    assert (ends - part.times > 0).all()
    assert (ends - part.times <= 135 * US).all()  # the longest frame of 8 bytes at 1 Mbit/s


def test_channels_are_mapped_to_their_buses(wire: tuple[BowdenBus, list[tuple[int, Frame]]]) -> None:
    bus, heard = wire
    rows = rows_of([(i * MS, 0x180 + i, 0, 0, i % 3, False, b"") for i in range(6)])
    outlet = Outlet({2: bus})
    player = Player(plan(rows, Selection(channels=frozenset({2}))), outlet.send)
    player.play(bus.time_ns())
    play_out(player, bus, bus.time_ns)
    assert [frame.can_id for _, frame in heard] == [0x182, 0x185]


def test_what_a_bus_does_not_take_is_counted() -> None:
    bus = BowdenBus(f"replay-{next(CHANNELS)}", bench=Bench([]))  # nobody acknowledges
    outlet = Outlet({}, bus)
    rows = rows_of([(i * US, 0x181, 0, 0, 0, False, b"") for i in range(100)])
    player = Player(plan(rows, Selection()), outlet.send)
    player.play(bus.time_ns())
    play_out(player, bus, bus.time_ns)
    bus.shutdown()
    assert 0 < outlet.lost < 100
