"""The picture that shows what was found: the strongest relation's residual over the gait, and the loop START over END.

The rule of this file: two plots that carry the verdict; how they are binned is `residuals`' and what is drawn is
measured, or measured less simulated, with nothing smoothed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.compared_signals import Compared
from diagnosis.findings import Findings
from diagnosis.report.headline import strongest
from diagnosis.report.plots import AFTER, BEFORE, MEASURED
from diagnosis.report.residuals import LEAST_IN_BIN, binned, bins_of, joined
from trial.report.page import Page, Series

Array = NDArray[np.float64]
PHASES: Final = (20, 200)
"""Least and most bins of gait phase for the mean cycle."""
GRID: Final = 120
"""Points of END at which the loop is drawn."""
ALONG: Final = (("gait_percent", "gait_percent (%)", "gait phase"), ("time_s", "time_s (s)", "time"))


class MeanResidual(NamedTuple):
    """Mean residual and its root mean square in bins, before and after, of one relation."""

    relation: str
    unit: str
    axis: str
    word: str
    centres: Array
    before: tuple[Array, Array]
    after: tuple[Array, Array]


class ForceLoop(NamedTuple):
    """START over END of the mean gait cycle while the tension rises, or falls: measured, simulated before, after."""

    direction: str
    end_n: Array
    measured: Array
    before: Array
    after: Array


def section(page: Page, found: Findings, sides: Mapping[str, Sequence[Compared]]) -> None:
    """Draw the two; say so where there is nothing to draw."""
    one = residual(found, sides)
    if one is None:
        page.text("No relation was searched, so there is no picture.", "note")
        return
    page.heading(f"The strongest relation, {one.relation}: measured less simulated over {one.word}")
    page.text("Residual: measured less simulated. Thick line: mean in each bin. Band: its root mean square either side "
              "of zero. Before: the simulation as it was; after: with what was found.", "note")
    series = []
    for label, (mean, square), colour in (("before", one.before, BEFORE), ("after", one.after, AFTER)):
        series += [Series(label, -square, colour, high=square, width=0.3), Series(label, mean, colour, width=2.2)]
    page.plot(f"{one.relation}: residual over {one.word}, before and after", one.centres, series, one.axis, one.unit,
              height=280)
    drawn = loops(sides)
    if not drawn:
        return
    page.heading("The loop: START over END")
    page.text("The mean gait cycle, up to its peak and down again. Friction opens the loop, a gain turns it, an offset "
              "shifts it.", "note")
    lines = [Series(f"{which}, {one.direction}", values, colour, width=width, dash=one.direction == "tension falling")
             for one in drawn for which, values, colour, width in (
                 ("measured", one.measured, MEASURED, 4.0), ("before", one.before, BEFORE, 1.2),
                 ("after", one.after, AFTER, 1.2))]
    page.plot("START over END, tension rising and falling", drawn[0].end_n, lines, "tension_end_n (N)", "N", height=300)


def residual(found: Findings, sides: Mapping[str, Sequence[Compared]]) -> MeanResidual | None:
    """Return the strongest relation's residual over gait phase, over time where there is no gait; None without one."""
    best = strongest(found)
    if best is None or not sides.get(best[0]):
        return None
    name, parts = best[0], sides[best[0]]
    for signal, axis, word in ALONG:
        along, before, after = joined(parts, signal)
        if along.size and float(np.ptp(along)) > 0.0:
            bins = bins_of(along.size)
            centres, mean, square = binned(along, before, bins)
            _, mended, left = binned(along, after, bins)
            return MeanResidual(name, parts[0].unit, axis, word, centres, (mean, square), (mended, left))
    return None


def loops(sides: Mapping[str, Sequence[Compared]]) -> list[ForceLoop]:
    """Return both branches of START over END of the mean gait cycle, from what predicts START.

    Up: from the last minimum of END before its peak; down: to the first minimum after it.  [] where there is no gait,
    or END is not known.
    """
    parts = sides.get("friction") or sides.get("tension_start_n", ())
    if not parts:
        return []
    phase, end = (np.concatenate([p.along(name) for p in parts]) for name in ("gait_percent", "tension_end_n"))
    measured = np.concatenate([p.measured for p in parts])
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    if not (np.isfinite(phase).all() and np.isfinite(end).all()) or float(np.ptp(end)) <= 0.0:
        return []
    bins = int(np.clip(phase.size // LEAST_IN_BIN, *PHASES))
    place = np.clip((phase / 100.0 * bins).astype(np.intp), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    full = count > 0
    mean_end, *lines = (np.bincount(place, values, bins)[full] / count[full]
                        for values in (end, measured, measured - before, measured - after))
    grid = np.linspace(float(mean_end.min()), float(mean_end.max()), GRID)
    return [ForceLoop(direction, grid, *(_along(grid, mean_end[branch], line[branch]) for line in lines))
            for direction, branch in _branches(mean_end) if branch.size > 2]


def _branches(end: Array) -> list[tuple[str, NDArray[np.intp]]]:
    """Return the places of the rise to the peak and of the fall from it, each by rising END."""
    peak = int(np.argmax(end))
    first = last = peak
    while first > 0 and end[first - 1] < end[first]:
        first -= 1
    while last < end.size - 1 and end[last + 1] < end[last]:
        last += 1
    return [("tension rising", np.arange(first, peak + 1)), ("tension falling", np.arange(last, peak - 1, -1))]


def _along(grid: Array, end: Array, values: Array) -> Array:
    return np.asarray(np.interp(grid, end, values, left=np.nan, right=np.nan))
