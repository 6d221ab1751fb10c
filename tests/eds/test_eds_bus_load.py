"""Frame lengths, load and response times: against the literature, and against a bus played out."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

import eds
from eds.bench import bus_load
from eds.bench.bench_network import Network
from eds.bench.bus_load import Kind, Stream, frame_bits, response_ns
from parameters import InputError


def stuffed_bits(stream):
    """Stuff bits that a transmitter adds: one after five equal bits, itself counting as the first of the next run."""
    count, run, last = 0, 0, None
    for bit in stream:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, run, last = count + 1, 1, 1 - bit
    return count


@pytest.mark.parametrize("size", range(9))
def test_worst_frame_is_55_plus_10_n_and_some_bit_pattern_reaches_it(size):
    stuffable = 34 + 8 * size
    pattern = [0] * 5 + [bit for block in itertools.repeat([1] * 4 + [0] * 4, stuffable) for bit in block]
    assert frame_bits(size) == 55 + 10 * size == stuffable + 13 + stuffed_bits(pattern[:stuffable])


@given(st.integers(0, 8), st.data())
def test_no_bit_pattern_needs_more(size, data):
    stuffable = 34 + 8 * size
    pattern = data.draw(st.lists(st.integers(0, 1), min_size=stuffable, max_size=stuffable))
    assert stuffable + 13 + stuffed_bits(pattern) <= frame_bits(size)


def test_the_design_s_budget():
    wire = eds.wire(Network())
    cyclic = sum(s.bits() for s in bus_load.streams(wire) if s.kind is Kind.CYCLIC)
    assert cyclic == 590
    assert bus_load.load_percent(wire) == pytest.approx(59.865)
    found = bus_load.refuse(wire)
    assert found.load_percent < bus_load.LOAD_GOAL_PERCENT
    assert (found.inputs_ns, found.targets_ns, found.deadline_ns) == (655_000, 230_000, 670_000)


def test_the_refutation_example_of_davis_2007():
    """Section 3.2: three messages of 1 ms, periods 2.5, 3.5 and 3.5 ms; the second instance of C is the late one.

    Here a millisecond is the 135 bits of an 8-byte frame, 270 ns at 2 ns a bit.
    """
    periods = (675, 945, 945)
    streams = [Stream("ABC"[i], i, 8, period, Kind.CYCLIC) for i, period in enumerate(periods)]
    assert [response_ns(s, streams, 2) / 270 for s in streams] == [2.0, 3.0, 3.5]


def play(streams, offsets, bit, horizon):
    """Worst time from queueing to end of each stream on a bus that always sends the least identifier waiting."""
    pending = sorted((offset + n * s.period_ns, s.can_id, i)
                     for i, (s, offset) in enumerate(zip(streams, offsets, strict=True))
                     for n in range(horizon // s.period_ns))
    worst, now = [0] * len(streams), 0
    while pending:
        ready = [row for row in pending if row[0] <= now]
        if not ready:
            now = pending[0][0]
            continue
        release, _, i = chosen = min(ready, key=lambda row: (row[1], row[0]))
        pending.remove(chosen)
        now += streams[i].bits() * bit
        worst[i] = max(worst[i], now - release)
    return worst


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(5, 40), st.integers(0, 40)), min_size=1, max_size=5))
def test_no_played_bus_is_later_than_its_bound(rows):
    streams = [Stream(str(i), i, size, period * 100, Kind.CYCLIC) for i, (size, period, _) in enumerate(rows)]
    seen = play(streams, [offset * 50 for *_, offset in rows], 1, 40_000)
    for stream, worst in zip(streams, seen, strict=True):
        bound = response_ns(stream, streams, 1)
        assert bound is None or worst <= bound


def test_a_stream_that_never_gets_through_has_no_bound():
    streams = [Stream("fills", 1, 8, 135, Kind.CYCLIC), Stream("waits", 2, 0, 10_000, Kind.CYCLIC)]
    assert response_ns(streams[0], streams, 1) is None
    assert response_ns(streams[1], streams, 1) is None


@pytest.mark.parametrize("network", [
    Network(bitrate=500_000), Network(bitrate=125_000, rate_hz=200), Network(compute_budget_us=200),
    Network(node_turnaround_us=100),
])
def test_a_network_that_cannot_keep_its_deadline_is_refused(network):
    with pytest.raises(InputError, match=rf"rate_hz = {network.rate_hz} at bitrate = {network.bitrate}.*is due at"):
        bus_load.refuse(eds.wire(network))


@pytest.mark.parametrize("network", [Network(bitrate=500_000, rate_hz=500), Network(bitrate=125_000, rate_hz=100)])
def test_a_slower_bus_carries_a_slower_cycle(network):
    found = bus_load.refuse(eds.wire(network))
    assert found.inputs_ns <= found.deadline_ns < 1_000_000_000 // network.rate_hz


def test_every_stream_of_the_bench_has_a_bound():
    responses = bus_load.budget(eds.wire(Network())).responses
    assert [stream.can_id for stream, _ in responses] == sorted(stream.can_id for stream, _ in responses)
    assert all(bound is not None and bound >= stream.bits() * 1000 for stream, bound in responses)
    assert {stream.kind for stream, _ in responses} == set(Kind)
