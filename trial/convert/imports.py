"""Import of foreign files into trials: tables, CAN logs and foreign MCAP.

Everything dropped or changed is counted; the counts go into the trial's result and back to the caller. The table in
docs/trials.md lists repairs and refusals. A topic of an MCAP file is read by its schema: `can_msgs/msg/Frame` in CDR,
or a stamp and float64 columns; every other topic is left out and named.
"""

import gzip
import io
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eds.bench.bench_network import Network, WireLayout
from eds.bench.bench_network import wire as wire_of
from parameters import InputError
from parameters.files import BoundedFile, refuse_large, refuse_special, unpacked_ending
from trial import decode, record
from trial.convert import candump, csv_table, sheets
from trial.convert.csv_file import Dialect
from trial.convert.csv_table import SignalSource
from trial.convert.frames import ChannelNumbers, FrameRows, LoggedFrames, Row, mend, oddities, rising
from trial.convert.lab_table import LabTable
from trial.mcap_file import cdr, records
from trial.read import paths_metadata
from trial.record import Progress, TrialContent, silent
from trial.signals import UNITS, of_bench

Floats = NDArray[np.float64]
PYTHON_CAN = (".asc", ".blf", ".trc", ".db")
LINES_TOLD = 1 << 14  # between two words of progress
READING = 0.7  # of the share: of a CAN log the reading takes longer than the writing


@dataclass
class ImportReport:
    """Result of an import: counts by name (zeros left out), columns left out, and how the file was read.

    `questions` are, by signal, about a range beyond a rope bench. `damage` lists cut frames of a CAN log, by line.
    """

    source: Path
    counts: dict[str, int] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    channels: dict[str, int] = field(default_factory=dict)
    read_as: list[str] = field(default_factory=list)
    questions: dict[str, str] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, object]:
        """Return the report as the trial's result keeps it."""
        counts = {name: count for name, count in self.counts.items() if count}
        return {"imported_from": self.source.name, "counts": counts, "left_out": self.left_out,
                "channels": self.channels, "read_as": self.read_as, "damage": self.damage}


@dataclass
class ForeignContent:
    """Content of a file: frames, a table (times and columns as its schema names them), and topics left out."""

    frames: LoggedFrames
    times: NDArray[np.int64]
    columns: dict[str, NDArray[np.float64]]
    units: dict[str, str]
    left_out: list[str]


class ImportRequest(NamedTuple):
    """Settings of an import: sources of columns, meaning of CAN frames, and the receiver of progress."""

    mapped: Mapping[str, SignalSource] | None
    wire: WireLayout
    progress: Progress


def import_file(
    source: str | Path, target: str | Path, *, mapped: Mapping[str, SignalSource] | None = None,
    wire: WireLayout | None = None,
    overwrite: bool = False, progress: Progress = silent,
) -> ImportReport:
    """Make a trial of `source`, a table, a CAN log or an MCAP file (`FORMATS`); raises `InputError`.

    `mapped` (see `csv_table.read_map`) names columns of tables; `wire` decodes CAN frames, this bench's by default;
    `progress` receives the share done, 0 … 1.
    """
    source = Path(source)
    report = ImportReport(source)
    refuse_special(source)
    reader = _reader(source)
    if mapped is not None and reader is not _from_table and reader is not _from_mcap:
        raise InputError(f"{source}: is a CAN log, which a map does not apply to; leave out --map.")
    wire = wire or wire_of(Network())
    asked = ImportRequest(mapped, wire, lambda share: progress(READING * share))
    content = reader(source, report, asked)
    record.write(target, content, metadata={"imported_from": source.name, **(
        {} if reader is _from_table else paths_metadata(wire.network.bench))}, result=report.as_json(),
        overwrite=overwrite, progress=lambda share: progress(READING + (1 - READING) * share))
    return report


Reader = Callable[[Path, ImportReport, ImportRequest], TrialContent]


FORMATS = ".csv, .tsv, .dat, .txt, .log (also .gz), .xlsx, .tdms, .parquet, .mat, .mf4, .asc, .blf, .trc, .db or .mcap"


