"""A CSV file as columns of `/cycle`.

The rule of this file: a column is taken under its canonical name, or under the name, unit, factor and offset
that a map gives it; what is not mapped is left out and named.  An empty cell or NaN is an unknown value; a
cell that is no number is an error with its row.  Rows are counted as an editor counts them.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameters import InputError, from_table, parameter, read_toml
from trial.signals import UNITS

Floats = NDArray[np.float64]

UNPACKED_FLOOR, UNPACKED_RATIO = 256 << 20, 200  # bytes a .gz may always unpack to; or this many times its size
TO_SI = {  # unit of a file: (unit of a signal, factor)
    "m": ("m", 1.0), "mm": ("m", 1e-3), "cm": ("m", 1e-2), "um": ("m", 1e-6), "µm": ("m", 1e-6), "in": ("m", 0.0254),
    "m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "rad": ("rad", 1.0), "deg": ("rad", math.pi / 180),
    "mdeg": ("rad", math.pi / 180e3), "mrad": ("rad", 1e-3), "N": ("N", 1.0), "mN": ("N", 1e-3), "kN": ("N", 1e3),
    "kgf": ("N", 9.80665), "lbf": ("N", 4.4482216152605), "s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6),
    "µs": ("s", 1e-6), "ns": ("ns", 1.0), "min": ("s", 60.0), "%": ("%", 1.0), "1": ("1", 1.0),
}
DEGREE_ALIAS = "knee_angle_deg"  # the one accepted alias, where gait_percent is a column too


@dataclass(frozen=True)
class Source:
    """Where a signal comes from: value = (number in the file × scale) in `unit`, converted, plus `offset`."""

    column: str = parameter("", "", "header of the file's column", source="the map file")
    unit: str = parameter("", "", "unit of the file's numbers; the signal's own where empty", source="the map file")
    scale: float = parameter(1.0, "1", "factor on the file's numbers, −1 to turn a sign", source="the map file")
    offset: float = parameter(0.0, "", "added to the converted value, in the signal's unit", source="the map file")

    def factor(self, signal: str, where: str) -> float:
        """Return the factor to the signal's unit; raises `InputError` where the units do not fit."""
        si, factor = TO_SI.get(self.unit or UNITS[signal], ("", 0.0))
        if self.unit and si != UNITS[signal] and not (si == "s" and UNITS[signal] == "ns"):
            known = ", ".join(unit for unit, (to, _) in TO_SI.items() if to == UNITS[signal])
            raise InputError(f"{where}: unit = {self.unit!r} does not fit {signal}; expected one of {known}.")
        return factor * self.scale * (1e9 if si == "s" and UNITS[signal] == "ns" else 1.0)


@dataclass
class Columns:
    """Columns by signal name, what was counted, and the headers that were left out."""

    columns: dict[str, Floats]
    counts: dict[str, int]
    left_out: list[str] = field(default_factory=list)


def read_map(path: Path) -> dict[str, Source]:
    """Read a map: one TOML table a signal, `column`, `unit`, `scale` and `offset` in it."""
    mapped = {}
    for signal, table in read_toml(path).items():
        where = f"{path} [{signal}]"
        if signal not in UNITS:
            raise InputError(f"{where}: is no signal; expected one of {', '.join(UNITS)}.")
        if not isinstance(table, dict):
            raise InputError(f"{where}: is no table; write [{signal}] and column = \"…\" below it.")
        mapped[signal] = from_table(Source, table, where=where)
        mapped[signal].factor(signal, where)
    return mapped


def read(path: Path, mapped: Mapping[str, Source] | None = None) -> Columns:
    """Read a CSV or CSV.gz file; `mapped` says where signals come from that are not under their own names."""
    header, values = _numbers(path, _text(path))
    sources = dict(_canonical(header)) | dict(mapped or {})
    columns = {}
    for signal, source in sources.items():
        if source.column not in header:
            raise InputError(f"{path}: the map takes {signal} from {source.column!r}, which is no column of the file; "
                             f"expected one of {', '.join(header)}.")
        raw = values[header.index(source.column)]
        columns[signal] = raw * source.factor(signal, str(path)) + source.offset
    if "time_s" not in columns:
        raise InputError(f"{path}: has no column time_s; rename it, or give --map with a table [time_s].")
    taken = {source.column for source in sources.values()}
    unknown = int(sum(np.isnan(column).sum() for column in columns.values()))
    return Columns(columns, {"rows": len(columns["time_s"]), "unknown_values": unknown},
                   [name for name in header if name not in taken])


def _canonical(header: list[str]) -> list[tuple[str, Source]]:
    named = [(name, Source(column=name)) for name in header if name in UNITS]
    if DEGREE_ALIAS in header and "gait_percent" in header and "knee_angle_rad" not in header:
        named.append(("knee_angle_rad", Source(column=DEGREE_ALIAS, unit="deg")))
    return named


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes() if path.suffix != ".gz" else _unzipped(path)
        return raw.decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give the path of a CSV file.") from None
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a UTF-8 CSV file, gzipped or not.") from None


def _unzipped(path: Path) -> bytes:
    limit = max(UNPACKED_FLOOR, UNPACKED_RATIO * path.stat().st_size)
    with gzip.open(path) as file:
        raw = file.read(limit + 1)
    if len(raw) > limit:
        raise InputError(f"{path}: unpacks to more than {limit} bytes; it is no measured table, do not open it.")
    return raw


def _numbers(path: Path, text: str) -> tuple[list[str], list[Floats]]:
    """Return the header and one array a column."""
    first, _, rest = text.partition("\n")
    header = [name.strip() for name in next(csv.reader([first]), [])]
    if not any(header):
        raise InputError(f"{path}: row 1 is no header; name the columns there.")
    for name in header:
        if header.count(name) > 1:
            raise InputError(f"{path}: row 1 names the column {name!r} {header.count(name)} times; keep one.")
    if not rest.strip():
        raise InputError(f"{path}: a header and no rows; give at least one.")
    try:
        table = np.loadtxt(io.StringIO(rest), delimiter=",", ndmin=2, comments=None)
        if table.shape[1] == len(header) and not np.isinf(table).any():
            return header, list(np.ascontiguousarray(table.T))
    except ValueError:
        pass  # an empty or wrong cell: row by row then
    return header, _row_by_row(path, header, rest)


def _row_by_row(path: Path, header: list[str], text: str) -> list[Floats]:
    table: list[list[float]] = []
    for number, row in enumerate(csv.reader(io.StringIO(text)), start=2):
        if not row:
            continue
        if len(row) != len(header):
            raise InputError(f"{path}: row {number} has {len(row)} cells, the header {len(header)}; mend that row.")
        table.append([_cell(cell, name, path, number) for cell, name in zip(row, header, strict=True)])
    return list(np.array(table).T.copy())


def _cell(cell: str, name: str, path: Path, number: int) -> float:
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        raise InputError(f"{path}: row {number}: {name} = {cell!r} is not a number; mend that cell.") from None
    if math.isinf(value):
        raise InputError(f"{path}: row {number}: {name} = {cell} is not finite; leave an unknown cell empty.")
    return value
