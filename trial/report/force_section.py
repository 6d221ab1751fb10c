"""Force and motion in the report: over time, and gait cycles overlaid against the phase.

Only recorded values are drawn. Of a long trial every extreme stays (see `overview`); of many gait cycles the complete
band is drawn with the first, the worst and the last.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trial import slow_columns
from trial.read import Trial, TrialFile
from trial.report.overview import (
    ERROR,
    HIGH,
    LOW,
    SINGLE_CYCLES,
    GaitCycles,
    Overview,
    TrialSetting,
    gait_cycles,
    known,
    seconds,
)
from trial.report.page import Page, Series
from trial.report.words import display_unit, words
from trial.signals import UNITS

Floats = NDArray[np.float64]

TROUBLE = {"emcy", "miss", "safety", "warning"}  # kinds of events that are marked on the force
MOST_MARKS = 500
TIME = "time_s"
COLOURS = {
    "desired_force_n": "#30363f", "tension_start_n": "#d9730d", "tension_end_n": "#1f6fb2",
    "estimated_end_force_n": "#2a9d6f", "servo_target_m": "#30363f", "servo_position_m": "#1f6fb2",
    "knee_target_rad": "#30363f", "knee_angle_rad": "#8e44ad", "servo_force_n": "#b3261e",
    "servo_velocity_m_s": "#2a9d6f", "feedforward_m": "#8e44ad", "impedance_dx_m": "#2a9d6f",
}
ESTIMATE = "estimated_end_force_n"
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
    """Plot columns of a reduced trial over its time (s), with marks at times."""
    shown, factor = display_unit(unit)
    along, values = seconds(trial, trial.time_ns), [
        factor * column for column in (*columns.values(), *(band[2:] if band else ()))]
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


def force(page: Page, file: TrialFile, view: Overview, setting: TrialSetting) -> None:
    """Add force over time, per gait cycle, and its error; nothing where no force is known."""
    trial = view.drawn
    if not chosen(trial, FORCE):
        return
    page.section("Force")
    troubles = _troubles(trial)
    over_time(page, trial, "Force over time", chosen(trial, FORCE), "N", height=320, marks=troubles[:MOST_MARKS],
              band=_interval(trial))
    if troubles:
        first = f"the first {MOST_MARKS} of " if len(troubles) > MOST_MARKS else ""
        page.text(f"Dashed lines mark {first}{len(troubles)} events ({', '.join(sorted(TROUBLE))}).", "note")
    error = known(trial, ERROR)
    if error is not None:
        over_time(page, trial, "Error: END less desired", {ERROR: error}, "N")
    cycles = gait_cycles(file, setting, view, [name for name in BY_PHASE if known(trial, name) is not None])
    if cycles is None:
        page.text("No gait cycle was recorded, so nothing is drawn against the phase.", "note")
        return
    if error is not None and setting.peak_n is not None:
        _by_cycle(page, cycles, setting)
    page.text(_cycles_drawn(cycles), "note")
    _against_phase(page, cycles, "Force against gait phase", [name for name in BY_PHASE if name in cycles.band])
    if error is not None:
        _against_phase(page, cycles, "Error against gait phase: END less desired", [ERROR])


def _interval(trial: Trial) -> Band | None:
    """Return the 95 % interval of the estimated END force, where the trial has one."""
    low, high = known(trial, LOW), known(trial, HIGH)
    if low is None or high is None:
        return None
    return Band(f"{words(ESTIMATE)}, 95 % interval", COLOURS[ESTIMATE], low, high)


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


def _by_cycle(page: Page, cycles: GaitCycles, setting: TrialSetting) -> None:
    """Plot the relative RMSE by gait cycle."""
    numbers = np.arange(setting.cycles)
    found = [cycles.errors[one].relative_rms(setting.peak_n or 1.0) if one in cycles.errors else None
             for one in numbers.tolist()]
    figures = np.array([np.nan if one is None else one for one in found])
    page.plot(f"Relative RMSE by gait cycle; the figures count from cycle {setting.settle}", numbers,
              [Series("relative RMSE", figures, COLOURS["tension_end_n"], points=True)], "cycle", "% of the peak",
              height=170)


def _cycles_drawn(cycles: GaitCycles) -> str:
    if cycles.count <= SINGLE_CYCLES:
        return f"{cycles.count} gait cycles, each drawn as its own line."
    worst = f", the worst (cycle {cycles.worst})" if cycles.worst_lines else ""
    return f"The band spans all {cycles.count} gait cycles; the lines are the first{worst} and the last."


def _against_phase(page: Page, cycles: GaitCycles, title: str, names: Sequence[str]) -> None:
    series = []
    for name in names:
        colour = COLOURS.get(name, COLOURS["tension_end_n"])
        lines = [lines[name] for lines in cycles.first]
        if name in DASHED:
            lines = lines[:1]
        elif cycles.count > SINGLE_CYCLES:
            low, high = np.repeat(cycles.band[name], 2, axis=1)
            series.append(Series(_words(name), low, colour, high=high, width=0.3, tip=name))
            lines = [lines[0], *([cycles.worst_lines[name]] if name in cycles.worst_lines else []), cycles.last[name]]
        series += [Series(_words(name), line, colour, dash=name in DASHED, width=1.0, tip=name) for line in lines]
    page.plot(title, cycles.percent, series, "gait phase (%)", "N", linked="gait_percent", height=320)
