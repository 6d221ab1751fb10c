"""A growing trial watched: evidence by gait cycle, the diagnosis of suspected cycles, and of the whole at its end.

The rule of this file: it reads one file and sends nothing to a bus; a stop is asked for by its answer alone.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from diagnosis.evidence.decision import threshold
from diagnosis.finder import Finder
from diagnosis.findings import Findings
from estimation.data import table, windows
from estimation.data.table import Table
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import SIGNALS, PathRecording
from estimation.path_model import PATH_MODEL, usable_table
from estimation.running_evidence import MOTION_COLUMNS, Naming, RunningEvidence, WatchVerdict
from parameters import InputError
from physics.effects.hypotheses import HYPOTHESES
from physics.laws import Array
from trial.growing import GrowingTrial
from trial.signals import of_path

LEAD_S: Final = 2.5
"""Time simulated before a cycle, s, so that friction states are known at its start."""


DIAGNOSED_S: Final = 40.0
"""Time, s, of suspected cycles that one diagnosis uses, in windows spread evenly over them.

A diagnosis takes about as long as the time that it uses.  If this is too large, a watch falls behind its trial; if it
is too small, small effects are not named before the diagnosis of the whole trial.
"""


class GaitWindow(NamedTuple):
    """One complete gait cycle: its number, columns from up to `LEAD_S` before it, and the time, s, it begins at.

    `rows`: of the cycle, with all columns.
    """

    cycle: int
    columns: dict[str, Array]
    begins_s: float
    rows: Array


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
        rows = self._kept[begin:end].copy()
        kept = int(np.searchsorted(self._kept[:, self._place["time_s"]], time[-1] - LEAD_S))
        self._kept, self._numbers = self._kept[kept:], self._numbers[kept:]
        return GaitWindow(int(number), columns, begins_s, rows)


class LatestCycles:
    """Columns of the latest gait cycles that a diagnosis uses, and the effects that their diagnosis names.

    `names`: of the columns, "" for one of another force path.  `finder`: diagnosis with the reference trials.
    """

    def __init__(self, source: str, names: Sequence[str], finder: Finder) -> None:
        self._source, self._finder = source, finder
        self._place = {name: k for k, name in enumerate(names)
                       if name in table.UNITS or name in table.WORDS or name.endswith(table.AGE_SUFFIX)}
        self._cycles: deque[dict[str, Array]] = deque()

    def add(self, rows: Array, most_s: float = 120.0) -> None:
        """Add the rows of one cycle; cycles that begin more than `most_s` before its last row are dropped."""
        self._cycles.append({name: rows[:, place].copy() for name, place in self._place.items()})
        while len(self._cycles) > 1 and rows[-1, self._place["time_s"]] - self._cycles[0]["time_s"][0] > most_s:
            self._cycles.popleft()

    def recorded(self, count: int) -> Table:
        """Return the latest `count` cycles, or as many of them as there are, as a trial of `DIAGNOSED_S` at most."""
        cycles = list(self._cycles)[-count:]
        columns = {name: np.concatenate([cycle[name] for cycle in cycles]) for name in self._place}
        return windows.bounded(table.table(self._source, table.recorded(columns)), DIAGNOSED_S)

    def diagnosed(self, count: int) -> dict[str, float] | None:
        """Return the effects that a diagnosis of the latest `count` cycles names, best first, with log Bayes factors.

        None if the diagnosis refuses them, as it does fewer than three cycles.
        """
        found = self._finder.diagnose([self.recorded(count)])
        nats = (found.evidence or {}).get("log_bayes_factors", {})
        return None if found.verdict == "refused" else {name: nats.get(name, 0.0) for name in found.rivals}


LOOK_S: Final = 0.1
"""Time between two looks at the file, s: as often as a recorder writes."""
STILL_LOOKS: Final = 50
"""Number of looks without growth of the file until a remark on it: a recording that was cut off never grows."""
ANY: Final = "any"
"""Word for every effect in --stop-on."""
STOP_PERCENT: Final = 2.0
"""Error of END, % of the peak, that a named effect must cost for a stop."""
DRIFT_S: Final = 20.0
"""Time, s, over which a running trial's drifts are counted, since its end is unknown yet."""


@dataclass(frozen=True)
class WatchedBench:
    """The bench that is watched: reference trials, 1σ between sessions (None: the published one), stops asked for.

    `path`: the force path that is watched, of a bench of several; None of a bench of a single one.
    """

    healthy: tuple[Path, ...]
    session_sd: dict[str, float] | None = None
    stop_on: tuple[str, ...] = ()
    path: str | None = None


def refuse_stop_on(names: Sequence[str], where: str) -> None:
    """Raise `InputError` for names of no effect that the evidence can name."""
    for name in names:
        if name != ANY and name not in HYPOTHESES:
            raise InputError(f"{where} {name}: no effect that a watch can name; expected {ANY} or one of "
                             f"{', '.join(HYPOTHESES)}.")


