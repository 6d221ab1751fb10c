"""Knee motions and desired forces from files, checked row by row.

Each row is used, bridged and counted, or refused with its number; nothing is smoothed or closed here
(`physics.reference` does that). `trial.convert.csv_file` reads the file: its delimiter, decimal sign, units row and
encoding are detected.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.convert import csv_file
from trial.convert.lab_table import LabTable

Floats = NDArray[np.float64]


class Abscissa(NamedTuple):
    """Abscissa of a curve, and the longest step between samples that a straight line may bridge."""

    name: str
    unit: str
    longest_gap: float


class Quantity(NamedTuple):
    """A column that may be read: its factor to SI, and the SI values that are believable."""

    name: str
    unit: str
    factor: float
    low: float
    high: float
    doubt: str


AXES = {"time_s": Abscissa("time_s", "s", 0.1), "gait_percent": Abscissa("gait_percent", "%", 5.0)}
_KNEE = "flexion is negative, and no knee bends past 160 degrees; mend the sign or the unit"
KNEE_RAD = Quantity("knee_angle_rad", "rad", 1.0, -2.8, 0.35, _KNEE)
KNEE_DEG = Quantity("knee_angle_deg", "deg", math.pi / 180, -2.8, 0.35, _KNEE)
FORCE = Quantity("desired_force_n", "N", 1.0, 0.0, 1000.0, "a rope only pulls; mend the sign or the unit")
ACCEPTED = {  # column asked for: (axis, column) pairs a file may have
    "knee_angle_rad": (("time_s", KNEE_RAD), ("gait_percent", KNEE_DEG), ("gait_percent", KNEE_RAD)),
    "desired_force_n": (("time_s", FORCE), ("gait_percent", FORCE)),
}
LEAST_ROWS = 8
STRIDE_COLUMNS = ("stride", "cycle")
"""Columns that number the strides of a file."""
SEAM_SHARE = 0.1
"""Distance from a repetition, in parts of the stride, within which its greatest extension is looked for."""


@dataclass(frozen=True)
class Curve:
    """One gait cycle of a file: `percent` 0 … 100 rising, `values` in SI, of equal length.

    `strides` is the number of complete strides in the file; of several, `values` is the first one. `stride_s` is its
    duration (NaN if the file has no time), `begins` its start on the file's own axis. `bridged` counts rows without a
    value that a straight line replaced, `trimmed` those at the ends that were left out.
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
        """Return in one sentence how the file was processed."""
        parts = [f"{len(self.values)} samples"]
        if self.strides > 1:
            timed = f" of {self.stride_s:.2f} s, from {self.begins:g} s" if math.isfinite(self.stride_s) else ""
            parts.append(f"the first of {self.strides} strides{timed}")
        if self.bridged:
            parts.append(f"{self.bridged} missing values bridged")
        if self.trimmed:
            parts.append(f"{self.trimmed} missing values at the ends left out")
        return f"{self.path}: {', '.join(parts)}."


class ForceTable(NamedTuple):
    """A desired force by phase and knee angle: rising percents of the gait, rising angles, rad, and N by both."""

    percent: Floats
    knee_rad: Floats
    force_n: Floats

    def note(self) -> str:
        """Return in half a sentence what the table covers."""
        low, high = (math.degrees(self.knee_rad[i]) for i in (0, -1))
        return f"desired force at {len(self.percent)} phases and {len(self.knee_rad)} knee angles, {low:g} … {high:g}°"


class _Samples(NamedTuple):
    """Samples of a curve in a file, without missing values."""

    path: Path
    column: str
    axis: Abscissa
    along: Floats
    values: Floats
    bridged: int
    trimmed: int

    def curve(self, begin: int = 0, end: int | None = None, strides: int = 1) -> Curve:
        """Return samples as one gait cycle."""
        along, values = self.along[begin:end], self.values[begin:end]
        stride_s, percent = math.nan, along
        if self.axis.name != "gait_percent":
            stride_s = float(along[-1] - along[0]) * len(along) / (len(along) - 1)
            percent = 100 * (along - along[0]) / stride_s
        return Curve(self.path, self.column, percent, values, strides, stride_s, float(along[0]), self.bridged,
                     self.trimmed)