def _reader(source: Path) -> Reader:
    ending = unpacked_ending(source)
    if ending == ".txt" and any(map(candump.is_log, first_lines(source))):
        return _from_candump
    if (ending == ".csv" and _is_python_cans(source)) or (ending == ".mf4" and sheets.has_can_frames(source)):
        return _from_python_can
    readers = {".mcap": _from_mcap, ".log": _from_candump, **dict.fromkeys(sheets.ENDINGS, _from_table),
               **dict.fromkeys(PYTHON_CAN, _from_python_can)}
    if ending not in readers:
        raise InputError(f"{source}: the ending {ending or 'is missing and'} names no format; expected {FORMATS}.")
    if source.is_file() and not source.stat().st_size:
        raise InputError(f"{source}: cannot be read (the file is empty); give a recording, a log or a table.")
    return readers[ending]


def table_of(source: Path, sheet: str = "") -> LabTable:
    """Return the table in a file, of a workbook in `sheet`; raises `InputError` for CAN frames and for a trial."""
    refuse_special(source)
    if not source.exists():
        raise InputError(f"{source}: no such file; give the path of a table.")
    if _reader(source) is not _from_table:
        raise InputError(f"{source}: holds no table but CAN frames or topics, which need no map; say bowden import "
                         f"{source} -o trial.mcap.")
    return sheets.sheet_of(source, Dialect(sheet=sheet) if sheet else None)


def raw_content(source: Path) -> LoggedFrames | LabTable:
    """Return the frames or the table in a file as they are; raises `InputError`, also for MCAP."""
    reader = _reader(source)
    if reader is _from_table:
        return sheets.sheet_of(source)
    if reader is _from_candump:
        return _candump_frames(source, silent)
    if reader is _from_python_can:
        from trial.convert.python_can import read_log

        return read_log(source)
    raise InputError(f"{source}: is an MCAP file; it is read as one.")


def first_lines(source: Path, count: int = 20) -> list[str]:
    """Return the first lines of a text, few and short; none of a file that is not there."""
    refuse_special(source)
    try:
        with (gzip.open if source.suffix.lower() == ".gz" else open)(source, "rb") as file:
            return file.read(1 << 14).decode("utf-8", "replace").splitlines()[:count]
    except (OSError, EOFError, zlib.error):
        return []


def _is_python_cans(source: Path) -> bool:
    from trial.convert.python_can import CSV_HEADER

    return first_lines(source, 1)[:1] == [CSV_HEADER]


def _from_table(source: Path, report: ImportReport, asked: ImportRequest) -> TrialContent:
    table = csv_table.read(source, asked.mapped)
    report.counts |= table.counts
    report.left_out, report.read_as, report.questions = table.left_out, table.remarks, table.questions
    times, columns = _ordered(source, table, report)
    if table.begins_ns is not None and table.begins_ns >= 0:
        times = times + table.begins_ns
    return TrialContent(times, columns, np.empty(0, cdr.FRAME_ROW), [])


def _ordered(
    source: Path, table: csv_table.Columns, report: ImportReport
) -> tuple[NDArray[np.int64], dict[str, Floats]]:
    """Return times ≥ 0 and the columns, rows that repeat the one before left out; time that falls is refused."""
    columns = table.columns
    seconds = columns["time_s"]
    unknown = np.flatnonzero(np.isnan(seconds))
    if len(unknown):
        raise InputError(f"{source}: row {table.rows[unknown[0]]} has no time; every row needs its time_s.")
    if np.abs(seconds).max() > 9e9:
        raise InputError(f"{source}: time_s reaches {np.abs(seconds).max():g} s; is it in another unit? Give --map.")
    rows = np.array(list(columns.values()))
    same = np.append(False, ((rows[:, 1:] == rows[:, :-1]) | (np.isnan(rows[:, 1:]) & np.isnan(rows[:, :-1]))).all(0))
    report.counts["repeated_rows"] = int(same.sum())
    first_of_equal = np.flatnonzero(~same)
    falls = np.flatnonzero(np.diff(seconds[first_of_equal]) <= 0)
    if len(falls):
        row = first_of_equal[falls[0] + 1]
        raise InputError(f"{source}: row {table.rows[row]}: time_s = {seconds[row]:g} " + (
            "stands in the row before too; write times with more digits." if seconds[row] == seconds[
                first_of_equal[falls[0]]] else "does not rise; sort or cut the file."))
    times = np.rint(seconds[first_of_equal] * 1e9).astype(np.int64)
    mended = mend(times, source)
    report.counts["shifted_ns"] = mended.shift_ns
    return mended.times, {name: column[first_of_equal] for name, column in columns.items()}


