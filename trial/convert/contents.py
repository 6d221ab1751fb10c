"""Contents of a file of any format: streams with rates, gaps, units and ranges, and its author.

Nothing is converted and nothing judged; a property that the file does not state equals None.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eds.bench.bench_network import NAMES, Network, wire
from parameters import InputError
from parameters.files import refuse_special
from trial.convert import imports
from trial.convert.csv_table import offer
from trial.convert.frames import LoggedFrames
from trial.convert.guess_map import guesses
from trial.convert.lab_table import LabTable
from trial.mcap_file import cdr
from trial.signals import UNITS

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


def _stream(name: str, kind: str, times: NDArray[np.int64]) -> StreamSummary:
    """Describe a stream by its times, ns."""
    steps: NDArray[np.float64] = np.diff(np.sort(times).astype(np.float64)) / 1e9
    if not len(steps):
        return StreamSummary(name, kind, len(times), None, None, None)
    middle, span = float(np.median(steps)), float(np.sum(steps))
    rate = (len(times) - 1) / span if span > 0 else None
    regular = middle > 0 and float(np.quantile(steps, 0.9)) <= GAP * middle  # frames come in bursts, which have no gaps
    gaps = int((steps > GAP * middle).sum()) if regular else None
    return StreamSummary(name, kind, len(times), rate, gaps, float(steps.max()))


def _column(name: str, unit: str, values: NDArray[np.float64]) -> ColumnSummary:
    known = values[np.isfinite(values)]
    if not len(known):
        return ColumnSummary(name, unit, None, None, len(values))
    return ColumnSummary(name, unit, float(known.min()), float(known.max()), len(values) - len(known))


def _mcap(path: Path) -> Contents:
    from mcap.exceptions import McapError
    from mcap.reader import SeekingReader

    try:
        with path.open("rb") as file:
            reader = SeekingReader(file)
            summary = reader.get_summary()
            if summary is None:
                raise InputError(f"{path}: has no summary, it is torn; say bowden recover {path} -o FILE.")
            header = reader.get_header()
            found = Contents(path, f"MCAP, profile {header.profile or 'none'}, by {header.library or 'unknown'}")
            times = _times(file, summary)
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
        found.streams.append(_stream(channel.topic, schema.name if schema else channel.message_encoding,
                                     times.get(number, np.empty(0, np.int64))))
    if summary.statistics and summary.statistics.message_count:
        found.begins_ns = summary.statistics.message_start_time
        found.seconds = (summary.statistics.message_end_time - summary.statistics.message_start_time) / 1e9
    _columns_of_trial(path, found)
    return found


def _times(file: Any, summary: Any) -> dict[int, NDArray[np.int64]]:
    """Return the log times of every channel by the message indexes, which are read without unpacking a chunk."""
    gathered: dict[int, list[NDArray[np.int64]]] = {}
    for chunk in summary.chunk_indexes:
        for channel, offset in chunk.message_index_offsets.items():
            file.seek(offset)
            head = file.read(15)  # opcode, length, channel, length of the array
            entries = np.frombuffer(file.read(int.from_bytes(head[11:15], "little")), "<u8").reshape(-1, 2)
            gathered.setdefault(channel, []).append(entries[:, 0].astype(np.int64))
    return {channel: np.concatenate(parts) for channel, parts in gathered.items()}


def _columns_of_trial(path: Path, found: Contents) -> None:
    from trial import read

    if not any(stream.name == cdr.CYCLE for stream in found.streams):
        return
    try:
        opened = read.open(path)
    except InputError as error:
        found.remarks.append(str(error))
        return
    found.columns = [_column(name, opened.units[name], values) for name, values in opened.columns.items()]
    if opened.lost_cycles:
        found.remarks.append(f"{opened.lost_cycles} control cycles are missing")
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
            found.streams.append(_stream(f"  {can_id:03X}h", known.get(can_id, ""),
                                         ours["time_ns"][ours["can_id"] == can_id]))
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
    found.remarks += [f"read with {', '.join(sheet.said)}"] if sheet.said else []
    for name in sheet.names:
        if name in sheet.faults:
            row, _ = sheet.faults[name]
            found.columns.append(ColumnSummary(name, "no numbers", None, None, len(sheet)))
            if name in UNITS:
                found.remarks.append(f"row {row} of {name} is no number")
        else:
            found.columns.append(_column(name, UNITS.get(name) or sheet.unit(name), sheet.column(name)))
    found.remarks += [f"{name} is left out: {why}" for name, why in sheet.left_out.items()]
    _clock(sheet, found)
    if "time_s" not in sheet:
        found.remarks.append(f"no column time_s: {offer(path)}")
    return found


def _clock(sheet: LabTable, found: Contents) -> None:
    guess = next((one for one in guesses(sheet) if one.signal == "time_s"), None)
    if guess is None:
        return
    from trial.convert.csv_table import SignalSource

    values = sheet.column(guess.column) * SignalSource(guess.column, guess.unit).factor("time_s", str(sheet.path))
    known = values[np.isfinite(values)]
    times = np.rint((known - known[0]) * 1e9).astype(np.int64)
    found.streams.append(_stream(guess.column, f"time, {guess.unit}", times))
    found.seconds = float(known.max() - known.min())
    begins = sheet.begins_ns.get(guess.column, -1)
    found.begins_ns = begins if begins >= 0 else round(known[0] * 1e9) if known[0] > 1e8 else None
    if (np.diff(known) <= 0).any():
        found.remarks.append(f"{int(np.count_nonzero(np.diff(known) <= 0))} times of {guess.column} stand or fall")