def read_curve(path: str | Path, column: str) -> Curve:
    """Read `column` ("knee_angle_rad" or "desired_force_n") from a CSV file; raises `InputError`."""
    return _read(Path(path), column)[1]


def read_strides(path: str | Path) -> list[Curve]:
    """Read every stride of the knee angle in a CSV file, each as a curve of its own; raises `InputError`.

    Strides are numbered by a column `stride` or `cycle`, negative numbers being no stride.  Without one, a recording
    in time is cut at the greatest extension nearest to each repetition, and a file by `gait_percent` is one stride.
    """
    path, column = Path(path), "knee_angle_rad"
    sheet = csv_file.read(path)
    numbered = _numbered(sheet, path)
    if numbered:
        return [_samples(sheet, path, column, rows).curve() for rows in numbered]
    samples, first = _read(path, column, sheet)
    if first.strides == 1:
        return [first]
    return [samples.curve(a, b) for a, b in pairwise(_seams(samples.along, samples.values, first))]


def read_desired(path: str | Path) -> Curve | ForceTable:
    """Read a desired force: a curve, or a table that has each `gait_percent` at several knee angles.

    Raises `InputError`.
    """
    path = Path(path)
    sheet = csv_file.read(path)
    knee = next((quantity for quantity in (KNEE_RAD, KNEE_DEG) if quantity.name in sheet), None)
    if knee is None or "gait_percent" not in sheet or len(set(sheet.column("gait_percent"))) == len(sheet.rows):
        return read_curve(path, FORCE.name)
    percent, (angle, force) = sheet.column("gait_percent"), (_si(sheet, each, path) for each in (knee, FORCE))
    for name, values in (("gait_percent", percent), (knee.name, angle), (FORCE.name, force)):
        if np.isnan(values).any():
            raise InputError(f"{path}: row {sheet.rows[int(np.flatnonzero(np.isnan(values))[0])]} has no {name}; every "
                             "row of a table by phase and knee angle needs it.")
    (phases, row), (angles, place) = (np.unique(values, return_inverse=True) for values in (percent, angle))
    table = np.full((len(phases), len(angles)), np.nan)
    table[row, place] = force
    if np.isnan(table).any() or table.size != len(force):
        raise InputError(f"{path}: {len(force)} rows for {len(phases)} phases and {len(angles)} knee angles; give one "
                         "row for each phase and angle.")
    _covers(phases, path)
    gap = float(np.diff(phases).max())
    if gap > AXES["gait_percent"].longest_gap:
        raise InputError(f"{path}: gait_percent has steps of {gap:g} %, at most {AXES['gait_percent'].longest_gap:g} "
                         "are bridged; give a finer table.")
    return ForceTable(phases, angles, table)


def _read(path: Path, column: str, sheet: LabTable | None = None) -> tuple[_Samples, Curve]:
    """Return the samples of a file, and the first stride of them."""
    sheet = csv_file.read(path) if sheet is None else sheet
    numbered = _numbered(sheet, path) if _header(sheet, path, column)[0].name == "gait_percent" else []
    samples = _samples(sheet, path, column, *numbered[:1])
    if samples.axis.name == "gait_percent":
        return samples, samples.curve(strides=max(1, len(numbered)))
    return samples, samples.curve(*_stride(samples.along, samples.values, column))


def _samples(sheet: LabTable, path: Path, column: str, rows: slice | None = None) -> _Samples:
    """Return the samples of a file, or of one numbered stride of it, without those that lack a value."""
    axis, quantity, along_name = _header(sheet, path, column)
    along, values, trimmed = _trim(*_numbers(sheet, along_name, quantity, path, rows or slice(None)))
    if len(along) < LEAST_ROWS:
        where, what = (f", stride from row {sheet.rows[rows.start]}", "leave it out") if rows else (
            "", "give one gait cycle")
        raise InputError(f"{path}{where}: {len(along)} rows with a value, expected {LEAST_ROWS} or more; {what}.")
    bridged = int(np.isnan(values).sum())
    along, values = _bridge(along, values, axis, path)
    if axis.name == "gait_percent":
        _covers(along, path)
    return _Samples(path, column, axis, along, values, bridged, trimmed)


