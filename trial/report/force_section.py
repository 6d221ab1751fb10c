"""Force and motion in the report: over time, and gait cycles overlaid against the phase.

Only recorded values are drawn. Of a long trial every extreme stays (see `packing`); of many gait cycles the complete
band is drawn with the first, the worst and the last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial import metrics, slow_columns
from trial.read import Trial
from trial.report.packing import broken, thinned
from trial.report.page import Page, Series
from trial.report.setting import TrialSetting, known, seconds
from trial.report.words import hand, words
from trial.signals import UNITS

Floats = NDArray[np.float64]

BINS = 20_000  # of a plot over time, each two points
PHASE_BINS = 500  # of a gait cycle, each two points
SINGLE_CYCLES = 12  # more gait cycles than these are drawn as a band
TROUBLE = {"emcy", "miss", "safety", "warning"}  # kinds of events that are marked on the force
MOST_MARKS = 500
GAP_PERIODS = 2.5  # a line breaks where rows are farther apart
TIME = "time_s"
COLOURS = {
    "desired_force_n": "#30363f", "tension_start_n": "#d9730d", "tension_end_n": "#1f6fb2",
    "estimated_end_force_n": "#2a9d6f", "servo_target_m": "#30363f", "servo_position_m": "#1f6fb2",
    "knee_target_rad": "#30363f", "knee_angle_rad": "#8e44ad", "servo_force_n": "#b3261e",
    "servo_velocity_m_s": "#2a9d6f", "feedforward_m": "#8e44ad", "impedance_dx_m": "#2a9d6f",
}
ESTIMATE, HALF = "estimated_end_force_n", "estimated_end_half_n"
DASHED = {"desired_force_n", "servo_target_m", "knee_target_rad"}
OTHER = "#5b6675"

FORCE = ("tension_start_n", "estimated_end_force_n", "tension_end_n", "desired_force_n")  # the last in front
BY_PHASE = ("tension_start_n", "tension_end_n", "desired_force_n")
MOTION = (
    ("Rope at the drum", ("servo_target_m", "servo_position_m"), "m"),
    ("Knee", ("knee_target_rad", "knee_angle_rad"), "rad"),
    ("Rope force by the servo's torque", ("servo_force_n",), "N"),
    ("Rope speed", ("servo_velocity_m_s",), "m/s"),
    ("Corrections of the controller", ("feedforward_m", "impedance_dx_m"), "m"),
)


class Band(NamedTuple):
    """A band between two columns."""

    label: str
    colour: str
    low: Floats
    high: Floats


def over_time(
    page: Page, trial: Trial, title: str, columns: Mapping[str, Floats], unit: str,
    colours: Mapping[str, str] = COLOURS, height: int = 240, marks: Sequence[float] = (), band: Band | None = None,
) -> None:
    """Plot columns over the trial's time (s), thinned, broken where rows are missing, with marks at times."""
    shown, factor = hand(unit)
    along, values = seconds(trial, trial.time_ns), [
        factor * column for column in (*columns.values(), *(band[2:] if band else ()))]
    if len(along) > 1:
        along, values = broken(along, values, GAP_PERIODS * float(np.median(np.diff(along))))
        along, values = thinned(along, values, BINS)
    lines = [Series(_words(name), column, colours.get(name, OTHER), dash=name in DASHED, tip=name)
             for name, column in zip(columns, values, strict=False)]
    if band is not None:
        lines.insert(0, Series(band.label, values[-2], band.colour, high=values[-1], width=0.3))
    page.plot(title, along, lines, "time (s)", shown, linked=TIME, marks=marks, height=height)


def _words(name: str) -> str:
    """Return a column, or a difference of two, in words."""
    return " − ".join(map(words, name.split(" − ")))


def chosen(trial: Trial, names: Sequence[str]) -> dict[str, Floats]:
    """Return those of the columns that the trial has; one of a lower rate than the rows with lines between values."""
    found = {name: known(trial, name) for name in names}
    time = seconds(trial, trial.time_ns)
    return {name: slow_columns.on_rows(time, column)[0] for name, column in found.items() if column is not None}


def force(page: Page, trial: Trial, setting: TrialSetting) -> None:
    """Add force over time, per gait cycle, and its error; nothing where no force is known."""
    if not chosen(trial, FORCE):
        return
    page.section("Force")
    troubles = _troubles(trial)
    over_time(page, trial, "Force over time", chosen(trial, FORCE), "N", height=320, marks=troubles[:MOST_MARKS],
              band=_interval(trial))
    if troubles:
        first = f"the first {MOST_MARKS} of " if len(troubles) > MOST_MARKS else ""
        page.text(f"Dashed lines mark {first}{len(troubles)} events ({', '.join(sorted(TROUBLE))}).", "note")
    end, desired = known(trial, "tension_end_n"), known(trial, "desired_force_n")
    error = None if end is None or desired is None else end - desired
    if error is not None:
        over_time(page, trial, "Error: END less desired", {"tension_end_n − desired_force_n": error}, "N")
    phases = _phases(trial, setting)
    if phases is None:
        page.text("No gait cycle was recorded, so nothing is drawn against the phase.", "note")
        return
    worst = None if error is None else _by_cycle(page, trial, setting, error)
    page.text(_cycles_drawn(phases, worst), "note")
    _against_phase(page, phases, "Force against gait phase", chosen(trial, BY_PHASE), worst)
    if error is not None:
        _against_phase(page, phases, "Error against gait phase: END less desired",
                       {"tension_end_n − desired_force_n": error}, worst)


