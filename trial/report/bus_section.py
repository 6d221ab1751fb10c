"""The report's bus: when PDOs came, how old they were, how exact SYNC was, how full the bus was.

The rule of this file: bits are counted by whoever hands in the counter; here they are only summed.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eds import cia301
from trial.mcap_file import cdr
from trial.read import Trial, TrialFile
from trial.report.force_section import TIME, chosen, over_time
from trial.report.overview import COUNTED, INTERVAL, TIMED, Overview, Quantiles, TrialSetting, known, seconds
from trial.report.page import Cell, Page, Series
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
    return [name.removesuffix("_ns"), *(None if one is None else one / 1000 for one in quantiles), found.unknown]


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
    page.plot("Load over 100 ms", along, [total, *series, *bound], f"{TIME} (s)", unit, linked=TIME)


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