class FileWatch:
    """Watch of one file; raises `InputError` for unusable reference trials.

    `replaced`: a file that is there already is about to be overwritten.
    """

    def __init__(self, path: Path, bench: WatchedBench, *, replaced: bool = False) -> None:
        self._bench, self._file = bench, GrowingTrial(path, replaced=replaced)
        self._tables = [usable_table(path, bench.path) for path in bench.healthy]
        self._windows: GaitWindows | None = None
        self._latest: LatestCycles | None = None
        self._evidence: dict[tuple[str, ...], RunningEvidence] = {}
        self._of(tuple(n for n in SIGNALS if all(n in t for t in self._tables)))
        self._finder = Finder(session_sd=bench.session_sd).fit([windows.read(p, bench.path) for p in bench.healthy])

    @property
    def closed(self) -> bool:
        """True if the writer has closed the file."""
        return self._file.closed

    def look(self, last: bool = False) -> Iterator[WatchVerdict]:
        """Yield the suspicion after each gait cycle that the file has completed since the last call.

        `last`: nothing more comes, and the cycle that was begun counts as complete.
        """
        with threadpool_limits(1, user_api="blas"):
            while (rows := self._file.rows()).size:
                for window in self._cut(rows):
                    yield from self._judged(window)
            if last and self._windows is not None:
                for window in self._windows.rest():
                    yield from self._judged(window)

    def follow(self, over: Callable[[], bool], remark: Callable[[str], None]) -> Iterator[WatchVerdict]:
        """Yield each suspicion until the file is closed or `over()`; `remark` is called once if it does not grow."""
        still, size, path = 0, -1, self._file.path
        while not self.closed and not over():
            yield from self.look()
            before, size = size, path.stat().st_size if path.exists() else 0
            still = still + 1 if size == before else 0
            if still == STILL_LOOKS:
                remark(f"{path}: does not grow; if nothing writes it, end the watch by Ctrl-C and say bowden recover "
                       f"{path} -o FILE.")
            if not self.closed:
                time.sleep(LOOK_S)
        yield from self.look(last=True)

    def _cut(self, rows: Array) -> Iterator[GaitWindow]:
        if self._windows is None:
            own = [name if self._bench.path is None else of_path(name, self._bench.path) or ""
                   for name in self._file.columns]
            self._windows = GaitWindows(own, _period_s(self._tables))
            self._latest = LatestCycles(str(self._file.path), own, self._finder)
        return self._windows.add(rows)

    def _judged(self, window: GaitWindow) -> Iterator[WatchVerdict]:
        outputs = tuple(n for n in SIGNALS if n in window.columns and all(n in t for t in self._tables))
        assert self._latest is not None
        self._latest.add(window.rows)
        found = self._of(outputs).add(*window[:3])
        if found is not None:
            yield found

    def stops(self, found: WatchVerdict) -> bool:
        """Return whether a suspicion requests a safe stop."""
        asked = self._bench.stop_on
        named = ANY in asked or any(name in asked for name in found.suspected)
        return bool(found.suspected) and named and found.cost_percent >= STOP_PERCENT

    def told(self, found: WatchVerdict) -> str:
        """Return a suspicion as one line for a terminal, with the force path of a bench of several."""
        return (f"{self._bench.path}, " if self._bench.path else "") + told(found)

    def diagnosis(self) -> Findings:
        """Return the diagnosis of the whole file, as `bowden diagnose` gives it; cycles and evidence are dropped first.
        """
        self._windows, self._latest = None, None
        self._evidence.clear()
        return self._finder.diagnose([windows.read(self._file.path, self._bench.path)])

    def _diagnosed(self, count: int) -> dict[str, float] | None:
        assert self._latest is not None
        return self._latest.diagnosed(count)

    def _of(self, outputs: tuple[str, ...]) -> RunningEvidence:
        """Return the running evidence from these outputs; other outputs need another fit of the reference trials."""
        if outputs not in self._evidence:
            if "tension_start_n" not in outputs:
                raise InputError(f"{self._file.path}: no START tension; the watch simulates the force path against it.")
            with threadpool_limits(1, user_api="blas"):
                recordings = [PathRecording(replace(t, columns={
                    n: v for n, v in t.columns.items() if n not in SIGNALS or n in outputs})) for t in self._tables]
                fit = fit_reference(PATH_MODEL, recordings, self._bench.session_sd)
            naming = Naming(threshold(PATH_MODEL), self._diagnosed)
            self._evidence[outputs] = RunningEvidence(fit, DRIFT_S, naming, _missed_n(self._tables))
        return self._evidence[outputs]


def told(found: WatchVerdict) -> str:
    """Return a suspicion as one line for a terminal."""
    error = f"END error {found.end_error_n:.2f} N"
    if not found.suspected:
        said = "nothing suspected" if found.nats < threshold(PATH_MODEL) else "no diagnosis names a cause"
        return f"cycle {found.cycle}: {said} ({found.best} {found.nats:.0f} nats by the linear model); {error}"
    since = "before the trial" if found.since == 0 else f"cycle {found.since}"
    return (f"cycle {found.cycle}: suspected {', '.join(found.suspected)}; {found.nats:.0f} nats, "
            f"since {since}; {error}, {found.cost_percent:.1f} % of the peak beyond the reference")


def as_json(found: Findings) -> dict[str, Any]:
    """Return the part of a diagnosis that a watch reports."""
    whole = found.as_json()
    return {name: whole[name] for name in ("verdict", "causes", "class", "experiment", "warnings")}


def _period_s(tables: Sequence[Table]) -> float:
    """Return the length of a gait cycle of the reference trials, s; 2 s where none is numbered."""
    for given in tables:
        if "cycle" in given and given["cycle"].max() > given["cycle"].min():
            spans = given["time_s"][-1] - given["time_s"][0]
            return float(spans / (given["cycle"].max() - given["cycle"].min() + 1.0))
    return 2.0


def _missed_n(tables: Sequence[Table]) -> float:
    """Return the RMS, N, by which the reference trials' END misses the desired force; 0 where it is not recorded."""
    squares = [float(np.nanmean((t["tension_end_n"] - t["desired_force_n"]) ** 2)) for t in tables
               if "tension_end_n" in t and "desired_force_n" in t]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0
