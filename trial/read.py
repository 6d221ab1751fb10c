"""A recorded trial, opened.

The rule of this file: bytes become numbers in bulk, a chunk at a time, and every number comes back under
its name and unit or not at all.  `/cycle` is read at once; `/can/frames` when it is first asked for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.mcap_file import cdr, records, scan
from trial.mcap_file import container as mcap
from trial.signals import UNITS

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Event(NamedTuple):
    """One event; `kind` as in `Recorder.event`."""

    time_ns: int
    kind: str
    source: str
    text: str


@dataclass(frozen=True)
class Trial:
    """One experiment.  `columns[name]` are float64 of equal length, one value a control cycle, NaN where unknown."""

    path: Path
    time_ns: Integers
    columns: Mapping[str, Floats]
    units: Mapping[str, str]
    events: tuple[Event, ...]
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    result: Mapping[str, object] | None
    derived: frozenset[str] = frozenset()
    lost_cycles: int = 0
    recovered: Mapping[str, str] | None = None
    _summary: scan.Summary | None = field(default=None, repr=False)
    _identity: tuple[int, ...] = field(default=(), repr=False)

    @cached_property
    def frames(self) -> NDArray[np.void]:
        """CAN frames as recorded, as `cdr.FRAME_ROW`: time_ns, can_id, flags, dlc, channel, sent, data."""
        with records.mapped(self.path) as view:
            if _identity(self.path) != self._identity:
                raise InputError(f"{self.path}: the file changed since it was opened; open it again.")
            return frames_of(view, self.path, self._summary)

    def digest(self) -> str:
        """Return a SHA-256 over every channel's names, times and values; attachments and chunking play no part."""
        total = hashlib.sha256()
        for name, column in self.columns.items():
            total.update(f"{name} {self.units[name]}\n".encode())
            total.update(np.ascontiguousarray(column).tobytes())
        total.update(np.ascontiguousarray(self.time_ns).tobytes())
        total.update(np.ascontiguousarray(self.frames).tobytes())
        total.update(repr([tuple(event) for event in self.events]).encode())
        return total.hexdigest()


def open(path: str | Path) -> Trial:
    """Open a trial; raises `InputError` where the file is torn, damaged, foreign or contradicts itself."""
    return open_table(path, cdr.CYCLE)


def open_table(path: str | Path, table: str) -> Trial:
    """Open a file whose columns are in the topic `table`."""
    path = Path(path)
    with records.mapped(path) as view:
        found = scan.summary(view, path)
        channel = _channel(found, table)
        if channel is None:
            raise InputError(f"{path}: has no topic {table}, so it is no trial; say bowden import {path} -o FILE.")
        names, units = _columns(channel, path)
        times, values, lost = _table(view, found, channel, len(names), path)
        metadata = scan.metadata(view, found, path)
        return Trial(
            path=path,
            time_ns=times,
            columns=dict(zip(names, values, strict=True)),
            units=units,
            events=_events(view, found, path),
            metadata=metadata.get("trial", {}),
            attachments=scan.attachments(view, found, path),
            result=_result(metadata.get("result"), path),
            derived=frozenset(channel.metadata.get("derived", "").split()),
            lost_cycles=lost,
            recovered=metadata.get("recovered"),
            _summary=found,
            _identity=_identity(path),
        )


def _identity(path: Path) -> tuple[int, ...]:
    told = path.stat()
    return told.st_dev, told.st_ino, told.st_size, told.st_mtime_ns


def frames_of(view: records.View, path: str | Path, found: scan.Summary | None = None) -> NDArray[np.void]:
    """Return the CAN frames in an MCAP file's bytes as `cdr.FRAME_ROW`, none where it has no `/can/frames`."""
    found = found or scan.summary(view, path)
    channel = _channel(found, cdr.FRAMES)
    return np.empty(0, cdr.FRAME_ROW) if channel is None else _frames(view, found, channel, Path(path))


def _result(written: Mapping[str, str] | None, path: Path) -> dict[str, object] | None:
    try:
        return None if written is None else {key: json.loads(text) for key, text in written.items()}
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: the result is not JSON ({error}); say bowden import {path} -o FILE.") from None


def _channel(found: scan.Summary, topic: str) -> records.Channel | None:
    return next((channel for channel in found.channels.values() if channel.topic == topic), None)


