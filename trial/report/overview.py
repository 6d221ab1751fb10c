"""A trial reduced to what a page draws of it, by block: memory does not grow with the trial.

Over time, of each of `BINS` bins the least and the greatest value stay; against the gait phase, each gait cycle is
reduced when it ends.  Figures in tables are exact.  Settings that figures need (peak, rate, gait cycles) come from
the metadata; missing ones are estimated from the columns, and `read_off` lists them.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial.metrics import Magnitudes
from trial.read import Extent, RowBlock, Trial, TrialFile
from trial.report.page import extremes, interleaved
from trial.signals import PDO_NAMES, SIGNALS

Floats = NDArray[np.float64]
SETTLE = 1  # first gait cycles that no figure counts, where nothing else is stated


@dataclass(frozen=True)
class TrialSetting:
    """Peak of the desired force (N), control rate (Hz; None: unknown), gait cycles, and the values taken from the
    columns."""

    peak_n: float | None
    rate_hz: float | None
    cycles: int
    settle: int
    read_off: tuple[str, ...]

    @property
    def period_ns(self) -> float | None:
        """Length of a control cycle."""
        return None if self.rate_hz is None else 1e9 / self.rate_hz


def setting(trial: TrialFile) -> TrialSetting:
    """Return the setting of a trial, one's own or an imported one."""
    stated = {name: _figure(trial.metadata.get(name)) for name in ("peak_n", "rate_hz", "cycles", "settle")}
    readers = {"peak_n": lambda trial: _greatest(trial, "desired_force_n") or None, "rate_hz": _rate, "cycles": _cycles}
    measured = {name: readers[name](trial) if value is None and name in readers else None
                for name, value in stated.items()}
    found = {name: measured[name] if value is None else value for name, value in stated.items()}
    cycles = int(found["cycles"] or 0)
    settle = int(SETTLE if found["settle"] is None else found["settle"])
    read_off = tuple(name for name, value in stated.items() if value is None and measured[name] is not None)
    return TrialSetting(found["peak_n"], found["rate_hz"], cycles, min(settle, max(cycles - 1, 0)), read_off)


def known(trial: Trial, name: str) -> Floats | None:
    """Return a column that has a known value somewhere, or None."""
    column = trial.columns.get(name)
    return column if column is not None and np.isfinite(column).any() else None


def unknown(trial: Trial) -> list[str]:
    """Return the declared signals that the trial does not have."""
    return [signal.name for signal in SIGNALS if known(trial, signal.name) is None]


def seconds(trial: TrialFile, time_ns: NDArray[np.int64]) -> Floats:
    """Return times as seconds from the trial's first control cycle, or from the first of them where it has none."""
    first = trial.extent.first_ns if trial.extent.rows else int(time_ns.min(initial=np.iinfo(np.int64).max))
    return (time_ns - first) / 1e9


def _figure(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) and value >= 0 else None


def _rate(trial: TrialFile) -> float | None:
    block = next(trial.blocks([]), None)
    return None if block is None or len(block.time_ns) < 2 else 1e9 / float(np.median(np.diff(block.time_ns)))


def _cycles(trial: TrialFile) -> float | None:
    greatest = _greatest(trial, "cycle")
    return None if greatest is None else max(greatest + 1, 0.0)


def _greatest(trial: TrialFile, name: str) -> float | None:
    """Return the greatest value of a column, None without any."""
    found = [float(np.nanmax(columns[name])) for _, columns in trial.blocks([name] if name in trial.units else [])
             if name in columns and np.isfinite(columns[name]).any()]
    return max(found, default=None)


