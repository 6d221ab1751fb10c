"""A long trial is diagnosed by windows of it, spread over it, so that the memory is bounded."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import bowden
from estimation.data import integrity, table, windows


def test_a_long_trial_is_windows_spread_over_it_without_gaps_that_are_not_its_own() -> None:
    time = np.arange(0.0, 3600.0, 0.1)
    lost = (time > 3590.0) & (time < 3591.0)
    whole = table.table("long.csv", {"time_s": time[~lost], "tension_start_n": 20.0 + np.sin(time[~lost])})
    used = windows.bounded(whole)
    assert windows.bounded(used) is used
    assert used["tension_start_n"][0] == whole["tension_start_n"][0]
    assert used["tension_start_n"][-1] == whole["tension_start_n"][-1]
    assert len(used.seams) == 11
    assert used["time_s"][-1] < 12 * 10.0 + 12.0
    (gap,) = [found.text for found in integrity.examine(used) if "gap of" in found.text]
    assert "time_s has a gap of 1 s at" in gap
    assert "of its 3600 s, 12 windows of 10 s" in used.notes[-1]


def test_a_long_file_is_read_by_its_windows_as_it_is_from_memory(tmp_path: Path) -> None:
    path = tmp_path / "trial.mcap"
    bowden.run(bowden.Experiment(cycles=6, settle=0), output=path)
    from_file, from_memory = windows.read(path, most_s=4.8), windows.bounded(table.read(path), most_s=4.8)
    assert len(from_file.seams) == 11
    assert from_file.seams == from_memory.seams
    assert from_file.notes == from_memory.notes
    for rows, same in ((from_file.columns, from_memory.columns), (from_file.before, from_memory.before)):
        assert rows.keys() == same.keys()
        assert all(np.array_equal(rows[name], same[name], equal_nan=True) for name in rows)
    assert all(values.base is None for values in from_file.before.values()), "the whole file's columns stay in memory"
