"""Contents of a file of any format: streams with rates, gaps, units and ranges, and its author.

Nothing is converted and nothing judged; a property that the file does not state equals None.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eds.bench.bench_network import NAMES, Network, wire
from parameters import InputError
from parameters.files import refuse_special
from trial import read
from trial.convert import imports
from trial.convert.csv_table import SignalSource, guesses, offer, written_unit
from trial.convert.frames import LoggedFrames
from trial.convert.lab_table import LabTable
from trial.mcap_file import cdr, records
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
    """Histogram of the steps between a stream's times, ns, in bins 0.1 % wide: fixed memory at any length."""

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

    @property
    def ends_ns(self) -> tuple[int, int]:
        """First and last time, ns."""
        return self._first_ns, self._last_ns

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
    with records.mapped(path) as view:
        summary = records.summary(view, path)
        steps = {number: StepHistogram() for number in summary.channels}
        for number, times in records.message_times(view, path):
            steps.setdefault(number, StepHistogram()).add(times)
        profile, library = records.header(view, path)
        found = Contents(path, f"MCAP, profile {profile or 'none'}, by {library or 'unknown'}")
        for name, written in records.metadata(view, summary, path).items():
            if name in ("trial", "result", "recovered"):
                found.about |= {key: text for key, text in written.items() if text}
        found.attachments = {name: len(data) for name, data in records.attachments(view, summary, path).items()}
    for number, channel in summary.channels.items():
        found.streams.append(steps[number].summary(channel.topic, channel.schema_name or channel.encoding))
    ends = np.array([one.ends_ns for one in steps.values() if one.messages])
    if len(ends):
        found.begins_ns = int(ends.min())
        found.seconds = (int(ends.max()) - found.begins_ns) / 1e9
    if not found.streams:
        found.remarks.append("no topics: nothing was recorded")
    _columns_of_trial(path, found)
    return found


def _columns_of_trial(path: Path, found: Contents) -> None:
    if not any(stream.name == cdr.CYCLE for stream in found.streams):
        return
    try:
        opened = read.open_file(path)
        columns = {name: _column(name, unit, np.empty(0)) for name, unit in opened.units.items()}
        for block in opened.blocks():
            for name, values in block.columns.items():
                columns[name] = _together((columns[name], _column(name, opened.units[name], values)))
        lost = opened.extent.lost_cycles
    except InputError as error:
        found.remarks.append(str(error))
        return
    found.columns = list(columns.values())
    if lost:
        found.remarks.append(f"{lost} control cycles are missing")
    if opened.recovered is not None:
        found.remarks.append("recovered from a torn recording")


def _log(path: Path, frames: LoggedFrames) -> Contents:
    rows = frames.rows
    found = Contents(path, "CAN log", counts=dict(frames.counts))
    found.remarks += frames.damage.sentences
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
            row, cell = sheet.faults[name]
            found.columns.append(ColumnSummary(name, "no numbers", None, None, len(sheet)))
            if name in UNITS:
                found.remarks.append(f"row {row} of {name} is no number: {cell[:40]!r}")
        else:
            found.columns.append(_column(name, written_unit(sheet, name), sheet.column(name)))
    found.remarks += [f"{name} is left out: {why}" for name, why in sheet.left_out.items()]
    _clock(sheet, found)
    if "time_s" not in sheet:
        found.remarks.append(f"no column time_s: {offer(path)}")
    return found


def _clock(sheet: LabTable, found: Contents) -> None:
    guess = next((one for one in guesses(sheet) if one.signal == "time_s"), None)
    if guess is None:
        if "time_s" in sheet and "time_s" not in sheet.faults:
            falls = int(np.count_nonzero(np.diff(sheet.column("time_s")) <= 0))
            found.remarks.append(f"{falls} times of time_s do not rise")
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
