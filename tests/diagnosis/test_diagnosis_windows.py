"""A long trial is diagnosed by windows of it, spread over it, so that the memory is bounded."""

from __future__ import annotations

import numpy as np

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
    (gap,) = [found.text for found in integrity.examine(used) if "gaps" in found.text]
    assert "time_s has 1 gaps" in gap
    assert "of its 3600 s, 12 windows of 10 s" in used.notes[-1]