def _from_candump(source: Path, report: ImportReport, asked: ImportRequest) -> TrialContent:
    return _from_log(source, _candump_frames(source, asked.progress), report, asked.wire)


def _candump_frames(source: Path, progress: Progress) -> LoggedFrames:
    try:
        refuse_large(source)
        with BoundedFile(source, lines=True) as raw:
            lines = io.TextIOWrapper(io.BufferedReader(raw, 1 << 16), encoding="ascii", errors="replace")
            return candump.read(_followed(lines, raw, progress))
    except FileNotFoundError:
        raise InputError(f"{source}: no such file; give the path of a CAN log.") from None
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(str(source)) else f"{source}: {error}") from None
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"{source}: cannot be read ({error}); give a candump -L log.") from None


def _followed(lines: Iterable[str], raw: BoundedFile, progress: Progress) -> Iterator[str]:
    """Yield `lines`; every `LINES_TOLD` of them call `progress` with the share of the file `raw` that has been read."""
    for number, line in enumerate(lines, start=1):
        if not number % LINES_TOLD:
            progress(raw.share())
        yield line


def _from_log(source: Path, frames: LoggedFrames, report: ImportReport, wire: WireLayout) -> TrialContent:
    if not len(frames.rows):
        fd_frames = frames.counts.get("fd_frames", 0)
        if fd_frames:
            raise InputError(f"{source}: holds {fd_frames} CAN FD frame{'s' if fd_frames > 1 else ''} and no classical "
                             "one; a bench and its trials are of classical CAN, give such a log.")
        if damage := frames.damage.sentences:
            raise InputError(f"{source}: holds no whole CAN frame ({damage[0]}); give a log that is not cut.")
        raise InputError(f"{source}: holds no CAN frame; give a log in the format that its ending names.")
    return _from_frames(source, frames, report, wire)


def _from_python_can(source: Path, report: ImportReport, asked: ImportRequest) -> TrialContent:
    from trial.convert.python_can import read_log

    return _from_log(source, read_log(source, asked.progress), report, asked.wire)


def _from_mcap(source: Path, report: ImportReport, asked: ImportRequest) -> TrialContent:
    found = read_foreign(source)
    report.left_out = found.left_out
    content = _from_frames(source, found.frames, report, asked.wire)
    if found.columns:
        content.columns = _mapped_columns(source, found, asked.mapped, report)
        content.times, coarse = rising(mend(found.times, source).times, source)
        report.counts["coarse_stamps"] = coarse
        report.counts["cycles"] = len(content.times)
    elif asked.mapped:
        raise InputError(f"{source}: has no table that a map applies to; leave out --map.")
    if not len(content.frames) and not content.columns:
        topics = ", ".join(found.left_out) or "none"
        raise InputError(f"{source}: no topic that can be read (it has {topics}); expected {cdr.FRAME_SCHEMA_NAME} "
                         "or a stamp and float64 columns, in CDR.")
    return content


def _mapped_columns(
    source: Path, found: ForeignContent, mapped: Mapping[str, SignalSource] | None, report: ImportReport
) -> dict[str, Floats]:
    columns = {}
    for name, unit in found.units.items():
        if name in UNITS:
            columns[name] = found.columns[name] * SignalSource(column=name, unit=unit).factor(name, f"{source}: {name}")
    for name, origin in (mapped or {}).items():
        if origin.column not in found.columns:
            raise InputError(f"{source}: the map takes {name} from {origin.column!r}, which is no column of the file.")
        columns[name] = found.columns[origin.column] * origin.factor(name, str(source)) + origin.offset
    columns_used = {origin.column for origin in (mapped or {}).values()}
    report.left_out += [name for name in found.columns if name not in columns and name not in columns_used]
    return columns


