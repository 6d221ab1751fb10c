"""CAN frames and tables from MCAP files of other programs, and from inconsistent files.

A topic is read by its schema: `can_msgs/msg/Frame` in CDR, or a stamp and float64 columns. Every other topic is left
out and named. `bowden recover` handles files without a summary.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.convert.frames import ChannelNumbers, FrameRows, LoggedFrames, Row
from trial.mcap_file import cdr, records

_FRAME = struct.Struct("<I3?B")


@dataclass
class ForeignContent:
    """Content of a file: frames, a table (times and columns as its schema names them), and topics left out."""

    frames: LoggedFrames
    times: NDArray[np.int64]
    columns: dict[str, NDArray[np.float64]]
    units: dict[str, str]
    left_out: list[str]


def read(path: Path) -> ForeignContent:
    """Read every topic that can be read."""
    with records.mapped(path) as view:
        summary = records.summary(view, path)
        kinds = {channel.number: _kind(channel) for channel in summary.channels.values()}
        frames = [channel for channel in summary.channels.values() if kinds[channel.number] == "frames"]
        tables = [channel for channel in summary.channels.values() if kinds[channel.number] == "table"]
        if len(tables) > 1:
            names = ", ".join(channel.topic for channel in tables)
            raise InputError(f"{path}: has several tables, {names}; give a file with one.")
        columns, units = _columns(tables, path)
        times, values = _table(view, summary, tables, len(columns), path)
        left_out = [channel.topic for channel in summary.channels.values() if kinds[channel.number] == ""]
        return ForeignContent(_frames(view, summary, frames, path), times, dict(zip(columns, values, strict=True)),
                              units,
                              [topic for topic in left_out if topic != cdr.EVENTS])


def _kind(channel: records.Channel) -> str:
    if channel.encoding != "cdr" or channel.schema_encoding != "ros2msg":
        return ""
    if channel.schema_name == cdr.FRAME_SCHEMA_NAME:
        return "frames"
    return "table" if cdr.cycle_columns(channel.schema) else ""


def _columns(tables: list[records.Channel], path: Path) -> tuple[tuple[str, ...], dict[str, str]]:
    names = cdr.cycle_columns(tables[0].schema) or () if tables else ()
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: {tables[0].topic} has the column {name} twice; write it with other names.")
    return names, {name: tables[0].metadata[name] for name in names if name in tables[0].metadata}


def _payloads(
    view: records.View, summary: records.Summary, channel: records.Channel, path: Path
) -> Iterator[tuple[int, int, bytes]]:
    for chunk in records.chunks_of(summary, channel.number, path, len(view)):
        content = records.content(view, chunk, path, summary.checked)
        try:
            yield from records.messages(content, channel.number)
        except records.CutError:
            raise InputError(f"{path}: the chunk at byte {chunk.offset} is damaged; say bowden recover.") from None


def _table(
    view: records.View, summary: records.Summary, tables: list[records.Channel], width: int, path: Path
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    times, rows = [], []
    for channel in tables:
        for _, time_ns, payload in _payloads(view, summary, channel, path):
            if len(payload) != 12 + 8 * width or payload[:4] != b"\0\1\0\0":
                raise InputError(f"{path}: a message of {channel.topic} is not as its schema says; it cannot be read.")
            times.append(time_ns)
            rows.append(np.frombuffer(payload, "<f8", offset=12))
    return np.array(times, np.int64), np.array(rows).T.copy() if rows else np.empty((width, 0))


def _frames(view: records.View, summary: records.Summary, channels: list[records.Channel], path: Path) -> LoggedFrames:
    rows, numbers, malformed = FrameRows(), ChannelNumbers(), 0
    for channel in channels:
        for _, time_ns, payload in _payloads(view, summary, channel, path):
            row = _frame(payload, time_ns, channel.topic, numbers)
            malformed += row is None
            if row is not None:
                rows.add(row)
    frames = rows.rows()
    return LoggedFrames(frames[np.argsort(frames["time_ns"], kind="stable")], numbers.names,
                        {"malformed_frames": malformed})


def _frame(payload: bytes, time_ns: int, topic: str, numbers: ChannelNumbers) -> Row | None:
    """Decode a `can_msgs/msg/Frame` whose `frame_id` may be anything; the channel is its front, or the topic."""
    body = payload[4:]
    try:
        (length,) = struct.unpack_from("<I", body, 8)
        at = 12 + length
        frame_id = body[12:at - 1].decode(errors="replace")
        at += -at % 4
        can_id, remote, extended, error, dlc = _FRAME.unpack_from(body, at)
    except struct.error:
        return None
    data = body[at + 8:at + 16]
    if payload[:4] != b"\0\1\0\0" or dlc > 8 or len(data) != 8:
        return None
    flags = remote * cdr.REMOTE | extended * cdr.EXTENDED | error * cdr.ERROR
    name, _, direction = frame_id.partition("/")
    return time_ns, can_id, flags, dlc, numbers.number(name or topic), direction == "tx", data
