"""The picture of a trial: desired, START and END force over time, with the cycles overlaid below."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.float64]]
TRACES = (("desired_force_n", "desired", "0.15", "--"), ("tension_start_n", "START", "tab:orange", "-"),
          ("tension_end_n", "END", "tab:blue", "-"))


def draw(columns: Columns, title: str, path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) from the `/cycle` columns of one trial; forces in N, time in s."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    over_time, over_phase = figure.subplots(2, 1)
    cycles = columns["cycle"]
    for name, label, colour, style in TRACES:
        over_time.plot(columns["time_s"], columns[name], style, color=colour, lw=1.0, label=label)
        for cycle in np.unique(cycles[cycles >= 0]):
            chosen = cycles == cycle
            over_phase.plot(columns["gait_percent"][chosen], columns[name][chosen], style, color=colour, lw=0.7)
    over_time.set(title=title, xlabel="time (s)", ylabel="force (N)")
    over_phase.set(xlabel="gait cycle (%)", ylabel="force (N)", xlim=(0, 100))
    over_time.legend(loc="upper right", ncols=3)
    for axes in (over_time, over_phase):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