def _interval(trial: Trial) -> Band | None:
    """Return the 95 % interval of the estimated END force, where the trial has one."""
    estimate, half = known(trial, ESTIMATE), known(trial, HALF)
    if estimate is None or half is None:
        return None
    return Band(f"{words(ESTIMATE)}, 95 % interval", COLOURS[ESTIMATE], estimate - half, estimate + half)


def _troubles(trial: Trial) -> list[float]:
    times = [event.time_ns for event in trial.events if event.kind in TROUBLE]
    found: list[float] = seconds(trial, np.array(times, np.int64)).tolist()
    return found


def motion(page: Page, trial: Trial) -> None:
    """Add rope, knee and controller over time; nothing where none of them is known."""
    if not any(chosen(trial, names) for _, names, _ in MOTION):
        return
    page.section("Motion")
    for title, names, unit in MOTION:
        columns = chosen(trial, names)
        if columns:
            over_time(page, trial, title, columns, unit)


def others(page: Page, trial: Trial) -> None:
    """Add the signals that only this bench or its controller has, over time; nothing if there are none."""
    columns = chosen(trial, [name for name in trial.columns if name not in UNITS and name in trial.units])
    if not columns:
        return
    page.section("Other signals")
    for name, column in columns.items():
        over_time(page, trial, words(name), {name: column}, trial.units[name])


def _by_cycle(page: Page, trial: Trial, setting: TrialSetting, error: Floats) -> int | None:
    """Plot the relative RMSE by gait cycle; returns the worst one that counts."""
    if setting.peak_n is None:
        return None
    cycle = trial.columns["cycle"]
    numbers = np.arange(setting.cycles)
    found = [metrics.relative_rmse(error, cycle == number, setting.peak_n) for number in numbers]
    figures = np.array([np.nan if one is None else one for one in found])
    page.plot(f"Relative RMSE by gait cycle; the figures count from cycle {setting.settle}", numbers,
              [Series("relative RMSE", figures, COLOURS["tension_end_n"], points=True)], "cycle", "% of the peak",
              height=170)
    counted = figures[setting.settle:]
    return int(np.nanargmax(counted)) + setting.settle if np.isfinite(counted).any() else None


class Phases(NamedTuple):
    """Rows in gait cycles, by time; `first` row of each (cycle, bin) met, `place` of it; `cycles` met."""

    rows: NDArray[np.intp]
    first: NDArray[np.intp]
    place: NDArray[np.intp]
    cycles: NDArray[np.int64]
    bins: int

    @property
    def percent(self) -> Floats:
        """Phases of the two points of each bin: its borders."""
        return np.repeat(np.linspace(0.0, 100.0, self.bins + 1), 2)[1:-1]

    def envelope(self, column: Floats) -> Floats:
        """Return least and greatest value by gait cycle and bin, interleaved: (cycles, 2 bins), NaN where unknown."""
        values = column[self.rows]
        low, high = np.fmin.reduceat(values, self.first), np.fmax.reduceat(values, self.first)
        falls = values[self.first] > values[np.append(self.first[1:], len(values)) - 1]
        found = np.full((len(self.cycles) * self.bins, 2), np.nan)
        found[self.place, 0], found[self.place, 1] = np.where(falls, high, low), np.where(falls, low, high)
        return found.reshape(len(self.cycles), 2 * self.bins)


def _phases(trial: Trial, setting: TrialSetting) -> Phases | None:
    percent, cycle = known(trial, "gait_percent"), known(trial, "cycle")
    if percent is None or cycle is None:
        return None
    rows = np.flatnonzero((cycle >= 0) & (cycle < setting.cycles) & (percent >= 0) & (percent <= 100))
    if not len(rows):
        return None
    cycles, which = np.unique(cycle[rows].astype(np.int64), return_inverse=True)
    bins = int(np.clip(len(rows) / len(cycles) / 4, 10, PHASE_BINS))
    key = which * bins + np.minimum(percent[rows] / 100 * bins, bins - 1).astype(np.int64)
    order = np.argsort(key, kind="stable")
    place, first = np.unique(key[order], return_index=True)
    return Phases(rows[order], first, place, cycles, bins)


def _cycles_drawn(phases: Phases, worst: int | None) -> str:
    count = len(phases.cycles)
    if count <= SINGLE_CYCLES:
        return f"{count} gait cycles, each drawn as its own line."
    worst_one = "" if worst is None else f", the worst (cycle {worst})"
    return f"The band spans all {count} gait cycles; the lines are the first{worst_one} and the last."


def _against_phase(
    page: Page, phases: Phases, title: str, columns: Mapping[str, Floats], worst: int | None
) -> None:
    series = []
    for name, column in columns.items():
        drawn, colour = phases.envelope(column), COLOURS.get(name, COLOURS["tension_end_n"])
        if len(drawn) <= SINGLE_CYCLES or name in DASHED:
            lines = drawn[:SINGLE_CYCLES] if name not in DASHED else drawn[:1]
        else:
            low, high = _band(drawn)
            series.append(Series(_words(name), low, colour, high=high, width=0.3, tip=name))
            kept = [0, len(drawn) - 1] + [at for at, one in enumerate(phases.cycles) if one == worst]
            lines = drawn[sorted(set(kept))]
        series += [Series(_words(name), line, colour, dash=name in DASHED, width=1.0, tip=name) for line in lines]
    page.plot(title, phases.percent, series, "gait phase (%)", "N", linked="gait_percent", height=320)


def _band(drawn: Floats) -> tuple[Floats, Floats]:
    low, high = np.fmin.reduce(drawn, axis=0), np.fmax.reduce(drawn, axis=0)
    return np.repeat(np.fmin(low[::2], low[1::2]), 2), np.repeat(np.fmax(high[::2], high[1::2]), 2)