BINS: Final = 20_000  # of a plot over time, each two points
PHASE_BINS: Final = 500  # of a gait cycle, each two points
SINGLE_CYCLES: Final = 12  # more gait cycles than these are drawn as a band
GAP_PERIODS: Final = 2.5  # a line breaks where rows are farther apart
MOST_VALUES: Final = 20_000  # distinct values of a signal whose quantiles are exact
ERROR, LOW, HIGH = "tension_end_n − desired_force_n", "least estimate", "greatest estimate"
INTERVAL: Final = "interval between SYNCs − period"
TIMED: Final = (*(f"{name}_pdo_{ending}_ns" for ending in ("arrival", "age") for name in PDO_NAMES),
                "sync_jitter_ns", "step_duration_ns", INTERVAL)
COUNTED: Final = ("missed_inputs", "missed_outputs", "held")


class Quantiles:
    """Quantiles of values that come in parts; of more than `MOST_VALUES` distinct ones they are rounded, coarser and
    coarser."""

    def __init__(self) -> None:
        self.unknown, self._step = 0, 0.0
        self._values, self._counts = np.empty(0), np.empty(0, np.int64)

    def add(self, values: Floats) -> None:
        """Add values, NaN where unknown."""
        known = values[np.isfinite(values)]
        self.unknown += len(values) - len(known)
        self._merge(*np.unique(known, return_counts=True))
        while len(self._values) > MOST_VALUES:
            self._step = 2.0 * self._step or 1.0
            self._merge(np.empty(0), np.empty(0, np.int64))

    def _merge(self, values: Floats, counts: NDArray[np.int64]) -> None:
        both = np.concatenate([self._values, values])
        both = np.rint(both / self._step) * self._step if self._step else both
        self._values, place = np.unique(both, return_inverse=True)
        self._counts = np.bincount(place, np.concatenate([self._counts, counts]), len(self._values)).astype(np.int64)

    def at(self, shares: Sequence[float]) -> list[float | None]:
        """Return the values at or above which these shares of all known values end; None without any."""
        if not len(self._values):
            return [None] * len(shares)
        ends = np.cumsum(self._counts)
        return [float(self._values[np.searchsorted(ends, share * (ends[-1] - 1), side="right")]) for share in shares]

    def above(self, value: float) -> int:
        """Return how many values are above this one."""
        return int(self._counts[self._values > value].sum())


class Overview(NamedTuple):
    """A trial as a page draws it: `drawn`, with lines broken where rows are missing, and exact figures by column.

    `spreads`: of `TIMED`; `counts`: rows above 0 of `COUNTED`; `gait_rows`: rows in gait cycles, `gait_cycles` of them.
    """

    drawn: Trial
    extent: Extent
    spreads: dict[str, Quantiles]
    counts: dict[str, int]
    gait_rows: int
    gait_cycles: int


def overview(file: TrialFile, setting: TrialSetting) -> Overview:
    """Reduce a trial; raises `InputError` where its data are damaged."""
    rows, first_ns, last_ns, lost = file.extent
    edges = np.linspace(first_ns, last_ns, BINS + 1)[1:-1] if rows > 2 * BINS else None
    spreads: dict[str, Quantiles] = {}
    counts: dict[str, int] = {}
    gait_rows, numbers = 0, set[int]()
    names, times, tables = list(file.units), list[NDArray[np.int64]](), list[Floats]()

    def followed() -> Iterator[RowBlock]:
        nonlocal gait_rows, names
        for block in _with_derived(file, setting):
            for name in TIMED:
                if name in block.columns:
                    spreads.setdefault(name, Quantiles()).add(block.columns[name])
            for name in COUNTED:
                if name in block.columns and np.isfinite(block.columns[name]).any():
                    counts[name] = counts.get(name, 0) + int(np.count_nonzero(block.columns[name] > 0))
            inside = _in_gait(block.columns, setting.cycles)
            gait_rows += len(inside)
            numbers.update(np.unique(block.columns["cycle"][inside]).astype(int).tolist() if len(inside) else ())
            names = list(block.columns)
            yield block

    for part_times, table in _thinned(_broken(followed()), edges):
        times.append(part_times)
        tables.append(table)
    table = np.concatenate(tables, axis=1) if tables else np.empty((len(names), 0))
    descriptions = {part.name: getattr(file, part.name) for part in dataclasses.fields(TrialFile)}
    drawn = Trial(**descriptions, time_ns=np.concatenate([np.empty(0, np.int64), *times]), lost_cycles=lost,
                  columns=dict(zip(names, table, strict=True)))
    return Overview(drawn, file.extent, spreads, counts, gait_rows, len(numbers))


