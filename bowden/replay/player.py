"""Recorded frames to play and their times; the player: played, paused, stepped, sought and repeated.

A schedule is chosen by pure functions; frames are `trial.mcap_file.cdr.FRAME_ROW` rows in the order of the recording,
times are ns from the recording's first frame.  After a jump, frames that restore the bus are sent first.

`trial.playback` holds its state, and time is an argument; the owner of a bus asks `next_ns`, waits by receiving, and
calls `poll`. `play_out` does so on a python-can bus.
"""

from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import can
import numpy as np
from numpy.typing import NDArray

from eds.bench.bench_network import MASTER
from eds.cia301 import (
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    TPDO_BASE,
    Frame,
    NmtCommand,
    NmtState,
)
from parameters import InputError
from trial.mcap_file import cdr
from trial.playback import SPEEDS, TRANSITIONS, PlayerControl, PlayerStatus, ready
from virtual_bus.wire.host import message_of

Rows = NDArray[np.void]
Integers = NDArray[np.int64]

BROADCAST = 0
"""Node number of NMT, SYNC and TIME frames, which belong to no node."""
DIRECTIONS = {"rx": False, "tx": True, "both": None}
"""Direction as recorded: received from the bus, or sent by the recording computer; None: both."""
_TIME_COB_ID = 0x100
_NODE_MASK = 0x7F
_COMMANDS = {
    NmtState.OPERATIONAL: NmtCommand.START, NmtState.STOPPED: NmtCommand.STOP,
    NmtState.PRE_OPERATIONAL: NmtCommand.ENTER_PRE_OPERATIONAL,
    NmtState.INITIALISING: NmtCommand.ENTER_PRE_OPERATIONAL,
}
_STATES = {
    NmtCommand.START: NmtState.OPERATIONAL, NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL, NmtCommand.RESET_NODE: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_COMMUNICATION: NmtState.PRE_OPERATIONAL,
}


@dataclass(frozen=True)
class Selection:
    """Selection of the frames to play; None and empty mean all. `from_s` and `to_s` count from the recording's first
    frame.

    `nodes` are those of the pre-defined connection set, 0 for NMT, SYNC and TIME. `channels` are the recorded
    channels to play.
    """

    nodes: frozenset[int] = frozenset()
    cob_ids: frozenset[int] = frozenset()
    direction: str | None = None
    channels: frozenset[int] = frozenset()
    from_s: float = 0.0
    to_s: float | None = None


@dataclass(frozen=True)
class Schedule:
    """Frames to play: frame i at `times[i]` ns of the window, which is `length_ns` long.

    `before` are the frames ahead of the window that pass the same filters; `left_out` counts unsendable frames.
    """

    times: Integers
    frames: Rows
    length_ns: int
    before: Rows
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times)


def plan(frames: Rows, selection: Selection, lead_ns: Integers | int = 0) -> Schedule:
    """Choose frames and their times: `lead_ns` (one for all, or one a frame) before the recorded time.

    Raises `InputError` if no frame remains to play.
    """
    if not len(frames):
        raise InputError("the trial holds no CAN frames; give one that was recorded on a bus.")
    begin, end = _window(frames, selection)
    chosen = chosen_by(frames, selection)
    sendable = frames["flags"] & cdr.ERROR == 0
    at = frames["time_ns"] - frames["time_ns"].min() - begin
    inside = (at >= 0) & (at <= end - begin)
    played = chosen & sendable & inside
    if not played.any():
        raise InputError("no recorded frame passes the filters; widen --from, --to, --node, --cob-id or --direction.")
    times = (at - lead_ns)[played]
    order = np.argsort(times, kind="stable")
    return Schedule(
        np.maximum(times[order], 0), frames[played][order], end - begin, frames[chosen & sendable & (at < 0)],
        {"error_frames": int(np.count_nonzero(chosen & inside & ~sendable))})


def _window(frames: Rows, selection: Selection) -> tuple[int, int]:
    """Return begin and end of the window, ns from the first frame."""
    whole = int(frames["time_ns"].max() - frames["time_ns"].min())
    begin = round(selection.from_s * 1e9)
    end = whole if selection.to_s is None else min(round(selection.to_s * 1e9), whole)
    if not 0 <= begin <= end:
        raise InputError(f"--from {selection.from_s:g} --to {end / 1e9:g}: expected 0 ≤ from ≤ to ≤ "
                         f"{whole / 1e9:g} s, the recording's length; choose a part of it.")
    return begin, end


def chosen_by(frames: Rows, selection: Selection) -> NDArray[np.bool_]:
    """Return a mask of the frames that pass the filters by node, COB-ID, direction and channel."""
    chosen = np.ones(len(frames), np.bool_)
    if selection.nodes:
        chosen &= np.isin(nodes_of(frames), list(selection.nodes))
    if selection.cob_ids:
        chosen &= np.isin(frames["can_id"], list(selection.cob_ids))
    if selection.direction is not None:
        if selection.direction not in DIRECTIONS:
            raise InputError(f"--direction {selection.direction}: expected rx, tx or both; rx is what the nodes sent.")
        if DIRECTIONS[selection.direction] is not None:
            chosen &= frames["sent"] == DIRECTIONS[selection.direction]
    if selection.channels:
        chosen &= np.isin(frames["channel"], list(selection.channels))
    return chosen


