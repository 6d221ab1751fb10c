"""Measured data in memory: columns by their names of the signal table, read once, filtered alike.

The rule of this file: it is the only place of the diagnosis that knows where numbers come from (CSV,
gzipped CSV, MCAP); a missing column is missing knowledge, never zeros; nothing is repaired silently.
"""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from parameters import InputError
from physics.laws import Array

UNITS: Final[Mapping[str, str]] = {
    "time_s": "s", "gait_percent": "%", "cycle": "",
    "servo_target_m": "m", "servo_position_m": "m", "servo_velocity_m_s": "m/s", "servo_force_n": "N",
    "knee_target_rad": "rad", "knee_angle_rad": "rad",
    "tension_start_n": "N", "tension_end_n": "N", "desired_force_n": "N", "estimated_end_force_n": "N",
}
"""The signals that CSV headers, the channel /cycle and report axes share."""

COUNTERS: Final = ("time_s", "gait_percent", "cycle")
AGE_SUFFIX: Final = "_age_ns"
DEGREE_ALIAS: Final = "knee_angle_deg"


@dataclass(frozen=True)
class Table:
    """One trial: float64 columns of equal length; `digest` tells equal files, `calibration` is what it carries."""

    source: str
    columns: Mapping[str, Array]
    digest: str
    calibration: Mapping[str, Any] | None = None
    lowpass_hz: float | None = None
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.columns["time_s"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]


def read(path: str | Path) -> Table:
    """Read a trial (.mcap) or a CSV (plain or .gz) with a subset of the canonical headers.

    Raises `InputError` for a file that is absent, unreadable, ragged, without `time_s` or without any signal.
    """
    path = Path(path)
    if path.suffix == ".mcap":
        return _read_mcap(path)
    header, values = _read_csv(path)
    return table(str(path), {name: values[:, i] for i, name in enumerate(header)})


def table(
    source: str, columns: Mapping[str, Sequence[float] | Array], calibration: Mapping[str, Any] | None = None
) -> Table:
    """Keep the known columns of `columns`; raises `InputError` without `time_s` or without a signal."""
    known: dict[str, Array] = {}
    for name, values in columns.items():
        if name == DEGREE_ALIAS:
            known["knee_angle_rad"] = np.deg2rad(np.asarray(values, dtype=np.float64))
        elif name in UNITS or name.endswith(AGE_SUFFIX):
            known[name] = np.ascontiguousarray(values, dtype=np.float64)
    if "time_s" not in known:
        raise InputError(f"{source}: no column time_s; name the time column time_s, in seconds.")
    if not any(name not in COUNTERS and not name.endswith(AGE_SUFFIX) for name in known):
        raise InputError(f"{source}: no signal among its columns; expected some of {', '.join(UNITS)}.")
    ignored = sorted(set(columns) - set(known) - {DEGREE_ALIAS})
    notes = (f"columns not known, not used: {', '.join(ignored)}",) if ignored else ()
    known = _numbered(known)
    return Table(source, known, _digest(known), calibration, notes=notes)


def _numbered(columns: dict[str, Array]) -> dict[str, Array]:
    """Leave out the rows before and after the numbered cycles: there the encoder's zero may be another.

    What is done between two of them belongs to the first.
    """
    inside = np.flatnonzero(columns["cycle"] >= 0.0) if "cycle" in columns else np.zeros(0, dtype=np.intp)
    if not inside.size or inside.size == columns["cycle"].size:
        return columns
    kept = {name: values[inside[0]:inside[-1] + 1] for name, values in columns.items()}
    cycle = kept["cycle"]
    last = np.maximum.accumulate(np.where(cycle >= 0.0, np.arange(cycle.size), 0))
    return {**kept, "cycle": cycle[last]}


def _digest(columns: Mapping[str, Array]) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(columns):
        digest.update(name.encode() + columns[name].tobytes())
    return digest.hexdigest()


def _read_csv(path: Path) -> tuple[list[str], Array]:
    opener: Any = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding="utf-8-sig") as stream:
            header = [name.strip() for name in stream.readline().split(",")]
            rows = stream.read()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a trial (.mcap, .csv, .csv.gz).") from None
    except (OSError, UnicodeDecodeError, EOFError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a readable .mcap, .csv or .csv.gz.") from None
    repeated = {name for name in header if header.count(name) > 1}
    if repeated:
        raise InputError(f"{path}: column {sorted(repeated)[0]} appears twice; keep one.")
    return header, _parse(path, len(header), rows)


def _parse(path: Path, width: int, rows: str) -> Array:
    lines = rows.splitlines()
    if not any(line.strip() for line in lines):
        raise InputError(f"{path}: no row below the header; give a recorded trial.")
    try:
        values = np.loadtxt(lines, delimiter=",", ndmin=2, dtype=np.float64, converters=None, comments=None)
    except ValueError:
        values = np.array([_row(path, width, i, line) for i, line in enumerate(lines, 2) if line.strip()])
    if values.shape[1] != width:
        raise InputError(f"{path}: row 2 has {values.shape[1]} cells, its header {width}; give every row the same.")
    return values


def _row(path: Path, width: int, number: int, line: str) -> list[float]:
    cells = line.split(",")
    if len(cells) != width:
        raise InputError(f"{path}: row {number} has {len(cells)} cells, its header {width}; give every row the same.")
    try:
        return [float(cell) if cell.strip() else float("nan") for cell in cells]
    except ValueError as error:
        raise InputError(f"{path}: row {number}: {error}; every cell is a number, empty where unknown.") from None


def _read_mcap(path: Path) -> Table:
    from trial import read as reader

    trial: Any = reader.open(path)
    columns = {name: values for name, values in trial.columns.items()
               if (name in UNITS or name.endswith(AGE_SUFFIX)) and not np.isnan(values).all()}
    return table(str(path), columns, _carried_calibration(trial))


def _carried_calibration(trial: Any) -> Mapping[str, Any] | None:
    import tomllib

    raw = trial.attachments.get("calibration.toml")
    return None if raw is None else tomllib.loads(bytes(raw).decode("utf-8"))


def low_passed(given: Table, cutoff_hz: float) -> Table:
    """Put the same zero-phase second-order Butterworth low-pass, `cutoff_hz`, on every signal of `given`.

    The filter runs forward and backward, so it moves no phase; counters and ages keep their values.
    Raises `InputError` for a cut-off that is not below half the sampling rate.
    """
    rate = 1.0 / float(np.median(np.diff(given["time_s"])))
    if not 0.0 < cutoff_hz < rate / 2.0:
        raise InputError(f"{given.source}: a low-pass of {cutoff_hz:g} Hz on {rate:g} Hz data; expected above 0 and "
                         f"below {rate / 2.0:g} Hz, give another cut-off.")
    sos = butter(2, cutoff_hz, fs=rate, output="sos")
    filtered = {name: values if name in COUNTERS or name.endswith(AGE_SUFFIX) else sosfiltfilt(sos, values)
                for name, values in given.columns.items()}
    return replace(given, columns=filtered, lowpass_hz=cutoff_hz)
