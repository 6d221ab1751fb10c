"""Sections of the report: force and motion over time and against the gait phase; timing of PDOs and SYNC; bus load.

Only recorded values are drawn. Of a long trial every extreme stays (see `overview`); of many gait cycles the complete
band is drawn with the first, the worst and the last.  The bits of a frame are counted by the caller's function.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eds import cia301
from trial import slow_columns
from trial.mcap_file import cdr
from trial.read import Trial, TrialFile
from trial.report.overview import (
    COUNTED,
    ERROR,
    HIGH,
    INTERVAL,
    LOW,
    SINGLE_CYCLES,
    TIMED,
    GaitCycles,
    Overview,
    Quantiles,
    TrialSetting,
    gait_cycles,
    known,
    seconds,
)
from trial.report.page import Cell, Page
from trial.report.plot import Plot, Series
from trial.report.words import display_unit, words
from trial.signals import PDO_NAMES, UNITS

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
    page.plot(Plot(title, along, lines, "time (s)", shown, linked=TIME, marks=marks, height=height))


def _words(name: str) -> str:
    """Return a column, or a difference of two, in words."""
    return " − ".join(map(words, name.split(" − ")))


def chosen(trial: Trial, names: Sequence[str]) -> dict[str, Floats]:
    """Return the columns that the trial has; a column sampled at a lower rate is interpolated linearly."""
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
    page.plot(Plot(f"Relative RMSE by gait cycle; the figures count from cycle {setting.settle}", numbers,
              [Series("relative RMSE", figures, COLOURS["tension_end_n"], points=True)], "cycle", "% of the peak",
              height=170))


def _cycles_drawn(cycles: GaitCycles) -> str:
    if cycles.count <= SINGLE_CYCLES:
        return "One gait cycle." if cycles.count == 1 else f"{cycles.count} gait cycles, each drawn as its own line."
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
    page.plot(Plot(title, cycles.percent, series, "gait phase (%)", "N", linked="gait_percent", height=320))


FrameBits = Callable[[NDArray[np.void]], NDArray[np.int64]]
"""Bit times of each frame of a `cdr.FRAME_ROW` array, with its interframe space."""

WINDOW_NS: Final = 100_000_000
PDO_COLOURS = dict(zip(PDO_NAMES, ("#1f6fb2", "#8e44ad", "#d9730d", "#2a9d6f"), strict=True))
# Kinds of frames by their COB-IDs (CiA 301, 7.3.3), first and last.
KINDS = (
    ("SYNC and PDOs", "#1f6fb2", ((cia301.SYNC_COB_ID, cia301.SYNC_COB_ID), (0x180, 0x57F))),
    ("SDO", "#d9730d", ((0x580, 0x67F),)),
    ("NMT, EMCY, heartbeats and others", "#2a9d6f", ()),
)


def timing(page: Page, view: Overview, setting: TrialSetting, *, on_bus: bool = True) -> None:
    """Add age and arrival of the PDOs, SYNC, misses and the step's duration; for an imported table, the steps of its
    time.
    """
    trial = view.drawn
    timed = [name for name in TIMED if known(trial, name) is not None]
    if not on_bus and set(timed) <= {INTERVAL}:
        _sampling(page, view, setting.period_ns)
        return
    page.section("Timing")
    if "sync_jitter_ns" in timed and INTERVAL in timed:
        timed.remove(INTERVAL)
    if timed:
        page.table(("signal (µs)", "least", "median", "99.9 %", "greatest", "unknown rows"),
                   [_spread(name, view.spreads[name]) for name in timed])
    page.facts(_misses(view))
    for title, ending in (("PDO arrival after SYNC", "arrival"), ("PDO age at the controller's step", "age")):
        _timing_plot(page, trial, title, {f"{name}_pdo_{ending}_ns": PDO_COLOURS[name] for name in PDO_NAMES})
    for name, title in (("sync_jitter_ns", "SYNC against its nominal time"),
                        (INTERVAL, "SYNC against its nominal time"),
                        ("step_duration_ns", "Duration of the controller's step")):
        if name in timed:
            over_time(page, trial, title, chosen(trial, [name]), "ns")


def _sampling(page: Page, view: Overview, period_ns: float | None) -> None:
    """Add the regularity of a table's time steps."""
    if INTERVAL not in view.spreads or view.extent.rows < 3 or period_ns is None:
        return
    page.section("Sampling")
    least, middle, greatest = ((one or 0.0) + period_ns for one in view.spreads[INTERVAL].at((0.0, 0.5, 1.0)))
    page.facts({"rate (Hz)": 1e9 / middle, "median step (s)": middle / 1e9, "least step (s)": least / 1e9,
                "greatest step (s)": greatest / 1e9,
                "steps above 2.5 medians": view.spreads[INTERVAL].above(2.5 * middle - period_ns)})


