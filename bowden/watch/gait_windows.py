"""Rows of a running trial cut into gait cycles, each with the time before it that its friction states need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from estimation.running_evidence import MOTION_COLUMNS
from physics.laws import Array

LEAD_S: Final = 2.5
"""Time simulated before a cycle, s, so that friction states are known at its start."""


class GaitWindow(NamedTuple):
    """One complete gait cycle: its number, columns from up to `LEAD_S` before it, and the time, s, it begins at."""

    cycle: int
    columns: dict[str, Array]
    begins_s: float


class GaitWindows:
    """Cuts rows into cycles by the column `cycle`, or every `period_s` where a bus carries no cycle number.

    Times count from the first row that belongs to a cycle.
    """

    def __init__(self, columns: Sequence[str], period_s: float) -> None:
        self._period_s = period_s
        self._place = {name: columns.index(name) for name in MOTION_COLUMNS if name in columns}
        self._cycle = columns.index("cycle") if "cycle" in columns else None
        self._kept = np.zeros((0, len(columns)))
        self._numbers = np.zeros(0)
        self._first_s: float | None = None
        self._last = -1.0

    def add(self, rows: Array) -> Iterator[GaitWindow]:
        """Add rows and yield the gait cycles that they complete."""
        rows, numbers = self._numbered(rows)
        self._kept = np.concatenate([self._kept, rows])
        self._numbers = np.concatenate([self._numbers, numbers])
        while self._numbers.size and self._numbers[-1] > self._numbers[self._begin()]:
            yield self._cut()

    def rest(self) -> Iterator[GaitWindow]:
        """Yield the last cycle, which no further row completes."""
        if self._numbers.size > self._begin() and self._cycle is not None:
            yield self._cut()

    def _begin(self) -> int:
        """Return the index of the first row of the newest incomplete cycle."""
        return int(np.searchsorted(self._numbers, self._last, side="right"))

    def _numbered(self, rows: Array) -> tuple[Array, Array]:
        """Return the rows from the first gait cycle on, and the cycle number of each row."""
        time = rows[:, self._place["time_s"]]
        if self._first_s is None:
            inside = np.arange(time.size) if self._cycle is None else np.flatnonzero(rows[:, self._cycle] >= 0.0)
            if not inside.size:
                return rows[:0], time[:0]
            rows, time = rows[inside[0]:], time[inside[0]:]
            self._first_s = float(time[0])
        if self._cycle is None:
            return rows, np.floor((time - self._first_s) / self._period_s)
        given = np.where(rows[:, self._cycle] >= 0.0, rows[:, self._cycle], -1.0)
        before = self._numbers[-1] if self._numbers.size else -1.0
        return rows, np.maximum.accumulate(np.concatenate([[before], given]))[1:]

    def _cut(self) -> GaitWindow:
        begin = self._begin()
        number = self._numbers[begin]
        end = int(np.searchsorted(self._numbers, number, side="right"))
        time = self._kept[:end, self._place["time_s"]]
        lead = int(np.searchsorted(time, time[begin] - LEAD_S))
        columns = {name: self._kept[lead:end, place] for name, place in self._place.items()}
        known = np.all([np.isfinite(v) for n, v in columns.items() if n != "desired_force_n" and np.isfinite(v).any()],
                       axis=0)
        columns = {n: v[known] for n, v in columns.items() if np.isfinite(v).any()}
        assert self._first_s is not None
        columns["time_s"] = columns["time_s"] - self._first_s
        begins_s = float(time[begin] - self._first_s)
        self._last = number
        kept = int(np.searchsorted(self._kept[:, self._place["time_s"]], time[-1] - LEAD_S))
        self._kept, self._numbers = self._kept[kept:], self._numbers[kept:]
        return GaitWindow(int(number), columns, begins_s)