def nodes_of(frames: Rows) -> NDArray[np.int64]:
    """Return the node of each frame by the pre-defined connection set (CiA 301, 7.3.3), −1 for extended identifiers."""
    can_id = frames["can_id"].astype(np.int64)
    broadcast = (can_id == NMT_COB_ID) | (can_id == SYNC_COB_ID) | (can_id == _TIME_COB_ID)
    node = np.where(broadcast, BROADCAST, can_id & _NODE_MASK)
    return np.where(frames["flags"] & cdr.EXTENDED != 0, -1, node)


def frame_of(row: np.void) -> Frame:
    """Return a recorded row as a frame."""
    flags, dlc = int(row["flags"]), int(row["dlc"])
    remote = bool(flags & cdr.REMOTE)
    return Frame(int(row["can_id"]), b"" if remote else row["data"][:dlc].tobytes(), remote,
                 bool(flags & cdr.EXTENDED), dlc=dlc if remote else None)


def nmt_states(frames: Rows) -> dict[int, NmtState]:
    """Return the NMT state of every node after `frames`: by its heartbeats and boot-ups, and by the commands it was
    sent."""
    plain = frames["flags"] == 0
    can_id, dlc = frames["can_id"], frames["dlc"]
    commands = plain & (can_id == NMT_COB_ID) & (dlc >= 2)
    beats = plain & (can_id > HEARTBEAT_BASE) & (can_id <= HEARTBEAT_BASE + _NODE_MASK) & (dlc >= 1)
    states: dict[int, NmtState] = {}
    for row in frames[commands | beats]:
        first, second = int(row["data"][0]), int(row["data"][1])
        if row["can_id"] != NMT_COB_ID:
            if first & _NODE_MASK in _COMMANDS:
                states[int(row["can_id"]) - HEARTBEAT_BASE] = NmtState(first & _NODE_MASK)
        elif first in _STATES:
            for node in states if second == BROADCAST else (second,):
                states[node] = _STATES[NmtCommand(first)]
    return states


def restoration(schedule: Schedule, count: int) -> list[tuple[Frame, int]]:
    """Return the frames, each with its channel, that restore the bus to its state after `count` frames of the schedule.

    On every channel NMT commands for every node but the master, then the last PDO of each COB-ID in the order of
    arrival.  Filtered frames are not sent.
    """
    past = np.concatenate([schedule.before, schedule.frames[:count]])
    found = []
    for channel in np.unique(past["channel"]).tolist():
        there = past[past["channel"] == channel]
        told = [Frame(NMT_COB_ID, bytes((_COMMANDS[state], node)))
                for node, state in sorted(nmt_states(there).items()) if node != MASTER]
        found += [(frame, channel) for frame in (*told, *_last_pdos(there))]
    return found


def _last_pdos(frames: Rows) -> list[Frame]:
    can_id = frames["can_id"]
    pdos = frames[(can_id > TPDO_BASE) & (can_id < SDO_RESPONSE_BASE) & (frames["flags"] == 0)]
    _, from_end = np.unique(pdos["can_id"][::-1], return_index=True)
    return [frame_of(pdos[len(pdos) - 1 - place]) for place in sorted(from_end.tolist(), reverse=True)]


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
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            raise InputError(f"--speed {speed:g}: expected 0.001 … 1000, recorded by played time; 1 is the original.")
        self._playback = ready(0, schedule.length_ns, 0, speed)
        self._next = 0

    @property
    def status(self) -> PlayerStatus:
        """State of the playback."""
        return self._playback.status

    def position_ns(self, now_ns: int) -> int:
        """Position in the window."""
        return self._playback.position_ns(now_ns)

    def share(self, now_ns: int) -> float:
        """Share of all passes that is played, 0 … 1."""
        played = self.position_ns(now_ns) / self.schedule.length_ns if self.schedule.length_ns else 0.0
        return (self.pass_ + played) / self._loops

    def _control(self, control: PlayerControl, now_ns: int) -> None:
        self._playback = self._playback.at(self.position_ns(now_ns), now_ns).commanded(now_ns, control)

    def play(self, now_ns: int) -> None:
        """Continue from the present position; start again at the first pass if every pass was played."""
        if self.status is PlayerStatus.ENDED:
            self._next = self.pass_ = 0
        self._control(PlayerControl.PLAY, now_ns)

    def pause(self, now_ns: int) -> None:
        """Pause the playback; the devices keep the last commands."""
        self._control(PlayerControl.PAUSE, now_ns)

    def seek(self, position_ns: int, now_ns: int) -> list[Frame]:
        """Go to a position of this pass: the nodes get the NMT state of that time, and the last PDOs are sent again.

        Returns the frames sent for that.
        """
        if not 0 <= position_ns <= self.schedule.length_ns:
            raise InputError(f"seek to {position_ns / 1e9:g} s: expected 0 … {self.schedule.length_ns / 1e9:g} s.")
        self._next = int(np.searchsorted(self.schedule.times, position_ns, side="left"))
        self._playback = self._playback.commanded(now_ns, PlayerControl.SEEK, seek_ns=position_ns)
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
        self._playback = self._playback.commanded(0, PlayerControl.STEP, seek_ns=self._times[self._next])
        return self._send_next()

    def _end(self) -> None:
        self._playback = self._playback.commanded(0, PlayerControl.END, seek_ns=self.schedule.length_ns)

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
            bus.send(message_of(frame, 0, False, ""), ROOM_S)
        except can.CanError:
            self.lost += 1


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
