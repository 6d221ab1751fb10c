"""The picture of a discovered law: residual of a signal against the variable of each term, measured and by the term."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from diagnosis.laws.law_result import Laws
from diagnosis.report.law_section import AXES
from trial.report.words import display_unit

SIGNALS: Final = {"tension_start_n": "START", "tension_end_n": "END", "servo_force_n": "servo force"}


def draw(laws: Laws, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) with one panel for each term."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4 * max(1, len(laws.terms)), 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, max(1, len(laws.terms)), squeeze=False)[0]
    for axes, term, picture in zip(panels, laws.terms, laws.pictures, strict=False):
        axis, si = AXES[picture.variable]
        unit, factor = display_unit(si)
        axes.plot(factor * picture.at, picture.residual, ".", ms=1.5, color="0.75",
                  label="measured less model without the term")
        at, *lines = picture.means()
        for values, colour, name in zip(lines, ("0.25", "tab:blue"), ("its mean", "the term"), strict=True):
            axes.plot(factor * at, values, color=colour, label=name)
        axes.set(xlabel=f"{axis} ({unit})", ylabel=f"{SIGNALS.get(picture.output, picture.output)} ({picture.unit})")
        axes.set_title(term.equation.split(", size")[0], fontsize="medium", wrap=True)
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)
