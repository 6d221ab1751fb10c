"""The growing table: continued after a tear, ordered at the end, the same as CSV and as Parquet."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

from bowden.sweep.row_trial import FIGURES, not_run
from bowden.sweep.sweep_table import SweepTable
from parameters import InputError

ROWS: list[dict[str, Any]] = [{"bench.serial": serial, "gait.peak_n": 40.0} for serial in (1, 2, 3)]


def figures(number: float) -> dict[str, Any]:
    return not_run("completed", "") | {"true_relative_rmse_percent": number, "missed_cycles": 0}


def written(path: Path, rows: list[dict[str, Any]]) -> None:
    with SweepTable(path, list(ROWS[0])) as table:
        for row in rows:
            table.append(row, figures(row["bench.serial"] / 3))


def serials(path: Path) -> list[str]:
    with path.open(newline="") as file:
        return [row["bench.serial"] for row in csv.DictReader(file)]


def test_a_row_is_in_the_file_at_once_and_again_when_the_table_is_continued(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with SweepTable(path, list(ROWS[0])) as table:
        table.append(ROWS[2], figures(0.1))
        assert serials(path) == ["3"]
    with SweepTable(path, list(ROWS[0])) as table:
        found = table.found(ROWS[2])
        assert found is not None
        assert float(found["true_relative_rmse_percent"]) == 0.1
        assert table.found(ROWS[0]) is None
        table.append(ROWS[0], figures(0.2))
        table.finish(ROWS)
    assert serials(path) == ["1", "3"]


@pytest.mark.parametrize("lost", [1, 5, 40])
def test_a_torn_line_is_left_out_and_what_is_whole_is_kept(tmp_path: Path, lost: int) -> None:
    path = tmp_path / "t.csv"
    written(path, ROWS)
    path.write_bytes(path.read_bytes()[:-lost])
    with SweepTable(path, list(ROWS[0])) as table:
        assert [table.found(row) is not None for row in ROWS] == [True, True, False]
    assert serials(path) == ["1", "2"]


def test_parquet_holds_the_same_in_types_and_is_continued(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    path = tmp_path / "t.parquet"
    written(path, ROWS[:1])
    assert not path.exists()
    with SweepTable(path, list(ROWS[0])) as table:
        table.append(ROWS[1], figures(2 / 3))
        table.finish(ROWS)
    assert sorted(tmp_path.iterdir()) == [path]
    content = parquet.read_table(path).to_pydict()
    assert content["bench.serial"] == [1, 2]
    assert content["gait.peak_n"] == [40.0, 40.0]
    assert content["true_relative_rmse_percent"] == [1 / 3, 2 / 3]
    assert content["relative_rmse_percent"] == [None, None]
    assert set(FIGURES) < set(content)
    with SweepTable(path, list(ROWS[0])) as table:
        assert [table.found(row) is not None for row in ROWS] == [True, True, False]


@pytest.mark.parametrize(("name", "said"), [
    ("t.txt", "a table is written as .csv or .parquet"), ("absent/t.csv", "is no directory"),
])
def test_a_table_that_cannot_be_written_is_refused(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        SweepTable(tmp_path / name, ["bench.serial"])


def test_the_table_of_another_sweep_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    written(path, ROWS)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"other columns than this sweep \(bench\.day\)"):
        SweepTable(path, [*ROWS[0], "bench.day"])
    assert path.read_bytes() == before
    with SweepTable(path, [*ROWS[0], "bench.day"], overwrite=True) as table:
        assert not table.rows
