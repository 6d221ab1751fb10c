"""The picture of a discovered law: residual of a signal against the variable of each term, measured and by the term."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from diagnosis.laws.law_findings import Laws
from physics.laws import Array

AXES: Final[Mapping[str, tuple[str, float]]] = {
    "time_s": ("time (s)", 1.0), "position_m": ("rope position (mm)", 1e3), "speed_m_s": ("rope speed (mm/s)", 1e3),
    "tension_n": ("START tension of the model (N)", 1.0), "knee_rad": ("knee angle (°)", 180.0 / np.pi),
    "phase": ("gait phase (share of a cycle)", 1.0)}
"""Label and factor from SI of each variable that a term may depend on."""
SIGNALS: Final = {"tension_start_n": "START", "tension_end_n": "END", "servo_force_n": "servo force"}
BINS: Final = 40
"""Bins of the variable over which means are drawn: enough for a bump of a twentieth of the range."""


def draw(laws: Laws, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) with one panel for each term."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4 * max(1, len(laws.terms)), 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, max(1, len(laws.terms)), squeeze=False)[0]
    for axes, term, picture in zip(panels, laws.terms, laws.pictures, strict=False):
        label, factor = AXES[picture.variable]
        at = factor * picture.at
        axes.plot(at, picture.residual, ".", ms=1.5, color="0.75", label="measured less model without the term")
        for values, colour, name in ((picture.residual, "0.25", "its mean"), (picture.law, "tab:blue", "the term")):
            axes.plot(*_means(at, values), color=colour, label=name)
        axes.set(xlabel=label, ylabel=f"{SIGNALS.get(picture.output, picture.output)} ({picture.unit})")
        axes.set_title(term.equation.split(", size")[0], fontsize="medium", wrap=True)
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=120)


def _means(at: Array, values: Array) -> tuple[Array, Array]:
    """Return the middles of `BINS` equal parts of the variable's range, and the mean of `values` in each."""
    edges = np.linspace(at.min(), at.max(), BINS + 1)
    part = np.clip(np.digitize(at, edges) - 1, 0, BINS - 1)
    filled: Sequence[int] = [k for k in range(BINS) if np.any(part == k)]
    middles = 0.5 * (edges[1:] + edges[:-1])
    return middles[filled], np.array([values[part == k].mean() for k in filled])
