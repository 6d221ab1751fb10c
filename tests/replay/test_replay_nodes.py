"""The recorded nodes before a live master: the same answers, or the first that is not."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from functools import partial
from typing import Any

import can
import numpy as np
import pytest

from bowden.replay import onto_master
from bowden.replay.onto_master import compare, on_wire, said
from bowden.replay.onto_plant import commands, lengths_ns
from eds.bench.bench_network import Network, wire
from eds.cia301 import Frame
from master.settings import Impedance
from nodes.recorded_nodes import MasterFrame, OnWire, RecordedNodes
from trial.read import Trial
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.kernel import TIMER
from virtual_bus.serve import serve
from virtual_bus.wire.station import Station

MS = 1_000_000
MASTERS = frozenset({0x000, 0x080, 0x601, 0x602, 0x77F})


def nodes_of(*frames: tuple[int, int, bytes]) -> RecordedNodes:
    """Nodes that recorded frames (ms, COB-ID, data); none takes any time on the wire."""
    return RecordedNodes([OnWire(at * MS, at * MS, Frame(can_id, data)) for at, can_id, data in frames], MASTERS)


def spoken(nodes: RecordedNodes, until_ms: int, *told: tuple[int, int, bytes]) -> list[tuple[float, int, bytes]]:
    """What the nodes say until then, told a master's frames (ms, COB-ID, data) on the way."""
    waiting, found = list(told), []
    nodes.power_on(0)
    for now_ns in range(0, until_ms * MS, MS // 2):
        while waiting and waiting[0][0] * MS <= now_ns:
            _, can_id, data = waiting.pop(0)
            nodes.receive(Frame(can_id, data), now_ns)
        nodes.poll(now_ns)
        while nodes.outbox:
            frame = nodes.outbox.popleft()
            found.append((now_ns / MS, frame.can_id, frame.data))
    return found


SCRIPT = ((1, 0x701, b"\0"), (10, 0x000, b"\x80\0"), (20, 0x601, b"a"), (22, 0x581, b"A"), (30, 0x601, b"b"),
          (31, 0x77F, b"\5"), (33, 0x581, b"B"), (40, 0x080, b""), (41, 0x181, b"1"), (50, 0x080, b""),
          (51, 0x77F, b"\5"), (52, 0x181, b"2"), (60, 0x701, b"\5"))


def test_each_frame_follows_what_it_followed() -> None:
    nodes = nodes_of(*SCRIPT)
    told = ((13, 0x000, b"\x80\0"), (23, 0x601, b"a"), (33, 0x601, b"b"), (43, 0x080, b""), (58, 0x080, b""))
    assert spoken(nodes, 100, *told) == [
        (1, 0x701, b"\0"), (25, 0x581, b"A"), (36, 0x581, b"B"), (44, 0x181, b"1"), (60, 0x181, b"2"),
        (68, 0x701, b"\5")]
    assert nodes.left == 0


def test_nodes_say_nothing_to_a_master_that_asks_nothing() -> None:
    nodes = nodes_of(*SCRIPT)
    assert spoken(nodes, 200) == [(1, 0x701, b"\0")]
    assert nodes.left == 5


HEARD = [MasterFrame(5 * MS, Frame(0x000, b"\1\0")), MasterFrame(7 * MS, Frame(0x080)),
         MasterFrame(9 * MS, Frame(0x201, b"ab")), MasterFrame(11 * MS, Frame(0x201, b"cd"))]


def test_two_masters_are_compared_from_their_first_frame() -> None:
    later = [MasterFrame(time_ns + 400 * MS + (2_000 if i == 2 else 0), frame)
             for i, (time_ns, frame) in enumerate(HEARD)]
    found = compare(HEARD, [*later, MasterFrame(500 * MS, Frame(0x080))])
    assert found.same
    assert (found.frames, found.beyond, found.timing_max_us) == (4, 1, 2.0)


@pytest.mark.parametrize(("live", "cob_id", "number", "was", "now"), [
    ([*HEARD[:2], MasterFrame(9 * MS, Frame(0x201, b"aB")), HEARD[3]], 0x201, 0, "61 62", "61 42"),
    (HEARD[:3], 0x201, 1, "63 64", None),
    ([*HEARD[:1], MasterFrame(6 * MS, Frame(0x301, b"")), *HEARD[1:]], 0x301, 0, None, ""),
    ([], 0x000, 0, "01 00", None),
])
def test_a_changed_a_missing_and_a_further_frame_are_told(
    live: list[MasterFrame], cob_id: int, number: int, was: str | None, now: str | None
) -> None:
    first = compare(HEARD, live).first
    assert first is not None
    assert (first.cob_id, first.number, first.recorded, first.live) == (cob_id, number, was, now)


@pytest.mark.parametrize("options", [
    ("--controller", "paper", "--cycles", 2), ("--dry-run",),
    pytest.param(("--controller", "extended", "--cycles", 2), marks=pytest.mark.exhaustive),
    pytest.param(("--experiment", "unload"), marks=pytest.mark.exhaustive),
], ids=str)
def test_a_live_master_says_the_same_to_recorded_nodes(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], options: tuple[Any, ...]
) -> None:
    trial = recorded(*options)
    told = bowden("replay", trial.path, "--onto", "bus", "--nodes-only", "--json")
    assert told.status == 0, told
    result = json.loads(told.stdout)
    assert result["same"] is True
    assert result["frames"] == np.count_nonzero(trial.frames["sent"])
    assert result["timing_max_us"] == 0.0


def test_a_master_that_changed_is_told_by_its_first_frame(
    recorded: Callable[..., Trial], bowden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = recorded()
    meant = onto_master.experiment(trial)
    changed = dataclasses.replace(meant, impedance=Impedance(stiffness_n_m=330.0))
    monkeypatch.setattr(onto_master, "experiment", lambda recorded, scripts: changed)
    told = bowden("replay", trial.path, "--onto", "bus", "--nodes-only", "--json")
    assert told.status == 1, told
    result = json.loads(told.stdout)
    assert list(result["differing"]) == ["201"]
    first = result["first"]
    assert first["cob_id"] == 0x201
    frames = trial.frames[trial.frames["can_id"] == 0x201]
    assert frames["data"][first["number"]].tobytes().hex(" ") == first["recorded"] != first["live"]


def test_recorded_nodes_are_served_to_a_master_elsewhere(recorded: Callable[..., Trial]) -> None:
    trial = recorded()
    frames = trial.frames[trial.frames["time_ns"] < 900 * MS]
    masters = commands(wire(Network())).cob_ids
    nodes = RecordedNodes(on_wire(frames, lengths_ns(frames, 1_000_000)), masters)
    outside = Bench([], master_turnaround_ns=0)
    outside.wire.attach(Station("listener", lambda frame, now_ns: None))
    with BowdenBus("replay-outside", bench=outside) as socket, BowdenBus("replay-outside") as master:
        for time_ns, frame in said(frames, masters):
            message = can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False)
            outside.kernel.at(time_ns + 40 * MS, TIMER, partial(master.send, message))
        serve(socket, Bench([nodes], node_turnaround_ns=0), socket.time_ns, lambda: socket.time_ns() > 1_000 * MS)
        answers = [m.arbitration_id for m in iter(lambda: master.recv(0), None)]
    assert compare(said(frames, masters), nodes.heard).same
    theirs = frames["can_id"][~frames["sent"]].tolist()
    assert sorted(answers) == sorted(theirs)
