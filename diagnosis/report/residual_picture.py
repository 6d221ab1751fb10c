"""The two main plots of a diagnosis: residual over the gait before and after, and the force loop START over END.

The residual is that of the output with the largest gain.  Curves are bin means; nothing is smoothed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.compared_signals import Compared
from diagnosis.findings import Findings
from diagnosis.report.headline import strongest
from diagnosis.report.plots import AFTER, BEFORE, MEASURED
from diagnosis.report.residuals import binned, bins_of, joined
from trial.report.page import Page, Series

Array = NDArray[np.float64]
ALONG: Final = (("gait_percent", "gait_percent (%)", "gait phase"), ("time_s", "time_s (s)", "time"))


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

    `measured`, and simulated `before` and `after`: START at the END values `end_n`.
    """

    direction: str
    end_n: Array
    measured: Array
    before: Array
    after: Array


def section(page: Page, found: Findings) -> None:
    """Add both plots to the page, or a note if no output was searched."""
    one = residual(found)
    if one is None:
        page.text("No signal was compared, so there is no picture.", "note")
        return
    page.heading(f"The strongest relation, {one.relation}: measured less simulated over {one.word}")
    page.text("Residual: measured less simulated. Thick line: mean in each bin. Band: its root mean square either side "
              "of zero. Before: the reference condition as identified; after: with the named effects.", "note")
    series = []
    for label, (mean, square), colour in (("before", one.before, BEFORE), ("after", one.after, AFTER)):
        series += [Series(label, -square, colour, high=square, width=0.3), Series(label, mean, colour, width=2.2)]
    page.plot(f"{one.relation}: residual over {one.word}, before and after", one.centres, series, one.axis, one.unit,
              height=280)
    drawn = loops(found.traces)
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


def residual(found: Findings) -> MeanResidual | None:
    """Return the residual of the output with the largest gain, over gait phase, else over time.

    None if no output was compared.
    """
    best = strongest(found)
    if best is None or not found.traces.get(best[0]):
        return None
    name, parts = best[0], found.traces[best[0]]
    for signal, axis, word in ALONG:
        along, before, after = joined(parts, signal)
        if along.size and float(np.ptp(along)) > 0.0:
            bins = bins_of(along.size)
            centres, mean, square = binned(along, before, bins)
            _, mended, left = binned(along, after, bins)
            return MeanResidual(name, parts[0].unit, axis, word, centres, (mean, square), (mended, left))
    return None


def loops(sides: Mapping[str, Sequence[Compared]]) -> list[ForceLoop]:
    """Return the rising and the falling branch of START over END of the mean gait cycle.

    The rising branch begins at the last minimum of END before its peak, the falling one ends at the first minimum after
    the peak.  [] if no prediction of START was compared, without a gait, and without END.
    """
    parts = sides.get("tension_start_n", ())
    if not parts:
        return []
    phase, end = (np.concatenate([p.along(name) for p in parts]) for name in ("gait_percent", "tension_end_n"))
    measured = np.concatenate([p.measured for p in parts])
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    if not (np.isfinite(phase).all() and np.isfinite(end).all()) or float(np.ptp(end)) <= 0.0:
        return []
    bins = bins_of(phase.size, 200)
    place = np.clip((phase / 100.0 * bins).astype(np.intp), 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    full = count > 0
    mean_end, *lines = (np.bincount(place, values, bins)[full] / count[full]
                        for values in (end, measured, measured - before, measured - after))
    grid = np.linspace(float(mean_end.min()), float(mean_end.max()), 120)
    return [ForceLoop(direction, grid, *(_along(grid, mean_end[branch], line[branch]) for line in lines))
            for direction, branch in _branches(mean_end) if branch.size > 2]


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
