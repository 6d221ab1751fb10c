"""The table of a sweep: a row is in the file as soon as its trial is done.

The rule of this file: while a sweep runs there is one CSV that only grows, so that whatever happens loses no row
that was finished; a Parquet table, and the order of the rows, are made of it at the end.

`ranked` ranks the controllers of a table by the error of END's force, true END's if the sweep has it: the median over
the trials that completed.  A controller whose trials stopped ranks behind every one whose trials completed.
"""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from bowden.sweep.row_trial import COMMIT, FIGURES
from parameters import InputError
from parameters.files import replaced

Key = tuple[str, ...]
FORMS = (".csv", ".parquet")


def text(value: object) -> str:
    """Return the text of a cell with `value`; None, the undefined, is empty."""
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


class SweepTable:
    """Rows by their parameters, all of them text; opening continues a partial file."""

    def __init__(self, path: Path, parameters: Sequence[str], *, overwrite: bool = False) -> None:
        """Open `path`; raises `InputError` where it cannot be written or has other parameters."""
        if path.suffix not in FORMS:
            raise InputError(f"{path}: a table is written as {' or '.join(FORMS)}; give a name that ends so.")
        if not path.parent.is_dir():
            raise InputError(f"{path}: {path.parent} is no directory; make it first.")
        self.path, self.parameters = path, tuple(parameters)
        self.columns = (*parameters, *FIGURES, COMMIT)
        self.growing = path if path.suffix == ".csv" else path.with_name(f"{path.name}.partial.csv")
        if path.suffix == ".parquet":
            _arrow()
        self.rows: dict[Key, list[str]] = {}
        if not overwrite:
            self._take(path, _parquet_lines) if self.growing != path else None
            self._take(self.growing, _csv_lines)
        self.commits = {line[-1] for line in self.rows.values()}
        self._write(self.rows.values())
        self._file = self.growing.open("a", newline="", encoding="utf-8")

    def __enter__(self) -> SweepTable:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()

    def key(self, row: Mapping[str, Any]) -> Key:
        """Return the parameters that identify a row."""
        return tuple(text(row[name]) for name in self.parameters)

    def append(self, row: Mapping[str, Any], figures: Mapping[str, Any]) -> None:
        """Append a finished row; the file contains the row when this function returns."""
        key = self.key(row)
        line = [*key, *(text(figures[name]) for name in self.columns[len(key):])]
        self.rows[key] = line
        csv.writer(self._file, lineterminator="\n").writerow(line)
        self._file.flush()

    def found(self, row: Mapping[str, Any]) -> dict[str, str] | None:
        """Return a row's cells by column, None where it is not done."""
        line = self.rows.get(self.key(row))
        return None if line is None else dict(zip(self.columns, line, strict=True))

    def finish(self, order: Iterable[Mapping[str, Any]]) -> None:
        """Put the rows in `order`, those of earlier sweeps behind them, in the format of the file's ending."""
        first = [self.rows[key] for key in map(self.key, order) if key in self.rows]
        wanted = {tuple(line[: len(self.parameters)]) for line in first}
        lines = first + [line for key, line in self.rows.items() if key not in wanted]
        self._file.close()
        if self.path == self.growing:
            self._write(lines)
            return
        pa, pq = _arrow()
        columns = {name: pa.array(_typed([line[i] for line in lines])) for i, name in enumerate(self.columns)}
        with replaced(self.path, overwrite=True) as part:
            pq.write_table(pa.table(columns), part)
        self.growing.unlink()

    def _take(self, path: Path, lines_of: Any) -> None:
        if not path.exists():
            return
        lines = lines_of(path)
        if lines and tuple(lines[0]) != self.columns:
            differ = sorted(set(lines[0]).symmetric_difference(self.columns)) or ["their order"]
            raise InputError(f"{path}: has other columns than this sweep ({', '.join(differ[:5])}); "
                             "give another name or --overwrite.")
        for line in lines[1:]:
            if len(line) == len(self.columns):
                self.rows[tuple(line[: len(self.parameters)])] = list(line)

    def _write(self, lines: Iterable[Sequence[str]]) -> None:
        with replaced(self.growing, overwrite=True) as part, part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *lines])


def lines_of(path: Path) -> list[list[str]]:
    """Return header and rows of a table, cells as text; raises `InputError` where it cannot be read."""
    return _parquet_lines(path) if path.suffix == ".parquet" else _csv_lines(path)


def _csv_lines(path: Path) -> list[list[str]]:
    try:
        content = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give another name or --overwrite.") from None
    whole = content[: content.rfind("\n") + 1]
    return list(csv.reader(io.StringIO(whole, newline="")))


