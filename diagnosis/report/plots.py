"""Plots of the page of a diagnosis: measured and simulated signals over time, and residuals along other signals.

A line is broken over a gap in the compared samples.  Bands and means are of all trials together.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar

import numpy as np

from diagnosis.compared_signals import SignalResiduals
from diagnosis.report.residuals import binned, bins_of, by_direction, joined, rms
from trial.report.page import Page, broken
from trial.report.plot import Plot, Series
from trial.report.words import display_unit, words

Modelled = TypeVar("Modelled")
BEFORE, ADAPTED, AFTER, MEASURED = "#c2410c", "#15803d", "#2563eb", "#6b7280"
SIDES: Final = (("gait_percent", "gait phase", "%"), ("tension_start_n", "START", "N"),
                ("knee_angle_rad", "knee angle", "rad"), ("servo_position_m", "rope", "m"), ("time_s", "time", "s"))
"""Signals along which residuals are plotted: name, words, unit."""
MEANING: Final = {
    "tension_start_n": "from rope and knee motion", "tension_end_n": "from rope and knee motion",
    "servo_force_n": "from motion and START"}
"""By output: the inputs of its prediction, in words."""


def models(before: Modelled, after: Modelled, *, named: bool) -> list[tuple[str, Modelled, str]]:
    """Return label, values and colour of each model drawn: the reference condition and, if `named`, the effects."""
    both = [("reference condition", before, BEFORE), ("with what is named", after, AFTER)]
    return both if named else both[:1]


def measured(
    page: Page, sides: Mapping[str, Sequence[SignalResiduals]], title: str, linked: str, *, named: bool,
) -> None:
    """Add plots of each output for the first trial: the whole trial, and its cycle with the largest error.

    `named`: an effect is named, so that the simulation with it is drawn, too.
    """
    page.section(title)
    parts_of = {name: parts for name, parts in sides.items() if parts}
    if not parts_of:
        page.text("No signal was compared.", "note")
        return
    many = max(len(parts) for parts in parts_of.values()) > 1
    page.text("Each signal is simulated from others." + (
        " The first trial is drawn; the figures are of all." if many else ""), "note")
    for name, (first, *_) in parts_of.items():
        whole = np.ones(first.measured.size, dtype=np.bool_)
        loaded = name != "servo_force_n" or np.isfinite(first.along("tension_start_n")).any()
        meaning = MEANING.get(name, "from the others") if loaded else "from motion"
        _drawn(page, f"{words(name)}, simulated {meaning}", first, whole, linked, named)
        _drawn(page, f"{words(name)}: the cycle with the largest error", first, _worst(first),
               f"{linked}, one cycle of {name}", named)


def _worst(one: SignalResiduals) -> np.ndarray[Any, Any]:
    """Return a mask of the samples of the cycle with the largest mean squared residual before the diagnosis."""
    cycle = one.cycle
    squares, counts = np.bincount(cycle, one.before**2), np.bincount(cycle)
    return np.asarray(cycle == int(np.argmax(squares / np.maximum(counts, 1))))


def _drawn(page: Page, title: str, one: SignalResiduals, shown: np.ndarray[Any, Any], linked: str, named: bool) -> None:
    columns, time = [one.measured, one.measured - one.before, one.measured - one.after], one.along("time_s")
    gap = 1.5 * float(np.median(np.diff(time)))  # one sample or more is missing
    time, lines = broken(time[shown], [column[shown] for column in columns], gap)
    drawn = [Series("measured", lines[0], MEASURED, width=2.2, tip=one.output),
             Series("reference condition", lines[1], BEFORE, width=1.0, dash=named, tip=one.output),
             Series("with what is named", lines[2], AFTER, width=1.0, tip=one.output)]
    page.plot(Plot(title, time, drawn if named else drawn[:2], "time (s)", one.unit, linked=linked, height=220))


def residuals(
    page: Page, sides: Mapping[str, Sequence[SignalResiduals]], turning: bool = False, *, named: bool,
) -> None:
    """Add plots of the residual of each output along each recorded signal of `SIDES`.

    `turning`: the position is an angle.  `named`: an effect is named, so that the residual with it is drawn, too.
    """
    page.section("Residuals")
    if not any(sides.values()):
        page.text("No signal was compared.", "note")
        return
    page.text("Measured less simulated. Lines are the mean in each bin, bands its root mean square either side of "
              "zero; what is left after follows no axis where the model has everything.", "note")
    for name, parts in sides.items():
        page.heading(words(name))
        _by_direction(page, parts)
        unit = parts[0].unit
        for signal, word, si in SIDES:
            along, before, after = joined(parts, signal)
            if along.size and float(np.ptp(along)) > 0.0:
                if turning and signal == "servo_position_m":
                    word, si = "angle", "rad"
                shown, factor = display_unit(si)
                centres = factor * binned(along, before, bins_of(along.size))[0]
                page.plot(Plot(f"{words(name)} by {word}", centres, _banded(along, before, after, named),
                          f"{word} ({shown})", unit, linked=f"{signal} bins", height=190))
        _loops(page, name, parts, named)


def _banded(along: np.ndarray[Any, Any], before: np.ndarray[Any, Any], after: np.ndarray[Any, Any], named: bool
            ) -> list[Series]:
    series = []
    for label, residual, colour in models(before, after, named=named):
        _, mean, square = binned(along, residual, bins_of(along.size))
        series += [Series(label, -square, colour, high=square, width=0.3), Series(label, mean, colour, width=1.8)]
    return series


def _by_direction(page: Page, parts: Sequence[SignalResiduals]) -> None:
    masks = by_direction(parts)
    before, after = (np.concatenate([getattr(p, which) for p in parts]) for which in ("before", "after"))
    unit = parts[0].unit
    if masks:
        page.table(("rope", "samples", f"mean, reference ({unit})", "mean, named", f"RMS, reference ({unit})",
                    "RMS, named"), [
            (word, int(mask.sum()), float(before[mask].mean()), float(after[mask].mean()), rms(before[mask]),
             rms(after[mask])) for word, mask in masks.items() if mask.any()])


def _loops(page: Page, name: str, parts: Sequence[SignalResiduals], named: bool) -> None:
    """Add a plot of the mean residual over load, with separate lines for the rope pulled and paid out.

    In this plot friction opens a loop, and a wrong gain gives a slope.
    """
    masks = by_direction(parts)
    load, before, after = joined(parts, "tension_start_n")
    if not masks or load.size != sum(p.measured.size for p in parts) or float(np.ptp(load)) <= 0.0:
        return
    bins, span, series = bins_of(load.size), (float(load.min()), float(load.max())), list[Series]()
    for word, dash in (("pulled", False), ("paid out", True)):
        if not masks[word].any():
            continue
        for label, residual, colour in models(before, after, named=named):
            mean = binned(load[masks[word]], residual[masks[word]], bins, span)[1]
            series.append(Series(f"{word}, {label}", mean, colour, dash=dash))
    centres = binned(load, before, bins)[0]
    page.plot(Plot(f"{words(name)} by START and direction", centres, series, "START (N)", parts[0].unit,
              linked="tension_start_n bins", height=190))
