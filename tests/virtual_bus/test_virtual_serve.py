"""The served bench: another virtual bus plays the outside, so that no test waits for wall time."""

from __future__ import annotations

import errno
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import pytest

from parameters import InputError
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.serve import servable, serve
from virtual_bus.wire.faults import Fault

SYNC = can.Message(arbitration_id=0x080, is_extended_id=False)


class Scene:
    """A bench served on one socket of an outside bus, and a master's socket beside it, until `ms`."""

    def __init__(
        self, bench: Bench, witness: Any, ms: float, prepare: Callable[[BowdenBus], None], echoes: bool = False
    ) -> None:
        outside = Bench([witness], master_turnaround_ns=0)
        socket = BowdenBus("outside", bench=outside, receive_own_messages=echoes)
        with socket, BowdenBus("outside") as master:
            while master.recv(0.0005) is not None:
                pass
            prepare(master)
            self.served = serve(socket, bench, socket.time_ns, lambda: socket.time_ns() >= ms * 1_000_000,
                                echoes=echoes)
            self.seen = [m for m in iter(lambda: master.recv(0.0004), None) if m.arbitration_id != 0x77F]


def test_nodes_boot_answer_sync_and_hear_each_other(echo: Any) -> None:
    one, two = echo(1, 0x182), echo(2)
    scene = Scene(Bench([one, two]), echo(127), 10.5, lambda master: master.send_periodic(SYNC, 0.001))
    ids = [m.arbitration_id for m in scene.seen]
    assert ids[:2] == [0x701, 0x702]
    assert ids.count(0x181) == ids.count(0x182) == one.count
    assert sum(frame.can_id == 0x182 for _, frame in one.heard) == one.count
    assert scene.served.sent == 2 + 2 * one.count
    assert scene.served.lost == 0


def test_what_a_bus_echoes_is_heard_once(echo: Any) -> None:
    one, two = echo(1, 0x182), echo(2)
    scene = Scene(Bench([one, two]), echo(127), 10.5, lambda master: master.send_periodic(SYNC, 0.001), echoes=True)
    assert sum(frame.can_id == 0x182 for _, frame in one.heard) == one.count > 5
    assert scene.served.received == 2 * one.count  # SYNC and what the node outside answers
    assert scene.served.sent == 2 + 2 * one.count


def test_a_frame_reaches_a_device_at_the_time_it_came(echo: Any) -> None:
    one = echo(1)
    Scene(Bench([one]), echo(127), 10.5, lambda master: master.send_periodic(SYNC, 0.001))
    times = [now_ns for now_ns, frame in one.heard if frame.can_id == 0x080]
    assert {later - earlier for earlier, later in pairwise(times)} == {1_000_000}


def test_timers_are_kept_without_any_frame(echo: Any) -> None:
    beating = echo(1, heartbeat_ns=2_000_000)
    scene = Scene(Bench([beating]), echo(127), 21.5, lambda master: None)
    assert [m.arbitration_id for m in scene.seen] == [0x701] * 11


def test_the_whole_bench_is_served(echo: Any) -> None:
    from virtual_bus.build import build
    from virtual_bus.bus_options import Options

    def ask(master: BowdenBus) -> None:
        for node_id in (1, 2, 3, 4):
            master.send(can.Message(arbitration_id=0x600 + node_id, data=b"\x40\x00\x10\x00\0\0\0\0",
                                    is_extended_id=False))

    scene = Scene(build(Options(serial=0), "inside"), echo(127), 30, ask)
    answers = {m.arbitration_id: int.from_bytes(m.data[4:], "little") & 0xFFFF
               for m in scene.seen if 0x580 < m.arbitration_id < 0x600}
    assert answers == {0x581: 402, 0x582: 402, 0x583: 404, 0x584: 404}


class Failing(can.BusABC):
    """A bus that fails as an interface does that is down, or gone."""

    def __init__(self, code: int) -> None:
        self.code = code
        self.now_ns = 0
        self.channel_info = "failing"
        super().__init__("failing")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("down", errno.ENETDOWN)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.now_ns += round((timeout or 0.0) * 1e9) + 1
        raise can.CanOperationError("down", self.code)


def test_what_an_interface_that_is_down_does_not_take_is_counted(echo: Any) -> None:
    with Failing(errno.ENETDOWN) as bus:
        served = serve(bus, Bench([echo(1)]), lambda: bus.now_ns, lambda: bus.now_ns > 5_000_000)
    assert (served.sent, served.lost) == (0, 1)


def test_an_interface_that_is_gone_ends_it(echo: Any) -> None:
    with Failing(errno.ENODEV) as bus, pytest.raises(can.CanOperationError):
        serve(bus, Bench([echo(1)]), lambda: bus.now_ns)


def test_a_node_without_supply_is_silent_until_it_has_it_again(echo: Any) -> None:
    fault = Fault("power_off", start_s=0.002, stop_s=0.006, node=1)
    bench = Bench([echo(1, heartbeat_ns=1_000_000)], faults=[fault])
    scene = Scene(bench, echo(127), 10.5, lambda master: None)
    silent = [m for m in scene.seen if 0.0025 < m.timestamp < 0.006]
    assert silent == []
    assert sum(m.timestamp > 0.006 for m in scene.seen) > 2


def test_a_node_whose_line_is_cut_comes_back(echo: Any) -> None:
    fault = Fault("cut", start_s=0.002, stop_s=0.006, node=2)
    one, two = echo(1), echo(2, heartbeat_ns=1_000_000)
    scene = Scene(Bench([one, two], faults=[fault]), echo(127), 12.5, lambda master: None)
    at_ms = {round(m.timestamp * 1e3) for m in scene.seen if m.arbitration_id == 0x702}
    assert not at_ms & {4, 5}
    assert at_ms & {8, 9, 10}


def test_faults_of_the_wire_are_not_served(tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nkind = "power_off"\nnode = 2\n')
    assert [fault.node for fault in servable(file)] == [2]
    file.write_text('[[fault]]\nkind = "drop"\n')
    with pytest.raises(InputError, match=r"faults\.toml \[\[fault\]\] 1: drop is a fault of the virtual bus's wire"):
        servable(file)