def _seams(along: Floats, values: Floats, first: Curve) -> list[int]:
    """Return the rows at which strides begin: the greatest extension within a tenth of each repetition."""
    seams = []
    for k in range(first.strides + 1):
        near = np.flatnonzero(np.abs(along - first.begins - k * first.stride_s) < SEAM_SHARE * first.stride_s)
        if len(near):
            seams.append(int(near[np.argmax(values[near])]))
    return seams


def _numbered(sheet: LabTable, path: Path) -> list[slice]:
    """Return the rows of each stride by the column that numbers them; none without one that counts beyond a stride."""
    name = next((name for name in STRIDE_COLUMNS if name in sheet), None)
    if name is None:
        return []
    numbers = sheet.column(name)
    if np.isnan(numbers).any():
        raise InputError(f"{path}: row {sheet.rows[int(np.flatnonzero(np.isnan(numbers))[0])]} has no {name}; every "
                         "row needs it.")
    seams = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    found = [slice(a, b) for a, b in pairwise(seams) if numbers[a] >= 0.0]
    begun = [numbers[rows.start] for rows in found]
    if len(set(begun)) < len(begun):
        again = next(rows for i, rows in enumerate(found) if begun[i] in begun[:i])
        raise InputError(f"{path}: row {sheet.rows[again.start]}: {name} = {numbers[again.start]:g} comes a second "
                         "time; number each stride once.")
    return found if len(found) > 1 else []


def _header(sheet: LabTable, path: Path, column: str) -> tuple[Abscissa, Quantity, str]:
    for axis, quantity in ACCEPTED[column]:
        if axis in sheet and quantity.name in sheet:
            return AXES[axis], quantity, axis
    expected = " or ".join(f"{axis}, {quantity.name}" for axis, quantity in ACCEPTED[column])
    raise InputError(f"{path}: row {sheet.header_row} is {', '.join(sheet.names[:20])}; expected the columns "
                     f"{expected}, name them so.")


def _numbers(sheet: LabTable, axis: str, quantity: Quantity, path: Path, rows: slice = slice(None)
             ) -> tuple[Floats, Floats]:
    along, values, numbers = sheet.column(axis)[rows], _si(sheet, quantity, path, rows), sheet.rows[rows]
    unknown = np.flatnonzero(np.isnan(along))
    if len(unknown):
        raise InputError(f"{path}: row {numbers[unknown[0]]} has no {axis}; every row needs it.")
    falls = np.flatnonzero(np.diff(along) <= 0)
    if len(falls):
        at = falls[0] + 1
        raise InputError(f"{path}: row {numbers[at]}: {axis} = {along[at]:g} does not rise, {along[at - 1]:g} came "
                         "before; sort the rows.")
    return along, values


def _si(sheet: LabTable, quantity: Quantity, path: Path, rows: slice = slice(None)) -> Floats:
    """Return a column in SI, checked to be believable."""
    values = sheet.column(quantity.name)[rows] * quantity.factor
    stated = sheet.unit(quantity.name)
    if stated and stated.replace("°", "deg") != quantity.unit:
        raise InputError(f"{path}: {quantity.name} is in {stated} by the row of units; rename or convert the column.")
    odd = np.flatnonzero((values < quantity.low) | (values > quantity.high))
    if len(odd):
        raise InputError(f"{path}: row {sheet.rows[rows][odd[0]]}: {quantity.name} = "
                         f"{values[odd[0]] / quantity.factor:g} is not believable: {quantity.doubt}.")
    return values


def _trim(along: Floats, values: Floats) -> tuple[Floats, Floats, int]:
    good = np.flatnonzero(~np.isnan(values))
    if len(good) == 0:
        return along[:0], values[:0], len(values)
    kept = slice(good[0], good[-1] + 1)
    return along[kept], values[kept], len(values) - (good[-1] + 1 - good[0])


def _bridge(along: Floats, values: Floats, axis: Abscissa, path: Path) -> tuple[Floats, Floats]:
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
