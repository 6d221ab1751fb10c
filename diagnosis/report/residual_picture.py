"""The two main plots of a diagnosis: the force loop, and the residual of the output with the largest gain.

The loop is START over END, or force over position where END is not recorded.  Curves are bin means, not smoothed.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.compared_signals import SignalResiduals
from diagnosis.findings import Findings
from diagnosis.report.headline import strongest
from diagnosis.report.plots import ADAPTED, AFTER, BEFORE, MEASURED, models
from diagnosis.report.residuals import binned, bins_of, joined
from trial.report.page import Page
from trial.report.plot import Plot, Series
from trial.report.words import display_unit, words

Array = NDArray[np.float64]
ALONG: Final = (("gait_percent", "%", "gait phase"), ("servo_position_m", "m", "position"), ("time_s", "s", "time"))
"""Signals along which the residual is drawn, the first one that varies: name, unit, word in the title."""
FORCES: Final = ("tension_start_n", "servo_force_n", "tension_end_n")
"""Outputs whose loop is drawn, the first one that was compared."""
REFERENCE, NAMED = "simulated: reference condition", "simulated: with what is named"
SESSION = "simulated: session adapted"
MEASURED_ONLY: Final = " (measured)"
"""End of a signal's words, left out of a loop, which has simulated lines, too."""


class MeanResidual(NamedTuple):
    """Residual of one output in bins: mean and root mean square, `before` and `after`, in `unit`."""

    relation: str
    unit: str
    axis: str
    word: str
    centres: Array
    before: tuple[Array, Array]
    after: tuple[Array, Array]


class ForceLoop(NamedTuple):
    """One branch of START over END of the mean gait cycle, with rising or falling tension, N.

    `measured`, and simulated `before` and `after`: START at the END values `end_n`, simulated START over simulated END.
    """

    direction: str
    end_n: Array
    measured: Array
    before: Array
    after: Array


def section(page: Page, found: Findings, turning: bool = False) -> None:
    """Add the residual of the output with the largest gain, or a note if none was compared."""
    one = residual(found, turning)
    if one is None:
        page.text("No signal was compared, so there is no picture.", "note")
        return
    page.heading(f"Where the simulation misses most: {words(one.relation)} over {one.word}")
    page.text("Measured less simulated. Thick line: mean in each bin. Band: its root mean square either side of zero.",
              "note")
    page.plot(residual_plot(one, named=bool(found.causes)))


def residual_plot(one: MeanResidual, *, named: bool) -> Plot:
    """Return the plot of a residual, before and, if an effect is `named`, after."""
    series = []
    for label, (mean, square), colour in models(one.before, one.after, named=named):
        series += [Series(f"simulated: {label}", -square, colour, high=square, width=0.3, tip=one.relation),
                   Series(f"simulated: {label}", mean, colour, width=2.2, tip=one.relation)]
    return Plot(f"{words(one.relation)}: measured less simulated", one.centres, series, one.axis, one.unit, height=280)


def loop_section(page: Page, found: Findings, turning: bool = False) -> None:
    """Add the loop of the first compared force, if there is one."""
    plot = loop_plot(found, turning)
    if plot is None:
        return
    page.heading(f"The loop: {plot.title}")
    walked = any(_walks(parts) for parts in found.traces.values() if parts)
    page.text("Friction opens the loop, a gain turns it, an offset shifts it."
              + (" The mean gait cycle." if walked else ""), "note")
    page.plot(plot)


def loop_plot(found: Findings, turning: bool = False) -> Plot | None:
    """Return the loop of the first compared force: START over END, else the force over the position."""
    name = next((name for name in FORCES if found.traces.get(name)), next(iter(found.traces), None))
    parts = [] if name is None else found.traces[name]
    if name is None or not parts:
        return None
    over = "tension_end_n" if name == "tension_start_n" and np.isfinite(parts[0].along("tension_end_n")).all() \
        else "servo_position_m"
    x, *lines = _cycle(parts, over)
    if not np.isfinite(x).any() or float(np.ptp(x[np.isfinite(x)])) <= 0.0:
        return None
    shown, factor = display_unit("N" if over == "tension_end_n" else "rad" if turning else "m")
    across, up = ("position" if turning else words(over)).removesuffix(MEASURED_ONLY), words(name).removesuffix(
        MEASURED_ONLY)
    sides = (("measured", MEASURED, 4.5), (REFERENCE, BEFORE, 1.8), (SESSION, ADAPTED, 1.8), (NAMED, AFTER, 1.8))
    ends = _ends(found.traces, parts)
    along = _cycle(ends, over)[1:] if over == "tension_end_n" and ends else [x] * len(lines)
    series = [Series(label, line, colour, width=width, x=factor * own) for (label, colour, width), line, own in zip(
        sides if found.causes else sides[:3], lines, along, strict=False)]
    return Plot(f"{up} over {across}", factor * x, series, f"{across} ({shown})", f"{up} ({parts[0].unit})",
                height=440, loop=True)


