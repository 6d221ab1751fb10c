"""The python-can interface: waiting is receiving, sockets share a controller, periodic messages keep time."""

from __future__ import annotations

import argparse
import errno
import itertools
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest
from can.cli import create_bus_from_namespace

from eds.cia301 import Frame
from parameters import InputError
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.bits import frame_bits
from virtual_bus.wire.faults import Fault

Open = Callable[..., BowdenBus]
SYNC = can.Message(arbitration_id=0x080, is_extended_id=False)


@pytest.fixture
def open_bus() -> Iterator[Open]:
    opened: list[BowdenBus] = []
    numbers = itertools.count()

    def open_bus(bench: Bench | None = None, channel: str | None = None, **options: Any) -> BowdenBus:
        name = channel or f"test {next(numbers)}"
        opened.append(BowdenBus(name, bench=bench, **options))
        return opened[-1]

    yield open_bus
    for bus in opened:
        bus.shutdown()


def message(can_id: int, data: bytes = b"", **more: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **more)


def drain(bus: BowdenBus) -> list[can.Message]:
    return list(iter(lambda: bus.recv(0), None))


def test_time_passes_only_in_recv(open_bus: Open) -> None:
    bus = open_bus(Bench())
    assert bus.time_ns() == 0
    assert bus.recv(0) is None
    assert bus.time_ns() == 0
    assert bus.recv(0.25) is None
    assert bus.time_ns() == 250_000_000


def test_recv_returns_at_the_frame_with_its_exact_time(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(3)], node_turnaround_ns=10_000))
    received = bus.recv(1.0)
    assert received is not None
    end_ns = 10_000 + frame_bits(Frame(0x703, b"\x00")) * 1_000
    assert (received.arbitration_id, received.time_ns, bus.time_ns()) == (0x703, end_ns, end_ns)
    assert received.timestamp == end_ns / 1e9
    assert received.is_rx
    assert isinstance(received, can.Message)


def test_recv_zero_takes_only_what_is_there(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(1), echo(2)]))
    bus.recv(1.0)
    now_ns = bus.time_ns()
    assert bus.recv(0) is None
    assert bus.recv(-1.0) is None
    assert bus.time_ns() == now_ns


def test_what_a_bus_sends_leaves_after_the_stated_turnaround(open_bus: Open) -> None:
    bench = Bench(master_turnaround_ns=70_000)
    bus, other = open_bus(bench, "shared"), open_bus(channel="shared")
    bench.wire.attach(_acknowledger())
    bus.send(message(0x201, b"\x01\x02"))
    received = other.recv(1.0)
    assert received is not None
    assert received.time_ns == 70_000 + frame_bits(Frame(0x201, b"\x01\x02")) * 1_000
    assert not received.is_rx
    assert drain(bus) == []


def _acknowledger() -> Any:
    from virtual_bus.wire.station import Station

    return Station("acknowledger", lambda frame, now_ns: None)


def test_own_messages_come_back_where_asked_for(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(1)]), receive_own_messages=True)
    bus.send(message(0x201))
    ids = [bus.recv(0.01), bus.recv(0.01)]
    assert [(m.arbitration_id, m.is_rx) for m in ids if m] == [(0x701, True), (0x201, False)]


def test_buses_on_one_channel_share_the_bench_and_the_message(open_bus: Open, echo: Any) -> None:
    bench = Bench([echo(1)])
    bus, tap = open_bus(bench, "pair"), open_bus(channel="pair")
    assert tap.bench is bench
    received = bus.recv(1.0)
    assert received is not None
    assert tap.recv(0) is received


def test_the_bench_dies_with_its_last_bus(open_bus: Open) -> None:
    bench = Bench()
    bus, tap = open_bus(bench, "mortal"), open_bus(channel="mortal")
    bus.shutdown()
    tap.shutdown()
    assert open_bus(Bench(), "mortal").bench is not bench