def _from_frames(source: Path, frames: LoggedFrames, report: ImportReport, wire: WireLayout) -> TrialContent:
    mended = mend(frames.rows["time_ns"], source)
    frames.rows["time_ns"] = mended.times
    report.counts |= frames.counts | oddities(frames.rows)
    report.counts |= {"frames": len(frames.rows), "clock_steps": mended.steps, "shifted_ns": mended.shift_ns}
    report.channels = frames.channels
    events, found = decode.decoded_events_and_cycles(frames.rows, wire)
    report.counts |= found.counts
    _list_short_pdos(frames, wire)
    report.damage = frames.damage.sentences
    return TrialContent(found.time_ns, found.columns, frames.rows, events, of_bench(wire.network.bench))


def _list_short_pdos(frames: LoggedFrames, wire: WireLayout) -> None:
    """Add the PDOs of the bench's channel that have fewer bytes than are mapped to the log's damage."""
    rows = frames.rows
    ours = (rows["flags"] == 0) & (rows["channel"] == decode.bench_channel(rows, wire))
    sizes = {source.plan.cob_id: source.plan.size for source in decode.layout(wire)}
    for cob_id, size in sizes.items():
        for index in np.flatnonzero(ours & (rows["can_id"] == cob_id) & (rows["dlc"] < size)).tolist():
            frames.damage.add(frames.place(index), f"PDO {cob_id:03X} has {rows['dlc'][index]} of the {size} bytes "
                                                   "that are mapped; kept as a frame, without a value")


_FRAME = struct.Struct("<I3?B")


def read_foreign(path: Path) -> ForeignContent:
    """Read every topic that can be read."""
    with records.mapped(path) as view:
        summary = records.summary(view, path)
        kinds = {channel.number: _kind(channel) for channel in summary.channels.values()}
        frames, tables, others = ([channel for channel in summary.channels.values() if kinds[channel.number] == kind]
                                  for kind in ("frames", "table", ""))
        if len(tables) > 1:
            names = ", ".join(channel.topic for channel in tables)
            raise InputError(f"{path}: has several tables, {names}; give a file with one.")
        columns, units = _topic_columns(tables, path)
        times, values = _topic_table(view, summary, tables, len(columns), path)
        return ForeignContent(
            _topic_frames(view, summary, frames, path), times, dict(zip(columns, values, strict=True)), units,
            [channel.topic for channel in others if channel.topic != cdr.EVENTS])


def _kind(channel: records.Channel) -> str:
    if channel.encoding != "cdr" or channel.schema_encoding != "ros2msg":
        return ""
    if channel.schema_name == cdr.FRAME_SCHEMA_NAME:
        return "frames"
    return "table" if cdr.cycle_columns(channel.schema) else ""


def _topic_columns(tables: list[records.Channel], path: Path) -> tuple[tuple[str, ...], dict[str, str]]:
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


def _topic_table(
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


def _topic_frames(
    view: records.View, summary: records.Summary, channels: list[records.Channel], path: Path
) -> LoggedFrames:
    rows, numbers, malformed = FrameRows(), ChannelNumbers(), 0
    for channel in channels:
        for _, time_ns, payload in _payloads(view, summary, channel, path):
            row = _topic_frame(payload, time_ns, channel.topic, numbers)
            malformed += row is None
            if row is not None:
                rows.add(row)
    frames = rows.rows()
    return LoggedFrames(frames[np.argsort(frames["time_ns"], kind="stable")], numbers.names,
                        {"malformed_frames": malformed})


def _topic_frame(payload: bytes, time_ns: int, topic: str, numbers: ChannelNumbers) -> Row | None:
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
