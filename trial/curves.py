"""A knee motion or a desired force from a file, checked row by row.

The rule of this file: what a row says is used, bridged and counted, or refused with the row's number; nothing
is smoothed or closed here (`physics.reference` does that).  Rows are counted as an editor counts them: the
header is row 1.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError

Floats = NDArray[np.float64]


class Axis(NamedTuple):
    """What runs along a curve: the longest step between samples that is bridged by a straight line."""

    name: str
    unit: str
    longest_gap: float


class Quantity(NamedTuple):
    """A column that may be read: its factor to SI, and the SI values that are believable."""

    name: str
    factor: float
    low: float
    high: float
    doubt: str


AXES = {"time_s": Axis("time_s", "s", 0.1), "gait_percent": Axis("gait_percent", "%", 5.0)}
_KNEE = "flexion is negative, and no knee bends past 160 degrees; mend the sign or the unit"
KNEE_RAD = Quantity("knee_angle_rad", 1.0, -2.8, 0.35, _KNEE)
KNEE_DEG = Quantity("knee_angle_deg", math.pi / 180, -2.8, 0.35, _KNEE)
FORCE = Quantity("desired_force_n", 1.0, 0.0, 1000.0, "a rope only pulls; mend the sign or the unit")
ACCEPTED = {  # column asked for: (axis, column) pairs a file may have
    "knee_angle_rad": (("time_s", KNEE_RAD), ("gait_percent", KNEE_DEG), ("gait_percent", KNEE_RAD)),
    "desired_force_n": (("time_s", FORCE), ("gait_percent", FORCE)),
}
LEAST_ROWS = 8


@dataclass(frozen=True)
class Curve:
    """One gait cycle of a file: `percent` 0 … 100 rising, `values` in SI, of equal length.

    `strides` is how many whole ones the file holds; of several, `values` is the first one.  `stride_s` is its
    duration (NaN where the file knows no time), `begins` where on the file's own axis it begins; `bridged` counts
    rows without a value that a straight line replaced, `trimmed` those at the ends that were left out.
    """

    path: Path
    column: str
    percent: Floats
    values: Floats
    strides: int
    stride_s: float
    begins: float
    bridged: int
    trimmed: int

    def note(self) -> str:
        """Return in one sentence what was done to the file."""
        parts = [f"{len(self.values)} samples"]
        if self.strides > 1:
            parts.append(f"the first of {self.strides} strides of {self.stride_s:.2f} s, from {self.begins:g} s")
        if self.bridged:
            parts.append(f"{self.bridged} missing values bridged")
        if self.trimmed:
            parts.append(f"{self.trimmed} missing values at the ends left out")
        return f"{self.path}: {', '.join(parts)}."


def read_curve(path: str | Path, column: str) -> Curve:
    """Read `column` ("knee_angle_rad" or "desired_force_n") from a CSV file; raises `InputError`."""
    path = Path(path)
    rows = _rows(path)
    axis, quantity, places = _header(rows[0], path, column)
    along, values = _numbers(rows, places, quantity, axis, path)
    along, values, trimmed = _trim(along, values)
    if len(along) < LEAST_ROWS:
        raise InputError(f"{path}: {len(along)} rows with a value, expected {LEAST_ROWS} or more; give one gait cycle.")
    bridged = int(np.isnan(values).sum())
    along, values = _bridge(along, values, axis, path)
    if axis.name == "gait_percent":
        _covers(along, path)
        return Curve(path, column, along, values, 1, math.nan, float(along[0]), bridged, trimmed)
    begin, end, strides = _stride(along, values, column)
    stride_s = float(along[end - 1] - along[begin]) * (end - begin) / (end - begin - 1)
    percent = 100 * (along[begin:end] - along[begin]) / stride_s
    return Curve(path, column, percent, values[begin:end], strides, stride_s, float(along[begin]), bridged, trimmed)


def _rows(path: Path) -> list[list[str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a CSV file.") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a UTF-8 CSV file.") from None
    while rows and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if not rows:
        raise InputError(f"{path}: the file is empty; give a header and one gait cycle.")
    if len(rows) < 2:
        raise InputError(f"{path}: a header and no rows; give one gait cycle.")
    return rows


def _header(header: list[str], path: Path, column: str) -> tuple[Axis, Quantity, tuple[int, int]]:
    names = [name.strip() for name in header]
    for name in names:
        if name and names.count(name) > 1:
            raise InputError(f"{path}: row 1 names the column {name} {names.count(name)} times; keep one.")
    for axis, quantity in ACCEPTED[column]:
        if axis in names and quantity.name in names:
            return AXES[axis], quantity, (names.index(axis), names.index(quantity.name))
    expected = " or ".join(f"{axis}, {quantity.name}" for axis, quantity in ACCEPTED[column])
    raise InputError(f"{path}: row 1 is {', '.join(names)}; expected the columns {expected}, name them so.")


def _numbers(
    rows: list[list[str]], places: tuple[int, int], quantity: Quantity, axis: Axis, path: Path
) -> tuple[Floats, Floats]:
    along, values = np.empty(len(rows) - 1), np.empty(len(rows) - 1)
    before = -math.inf
    for number, row in enumerate(rows[1:], start=2):
        where = f"{path}: row {number}"
        if len(row) != len(rows[0]):
            raise InputError(f"{where} has {len(row)} cells, the header {len(rows[0])}; mend that row.")
        at = _number(row[places[0]], axis.name, where)
        if not at > before:
            raise InputError(f"{where}: {axis.name} = {at:g} does not rise, {before:g} came before; sort the rows.")
        before = along[number - 2] = at
        cell = row[places[1]].strip()
        values[number - 2] = _value(cell, quantity, where) if cell else math.nan
    return along, values


def _number(cell: str, name: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise InputError(f"{where}: {name} = {cell.strip()!r} is not a number; mend that row.") from None
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} = {cell.strip()} is not finite; leave the cell of a lost value empty.")
    return value


def _value(cell: str, quantity: Quantity, where: str) -> float:
    value = _number(cell, quantity.name, where) * quantity.factor
    if not quantity.low <= value <= quantity.high:
        raise InputError(f"{where}: {quantity.name} = {cell} is not believable: {quantity.doubt}.")
    return value


def _trim(along: Floats, values: Floats) -> tuple[Floats, Floats, int]:
    good = np.flatnonzero(~np.isnan(values))
    if len(good) == 0:
        return along[:0], values[:0], len(values)
    kept = slice(good[0], good[-1] + 1)
    return along[kept], values[kept], len(values) - (good[-1] + 1 - good[0])


def _bridge(along: Floats, values: Floats, axis: Axis, path: Path) -> tuple[Floats, Floats]:
    good = ~np.isnan(values)
    steps = np.diff(along[good])
    widest = int(np.argmax(steps))
    if steps[widest] > axis.longest_gap * (1 + 1e-9):
        raise InputError(
            f"{path}: no value from {axis.name} = {along[good][widest]:g} to {along[good][widest + 1]:g}, "
            f"at most {axis.longest_gap:g} {axis.unit} are bridged; give a recording without that gap.")
    return along, np.interp(along, along[good], values[good])


def _covers(percent: Floats, path: Path) -> None:
    gap = AXES["gait_percent"].longest_gap
    if percent[0] < 0 or percent[-1] > 100:
        raise InputError(f"{path}: gait_percent runs from {percent[0]:g} to {percent[-1]:g}; expected within 0 … 100.")
    if percent[0] + 100 - percent[-1] > gap:
        raise InputError(f"{path}: gait_percent covers {percent[0]:g} … {percent[-1]:g} only; give the whole cycle.")


def _stride(along: Floats, values: Floats, column: str) -> tuple[int, int, int]:
    """Return begin and end of the first stride and how many there are; one where nothing repeats."""
    grid = np.linspace(along[0], along[-1], len(along))
    even = np.interp(grid, along, values)
    lag = repeats_after(even)
    if lag is None:
        return 0, len(along), 1
    begin = int(np.argmax(even[:lag])) if column == "knee_angle_rad" else 0
    strides = (len(even) - begin) // lag
    if strides < 1:
        begin, strides = 0, len(even) // lag
    return begin, begin + lag, strides


def repeats_after(values: Floats) -> int | None:
    """Return after how many samples an evenly sampled motion repeats, None where it does not twice correlate.

    The first lag, beyond the first zero of the autocorrelation, where the correlation of the overlapping parts
    peaks above 0.9; a third of the recording must overlap.
    """
    centred = values - values.mean()
    least = max(LEAST_ROWS, len(values) // 3)
    score = np.array([_correlation(centred[lag:], centred[:-lag]) for lag in range(1, len(values) - least)])
    apart = np.flatnonzero(score < 0)
    if len(apart) == 0:
        return None
    rest = score[apart[0]:]
    peaks = np.flatnonzero((rest[1:-1] >= rest[:-2]) & (rest[1:-1] >= rest[2:]) & (rest[1:-1] > 0.9)) + 1
    return int(peaks[0] + apart[0] + 1) if len(peaks) else None


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale > 0 else 0.0