def _columns(channel: records.Channel, path: Path) -> tuple[tuple[str, ...], dict[str, str]]:
    names = cdr.cycle_columns(channel.schema) if channel.schema_encoding == "ros2msg" else None
    if channel.encoding != "cdr" or names is None:
        raise InputError(f"{path}: {channel.topic} is not a stamp and float64 columns in CDR; say bowden import.")
    units = {}
    for name in names:
        unit = channel.metadata.get(name)
        if name in units:
            raise InputError(f"{path}: {channel.topic} has the column {name} twice; say bowden import with a map.")
        if unit is None:
            raise InputError(f"{path}: {channel.topic} states no unit for {name}; say bowden import with a map.")
        if unit != UNITS.get(name, unit):
            raise InputError(f"{path}: {name} is in {unit}, expected {UNITS[name]}; say bowden import with a map.")
        units[name] = unit
    return names, units


def _fixed(data: bytes, dtype: np.dtype[np.void], channel: int, path: Path) -> NDArray[np.void]:
    """View a chunk's content as message records of one channel; other records are left out."""
    if len(data) % dtype.itemsize == 0:
        rows = np.frombuffer(data, dtype)
        if (rows["channel"] == channel).all() and _regular(rows):
            return rows
    try:
        whole = [data[at - 9:end] for opcode, at, end in records.records(data, 0, len(data))
                 if opcode == mcap.MESSAGE and int.from_bytes(data[at:at + 2], "little") == channel]
        rows = np.frombuffer(b"".join(whole), dtype)
    except (records.CutError, ValueError):
        rows = np.empty(0, dtype)
        whole = [b""]
    if len(rows) != len(whole) or not _regular(rows):
        raise InputError(f"{path}: messages do not have the layout their schema states; say bowden import.")
    return rows


def _regular(rows: NDArray[np.void]) -> bool:
    return bool(
        (rows["opcode"] == mcap.MESSAGE).all()
        and (rows["length"] == rows.dtype.itemsize - 9).all()
        and (rows["cdr"] == cdr.LITTLE_ENDIAN).all()
    )


def _table(
    view: records.View, found: scan.Summary, channel: records.Channel, width: int, path: Path
) -> tuple[Integers, Floats, int]:
    dtype = cdr.cycle_record(width)
    chunks = scan.chunks_of(found, channel.number, path, len(view))
    room = sum(chunk.unpacked for chunk in chunks) // dtype.itemsize
    times, values, sequence = np.empty(room, np.int64), np.empty((width, room)), np.empty(room, np.uint32)
    count = 0
    for chunk in chunks:
        rows = _fixed(scan.content(view, chunk, path, found.checked), dtype, channel.number, path)
        end = count + len(rows)
        times[count:end] = rows["log_time"]
        sequence[count:end] = rows["sequence"]
        values[:, count:end] = rows["values"].T
        count = end
    times, values = times[:count], values[:, :count]
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        raise InputError(
            f"{path}: {channel.topic} row {back[0] + 2} is at {times[back[0] + 1]} ns, not after the row before; "
            "say bowden import, which can mend and count that.")
    lost = int(sequence[count - 1]) + 1 - count if count else 0
    return times, values, lost


def _frames(view: records.View, found: scan.Summary, channel: records.Channel, path: Path) -> NDArray[np.void]:
    if channel.schema != cdr.FRAME_SCHEMA:
        raise InputError(f"{path}: {channel.topic} is not {cdr.FRAME_SCHEMA_NAME}; say bowden import.")
    chunks = scan.chunks_of(found, channel.number, path, len(view))
    rows = np.empty(sum(chunk.unpacked for chunk in chunks) // cdr.FRAME_RECORD.itemsize, cdr.FRAME_ROW)
    count = 0
    for chunk in chunks:
        records = _fixed(scan.content(view, chunk, path, found.checked), cdr.FRAME_RECORD, channel.number, path)
        rows[count:count + len(records)] = cdr.frame_rows(records)
        count += len(records)
    return rows[:count]


def _events(view: records.View, found: scan.Summary, path: Path) -> tuple[Event, ...]:
    channel = _channel(found, cdr.EVENTS)
    if channel is None:
        return ()
    events = []
    for chunk in scan.chunks_of(found, channel.number, path, len(view)):
        content = scan.content(view, chunk, path, found.checked)
        try:
            events += [Event(time_ns, *cdr.event_strings(payload))
                       for _, time_ns, payload in records.messages(content, channel.number)]
        except (records.CutError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: an event is damaged ({error}); say bowden recover {path} -o FILE.") from None
    return tuple(events)