def _with_derived(file: TrialFile, setting: TrialSetting) -> Iterator[RowBlock]:
    """Yield the blocks with the error of END, the interval of its estimate, and the intervals between cycles."""
    before: list[int] = []
    for times, columns in file.blocks():
        derived = {}
        if "tension_end_n" in columns and "desired_force_n" in columns:
            derived[ERROR] = columns["tension_end_n"] - columns["desired_force_n"]
        if "estimated_end_force_n" in columns and "estimated_end_half_n" in columns:
            estimate, half = columns["estimated_end_force_n"], columns["estimated_end_half_n"]
            derived |= {LOW: estimate - half, HIGH: estimate + half}
        if setting.period_ns is not None:
            steps = np.diff(times, prepend=before or times[:1]).astype(np.float64) - setting.period_ns
            steps[:0 if before else 1] = np.nan
            derived[INTERVAL] = steps
        before = times[-1:].tolist()
        yield RowBlock(times, {**columns, **derived})


def _broken(blocks: Iterable[RowBlock]) -> Iterator[tuple[NDArray[np.int64], Floats]]:
    """Yield times and a table (columns, rows) for each block, with an unknown row in every gap between rows."""
    before, gap = list[int](), 0.0
    for times, columns in blocks:
        steps, table = np.diff(times, prepend=before or times[:1]), np.array(list(columns.values()))
        gap = gap or GAP_PERIODS * float(np.median(np.diff(times))) if len(times) > 1 else gap
        places = np.flatnonzero(steps > gap) if gap else np.empty(0, np.intp)
        before = times[-1:].tolist()
        if len(places):
            table = np.insert(table, places, np.nan, axis=1)
            times = np.insert(times, places, times[places] - steps[places] // 2)
        yield times, table


def _thinned(
    parts: Iterable[tuple[NDArray[np.int64], Floats]], edges: Floats | None
) -> Iterator[tuple[NDArray[np.int64], Floats]]:
    """Yield two points of each bin between `edges` (ns); without edges the rows themselves."""
    if edges is None:
        yield from parts
        return
    held: tuple[NDArray[np.int64], Floats] | None = None
    for times, table in parts:
        if held is not None:
            times, table = np.concatenate([held[0], times]), np.concatenate([held[1], table], axis=1)
        first = np.flatnonzero(np.diff(np.searchsorted(edges, times, side="right"), prepend=-1))
        held = times[first[-1]:], table[:, first[-1]:]
        if len(first) > 1:
            yield _points(times[:first[-1]], table[:, :first[-1]], first[:-1])
    if held is not None:
        yield _points(*held, np.zeros(1, np.intp))


def _points(
    times: NDArray[np.int64], table: Floats, first: NDArray[np.intp]
) -> tuple[NDArray[np.int64], Floats]:
    last = np.append(first[1:], len(times)) - 1
    return interleaved(times[first], times[last]), extremes(table, first, last)


def _in_gait(columns: Mapping[str, Floats], cycles: int) -> NDArray[np.intp]:
    """Return the rows that belong to a gait cycle and have a phase."""
    if "cycle" not in columns or "gait_percent" not in columns:
        return np.empty(0, np.intp)
    cycle, percent = columns["cycle"], columns["gait_percent"]
    return np.flatnonzero((cycle >= 0) & (cycle < cycles) & (percent >= 0) & (percent <= 100))


class GaitCycles:
    """Gait cycles against the phase: of many the band that they span, the first ones, the worst and the last.

    A line has two points of each of `bins` bins of the phase, least and greatest value in the order of the bin.
    """

    def __init__(self, bins: int, peak_n: float | None, settle: int) -> None:
        self.bins, self.count, self.worst = bins, 0, None if peak_n is None else -1
        self.errors: dict[int, Magnitudes] = {}
        self.first: list[dict[str, Floats]] = []
        self.worst_lines: dict[str, Floats] = {}
        self.last: dict[str, Floats] = {}
        self.band: dict[str, Floats] = {}
        self._peak_n, self._settle, self._greatest = peak_n or 1.0, settle, -1.0
        self._number: int | None = None
        self._open: dict[str, Floats] = {}

    @property
    def percent(self) -> Floats:
        """Phases of the two points of each bin: its borders."""
        return np.repeat(np.linspace(0.0, 100.0, self.bins + 1), 2)[1:-1]

    def add(self, columns: Mapping[str, Floats], rows: NDArray[np.intp]) -> None:
        """Add the rows of a block that belong to gait cycles."""
        cycle = columns["cycle"]
        if ERROR in columns:
            for number in np.unique(cycle[cycle >= 0]).astype(int).tolist():
                self.errors.setdefault(number, Magnitudes()).add(columns[ERROR][cycle == number])
        for part in np.split(rows, np.flatnonzero(np.diff(cycle[rows].astype(int))) + 1) if len(rows) else ():
            number = int(cycle[part[0]])
            if number != self._number:
                self.close()
                self._number = number
            self._extend(columns, part)

    def _extend(self, columns: Mapping[str, Floats], rows: NDArray[np.intp]) -> None:
        bins = np.minimum(columns["gait_percent"][rows] / 100 * self.bins, self.bins - 1).astype(np.int64)
        order = np.argsort(bins, kind="stable")
        place, first = np.unique(bins[order], return_index=True)
        last = np.append(first[1:], len(rows)) - 1
        for name, column in columns.items():
            if name in ("cycle", "gait_percent"):
                continue
            values, kept = column[rows][order], self._open.setdefault(name, np.full((4, self.bins), np.nan))
            kept[0, place] = np.fmin(kept[0, place], np.fmin.reduceat(values, first))
            kept[1, place] = np.fmax(kept[1, place], np.fmax.reduceat(values, first))
            kept[2, place] = np.where(np.isnan(kept[2, place]), values[first], kept[2, place])
            kept[3, place] = values[last]

    def close(self) -> None:
        """End the gait cycle whose rows came last."""
        if self._number is None:
            return
        lines = {name: interleaved(*np.where(begin > end, (high, low), (low, high)))
                 for name, (low, high, begin, end) in self._open.items()}
        for name, (low, high, _, _) in self._open.items():
            band = self.band.setdefault(name, np.array([low, high]))
            band[0], band[1] = np.fmin(band[0], low), np.fmax(band[1], high)
        if self.count < SINGLE_CYCLES:
            self.first.append(lines)
        error = self.errors[self._number].relative_rms(self._peak_n) if self._number in self.errors else None
        if self.worst is not None and self._number >= self._settle and error is not None and error > self._greatest:
            self._greatest, self.worst, self.worst_lines = error, self._number, lines
        self.count, self.last, self._open, self._number = self.count + 1, lines, {}, None


def gait_cycles(
    file: TrialFile, setting: TrialSetting, view: Overview, names: Sequence[str]
) -> GaitCycles | None:
    """Return the gait cycles of a trial with the columns `names` and the error of END; None without any."""
    if not view.gait_rows:
        return None
    wanted = [name for name in ("cycle", "gait_percent", *names) if name in file.units]
    found = GaitCycles(int(np.clip(view.gait_rows / view.gait_cycles / 4, 10, PHASE_BINS)), setting.peak_n,
                       setting.settle)
    for _, columns in file.blocks(wanted):
        if "tension_end_n" in columns and "desired_force_n" in columns:
            columns = {**columns, ERROR: columns["tension_end_n"] - columns["desired_force_n"]}
        found.add(columns, _in_gait(columns, setting.cycles))
    found.close()
    return found
