"""A recorded trial, opened: by block (`TrialFile`), or whole in memory (`Trial`).

Bytes become numbers in bulk, a chunk at a time, and every number is returned under its name and unit or not at all.
Reading by block needs the same memory for a minute as for an hour.

`one_path` returns one force path of a trial of several as a trial of a single one: columns `<path>.<name>`, attachments
and metadata lose their prefix; entries without a prefix hold for every path.
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from eds.declaration import DeclaredBench
from parameters import InputError
from trial.mcap_file import cdr, records
from trial.mcap_file import container as mcap
from trial.signals import UNITS, of_path

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
ROWS_AT_ONCE: Final = 8192
"""Least number of control cycles in a block, but for the last; 34 columns of them take 2.2 MB."""


class Event(NamedTuple):
    """One event; `kind` as in `Recorder.event`."""

    time_ns: int
    kind: str
    source: str
    text: str


class RowBlock(NamedTuple):
    """Successive control cycles: times, ns, and float64 columns by name, NaN where unknown."""

    time_ns: Integers
    columns: Mapping[str, Floats]


class Extent(NamedTuple):
    """Number of control cycles, times of the first and the last one (ns; 0 without any), and cycles lost before it."""

    rows: int
    first_ns: int
    last_ns: int
    lost_cycles: int


@dataclass(frozen=True, kw_only=True)
class TrialFile:
    """One experiment: its descriptions in memory, its control cycles and frames read by block.

    `units` are those of the columns, in the order of the file.  `stored_names`: the file's names of columns that are
    shown under others; `has_frames`: False where the file's frames are those of several force paths.
    """

    path: Path
    units: Mapping[str, str]
    events: tuple[Event, ...]
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    result: Mapping[str, object] | None
    derived: frozenset[str] = frozenset()
    recovered: Mapping[str, str] | None = None
    table: str = cdr.CYCLE
    stored_names: Mapping[str, str] = field(default_factory=dict)
    has_frames: bool = True
    _summary: records.Summary | None = field(default=None, repr=False)
    _identity: tuple[int, ...] = field(default=(), repr=False)

    @contextmanager
    def _view(self) -> Iterator[tuple[records.View, records.Summary]]:
        with records.mapped(self.path) as view:
            if _identity(self.path) != self._identity:
                raise InputError(f"{self.path}: the file changed since it was opened; open it again.")
            yield view, self._summary or records.summary(view, self.path)

    @cached_property
    def extent(self) -> Extent:
        """Rows and times, by one pass over the file; raises `InputError` as `blocks` does."""
        with self._view() as (view, summary):
            rows = first = last = sequence = 0
            for part in _table_records(view, summary, self.table, self.path):
                first = first if rows else int(part["log_time"][0])
                rows, last, sequence = rows + len(part), int(part["log_time"][-1]), int(part["sequence"][-1]) + 1
            return Extent(rows, first, last, sequence - rows)

    def blocks(self, names: Iterable[str] | None = None) -> Iterator[RowBlock]:
        """Yield the control cycles in blocks with the columns `names` (None: all).

        Raises `InputError` where the file has changed, is damaged or contradicts itself.
        """
        names = list(self.units if names is None else names)
        with self._view() as (view, summary):
            stored = {name: at for at, name in enumerate(_columns(_described(summary, self.table, self.path),
                                                                  self.path)[0])}
            places = [stored[self.stored_names.get(name, name)] for name in names]
            parts, count = list[tuple[Integers, Floats]](), 0
            for rows in _table_records(view, summary, self.table, self.path):
                parts.append((rows["log_time"].astype(np.int64), rows["values"][:, places].T))
                count += len(rows)
                if count >= ROWS_AT_ONCE:
                    yield _joined(parts, names)
                    parts, count = [], 0
            if parts:
                yield _joined(parts, names)

    def frame_blocks(self) -> Iterator[NDArray[np.void]]:
        """Yield the CAN frames in the order of the file, a chunk at a time, as `cdr.FRAME_ROW`."""
        if self.has_frames:
            with self._view() as (view, summary):
                yield from frame_blocks(view, self.path, summary)

    @cached_property
    def frames(self) -> NDArray[np.void]:
        """CAN frames as recorded, as `cdr.FRAME_ROW`: time_ns, can_id, flags, dlc, channel, sent, data."""
        return np.concatenate([np.empty(0, cdr.FRAME_ROW), *self.frame_blocks()])


def _joined(parts: list[tuple[Integers, Floats]], names: list[str]) -> RowBlock:
    times, values = zip(*parts, strict=True)
    return RowBlock(np.concatenate(times), dict(zip(names, np.concatenate(values, axis=1), strict=True)))


@dataclass(frozen=True, kw_only=True)
class Trial(TrialFile):
    """A trial in memory.  `columns[name]` are float64 of equal length, one value a control cycle, NaN where unknown."""

    time_ns: Integers
    columns: Mapping[str, Floats]
    lost_cycles: int = 0

    @property
    def extent(self) -> Extent:
        """Rows and times."""
        first, last = self.time_ns[[0, -1]].tolist() if len(self.time_ns) else (0, 0)
        return Extent(len(self.time_ns), first, last, self.lost_cycles)

    def blocks(self, names: Iterable[str] | None = None) -> Iterator[RowBlock]:
        """Yield the control cycles in blocks with the columns `names` (None: all)."""
        names = list(self.columns if names is None else names)
        for at in range(0, len(self.time_ns), ROWS_AT_ONCE):
            part = slice(at, at + ROWS_AT_ONCE)
            yield RowBlock(self.time_ns[part], {name: self.columns[name][part] for name in names})

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


def open_file(path: str | Path, table: str = cdr.CYCLE) -> TrialFile:
    """Open a file whose columns are in the topic `table`, to be read by block.

    Raises `InputError` where its descriptions are torn, damaged, foreign or contradict themselves; its data are checked
    as they are read.
    """
    with records.mapped(path) as view:
        return _file(view, Path(path), table)


def _file(view: records.View, path: Path, table: str) -> TrialFile:
    summary = records.summary(view, path)
    channel = _described(summary, table, path)
    metadata = records.metadata(view, summary, path)
    return TrialFile(
        path=path,
        units=_columns(channel, path)[1],
        events=_events(view, summary, path),
        metadata=metadata.get("trial", {}),
        attachments=records.attachments(view, summary, path),
        result=_result(metadata.get("result"), path),
        derived=frozenset(channel.metadata.get("derived", "").split()),
        recovered=metadata.get("recovered"),
        table=table,
        _summary=summary,
        _identity=_identity(path),
    )


def open(path: str | Path) -> Trial:
    """Open a trial whole; raises `InputError` where the file is torn, damaged, foreign or contradicts itself."""
    return open_table(path, cdr.CYCLE)


def open_table(path: str | Path, table: str) -> Trial:
    """Open a file whose columns are in the topic `table`, whole in memory."""
    with records.mapped(path) as view:
        return _whole(view, _file(view, Path(path), table))


def whole(file: TrialFile) -> Trial:
    """Return a trial in memory; raises `InputError` as `TrialFile.blocks` does."""
    if isinstance(file, Trial):
        return file
    with file._view() as (view, _):
        return _whole(view, file)


def _whole(view: records.View, file: TrialFile) -> Trial:
    summary = file._summary or records.summary(view, file.path)
    channel = _described(summary, file.table, file.path)
    times, values, lost = _table(view, summary, channel, file.path)
    stored = dict(zip(_columns(channel, file.path)[0], values, strict=True))
    descriptions = {part.name: getattr(file, part.name) for part in fields(TrialFile)}
    return Trial(**descriptions, time_ns=times, lost_cycles=lost,
                 columns={name: stored[file.stored_names.get(name, name)] for name in file.units})


def _described(summary: records.Summary, table: str, path: Path) -> records.Channel:
    channel = _channel(summary, table)
    if channel is None:
        raise InputError(f"{path}: has no topic {table}, so it is no trial; say bowden import {path} -o FILE."
                         if summary.channels else f"{path}: has no topics, so nothing was recorded; record again.")
    return channel


def _identity(path: Path) -> tuple[int, ...]:
    status = path.stat()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def frame_blocks(
    view: records.View, path: str | Path, summary: records.Summary | None = None
) -> Iterator[NDArray[np.void]]:
    """Yield the CAN frames in an MCAP file's bytes a chunk at a time, as `cdr.FRAME_ROW`; none without `/can/frames`.
    """
    summary, path = summary or records.summary(view, path), Path(path)
    channel = _channel(summary, cdr.FRAMES)
    if channel is None:
        return
    if channel.schema != cdr.FRAME_SCHEMA:
        raise InputError(f"{path}: {channel.topic} is not {cdr.FRAME_SCHEMA_NAME}; say bowden import.")
    chunks = records.chunks_of(summary, channel.number, path, len(view))
    for content in records.contents(view, chunks, path, summary.checked):
        yield cdr.frame_rows(_fixed(content, cdr.FRAME_RECORD, channel.number, path))


def _result(written: Mapping[str, str] | None, path: Path) -> dict[str, object] | None:
    try:
        return None if written is None else {key: json.loads(text) for key, text in written.items()}
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: the result is not JSON ({error}); say bowden import {path} -o FILE.") from None


def _channel(found: records.Summary, topic: str) -> records.Channel | None:
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


def _table_records(
    view: records.View, summary: records.Summary, table: str, path: Path
) -> Iterator[NDArray[np.void]]:
    """Yield the message records of a table, a chunk at a time; raises `InputError` where their times do not rise."""
    channel = _described(summary, table, path)
    dtype, count, before_ns = cdr.cycle_record(len(_columns(channel, path)[0])), 0, -1
    chunks = records.chunks_of(summary, channel.number, path, len(view))
    for content in records.contents(view, chunks, path, summary.checked):
        rows = _fixed(content, dtype, channel.number, path)
        if not len(rows):
            continue
        times = rows["log_time"].astype(np.int64)
        if times[0] <= before_ns or not (times[1:] > times[:-1]).all():
            back = np.flatnonzero(np.diff(times, prepend=before_ns) <= 0)
            raise InputError(
                f"{path}: {table} row {count + back[0] + 1} is at {rows['log_time'][back[0]]} ns, not after the row "
                "before; say bowden import, which can mend and count that.")
        count, before_ns = count + len(rows), int(rows["log_time"][-1])
        yield rows


def _table(
    view: records.View, summary: records.Summary, channel: records.Channel, path: Path
) -> tuple[Integers, Floats, int]:
    """Return times, columns (names, rows) and the number of lost rows of a table."""
    width = len(_columns(channel, path)[0])
    records.chunks_of(summary, channel.number, path, len(view))  # raises before the room is taken
    room = records.unpacked_bytes(summary, channel.number) // cdr.cycle_record(width).itemsize
    times, values = np.empty(room, np.int64), np.empty((width, room))
    count = sequence = 0
    for rows in _table_records(view, summary, channel.topic, path):
        end = count + len(rows)
        times[count:end], values[:, count:end] = rows["log_time"], rows["values"].T
        count, sequence = end, int(rows["sequence"][-1]) + 1
    return times[:count], values[:, :count], sequence - count


def _events(view: records.View, found: records.Summary, path: Path) -> tuple[Event, ...]:
    channel = _channel(found, cdr.EVENTS)
    if channel is None:
        return ()
    events = []
    for chunk in records.chunks_of(found, channel.number, path, len(view)):
        content = records.content(view, chunk, path, found.checked)
        try:
            events += [Event(time_ns, *cdr.event_strings(payload))
                       for _, time_ns, payload in records.messages(content, channel.number)]
        except (records.CutError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: an event is damaged ({error}); say bowden recover {path} -o FILE.") from None
    return tuple(events)


T = TypeVar("T")
File = TypeVar("File", bound=TrialFile)
PATHS = "paths"
"""Key of the metadata that lists a trial's force paths; a trial of a single path has none."""
ALONE = "joint_alone"
"""Key of a path's metadata: true where no other path has its joint, so that its frames are those of a single path."""


