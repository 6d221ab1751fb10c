"""Contents of a file of any format: streams with rates, gaps, units and ranges, and its author.

Nothing is converted and nothing judged; a property that the file does not state equals None.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.exceptions import McapError
from numpy.typing import NDArray

from eds.bench.bench_network import NAMES, Network, wire
from parameters import InputError
from parameters.files import refuse_special
from trial import read
from trial.convert import imports
from trial.convert.csv_table import SignalSource, guesses, offer, split_unit
from trial.convert.frames import LoggedFrames
from trial.convert.lab_table import LabTable
from trial.mcap_file import cdr
from trial.signals import UNITS

MANTISSA_BITS = 10
GAP = 2.5  # a gap is longer than so many median steps


class StreamSummary(NamedTuple):
    """One topic, kind of frame or table: how many, how often (Hz), gaps, and the longest silence (s)."""

    name: str
    kind: str
    messages: int
    rate_hz: float | None
    gaps: int | None
    longest_gap_s: float | None


class ColumnSummary(NamedTuple):
    """One column of numbers: its unit, range and how many values are unknown."""

    name: str
    unit: str
    least: float | None
    greatest: float | None
    unknown: int


@dataclass
class Contents:
    """Contents of a file, as `bowden info` shows them."""

    path: Path
    format: str
    begins_ns: int | None = None
    seconds: float | None = None
    streams: list[StreamSummary] = field(default_factory=list)
    columns: list[ColumnSummary] = field(default_factory=list)
    about: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, int] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, object]:
        """Return the content as values that JSON can hold."""
        return {"file": str(self.path), "format": self.format, "begins_ns": self.begins_ns, "seconds": self.seconds,
                "streams": [one._asdict() for one in self.streams], "columns": [one._asdict() for one in self.columns],
                "about": self.about, "attachments": self.attachments,
                "counts": {name: count for name, count in self.counts.items() if count}, "remarks": self.remarks}


def contents(path: Path) -> Contents:
    """Return the contents of a file; raises `InputError` if it cannot be read."""
    refuse_special(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; give the path of a recording, a log or a table.")
    if path.suffix.lower() == ".mcap":
        return _mcap(path)
    found = imports.raw_content(path)
    return _log(path, found) if isinstance(found, LoggedFrames) else _table(path, found)


class StepHistogram:
    """Steps between the times (ns) of a stream that come in parts: counts of steps, alike to 0.1 %, in fixed memory."""

    def __init__(self) -> None:
        self.messages = 0
        self._counts = np.zeros(64 << MANTISSA_BITS, np.int64)
        self._first_ns = self._last_ns = self._longest_ns = 0

    def add(self, times: NDArray[np.int64]) -> None:
        """Add the times of a part, in any order; parts come by their first time."""
        if not len(times):
            return
        times = np.sort(times)
        steps = np.diff(times, prepend=self._last_ns if self.messages else times[0])[0 if self.messages else 1:].clip(0)
        self._first_ns = self._first_ns if self.messages else int(times[0])
        self._last_ns, self.messages = max(self._last_ns, int(times[-1])), self.messages + len(times)
        self._longest_ns = max(self._longest_ns, int(steps.max(initial=0)))
        mantissa, exponent = np.frexp(steps)
        place = (exponent << MANTISSA_BITS) + ((2 * mantissa - 1) * (1 << MANTISSA_BITS)).astype(np.int64)
        self._counts += np.bincount(np.where(steps > 0, place, 0), minlength=len(self._counts))

    def summary(self, name: str, kind: str) -> StreamSummary:
        """Describe the stream."""
        if self.messages < 2:
            return StreamSummary(name, kind, self.messages, None, None, None)
        span, places = (self._last_ns - self._first_ns) / 1e9, np.arange(len(self._counts))
        value = np.ldexp(0.5 + (places & (1 << MANTISSA_BITS) - 1) / (2 << MANTISSA_BITS), places >> MANTISSA_BITS)
        middle, high = (value[np.searchsorted(np.cumsum(self._counts), share * (self.messages - 1))]
                        for share in (0.5, 0.9))
        regular = middle > value[0] and high <= GAP * middle  # frames come in bursts, which have no gaps
        return StreamSummary(name, kind, self.messages, (self.messages - 1) / span if span > 0 else None,
                             int(self._counts[value > GAP * middle].sum()) if regular else None, self._longest_ns / 1e9)


def _stream(name: str, kind: str, times: NDArray[np.int64]) -> StreamSummary:
    """Describe a stream by its times, ns."""
    steps = StepHistogram()
    steps.add(times)
    return steps.summary(name, kind)


def _column(name: str, unit: str, values: NDArray[np.float64]) -> ColumnSummary:
    known = values[np.isfinite(values)]
    if not len(known):
        return ColumnSummary(name, unit, None, None, len(values))
    return ColumnSummary(name, unit, float(known.min()), float(known.max()), len(values) - len(known))


def _together(parts: Sequence[ColumnSummary]) -> ColumnSummary:
    """Return the summary of a column that comes in parts."""
    least = [one.least for one in parts if one.least is not None]
    greatest = [one.greatest for one in parts if one.greatest is not None]
    return parts[0]._replace(least=min(least, default=None), greatest=max(greatest, default=None),
                             unknown=sum(one.unknown for one in parts))


def _mcap(path: Path) -> Contents:
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as file:
            reader = SeekingReader(file)
            summary = reader.get_summary()
            if summary is None:
                raise InputError(f"{path}: has no summary, it is torn; say bowden recover {path} -o FILE.")
            header = reader.get_header()
            found = Contents(path, f"MCAP, profile {header.profile or 'none'}, by {header.library or 'unknown'}")
            steps = _steps(file, summary)
            for metadata in reader.iter_metadata():
                if metadata.name in ("trial", "result", "recovered"):
                    found.about |= {name: text for name, text in metadata.metadata.items() if text}
            found.attachments = {one.name: one.data_size for one in summary.attachment_indexes}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a recording.") from None
    except (McapError, ValueError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is torn, damaged or no MCAP file ({type(error).__name__}); say bowden recover "
                         f"{path} -o FILE.") from None
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        found.streams.append(steps.get(number, StepHistogram()).summary(
            channel.topic, schema.name if schema else channel.message_encoding))
    if summary.statistics and summary.statistics.message_count:
        found.begins_ns = summary.statistics.message_start_time
        found.seconds = (summary.statistics.message_end_time - summary.statistics.message_start_time) / 1e9
    _columns_of_trial(path, found)
    return found


def _steps(file: Any, summary: Any) -> dict[int, StepHistogram]:
    """Return the steps of every channel by the message indexes, which are read without unpacking a chunk."""
    steps: dict[int, StepHistogram] = {}
    for chunk in sorted(summary.chunk_indexes, key=lambda chunk: chunk.message_start_time):
        for channel, offset in chunk.message_index_offsets.items():
            file.seek(offset)
            head = file.read(15)  # opcode, length, channel, length of the array
            entries = np.frombuffer(file.read(int.from_bytes(head[11:15], "little")), "<u8").reshape(-1, 2)
            steps.setdefault(channel, StepHistogram()).add(entries[:, 0].astype(np.int64))
    return steps


def _columns_of_trial(path: Path, found: Contents) -> None:
    if not any(stream.name == cdr.CYCLE for stream in found.streams):
        return
    try:
        opened = read.open_file(path)
        columns = {name: [_column(name, unit, np.empty(0))] for name, unit in opened.units.items()}
        for block in opened.blocks():
            for name, values in block.columns.items():
                columns[name].append(_column(name, opened.units[name], values))
        lost = opened.extent.lost_cycles
    except InputError as error:
        found.remarks.append(str(error))
        return
    found.columns = [_together(parts) for parts in columns.values()]
    if lost:
        found.remarks.append(f"{lost} control cycles are missing")
    if opened.recovered is not None:
        found.remarks.append("recovered from a torn recording")


def _log(path: Path, frames: LoggedFrames) -> Contents:
    rows = frames.rows
    found = Contents(path, "CAN log", counts=dict(frames.counts))
    if len(rows):
        found.begins_ns = int(rows["time_ns"].min())
        found.seconds = float(rows["time_ns"].max() - rows["time_ns"].min()) / 1e9
    for name, number in frames.channels.items():
        ours = rows[rows["channel"] == number]
        found.streams.append(_stream(f"channel {name}", "frames", ours["time_ns"]))
        known = _known_ids()
        for can_id in np.unique(ours["can_id"]).tolist():
            kind = known.get(can_id, "")
            stream = _stream(f"  {can_id:03X}h", kind, ours["time_ns"][ours["can_id"] == can_id])
            requested = kind.startswith(("SDO", "NMT", "EMCY", "controlwords"))  # sent as they are needed, at no rate
            found.streams.append(stream._replace(rate_hz=None, gaps=None) if requested else stream)
    return found


def _known_ids() -> dict[int, str]:
    described = wire(Network())
    known = {0x000: "NMT", 0x080: "SYNC", described.targets.cob_id: "targets",
             described.controlwords.cob_id: "controlwords"}
    for node, name in NAMES.items():
        known |= {0x080 + node: f"EMCY of {name}", 0x180 + node: f"TPDO of {name}", 0x580 + node: f"SDO of {name}",
                  0x600 + node: f"SDO to {name}", 0x700 + node: f"heartbeat of {name}"}
    return known


def _table(path: Path, sheet: LabTable) -> Contents:
    found = Contents(path, f"table of {len(sheet)} rows", counts=dict(sheet.counts))
    found.remarks += [f"read with {', '.join(sheet.remarks)}"] if sheet.remarks else []
    for name in sheet.names:
        if name in sheet.faults:
            row, _ = sheet.faults[name]
            found.columns.append(ColumnSummary(name, "no numbers", None, None, len(sheet)))
            if name in UNITS:
                found.remarks.append(f"row {row} of {name} is no number")
        else:
            unit = UNITS.get(name) or sheet.unit(name) or split_unit(name)[1]
            found.columns.append(_column(name, unit, sheet.column(name)))
    found.remarks += [f"{name} is left out: {why}" for name, why in sheet.left_out.items()]
    _clock(sheet, found)
    if "time_s" not in sheet:
        found.remarks.append(f"no column time_s: {offer(path)}")
    return found


def _clock(sheet: LabTable, found: Contents) -> None:
    guess = next((one for one in guesses(sheet) if one.signal == "time_s"), None)
    if guess is None:
        return
    values = sheet.column(guess.column) * SignalSource(guess.column, guess.unit).factor("time_s", str(sheet.path))
    known = values[np.isfinite(values)]
    times = np.rint((known - known[0]) * 1e9).astype(np.int64)
    found.streams.append(_stream(guess.column, f"time, {guess.unit}", times))
    found.seconds = float(known.max() - known.min())
    begins = sheet.begins_ns.get(guess.column, -1)
    found.begins_ns = begins if begins >= 0 else round(known[0] * 1e9) if known[0] > 1e8 else None
    if (np.diff(known) <= 0).any():
        found.remarks.append(f"{int(np.count_nonzero(np.diff(known) <= 0))} times of {guess.column} do not rise")