def _timing_plot(page: Page, trial: Trial, title: str, colours: dict[str, str]) -> None:
    columns = chosen(trial, list(colours))
    if columns:
        over_time(page, trial, title, columns, "ns", colours=colours)


def _spread(name: str, found: Quantiles) -> list[Cell]:
    quantiles = found.at((0.0, 0.5, 0.999, 1.0))
    text = f"{words(name)}, {name.removesuffix('_ns').rpartition('_')[2]}" if "_pdo_" in name else words(name)
    return [text, *(None if one is None else one / 1000 for one in quantiles), found.unknown]


def _misses(view: Overview) -> dict[str, Cell]:
    rows, _, _, lost = view.extent
    found: dict[str, Cell] = {"control cycles": rows, "cycles lost in recording": lost}
    for name, text in zip(COUNTED, ("cycles with missed inputs", "cycles with missed outputs",
                                    "cycles that held their targets"), strict=True):
        found[text] = view.counts.get(name, "not recorded")
    return found


def load(page: Page, trial: TrialFile, frame_bits: FrameBits, bound_percent: float | None) -> None:
    """Add the bus load in steps of 100 ms, by kind of frame; nothing where no bus was recorded."""
    sums: dict[str, Floats] = {}
    every, counted, first_ns = 0, 0, 0
    for block in trial.frame_blocks():
        every += len(block)
        frames = block[block["flags"] & cdr.ERROR == 0]
        if len(frames):
            first_ns = first_ns if counted else int(frames["time_ns"].min())
            counted += len(frames)
            window, bits = ((frames["time_ns"] - first_ns) // WINDOW_NS).clip(0), frame_bits(frames)
            for name, _, rows in [*_kinds(frames["can_id"]), ("all frames", "", np.ones(len(frames), bool))]:
                if rows.any():
                    own = np.bincount(window[rows], bits[rows]).astype(np.float64)
                    sums[name] = _added(sums.get(name, np.empty(0)), own)
    if not every:
        return
    page.section("Bus load")
    if not counted:
        page.text("No CAN frames were recorded.", "note")
        return
    bitrate, windows = _bitrate(trial), len(sums["all frames"])
    scale, unit = (1e-3, "kbit/s") if bitrate is None else (100.0 / bitrate, "% of the bus")
    along = seconds(trial, first_ns + np.arange(windows) * WINDOW_NS)
    series = [Series(name, _per_second(sums[name], windows) * scale, colour, steps=True)
              for name, colour, _ in KINDS if name in sums]
    total = Series("all frames", _per_second(sums["all frames"], windows) * scale, "#30363f", steps=True, width=1.6)
    bound = [] if bitrate is None or bound_percent is None else [
        Series("computed bound", np.full(len(along), bound_percent), "#b3261e", dash=True)]
    speed = "" if bitrate is None else f" at {bitrate / 1000:g} kbit/s"
    page.text(f"{counted} frames{speed}; bits as sent, with stuffing and interframe space. Error frames are not "
              "counted.", "note")
    page.plot(Plot("Load over 100 ms", along, [total, *series, *bound], "time (s)", unit, linked=TIME))


def _added(one: Floats, other: Floats) -> Floats:
    """Return the sum of two arrays; the shorter one is followed by zeros."""
    longer, shorter = (one, other) if len(one) >= len(other) else (other, one)
    longer[:len(shorter)] += shorter
    return longer


def _kinds(can_id: NDArray[np.uint32]) -> list[tuple[str, str, NDArray[np.bool_]]]:
    left, found = np.ones(len(can_id), bool), []
    for name, colour, ranges in KINDS:
        rows = left.copy() if not ranges else np.zeros(len(can_id), bool)
        for first, last in ranges:
            rows |= (can_id >= first) & (can_id <= last)
        left &= ~rows
        found.append((name, colour, rows))
    return found


def _per_second(bits: Floats, windows: int) -> Floats:
    """Return bit/s by window; unknown in the last of several, which the end of the recording cuts."""
    found = _added(np.zeros(windows), bits) * (1e9 / WINDOW_NS)
    if windows > 1:
        found[-1] = np.nan
    return found


def _bitrate(trial: TrialFile) -> int | None:
    text = trial.metadata.get("bitrate", "")
    return int(text) if text.isdecimal() and int(text) else None
