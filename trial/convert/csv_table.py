"""Tables of files as columns of `/cycle`.

A column is taken under its canonical name, or under the name, unit, factor and offset that a map gives it; other
columns are left out and named. An empty cell or NaN is an unknown value; a cell that is not a number is an error with
its row.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from parameters import InputError, from_table, parameter, read_toml
from trial.convert.csv_file import DEGREE_ALIAS, Dialect
from trial.convert.lab_table import TO_SI, Floats, LabTable, unit_of
from trial.convert.sheets import sheet_of
from trial.signals import UNITS

CSV_TABLE = "csv"  # of a map: how the file is written


@dataclass(frozen=True)
class SignalSource:
    """Source of a signal: value = (number in the file × scale) in `unit`, converted, plus `offset`."""

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


class Map(dict[str, SignalSource]):
    """Sources by signal; `dialect` is the file's format, if the map gives it."""

    dialect: Dialect | None = None


@dataclass
class Columns:
    """Columns by signal name, counts, and the headers left out; `rows` number the rows as the file does.

    `remarks` lists how the file was read; `begins_ns` is the time since 1970 at which `time_s` is 0, if the file gives
    it.
    """

    columns: dict[str, Floats]
    counts: dict[str, int]
    left_out: list[str] = field(default_factory=list)
    rows: np.ndarray[tuple[int], np.dtype[np.int64]] | range = range(0)
    remarks: list[str] = field(default_factory=list)
    begins_ns: int | None = None


def read_map(path: Path) -> Map:
    """Read a map: one TOML table a signal, `column`, `unit`, `scale` and `offset` in it, and perhaps [csv]."""
    mapped = Map()
    for signal, table in read_toml(path).items():
        where = f"{path} [{signal}]"
        if signal not in UNITS and signal != CSV_TABLE:
            raise InputError(f"{where}: is no signal; expected one of {', '.join(UNITS)}.")
        if not isinstance(table, dict):
            raise InputError(f"{where}: is no table; write [{signal}] and column = \"…\" below it.")
        if signal == CSV_TABLE:
            mapped.dialect = from_table(Dialect, table, where=where)
            continue
        mapped[signal] = from_table(SignalSource, table, where=where)
        mapped[signal].factor(signal, where)
    return mapped


def read(path: Path, mapped: Mapping[str, SignalSource] | None = None) -> Columns:
    """Read a table; `mapped` gives the sources of signals that do not have their own names in the file."""
    return columns_of(sheet_of(path, getattr(mapped, "dialect", None)), mapped)


def columns_of(sheet: LabTable, mapped: Mapping[str, SignalSource] | None = None) -> Columns:
    """Take signals out of a sheet; raises `InputError` without time, for units that do not fit and bad cells."""
    path = sheet.path
    sources = dict(_canonical(sheet, mapped or {})) | dict(mapped or {})
    columns = {}
    for signal, source in sources.items():
        if source.column not in sheet:
            raise InputError(f"{path}: the map takes {signal} from {source.column!r}, which is no column of the file; "
                             f"expected one of {_listed(sheet.names)}.")
        unit = source.unit or sheet.unit(source.column)
        factor = SignalSource(source.column, unit, source.scale).factor(signal, f"{path}: {source.column}")
        columns[signal] = sheet.column(source.column) * factor + source.offset
    if "time_s" not in columns:
        raise InputError(f"{path}: has no column time_s; {offer(path)}.")
    sources_used = {source.column for source in sources.values()}
    unknown = int(sum(np.isnan(column).sum() for column in columns.values()))
    return Columns(
        columns, {"rows": len(sheet), "unknown_values": unknown, **sheet.counts},
        [*(name for name in sheet.names if name not in sources_used),
         *(f"{name} ({why})" for name, why in sheet.left_out.items())], sheet.rows, sheet.remarks,
        sheet.begins_ns.get(sources["time_s"].column))


def offer(path: Path) -> str:
    """Return what to type where a table's columns have other names."""
    return (f"rename its columns, or say bowden import {path} --guess -o map.toml, check that map, and say "
            f"bowden import {path} --map map.toml -o trial.mcap")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:30]) + (f" and {len(names) - 30} more" if len(names) > 30 else "")


def _canonical(sheet: LabTable, mapped: Mapping[str, SignalSource]) -> list[tuple[str, SignalSource]]:
    named = [(name, SignalSource(column=name)) for name in sheet.names if name in UNITS and name not in mapped]
    for name, source in named:
        _refuse_other_unit(sheet, name, source)
    if DEGREE_ALIAS in sheet and "gait_percent" in sheet and not {"knee_angle_rad"} & (set(sheet.names) | set(mapped)):
        named.append(("knee_angle_rad", SignalSource(column=DEGREE_ALIAS, unit="deg")))
    return named


def _refuse_other_unit(sheet: LabTable, name: str, source: SignalSource) -> None:
    stated = sheet.unit(source.column)
    if stated and TO_SI[stated] != (UNITS[name], 1.0):
        raise InputError(f"{sheet.path}: {name} is in {UNITS[name]} by its name and in {stated} by the row of units; "
                         f"say which with --map: [{name}], column = \"{name}\" and unit.")


__all__ = ["TO_SI", "Columns", "Map", "SignalSource", "columns_of", "offer", "read", "read_map", "unit_of"]