def paths_metadata(bench: DeclaredBench) -> dict[str, str]:
    """Return the metadata that lists a bench's force paths; none for a bench of a single path."""
    return {PATHS: " ".join(path.name for path in bench.force_paths)} if len(bench.force_paths) > 1 else {}


def path_names(trial: TrialFile) -> tuple[str, ...]:
    """Return the force paths of a trial of several, in declared order; none for a trial of a single path."""
    return tuple(trial.metadata.get(PATHS, "").split())


def one_path(trial: File, path: str | None) -> File:
    """Return one force path of a trial of several as a trial; raises `InputError` for a path that it has not, or None.
    """
    known = path_names(trial)
    if path is None:
        raise InputError(f"{trial.path}: records the force paths {', '.join(known)}; name one with --path.")
    refuse_unknown(str(trial.path), path, known)
    metadata = {key: text for key, text in _own(trial.metadata, path, known).items() if key != PATHS}
    result = None if trial.result is None else dict(trial.result)
    homed: Any = (result or {}).pop("homed", {})
    if result is not None:
        result |= homed.get(path, {})
    others = set(known) - {path}
    stored = {name: old for old in trial.units if (name := of_path(old, path)) is not None}
    in_memory: dict[str, Any] = {"columns": {name: trial.columns[old] for name, old in stored.items()}} if isinstance(
        trial, Trial) else {}
    return dataclasses.replace(
        trial, **in_memory, stored_names=stored, units={name: trial.units[old] for name, old in stored.items()},
        derived=frozenset(filter(None, (of_path(old, path) for old in trial.derived))),
        events=tuple(event for event in trial.events if event.source not in others),
        metadata={**metadata, "path": path}, attachments=_own(trial.attachments, path, known), result=result,
        has_frames=metadata.get(ALONE) == "true")


def refuse_unknown(source: str, path: str, known: tuple[str, ...]) -> None:
    """Raise `InputError` if a file of the paths `known` does not have a path."""
    if path not in known:
        raise InputError(f"{source}: has no path {path}; " + (
            f"expected one of {', '.join(known)}." if known else "it records a single one: leave --path out."))


def _own(given: Mapping[str, T], path: str, known: tuple[str, ...]) -> dict[str, T]:
    """Return the entries of all paths, those with the prefix of this path in their place."""
    prefixes = tuple(f"{name}." for name in known)
    common = {key: value for key, value in given.items() if not key.startswith(prefixes)}
    return common | {key.removeprefix(f"{path}."): value for key, value in given.items() if key.startswith(f"{path}.")}
