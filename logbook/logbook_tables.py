"""The logbook's tables as CSV or Parquet: trials, sessions, constants by session, verdicts, notes, models."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any, Final

from logbook.bench_state import state_of
from logbook.database import Logbook
from parameters import InputError
from parameters.files import write_whole

TABLES: Final = {"trials": "trial", "sessions": "session", "verdicts": "verdict", "notes": "note", "models": "model"}
CONSTANTS_TABLE: Final = "constants"
CONSTANT_HEADER: Final = ("session", "label", "constant", "unit", "value", "low", "high")


def export_table(book: Logbook, what: str, path: Path) -> int:
    """Write one table to a .csv or .parquet file; return its number of rows."""
    header, rows = _content(book, what)
    if path.suffix.lower() == ".parquet":
        _write_parquet(path, header, rows)
    else:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
        write_whole(path, text.getvalue(), overwrite=True)
    return len(rows)


def _content(book: Logbook, what: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    if what in TABLES:
        return book.table(TABLES[what])
    if what != CONSTANTS_TABLE:
        raise InputError(f"--table {what}: expected one of {', '.join((*TABLES, CONSTANTS_TABLE))}.")
    state = state_of(book)
    rows = [(number, state.labels[number], c.name, c.unit, float(c.value[k]), float(c.low[k]), float(c.high[k]))
            for c in state.courses.values() for k, number in enumerate(state.sessions)]
    return list(CONSTANT_HEADER), rows


def _write_parquet(path: Path, header: list[str], rows: list[tuple[Any, ...]]) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(f"{path}: Parquet needs pyarrow; say pip install 'bowden-bench[parquet]', or name a .csv "
                         "file.") from None
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    table = pyarrow.table({name: list(column) for name, column in zip(header, columns, strict=True)})
    out = io.BytesIO()
    pyarrow.parquet.write_table(table, out)
    write_whole(path, out.getvalue(), overwrite=True)