def _parquet_lines(path: Path) -> list[list[str]]:
    pa, pq = _arrow()
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read ({error}); give another name or --overwrite.") from None
    columns = [list(map(text, table.column(name).to_pylist())) for name in table.column_names]
    return [list(table.column_names), *(list(line) for line in zip(*columns, strict=True))]


def _typed(cells: Sequence[str]) -> list[Any]:
    """Return a column's values as integers, numbers or text, whichever fits all of them; empty is null."""
    for kind in (int, float):
        try:
            values = [kind(cell) if cell else None for cell in cells]
        except ValueError:
            continue
        if list(map(text, values)) == list(cells):
            return values
    return [cell or None for cell in cells]


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError("a Parquet table needs pyarrow; install bowden-bench[parquet], or name a .csv.") from None
    return pyarrow, pyarrow.parquet


CONTROLLER, TUNING = "gait.controller", "gait.tuning"
ERROR = "true_relative_rmse_percent"
IDLE = "true_max_idle_tension_n"
JUMP = "true_peak_jump_n"


class RankedController(NamedTuple):
    """One controller: its trials, how many completed, and medians over those (None: none completed).

    `error_percent`: relative RMSE of END's force, %, with the least and the `worst`; `idle_n`, `jump_n`: largest END
    force while none is desired and jump at the peak, N; `stopped`: how many trials ended by each reason.
    """

    controller: str
    trials: int
    completed: int
    error_percent: float | None
    least: float | None
    worst: float | None
    idle_n: float | None
    jump_n: float | None
    stopped: Mapping[str, int]


def ranked_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a sweep's table; raises `InputError` for any other file, or if it has one controller only."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the table that bowden sweep --grid controller=… wrote.")
    header, *lines = lines_of(path) or [[]]
    if CONTROLLER not in header or ERROR not in header:
        raise InputError(f"{path}: has no columns {CONTROLLER} and {ERROR}; give the table of a bowden sweep.")
    rows = [dict(zip(header, line, strict=True)) for line in lines if len(line) == len(header)]
    names = {name_of(row) for row in rows}
    if len(names) < 2:
        raise InputError(f"{path}: has trials of {len(names)} controller; sweep several, such as --grid "
                         "controller=paper,extended, or values of its parameters.")
    return rows


def name_of(row: Mapping[str, str]) -> str:
    """Return a row's controller with the values of its own parameters."""
    return f"{row[CONTROLLER]} {row.get(TUNING, '')}".rstrip()


def ranked(rows: Sequence[Mapping[str, str]]) -> list[RankedController]:
    """Return the controllers of a sweep's rows, the best first."""
    names = dict.fromkeys(map(name_of, rows))
    found = [_of(name, [row for row in rows if name_of(row) == name]) for name in names]
    return sorted(found, key=lambda one: (one.completed < one.trials, math.inf if one.error_percent is None
                                          else one.error_percent, one.controller))


def _of(name: str, rows: Sequence[Mapping[str, str]]) -> RankedController:
    done = [row for row in rows if row["outcome"] == "completed"]
    reasons = Counter(row["stop_reason"] or row["outcome"] for row in rows if row["outcome"] != "completed")
    errors, idle, jump = (_known(done, figure) for figure in (ERROR, IDLE, JUMP))
    return RankedController(
        name, len(rows), len(done), _median(errors), min(errors, default=None), max(errors, default=None),
        _median(idle), _median(jump), dict(reasons))


def _median(values: Sequence[float]) -> float | None:
    return statistics.median(values) if values else None


def _known(rows: Sequence[Mapping[str, str]], figure: str) -> list[float]:
    return [float(row[figure]) for row in rows if row.get(figure)]


def draw_ranking(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Write a picture (PNG, SVG or PDF by suffix): each trial's error a dot, the median a bar, the best on top."""
    from matplotlib.figure import Figure

    order = ranked(rows)
    figure: Any = Figure(figsize=(8, 1.2 + 0.6 * len(order)), layout="constrained")
    axes = figure.subplots()
    for place, one in enumerate(order):
        errors = _known([row for row in rows if name_of(row) == one.controller and row["outcome"] == "completed"],
                        ERROR)
        axes.plot(errors, [place] * len(errors), "o", color="tab:blue", alpha=0.4)
        if one.error_percent is not None:
            axes.plot([one.error_percent] * 2, [place - 0.3, place + 0.3], color="0.15", lw=2.0)
    stops = [f" ({one.trials - one.completed} of {one.trials} stopped)" if one.completed < one.trials else ""
             for one in order]
    axes.set_yticks(range(len(order)), [one.controller + more for one, more in zip(order, stops, strict=True)])
    axes.invert_yaxis()
    axes.set(xlabel="relative RMSE of END's force (%); bar: median over trials", xlim=(0, None))
    axes.grid(alpha=0.3, axis="x")
    figure.savefig(path, dpi=120)