def test_filters_as_python_can_defines_them(open_bus: Open, echo: Any) -> None:
    bench = Bench([echo(1), echo(2), echo(3)])
    bus = open_bus(bench, "filtered", can_filters=[{"can_id": 0x702, "can_mask": 0x7FF, "extended": False}])
    tap = open_bus(channel="filtered")
    assert bus.recv(0.01).arbitration_id == 0x702  # type: ignore[union-attr]
    assert bus.recv(0.01) is None
    bus.set_filters(None)
    bench.host.receive(Frame(0x123, extended=True), bus.time_ns())
    assert [m.arbitration_id for m in drain(bus)] == [0x123]
    assert len(drain(tap)) == 4
    expected = can.Message(arbitration_id=0x123, is_extended_id=True)
    assert bus._matches_filters(expected)


def test_periodic_messages_leave_at_exact_multiples_and_come_back(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(1)]))
    bus.recv(0.0123)
    bus.recv(0.0123)
    drain(bus)
    task = bus.send_periodic(SYNC, 0.001)
    seen = [bus.recv(0.1) for _ in range(20)]
    bits = frame_bits(Frame(0x080)) * 1_000
    syncs = [m.time_ns - bits for m in seen if m is not None and m.arbitration_id == 0x080]
    assert syncs == [13_000_000 + k * 1_000_000 for k in range(10)]
    assert not any(m.is_rx for m in seen if m and m.arbitration_id == 0x080)
    task.stop()
    drain(bus)
    assert bus.recv(0.1) is None
    task.start()  # type: ignore[attr-defined]
    assert bus.recv(0.1) is not None


def test_a_periodic_message_with_a_counter_a_duration_and_new_data(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(1)]), can_filters=[{"can_id": 0x080, "can_mask": 0x7FF}])
    counted = [message(0x080, bytes([i])) for i in (1, 2, 3)]
    bus.send_periodic(counted, 0.001, duration=0.005)
    assert [bytes(m.data) for m in iter(lambda: bus.recv(0.1), None)] == [b"\1", b"\2", b"\3", b"\1", b"\2"]
    task = bus.send_periodic(message(0x080, b"\x00"), 0.001)
    task.modify_data(message(0x080, b"\x09"))  # type: ignore[attr-defined]
    assert bus.recv(0.1).data == b"\x09"  # type: ignore[union-attr]
    bus.stop_all_periodic_tasks()
    drain(bus)
    bumped = bus.send_periodic(message(0x080, b"\x00"), 0.001, modifier_callback=lambda m: _bump(m))
    assert [bus.recv(0.1).data[0] for _ in range(3)] == [1, 2, 3]  # type: ignore[union-attr]
    bumped.stop()


def _bump(changed: can.Message) -> None:
    changed.data[0] += 1


def test_a_full_transmit_queue_is_enobufs_or_waited_for(open_bus: Open, echo: Any) -> None:
    bus = open_bus(Bench([echo(1)], tx_queue=4))
    for _ in range(4):
        bus.send(message(0x201))
    with pytest.raises(can.CanOperationError) as refused:
        bus.send(message(0x201))
    assert refused.value.error_code == errno.ENOBUFS
    bus.send(message(0x201), timeout=0.1)
    assert 0 < bus.time_ns() < 1_000_000


def test_a_full_receive_queue_loses_the_newest_and_counts(open_bus: Open, echo: Any) -> None:
    bench = Bench([echo(n) for n in (1, 2, 3)])
    bus, slow = open_bus(bench, "slow"), open_bus(channel="slow", rx_queue=2)
    for _ in range(3):
        bus.recv(0.01)
    assert ([m.arbitration_id for m in drain(slow)], slow.lost) == ([0x701, 0x702], 1)


@pytest.mark.parametrize("wrong", [
    can.Message(arbitration_id=0x800, is_extended_id=False),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_fd=True),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_error_frame=True),
    can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes(9)),
])
def test_what_a_classical_bus_cannot_carry_is_refused(open_bus: Open, wrong: can.Message) -> None:
    with pytest.raises(can.CanError, match=r"outside|only"):
        open_bus(Bench()).send(wrong)


