"""Selection and times of the recorded frames to play, and the frames that restore the bus after a jump.

Pure functions; frames are `trial.mcap_file.cdr.FRAME_ROW` rows in the order of the recording, times are ns from the
recording's first frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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

Rows = NDArray[np.void]
Integers = NDArray[np.int64]

BROADCAST = 0
"""Node number of NMT, SYNC and TIME frames, which belong to no node."""
DIRECTIONS = {"rx": False, "tx": True}
"""Direction as recorded: received from the bus, or sent by the recording computer."""
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
    """Return a sentence with the filters by node, COB-ID, direction and channel."""
    chosen = np.ones(len(frames), np.bool_)
    if selection.nodes:
        chosen &= np.isin(nodes_of(frames), list(selection.nodes))
    if selection.cob_ids:
        chosen &= np.isin(frames["can_id"], list(selection.cob_ids))
    if selection.direction is not None:
        if selection.direction not in DIRECTIONS:
            raise InputError(f"--direction {selection.direction}: expected rx or tx; rx is what the nodes sent.")
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


def restoration(schedule: Schedule, count: int, master: int = 127) -> list[tuple[Frame, int]]:
    """Return the frames, each with its channel, that restore the bus to its state after `count` frames of the schedule.

    On every channel NMT commands for every node but `master`, then the last PDO of each COB-ID in the order of arrival.
    Filtered frames are not sent.
    """
    past = np.concatenate([schedule.before, schedule.frames[:count]])
    found = []
    for channel in np.unique(past["channel"]).tolist():
        there = past[past["channel"] == channel]
        told = [Frame(NMT_COB_ID, bytes((_COMMANDS[state], node)))
                for node, state in sorted(nmt_states(there).items()) if node != master]
        found += [(frame, channel) for frame in (*told, *_last_pdos(there))]
    return found


def _last_pdos(frames: Rows) -> list[Frame]:
    can_id = frames["can_id"]
    pdos = frames[(can_id > TPDO_BASE) & (can_id < SDO_RESPONSE_BASE) & (frames["flags"] == 0)]
    _, from_end = np.unique(pdos["can_id"][::-1], return_index=True)
    return [frame_of(pdos[len(pdos) - 1 - place]) for place in sorted(from_end.tolist(), reverse=True)]
