"""A plot as data, and its picture: what a page draws by uPlot (`Page.plot`), matplotlib draws as PNG, SVG or PDF.

Interface: a caller describes each plot once, as `Plot`: title, axes with their units, and `Series` with label and
style.  `picture` puts several plots into one matplotlib figure; `save` writes a figure to a file or a stream.
matplotlib is imported when a picture is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SEARCHED = 20_000
"""Points of a plot from which on its legend has a fixed place: the search for the best one visits every point."""


class Series(NamedTuple):
    """A line: `values` along the plot's x, NaN where unknown; with `high` the band between the two, filled.

    Series of one label share a legend entry; `tip` is its tooltip, such as the column's name.  `steps` holds each value
    to the next; `points` draws no line.  `x`: of this series alone, in a picture or a loop (None: the plot's).
    `colour` "": the next one of matplotlib's cycle, in a picture.
    """

    label: str
    values: ArrayLike
    colour: str
    high: ArrayLike | None = None
    width: float = 1.3
    dash: bool = False
    steps: bool = False
    points: bool = False
    tip: str = ""
    x: ArrayLike | None = None


class Plot(NamedTuple):
    """Series along `x`, which must not fall unless the plot is a `loop`, such as force over position.

    On a page: plots with the same `linked` zoom together; `marks` are places on x with a dashed line; `height` is in
    CSS pixels.
    """

    title: str
    x: ArrayLike
    series: Sequence[Series]
    x_label: str
    y_label: str
    linked: str | None = None
    marks: Sequence[float] = ()
    height: int = 240
    loop: bool = False


def picture(plots: Sequence[Plot], size: tuple[float, float], *, columns: int = 1, share_x: bool = False) -> Figure:
    """Return a matplotlib figure of `size`, inches, with the plots row by row in `columns`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(max(1, -(-len(plots) // columns)), columns, sharex=share_x, squeeze=False).flat
    for axes, plot in zip(panels, plots, strict=False):
        _draw(axes, plot)
    return figure


def save(figure: Figure, target: Path | IO[bytes], dpi: int = 120) -> None:
    """Write a figure; a path's ending names the format, a stream receives PNG."""
    kind: dict[str, Any] = {} if isinstance(target, Path) else {"format": "png", "metadata": {"Software": None}}
    figure.savefig(target, dpi=dpi, **kind)


def _draw(axes: Any, plot: Plot) -> None:
    lines = {one.label for one in plot.series if one.high is None}
    named = set[str]()
    for one in plot.series:
        x, colour = plot.x if one.x is None else one.x, one.colour or None
        label = "" if one.label in named or (one.high is not None and one.label in lines) else one.label
        named |= {label}
        if one.high is not None:
            axes.fill_between(x, one.values, one.high, color=colour, alpha=0.2, linewidth=0, label=label)
        elif one.points:
            axes.plot(x, one.values, ".", markersize=one.width, color=colour, label=label)
        else:
            axes.plot(x, one.values, "--" if one.dash else "-", linewidth=one.width, color=colour, label=label,
                      drawstyle="steps-post" if one.steps else "default")
    axes.set_title(plot.title, fontsize="medium", wrap=True)
    axes.set(xlabel=plot.x_label, ylabel=plot.y_label)
    axes.grid(alpha=0.3)
    if named - {""}:
        points = sum(np.size(one.values) for one in plot.series)
        axes.legend(fontsize="small", loc="best" if points < MOST_SEARCHED else "upper right")
