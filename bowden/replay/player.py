"""The player: a schedule of frames, played, paused, stepped, sought and repeated.

`trial.playback` holds its state, and time is an argument; the owner of a bus asks `next_ns`, waits by receiving, and
calls `poll`. `play_out` does so on a python-can bus.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import can
import numpy as np

from bowden.replay.schedule import Schedule, frame_of, restoration
from eds.cia301 import Frame
from parameters import InputError
from trial.playback import SPEEDS, TRANSITIONS, PlayerControl, PlayerStatus, ready


class Lateness(NamedTuple):
    """Delays of frames at the bus, ns: over all of them."""

    frames: int
    median_ns: int
    p99_ns: int
    max_ns: int


class Player:
    """Plays a schedule `loops` times through `send(frame, channel)`; positions are ns of the schedule's window.

    `lateness_ns` has one value for each frame that was played by its time (not by step).
    """

    def __init__(
        self, schedule: Schedule, send: Callable[[Frame, int], None], *, speed: float = 1.0, loops: int = 1
    ) -> None:
        if loops < 1:
            raise InputError(f"--loop {loops}: expected a whole number from 1; give how often it is played.")
        self.schedule = schedule
        self.lateness_ns = array("q")
        self.sent = self.pass_ = 0
        self._send, self._loops = send, loops
        self._times: list[int] = schedule.times.tolist()
        self._channels: list[int] = schedule.frames["channel"].tolist()
        self._playback = ready(0, schedule.length_ns, 0, checked_speed(speed))
        self._next = 0

    @property
    def status(self) -> PlayerStatus:
        """State of the playback."""
        return self._playback.status

    @property
    def speed(self) -> float:
        """Ratio of recorded time to playing time."""
        return self._playback.speed

    def position_ns(self, now_ns: int) -> int:
        """Position in the window."""
        return self._playback.position_ns(now_ns)

    def share(self, now_ns: int) -> float:
        """Share of all passes that is played, 0 … 1."""
        played = self.position_ns(now_ns) / self.schedule.length_ns if self.schedule.length_ns else 0.0
        return (self.pass_ + played) / self._loops

    def _control(self, control: PlayerControl, now_ns: int, speed: float | None = None) -> None:
        here = self._playback.at(self.position_ns(now_ns), now_ns)
        self._playback = here.told(now_ns, control, speed=speed)

    def play(self, now_ns: int) -> None:
        """Continue from the present position; start again at the first pass if every pass was played."""
        if self.status is PlayerStatus.ENDED:
            self._next = self.pass_ = 0
        self._control(PlayerControl.PLAY, now_ns)

    def pause(self, now_ns: int) -> None:
        """Pause the playback; the devices keep the last commands."""
        self._control(PlayerControl.PAUSE, now_ns)

    def set_speed(self, speed: float, now_ns: int) -> None:
        """Set the playback speed from the present position on."""
        self._playback = replace(self._playback.at(self.position_ns(now_ns), now_ns), speed=checked_speed(speed))

    def seek(self, position_ns: int, now_ns: int) -> list[Frame]:
        """Go to a position of this pass: the nodes get the NMT state of that time, and the last PDOs are sent again.

        Returns the frames sent for that.
        """
        if not 0 <= position_ns <= self.schedule.length_ns:
            raise InputError(f"seek to {position_ns / 1e9:g} s: expected 0 … {self.schedule.length_ns / 1e9:g} s.")
        self._next = int(np.searchsorted(self.schedule.times, position_ns, side="left"))
        self._playback = self._playback.told(now_ns, PlayerControl.SEEK, seek_ns=position_ns)
        restored = restoration(self.schedule, self._next)
        for frame, channel in restored:
            self._send(frame, channel)
        return [frame for frame, _ in restored]

    def step(self) -> Frame | None:
        """Send the next frame regardless of its time; None at the end."""
        if (self.status, PlayerControl.STEP) not in TRANSITIONS:
            return None
        last = self._next == len(self._times)
        if last and self.pass_ + 1 == self._loops:
            self._end()
            return None
        if last:
            self.pass_ += 1
            self._next = 0
        self._playback = self._playback.told(0, PlayerControl.STEP, seek_ns=self._times[self._next])
        return self._send_next()

    def _end(self) -> None:
        self._playback = self._playback.told(0, PlayerControl.END, seek_ns=self.schedule.length_ns)

    def _send_next(self) -> Frame:
        frame = frame_of(self.schedule.frames[self._next])
        channel = self._channels[self._next]
        self._next += 1
        self.sent += 1
        self._send(frame, channel)
        return frame

    def next_ns(self) -> int | None:
        """Return the time of the next frame, or of the end of this pass; None unless it plays."""
        if self.status is not PlayerStatus.PLAYING:
            return None
        due = self._times[self._next] if self._next < len(self._times) else self.schedule.length_ns
        return self._playback.due_ns(due)

    def poll(self, now_ns: int) -> None:
        """Send everything that is due; at the end of a pass begin the next one, exactly then."""
        while (due_ns := self.next_ns()) is not None and due_ns <= now_ns:
            if self._next < len(self._times):
                self.lateness_ns.append(now_ns - due_ns)
                self._send_next()
            elif self.pass_ + 1 < self._loops:
                self.pass_ += 1
                self._next = 0
                self._playback = self._playback.at(0, due_ns)
            else:
                self._end()

    def lateness(self) -> Lateness:
        """Return median, 99th percentile (nearest rank) and largest lateness, ns."""
        late = np.sort(np.array(self.lateness_ns, np.int64))
        if not len(late):
            return Lateness(0, 0, 0, 0)
        rank = [int(late[int(np.ceil(share * len(late))) - 1]) for share in (0.5, 0.99, 1.0)]
        return Lateness(len(late), *rank)


def checked_speed(speed: float) -> float:
    """Return a speed that can be played, else raise `InputError`."""
    if not SPEEDS[0] <= speed <= SPEEDS[1]:
        raise InputError(f"--speed {speed:g}: expected 0.001 … 1000, recorded by played time; 1 is the original.")
    return speed


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


def ignore_message(message: can.Message) -> None:
    """Ignore a received frame."""


def play_out(
    player: Player, bus: can.BusABC, clock: Callable[[], int], heard: Heard = ignore_message,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Play until the player pauses or ends; frames that `bus` receives are passed on."""
    shown = 0
    while (due_ns := player.next_ns()) is not None:
        wait_until(bus, clock, due_ns, heard)
        player.poll(clock())
        if player.sent - shown >= 1000:
            shown = player.sent
            progress(player.share(clock()))
    if player.status is PlayerStatus.ENDED:
        wait_until(bus, clock, clock() + LINGER_NS, heard)


def wait_until(bus: can.BusABC, clock: Callable[[], int], until_ns: int, heard: Heard) -> None:
    """Receive until the given time."""
    while (left_ns := until_ns - clock()) > 0:
        message = bus.recv(left_ns / NS)
        if message is not None:
            heard(message)
