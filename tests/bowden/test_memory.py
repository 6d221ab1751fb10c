"""Peak memory of commands through the real command line: the same for a short trial and for one eight times as long."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.performance import BOUNDED, HEALTHY, MEMORY, used

INDEX_MB = 16.0
"""A trial of 240 s has 4,200 chunks more than one of 30 s; their index takes 1.4 kB each in the readers, and a Parquet
writer's group, which the shorter trial does not fill, 9 MB.  One float64 of each signal and cycle would take 57 MB."""


@pytest.mark.exhaustive
def test_peak_memory_does_not_grow_with_the_trial(tmp_path: Path) -> None:
    for name, line in MEMORY.items():
        short, long = (used(line, at=tmp_path / str(cycles), cycles=cycles)[1] for cycles in (15, 120))
        assert long < short + INDEX_MB, f"{name}: {short:.0f} MB for 30 s, {long:.0f} MB for 240 s"


@pytest.mark.exhaustive
def test_a_trial_that_is_fitted_by_windows_takes_no_more_memory_for_being_long(tmp_path: Path) -> None:
    healthy = tmp_path / "healthy"
    used(HEALTHY, healthy=healthy)
    for cycles in (70, 140):  # both longer than the 120 s of which windows are used
        used(MEMORY["bowden trial"], at=tmp_path / str(cycles), cycles=cycles)
    for name, line in BOUNDED.items():
        short, long = (used(line, at=tmp_path / str(cycles), healthy=healthy)[1] for cycles in (70, 140))
        assert long < short + INDEX_MB, f"{name}: {short:.0f} MB for 140 s, {long:.0f} MB for 280 s"
