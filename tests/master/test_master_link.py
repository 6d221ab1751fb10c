"""The link: waiting is receiving, heartbeats go out meanwhile, and a bus that hides SYNC is paced by the master."""

from __future__ import annotations

from typing import TYPE_CHECKING

import can
import numpy as np
import pytest

from eds.bench.bench_network import Network, wire
from eds.cia301 import NmtCommand, NmtState
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.log import Log
from master.network import bringup
from master.network.link import EmcyMessage, Link, LinkError, stamp_ns
from master.settings import Limits

if TYPE_CHECKING:
    from conftest import Composer

MS = 1_000_000


def test_the_masters_heartbeat_goes_out_while_it_waits(composer: Composer) -> None:
    link, tap = composer.link()
    link.wait(1_000 * MS)
    beats = []
    while (message := tap.recv(0)) is not None:
        if message.arbitration_id == 0x77F:
            beats.append(stamp_ns(message))
    assert len(beats) == 10
    assert np.abs(np.diff(beats) - 100 * MS).max() < MS


def test_who_only_asks_sends_no_heartbeat(composer: Composer) -> None:
    """A node that has heard one would watch over a master that is not there."""
    bus, tap = composer.link()
    asking = Link(bus.bus, bus.clock, heartbeat_ms=None)
    assert len(asking.sdo_read(1, 0x1000)) == 4
    assert list(asking.listen(300 * MS))
    asking.wait(300 * MS)
    heard = set()
    while (message := tap.recv(0)) is not None:
        heard.add(message.arbitration_id)
    assert 0x601 in heard
    assert 0x77F not in heard


def test_who_listens_is_silent_however_late_the_frames_are_looked_at(composer: Composer) -> None:
    """On a busy bus the last look is after the deadline: a heartbeat then would stop the master that was found."""
    link, tap = composer.link()
    late_ns, heard = link.clock() + 400 * MS, list[int]()
    for _ in link.listen(300 * MS):
        while link.clock() < late_ns:
            message = tap.recv(0.01)
            heard += [] if message is None else [message.arbitration_id]
    heard += [message.arbitration_id for message in iter(lambda: tap.recv(0.002), None)]
    assert heard
    assert 0x77F not in heard
    link.wait(MS)
    assert 0x77F in [message.arbitration_id for message in iter(lambda: tap.recv(0), None)]


def test_waiting_takes_exactly_its_time(composer: Composer) -> None:
    link, _ = composer.link()
    before = link.clock()
    link.wait(123_456_789)
    assert link.clock() - before == 123_456_789
    assert link.receive(link.clock()) is None
    assert link.clock() - before == 123_456_789


def test_an_emergency_of_any_length_is_taken(composer: Composer) -> None:
    link, tap = composer.link()
    for data in (b"", b"\x10", bytes.fromhex("3081110000000000")):
        tap.send(can.Message(arbitration_id=0x083, data=data, is_extended_id=False))
    link.wait(10 * MS)
    assert [(e.node_id, e.code, e.register) for e in link.emergencies] == [
        (3, 0x1000, 0x01), (3, 0x1000, 0x01), (3, 0x8130, 0x11)]
    assert isinstance(link.emergencies[0], EmcyMessage)


@pytest.mark.parametrize("can_id", [0x000, 0x701, 0x77F, 0x580, 0x182])
def test_empty_frames_harm_nothing(composer: Composer, can_id: int) -> None:
    link, tap = composer.link()
    tap.send(can.Message(arbitration_id=can_id, is_extended_id=False))
    tap.send(can.Message(arbitration_id=can_id, is_remote_frame=True, is_extended_id=False))
    tap.send(can.Message(arbitration_id=can_id, is_extended_id=True))
    before = link.clock()
    link.wait(10 * MS)
    assert link.clock() - before == 10 * MS
    assert list(link.emergencies) == []


def test_a_state_is_awaited_by_heartbeat(composer: Composer) -> None:
    link, _ = composer.link()
    bringup.bring_up(link, wire(Network()), Log(None, None, 0x201))
    link.nmt(NmtCommand.STOP, 4)
    assert link.await_state(4, NmtState.STOPPED, 300 * MS)
    assert not link.await_state(4, NmtState.OPERATIONAL, 300 * MS)


def test_a_full_queue_is_waited_for(composer: Composer) -> None:
    link, _ = composer.link(tx_queue=2)
    for _ in range(20):
        link.send(0x601, bytes(8))
    assert link.clock() > 0


def test_a_closed_bus_is_an_error_with_a_reason(composer: Composer) -> None:
    link, _ = composer.link()
    link.bus.shutdown()
    with pytest.raises(LinkError, match=r"receiving failed: .*shut down"):
        link.wait(10 * MS)
    assert not link.try_send(can.Message(arbitration_id=0x701, is_extended_id=False))
    with pytest.raises(LinkError, match=r"failed: .*shut down"):
        link.send(0x601, bytes(8))


def test_sync_that_is_not_shown_is_paced_by_the_master(composer: Composer) -> None:
    """A filter that keeps SYNC from its sender stands for an interface that has no loopback of periodic frames."""
    link, tap = composer.link(serial=0)
    described = wire(Network())
    log = Log(tap, None, described.targets.cob_id)
    bringup.bring_up(link, described, log)
    link.bus.set_filters([{"can_id": 0x180, "can_mask": 0x780}, {"can_id": 0x580, "can_mask": 0x780},
                          {"can_id": 0x700, "can_mask": 0x700}])
    link.sync_start(described.period_ns)
    exchange = Exchange(link, described, log, Guard(link, described, log, Limits(), 250 * MS), 600_000)
    exchange.begin()
    stamps = [exchange.inputs.sync_ns] + [exchange.hold().sync_ns for _ in range(200)]
    assert set(np.diff(stamps).tolist()) == {MS}
    assert exchange.missed_cycles == 0
    link.sync_stop()
    assert isinstance(link, Link)
