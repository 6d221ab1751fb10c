"""The report's bus: when PDOs came, how old they were, how exact SYNC was, how full the bus was.

The rule of this file: bits are counted by whoever hands in the counter; here they are only summed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eds import cia301
from trial.mcap_file import cdr
from trial.read import Trial
from trial.report.force_section import TIME, chosen, over_time
from trial.report.page import Cell, Page, Series
from trial.report.setting import TrialSetting, known, seconds
from trial.signals import PDO_NAMES

Floats = NDArray[np.float64]
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


def timing(page: Page, trial: Trial, setting: TrialSetting, *, on_bus: bool = True) -> None:
    """Add age and arrival of the PDOs, SYNC, misses and the step's duration; for an imported table, the steps of its
    time.
    """
    if not on_bus and not _timed(trial):
        _sampling(page, trial)
        return
    page.section("Timing")
    rows = [_spread(name, trial.columns[name]) for name in _timed(trial)]
    sync = _sync(trial, setting)
    if sync is not None and "sync_jitter_ns" not in _timed(trial):
        rows.append(_spread(*sync))
    if rows:
        page.table(("signal (µs)", "least", "median", "99.9 %", "greatest", "unknown rows"), rows)
    page.facts(_misses(trial))
    for title, ending in (("PDO arrival after SYNC", "arrival"), ("PDO age at the controller's step", "age")):
        columns = {f"{name}_pdo_{ending}_ns": PDO_COLOURS[name] for name in PDO_NAMES}
        _timing_plot(page, trial, title, columns)
    if sync is not None:
        over_time(page, trial, "SYNC against its nominal time", dict([sync]), "ns")
    if known(trial, "step_duration_ns") is not None:
        over_time(page, trial, "Duration of the controller's step", chosen(trial, ["step_duration_ns"]), "ns")


def _sampling(page: Page, trial: Trial) -> None:
    """Return a sentence on the regularity of a table's time steps."""
    if len(trial.time_ns) < 3:
        return
    page.section("Sampling")
    steps = np.diff(trial.time_ns) / 1e9
    middle = float(np.median(steps))
    page.facts({"rate (Hz)": 1.0 / middle, "median step (s)": middle, "least step (s)": float(steps.min()),
                "greatest step (s)": float(steps.max()), "steps above 2.5 medians": int((steps > 2.5 * middle).sum())})


def _timing_plot(page: Page, trial: Trial, title: str, colours: dict[str, str]) -> None:
    columns = chosen(trial, list(colours))
    if columns:
        over_time(page, trial, title, columns, "ns", colours=colours)


def _timed(trial: Trial) -> list[str]:
    names = [f"{name}_pdo_{ending}_ns" for ending in ("arrival", "age") for name in PDO_NAMES]
    return list(chosen(trial, [*names, "sync_jitter_ns", "step_duration_ns"]))


def _sync(trial: Trial, setting: TrialSetting) -> tuple[str, Floats] | None:
    """Return SYNC's jitter as recorded, else the intervals between cycles against the period."""
    jitter = known(trial, "sync_jitter_ns")
    if jitter is not None:
        return "sync_jitter_ns", jitter
    if setting.period_ns is None or len(trial.time_ns) < 2:
        return None
    return "interval between SYNCs − period", np.diff(trial.time_ns, prepend=np.nan) - setting.period_ns


def _spread(name: str, column: Floats) -> list[Cell]:
    good = column[np.isfinite(column)] / 1000
    figures = np.quantile(good, (0.0, 0.5, 0.999, 1.0)).tolist() if len(good) else [None] * 4
    return [name.removesuffix("_ns"), *figures, len(column) - len(good)]


def _misses(trial: Trial) -> dict[str, Cell]:
    told: dict[str, Cell] = {"control cycles": len(trial.time_ns), "cycles lost in recording": trial.lost_cycles}
    for name, text in (("missed_inputs", "cycles with missed inputs"), ("missed_outputs", "cycles with missed outputs"),
                       ("held", "cycles that held their targets")):
        column = known(trial, name)
        told[text] = "not recorded" if column is None else int(np.count_nonzero(column > 0))
    return told


def load(page: Page, trial: Trial, frame_bits: FrameBits, bound_percent: float | None) -> None:
    """Add the bus load in steps of 100 ms, by kind of frame; nothing where no bus was recorded."""
    if not len(trial.frames):
        return
    page.section("Bus load")
    frames = trial.frames[trial.frames["flags"] & cdr.ERROR == 0]
    if not len(frames):
        page.text("No CAN frames were recorded.", "note")
        return
    bitrate = _bitrate(trial)
    scale, unit = (1e-3, "kbit/s") if bitrate is None else (100.0 / bitrate, "% of the bus")
    bits, window = frame_bits(frames), (frames["time_ns"] - frames["time_ns"].min()) // WINDOW_NS
    along = seconds(trial, frames["time_ns"].min() + np.arange(int(window.max()) + 1) * WINDOW_NS)
    series = [Series(name, _sum(window, np.where(rows, bits, 0)) * scale, colour, steps=True)
              for name, colour, rows in _kinds(frames["can_id"]) if rows.any()]
    total = Series("all frames", _sum(window, bits) * scale, "#30363f", steps=True, width=1.6)
    bound = [] if bitrate is None or bound_percent is None else [
        Series("computed bound", np.full(len(along), bound_percent), "#b3261e", dash=True)]
    speed = "" if bitrate is None else f" at {bitrate / 1000:g} kbit/s"
    page.text(f"{len(frames)} frames{speed}; bits as sent, with stuffing and interframe space. Error frames are not "
              "counted.", "note")
    page.plot("Load over 100 ms", along, [total, *series, *bound], f"{TIME} (s)", unit, linked=TIME)


def _kinds(can_id: NDArray[np.uint32]) -> list[tuple[str, str, NDArray[np.bool_]]]:
    left, found = np.ones(len(can_id), bool), []
    for name, colour, ranges in KINDS:
        rows = left.copy() if not ranges else np.zeros(len(can_id), bool)
        for first, last in ranges:
            rows |= (can_id >= first) & (can_id <= last)
        left &= ~rows
        found.append((name, colour, rows))
    return found


def _sum(window: NDArray[np.int64], bits: NDArray[np.int64]) -> Floats:
    """Return bit/s by window; unknown in the last of several, which the end of the recording cuts."""
    found = np.bincount(window, bits) * (1e9 / WINDOW_NS)
    if len(found) > 1:
        found[-1] = np.nan
    return np.asarray(found, np.float64)


def _bitrate(trial: Trial) -> int | None:
    text = trial.metadata.get("bitrate", "")
    return int(text) if text.isdecimal() and int(text) else None