def _ends(sides: Mapping[str, Sequence[SignalResiduals]], parts: Sequence[SignalResiduals]
          ) -> Sequence[SignalResiduals]:
    """Return the END residuals of the trials whose START residuals are `parts`; none if their samples differ."""
    ends = sides.get("tension_end_n", ())
    return ends if [p.measured.size for p in ends] == [p.measured.size for p in parts] else ()


def _walks(parts: Sequence[SignalResiduals]) -> bool:
    """Return whether every trial has a gait phase that varies."""
    phase = np.concatenate([p.along("gait_percent") for p in parts])
    return bool(np.isfinite(phase).all()) and float(np.ptp(phase)) > 0.0


def _cycle(parts: Sequence[SignalResiduals], over: str) -> list[Array]:
    """Return a signal, and the measured output and the three simulated ones along it, in the order of time.

    They are means over the gait phase, closed; without a gait, the first two loops of the first trial, by its passages
    of the middle of its range, and 1,500 samples at most.
    """
    if not _walks(parts):
        first = parts[0]
        x = first.along(over)[:1500]
        passed = np.flatnonzero(np.diff(x > 0.5 * (np.nanmin(x) + np.nanmax(x)))) if np.isfinite(x).any() else x[:0]
        end = x.size if passed.size < 5 else int(passed[4]) + 2
        return [values[:end] for values in (first.along(over), *_lines(first))]
    phase, x = (np.concatenate([p.along(name) for p in parts]) for name in ("gait_percent", over))
    lines = map(np.concatenate, zip(*map(_lines, parts), strict=True))
    bins = max(1, min(200, phase.size // 3))
    place = np.clip((phase / 100.0 * bins).astype(np.intp), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    full = count > 0
    means = [np.bincount(place, values, bins)[full] / count[full] for values in (x, *lines)]
    return [np.append(mean, mean[0]) for mean in means]


def _lines(one: SignalResiduals) -> tuple[Array, Array, Array, Array]:
    """Return the measured output, and the simulated ones of the reference, the adapted session and what is named."""
    return one.measured, one.measured - one.before, one.measured - one.session, one.measured - one.after


def residual(found: Findings, turning: bool = False) -> MeanResidual | None:
    """Return the residual of the output with the largest gain, over gait phase, else position or time.

    None if no output was checked or compared.
    """
    best = strongest(found)
    if best is None or not found.traces.get(best[0]):
        return None
    name, parts = best[0], found.traces[best[0]]
    for signal, si, word in ALONG:
        unit, factor = display_unit("rad" if turning and si == "m" else si)
        along, before, after = joined(parts, signal)
        if along.size and float(np.ptp(along)) > 0.0:
            bins = bins_of(along.size)
            centres, mean, square = binned(along, before, bins)
            _, mended, left = binned(along, after, bins)
            return MeanResidual(name, parts[0].unit, f"{word} ({unit})", word, factor * centres, (mean, square),
                                (mended, left))
    return None


def loops(sides: Mapping[str, Sequence[SignalResiduals]]) -> list[ForceLoop]:
    """Return the rising and the falling branch of START over END of the mean gait cycle.

    The rising branch begins at the last minimum of END before its peak, the falling one ends at the first minimum after
    the peak.  [] if no prediction of START was compared, without a gait, and without END.
    """
    parts = sides.get("tension_start_n", ())
    if not parts:
        return []
    phase, end = (np.concatenate([p.along(name) for p in parts]) for name in ("gait_percent", "tension_end_n"))
    if not (np.isfinite(phase).all() and np.isfinite(end).all()) or float(np.ptp(end)) <= 0.0:
        return []
    bins = bins_of(phase.size, 200)
    place = np.clip((phase / 100.0 * bins).astype(np.intp), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    full = count > 0

    def means(of: Sequence[SignalResiduals]) -> list[Array]:
        measured, before, _, after = map(np.concatenate, zip(*map(_lines, of), strict=True))
        return [np.bincount(place, values, bins)[full] / count[full] for values in (measured, before, after)]

    starts, mean_end = means(parts), np.bincount(place, end, bins)[full] / count[full]
    ends = means(compared) if (compared := _ends(sides, parts)) else [mean_end] * len(starts)
    grid = np.linspace(float(mean_end.min()), float(mean_end.max()), 120)
    branches = [dict(_branches(own)) for own in ends]
    return [ForceLoop(direction, grid, *(_along(grid, own[branch[direction]], line[branch[direction]])
                                         for own, line, branch in zip(ends, starts, branches, strict=True)))
            for direction, rows in branches[0].items() if rows.size > 2]


def _branches(end: Array) -> list[tuple[str, NDArray[np.intp]]]:
    """Return the indices of the rise to the peak of END and of the fall from the peak, each in the order of rising END.
    """
    peak = int(np.argmax(end))
    first = last = peak
    while first > 0 and end[first - 1] < end[first]:
        first -= 1
    while last < end.size - 1 and end[last + 1] < end[last]:
        last += 1
    return [("tension rising", np.arange(first, peak + 1)), ("tension falling", np.arange(last, peak - 1, -1))]


def _along(grid: Array, end: Array, values: Array) -> Array:
    return np.asarray(np.interp(grid, end, values, left=np.nan, right=np.nan))