def test_remote_and_extended_messages_pass(open_bus: Open, echo: Any) -> None:
    bench = Bench([echo(1, 0x181)])
    bus = open_bus(bench, "kinds")
    tap = open_bus(channel="kinds")
    bus.send(message(0x181, is_remote_frame=True, dlc=4))
    bus.send(can.Message(arbitration_id=0x12345678, data=b"\x01"))
    bus.recv(0.01)
    bus.recv(0.01)
    assert [(m.arbitration_id, m.is_remote_frame, m.is_extended_id, m.dlc) for m in drain(tap)[1:]] == [
        (0x181, True, False, 4), (0x12345678, False, True, 1)]
    assert [frame for _, frame in bench.nodes[1].device.heard] == [Frame(0x181, remote=True,
                                                                         dlc=4)]  # type: ignore[attr-defined]


def test_error_states_are_seen_as_socketcan_reports_them(open_bus: Open, echo: Any) -> None:
    disturbed = Fault("disturb", node=127, stop_s=0.006)
    bus = open_bus(Bench([echo(1)], faults=[disturbed], restart_ns=0))
    assert bus.state is can.BusState.ACTIVE
    bus.send(message(0x201))
    seen = []
    while bus.state is not can.BusState.ERROR:
        seen.append(bus.recv(0.1))
    errors = [m for m in seen + drain(bus) if m is not None and m.is_error_frame]
    classes = [m.arbitration_id & 0x1FF for m in errors]
    assert classes.count(0x088) == 32  # bus error, protocol violation
    assert classes.count(0x004) == 1  # controller: error passive
    assert classes.count(0x040) == 1  # bus-off
    with pytest.raises(can.CanOperationError) as refused:
        bus.send(message(0x201))
    assert refused.value.error_code == errno.ENETDOWN
    bus.recv(0.1)
    assert bus.state is can.BusState.ACTIVE
    assert bus.recv(0.01) is None  # the disturbance is over
    bus.send(message(0x080))
    assert bus.recv(0.1).arbitration_id == 0x181  # type: ignore[union-attr]


def test_waiting_for_ever_for_nothing_is_an_error(open_bus: Open) -> None:
    with pytest.raises(can.CanOperationError, match="time-out"):
        open_bus(Bench()).recv()


def test_a_closed_bus_says_so(open_bus: Open) -> None:
    bus = open_bus(Bench())
    bus.shutdown()
    bus.shutdown()
    for use in (lambda: bus.recv(0.1), lambda: bus.send(message(0x201))):
        with pytest.raises(can.CanOperationError, match="shut down"):
            use()


def test_python_cans_own_tools_open_it() -> None:
    """As `python -m can.logger -i bowden` does it."""
    arguments = argparse.Namespace(interface="bowden", channel="tools", bitrate=500_000)
    with create_bus_from_namespace(arguments) as bus:
        first = bus.recv(1.0)
        assert first is not None
        assert first.timestamp * 1e9 == 10_000 + 2_000 * frame_bits(Frame(0x701, b"\0"))


def test_no_file_descriptor_and_no_state_to_set(open_bus: Open) -> None:
    bus = open_bus(Bench())
    with pytest.raises(NotImplementedError):
        bus.fileno()
    with pytest.raises(NotImplementedError):
        bus.state = can.BusState.PASSIVE


def test_a_message_can_be_copied(open_bus: Open, echo: Any) -> None:
    import copy

    received = open_bus(Bench([echo(1)])).recv(1.0)
    assert received is not None
    assert copy.deepcopy(received).equals(received)


@pytest.mark.parametrize(("option", "value", "says"), [
    ("rate", 5, "rate_hz"), ("bitrate", 3, "125000"), ("serial", "x", "whole number"), ("day", -1, "day"),
    ("faults", [{"kind": "drip"}], "drip"), ("faults", [{"kind": "cut"}], "node"),
])
def test_an_unusable_option_is_one_sentence(option: str, value: object, says: str) -> None:
    with pytest.raises(InputError, match=says):
        BowdenBus("refused", **{option: value})  # type: ignore[arg-type]
