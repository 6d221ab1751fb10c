"""A player on python-can buses.

Waiting is receiving; frames received meanwhile go to `heard`, and time is that of the given clock, virtual or wall.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import can

from bowden.replay.player import Player
from eds.cia301 import Frame
from trial.playback import PlayerStatus

NS = 1_000_000_000
LINGER_NS = 10_000_000
"""Time before the bus is closed after the last frame, so that the frame is transmitted."""
ROOM_S = 0.1
"""Time limit for room in a full queue."""
Heard = Callable[[can.Message], None]


class Outlet:
    """Sender of frames of recorded channels to the buses they are mapped to; `lost` counts frames a bus refused.

    `buses` maps a recorded channel to its bus; a channel without one goes to `others`, or nowhere.
    """

    def __init__(self, buses: Mapping[int, can.BusABC], others: can.BusABC | None = None) -> None:
        self.lost = 0
        self._buses, self._others = buses, others

    def send(self, frame: Frame, channel: int) -> None:
        """Send one frame."""
        bus = self._buses.get(channel, self._others)
        if bus is None:
            return
        try:
            bus.send(message_of(frame), ROOM_S)
        except can.CanError:
            self.lost += 1


def message_of(frame: Frame) -> can.Message:
    """Return a frame as python-can's message."""
    return can.Message(
        arbitration_id=frame.can_id, data=frame.data, is_extended_id=frame.extended, is_remote_frame=frame.remote,
        dlc=len(frame.data) if frame.dlc is None else frame.dlc, is_rx=False)


def ignore(message: can.Message) -> None:
    """Ignore a received frame."""


def run(
    player: Player, bus: can.BusABC, clock: Callable[[], int], heard: Heard = ignore,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Play until the player pauses or ends; frames that `bus` receives are passed on."""
    shown = 0
    while (due_ns := player.next_ns()) is not None:
        wait(bus, clock, due_ns, heard)
        player.poll(clock())
        if player.sent - shown >= 1000:
            shown = player.sent
            progress(player.share(clock()))
    if player.status is PlayerStatus.ENDED:
        wait(bus, clock, clock() + LINGER_NS, heard)


def wait(bus: can.BusABC, clock: Callable[[], int], until_ns: int, heard: Heard) -> None:
    """Receive until the given time."""
    while (left_ns := until_ns - clock()) > 0:
        message = bus.recv(left_ns / NS)
        if message is not None:
            heard(message)
