"""The safety monitor as a program on a real bus, on a computer of its own.

Waiting is receiving: the monitor makes its step when it is due, whatever the bus brings meanwhile. A bus that fails
costs heartbeats alone, which open the line.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from bowden.deferred import on_first_use
from eds.bench.bench_network import MONITOR
from eds.cia301 import TPDO_BASE
from parameters import InputError
from parameters.plugins import load
from safety_monitor import MonitorNode, PathInputs, read
from safety_monitor.node import DIGEST_BYTES

with on_first_use():
    import can

    from virtual_bus.wire.host import frame_of, message_of

BOARDS = "bowden.monitor_boards"
"""Entry-point group of boards."""
IDLE_S = 0.0005
"""Pause after a bus has failed to receive, s, so that a broken interface does not take a whole processor."""


class Board(Protocol):
    """Protocol of the hardware of a monitor: its own sensors, and the output that holds the enable line."""

    def sensors(self, now_ns: int) -> Sequence[PathInputs]:
        """Return the monitor's own inputs, one row a force path: N, N, degrees, m; NaN where a sensor has no value."""

    def line(self, closed: bool) -> None:
        """Close or open the enable line; a board whose program has died must open it by itself (watchdog)."""


REPORT_S = 1.5
"""Time within which a monitor at rest reports its digest, s: one and a half of its periods."""


def refuse_other(bus: Any, clock: Callable[[], int], file: str) -> None:
    """Raise `InputError` unless the safety monitor on the bus reports the digest of this person's file, if any."""
    if not file:
        return
    expected = bytes.fromhex(read(Path(file)).sha256)[:DIGEST_BYTES]
    until_ns = clock() + round(REPORT_S * 1e9)
    while (left_ns := until_ns - clock()) > 0:
        message = bus.recv(left_ns * 1e-9)
        if message is None or message.arbitration_id != TPDO_BASE + MONITOR:
            continue
        if bytes(message.data) != expected:
            raise InputError(f"monitor {file}: begins with SHA-256 {expected.hex()}, and the monitor on the bus "
                             f"reports {bytes(message.data).hex()}; give both the same file.")
        return
    raise InputError(f"monitor {file}: no safety monitor (node {MONITOR}) reports its digest; switch it on, or off and "
                     "on where its line is open.")


@dataclass(frozen=True)
class MonitorEnd:
    """End of the program: steps made, frames that the bus did not take, and the cause of an open line ("" if none)."""

    steps: int
    lost: int
    cause: str


def board(name: str) -> Board:
    """Return the board of that name, or the one that "module:callable" makes; raises `InputError`."""
    made: Any = load("board", name, BOARDS, {})()
    for method in ("sensors", "line"):
        if not callable(getattr(made, method, None)):
            raise InputError(f"board {name}: has no method {method}; see bowden.bench.monitor_program.Board.")
    return made  # type: ignore[no-any-return]


def run(bus: Any, node: MonitorNode, clock: Callable[[], int], stop: Callable[[], bool]) -> MonitorEnd:
    """Run the monitor on `bus` by `clock`, ns, until `stop`; the line is open when it returns, whatever happens."""
    steps = lost = 0
    try:
        node.power_on(clock())
        while not stop():
            _receive(bus, node, clock)
            due_ns = node.next_ns()
            node.poll(clock())
            steps += node.next_ns() != due_ns
            while node.outbox:
                lost += not _sent(bus, node)
    finally:
        node.power_off()
    return MonitorEnd(steps, lost, node.state.text)


def _receive(bus: Any, node: MonitorNode, clock: Callable[[], int]) -> None:
    """Wait for a frame until the next step is due, and give it to the monitor."""
    try:
        message = bus.recv(max(0, (node.next_ns() or 0) - clock()) / 1e9)
    except (can.CanError, OSError):
        time.sleep(IDLE_S)
        return
    if message is not None:
        with suppress(can.CanError):  # an error frame or CAN FD is no heartbeat
            node.receive(frame_of(message), clock())


def _sent(bus: Any, node: MonitorNode) -> bool:
    try:
        bus.send(message_of(node.outbox.popleft(), 0, False, ""))
    except (can.CanError, OSError):
        return False
    return True
