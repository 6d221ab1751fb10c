"""The table of a sweep: a row is in the file as soon as its trial is done.

The rule of this file: while a sweep runs there is one CSV that only grows, so that whatever happens loses no row
that was finished; a Parquet table, and the order of the rows, are made of it at the end.
"""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from bowden.sweep.row_trial import COMMIT, FIGURES
from parameters import InputError
from parameters.files import replaced

Key = tuple[str, ...]
FORMS = (".csv", ".parquet")


def text(value: object) -> str:
    """Return the text of a cell with `value`; None, the undefined, is empty."""
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


class SweepTable(AbstractContextManager["SweepTable"]):
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
        for table in () if overwrite else dict.fromkeys((path, self.growing)):
            if table.exists():
                self._take(table, lines_of(table))
        self.commits = {line[-1] for line in self.rows.values()}
        self._write(self.rows.values())
        self._file = self.growing.open("a", newline="", encoding="utf-8")

    def __exit__(self, *_error: object) -> None:
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
        """Write the final table, CSV or Parquet by its ending: the rows in `order`, then rows of earlier sweeps."""
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

    def _take(self, path: Path, lines: Sequence[Sequence[str]]) -> None:
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
