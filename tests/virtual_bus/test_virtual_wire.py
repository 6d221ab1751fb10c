"""The wire: who wins, how long it takes, and what errors cost."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eds.cia301 import Frame
from virtual_bus.kernel import Kernel
from virtual_bus.wire import bits
from virtual_bus.wire.station import Confinement, Station
from virtual_bus.wire.wire import Wire

SENDINGS = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 400_000)), max_size=12
)


def test_arbitration_by_identifier_and_data_before_remote(listeners: Any) -> None:
    net = listeners(4)
    for station, frame in zip(net.stations, [Frame(0x300), Frame(0x200, remote=True), Frame(0x200, b"\x01")],
                              strict=False):
        station.submit(frame, 0)
    net.kernel.run(1_000_000)
    assert [(frame.can_id, frame.remote) for _, frame in net.heard[3]] == [
        (0x200, False), (0x200, True), (0x300, False)]


def test_a_frame_that_becomes_ready_during_another_takes_part_in_the_next_arbitration(listeners: Any) -> None:
    net = listeners(4)
    net.stations[0].submit(Frame(0x100, bytes(8)), 0)
    net.stations[1].submit(Frame(0x7FF), 1_000)
    net.stations[2].submit(Frame(0x080), 100_000)
    net.kernel.run(1_000_000)
    assert [frame.can_id for _, frame in net.heard[3]] == [0x100, 0x080, 0x7FF]


@pytest.mark.parametrize("bitrate", bits.BITRATES)
def test_a_frame_lasts_its_bits(listeners: Any, bitrate: int) -> None:
    net, frame = listeners(2, bitrate), Frame(0x181, bytes(range(8)))
    net.stations[0].submit(frame, 5_000)
    net.kernel.run(10_000_000)
    assert net.heard[1] == [(5_000 + bits.frame_bits(frame) * 1_000_000_000 // bitrate, frame)]


def test_the_intermission_is_three_bits(listeners: Any) -> None:
    net, frame = listeners(2), Frame(0x181)
    net.stations[0].submit(frame, 0)
    net.stations[0].submit(frame, 0)
    net.kernel.run(1_000_000)
    (first, _), (second, _) = net.heard[1]
    assert second - first == (bits.frame_bits(frame) + 3) * 1_000


def test_an_unknown_bit_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="123"):
        Wire(Kernel(), 123)


@given(SENDINGS)
def test_frames_never_overlap_and_none_is_lost(sendings: list[tuple[int, int, bytes, int]]) -> None:
    """Distinct identifiers: with equal ones two stations would collide."""
    distinct = {can_id: (place, can_id, data, ready) for place, can_id, data, ready in sendings}
    kernel = Kernel()
    wire = Wire(kernel, 1_000_000)
    ends: list[tuple[int, Frame]] = []
    stations = [Station(f"{i}", lambda frame, now_ns: None) for i in range(4)]
    tap = Station("tap", lambda frame, now_ns: ends.append((now_ns, frame)))
    for station in (*stations, tap):
        wire.attach(station)
    for place, can_id, data, ready in distinct.values():
        stations[place].submit(Frame(can_id, data), ready)
    kernel.run(10_000_000)
    assert sorted(frame.can_id for _, frame in ends) == sorted(distinct)
    idle_ns = 0
    waiting = dict(distinct)
    for end_ns, frame in ends:
        start_ns = end_ns - bits.frame_bits(frame) * 1_000
        assert start_ns == max(idle_ns, min(ready for *_, ready in waiting.values()))
        contenders = [can_id for can_id, (*_, ready) in waiting.items() if ready <= start_ns]
        assert frame.can_id == min(contenders)
        del waiting[frame.can_id]
        idle_ns = end_ns + 3_000
    assert wire.busy_bits == sum(bits.frame_bits(frame) + 3 for _, frame in ends)


def test_a_full_queue_refuses_and_counts(listeners: Any) -> None:
    net = listeners(2)
    net.stations[0].limit = 3
    assert [net.stations[0].submit(Frame(0x100 + i), 0) for i in range(5)] == [True, True, True, False, False]
    net.kernel.run(1_000_000)
    assert (net.stations[0].lost, len(net.heard[1])) == (2, 3)
    assert net.stations[0].submit(Frame(0x100), net.kernel.now_ns)


def test_a_fifo_station_lets_the_oldest_contend_and_others_the_most_important(listeners: Any) -> None:
    for fifo, expected in ((True, [0x300, 0x100]), (False, [0x100, 0x300])):
        net = listeners(2)
        net.stations[0].fifo = fifo
        net.stations[0].submit(Frame(0x300), 0)
        net.stations[0].submit(Frame(0x100), 0)
        net.kernel.run(1_000_000)
        assert [frame.can_id for _, frame in net.heard[1]] == expected


def test_filters_select_base_identifiers_and_may_change(listeners: Any) -> None:
    net = listeners(2)
    net.stations[1].filters = frozenset({0x181})
    net.wire.reroute()
    for frame in (Frame(0x181), Frame(0x182), Frame(0x181, extended=True)):
        net.stations[0].submit(frame, net.kernel.now_ns)
    net.kernel.run(1_000_000)
    net.stations[1].filters = frozenset({0x182})
    net.wire.reroute()
    net.stations[0].submit(Frame(0x182), net.kernel.now_ns)
    net.kernel.run(2_000_000)
    assert [frame for _, frame in net.heard[1]] == [Frame(0x181), Frame(0x182)]


def test_without_anyone_to_acknowledge_the_transmitter_turns_passive_and_stays(listeners: Any) -> None:
    net = listeners(1)
    net.stations[0].submit(Frame(0x181), 0)
    net.kernel.run(50_000_000)
    assert (net.stations[0].tec, net.stations[0].state) == (128, Confinement.PASSIVE)
    assert net.wire.errors > 16
    late = Station("late", lambda frame, now_ns: net.heard.append([(now_ns, frame)]))
    net.wire.attach(late)
    net.kernel.run(51_000_000)
    assert net.heard[-1][0][1] == Frame(0x181)
    assert net.stations[0].tec < 128


def test_who_only_listens_acknowledges_nothing(listeners: Any) -> None:
    net = listeners(2)
    net.stations[1].listen_only = True
    net.wire.reroute()
    net.stations[0].submit(Frame(0x181), 0)
    net.kernel.run(5_000_000)
    assert net.heard[1] == []
    assert net.wire.errors > 0


def test_equal_identifiers_with_other_data_drive_both_stations_off_the_bus(listeners: Any) -> None:
    net = listeners(3)
    net.stations[0].submit(Frame(0x181, b"\x01"), 0)
    net.stations[1].submit(Frame(0x181, b"\x02"), 0)
    net.kernel.run(3_000_000)
    assert [station.state for station in net.stations] == [
        Confinement.BUS_OFF, Confinement.BUS_OFF, Confinement.ACTIVE]
    assert net.heard[2] == []
    assert not net.stations[0].submit(Frame(0x182), net.kernel.now_ns)


def test_equal_frames_of_two_stations_are_one_on_the_wire(listeners: Any) -> None:
    """Two masters that send SYNC in the same bit time notice nothing."""
    net = listeners(3)
    net.stations[0].submit(Frame(0x080), 0)
    net.stations[1].submit(Frame(0x080), 0)
    net.kernel.run(1_000_000)
    assert [len(heard) for heard in net.heard] == [0, 0, 1]
    assert net.wire.errors == 0


def test_bus_off_ends_after_128_times_11_bits(listeners: Any) -> None:
    net = listeners(3)
    net.stations[0].submit(Frame(0x181, b"\x01"), 0)
    net.stations[1].submit(Frame(0x181, b"\x02"), 0)
    while net.stations[0].state is not Confinement.BUS_OFF:
        net.kernel.run(net.kernel.next_ns())
    free_ns = net.kernel.now_ns + 1408 * 1_000
    net.kernel.run(free_ns - 1)
    assert net.stations[0].state is Confinement.BUS_OFF
    net.kernel.run(free_ns)
    assert (net.stations[0].state, net.stations[0].tec) == (Confinement.ACTIVE, 0)
    assert net.stations[0].submit(Frame(0x181), free_ns)


def test_a_passive_transmitter_lets_others_go_first(listeners: Any) -> None:
    net = listeners(3)
    net.stations[0].tec = 200
    net.stations[0].state = Confinement.PASSIVE
    net.wire.detach(net.stations[0])
    net.wire.attach(net.stations[0])
    for _ in range(2):
        net.stations[0].submit(Frame(0x100), 0)
    net.stations[1].submit(Frame(0x200), 0)
    net.kernel.run(1_000_000)
    assert [frame.can_id for _, frame in net.heard[2]] == [0x100, 0x200, 0x100]


def test_error_counters_fall_by_one_for_each_good_frame(listeners: Any) -> None:
    net = listeners(2)
    net.stations[0].tec, net.stations[1].rec = 5, 3
    net.wire.detach(net.stations[0])
    net.wire.attach(net.stations[0])
    for i in range(4):
        net.stations[0].submit(Frame(0x100 + i), 0)
    net.kernel.run(1_000_000)
    assert (net.stations[0].tec, net.stations[1].rec) == (1, 0)


def test_a_station_taken_off_in_its_frame_takes_the_frame_along(listeners: Any) -> None:
    net = listeners(3)
    net.stations[0].submit(Frame(0x100, bytes(8)), 0)
    net.kernel.run(20_000)
    assert [entry[3] for entry in net.wire.detach(net.stations[0])] == [Frame(0x100, bytes(8))]
    net.stations[1].submit(Frame(0x200), net.kernel.now_ns)
    net.kernel.run(1_000_000)
    assert [frame.can_id for _, frame in net.heard[2]] == [0x200]


def test_flushing_keeps_the_frame_that_is_on_the_wire(listeners: Any) -> None:
    net = listeners(2)
    for i in range(3):
        net.stations[0].submit(Frame(0x100 + i), 0)
    net.kernel.run(10_000)
    net.wire.flush(net.stations[0])
    net.kernel.run(1_000_000)
    assert ([frame.can_id for _, frame in net.heard[1]], net.stations[0].waiting) == ([0x100], 0)
