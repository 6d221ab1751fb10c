"""The picture of a trial: desired, START and END force over time, with the cycles overlaid below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from parameters import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Columns = Mapping[str, NDArray[np.float64]]
TRACES = (("desired_force_n", "desired", "0.15", "--"), ("tension_start_n", "START", "tab:orange", "-"),
          ("tension_end_n", "END", "tab:blue", "-"))


def signals(columns: Columns, units: Mapping[str, str], names: Sequence[str], title: str) -> Figure:
    """Return a figure of signals over time, one axis for each unit; raises `InputError` for an unknown name."""
    from matplotlib.figure import Figure

    chosen = list(names) or [name for name, *_ in TRACES if name in columns]
    for name in chosen:
        if name not in columns:
            raise InputError(f"plot: {name} is no signal of this trial; expected any of {', '.join(columns)}.")
    by_unit: dict[str, list[str]] = {}
    for name in chosen:
        by_unit.setdefault(units[name], []).append(name)
    figure = Figure(figsize=(10, 1.2 + 2.6 * max(len(by_unit), 1)), layout="constrained")
    drawn = figure.subplots(max(len(by_unit), 1), 1, sharex=True, squeeze=False)[:, 0]
    colours = {name: (colour, style) for name, _, colour, style in TRACES}
    for axes, (unit, group) in zip(drawn, by_unit.items(), strict=False):
        for name in group:
            colour, style = colours.get(name, (None, "-"))
            axes.plot(columns["time_s"], columns[name], style, color=colour, lw=1.0, label=name)
        axes.set_ylabel(unit)
        axes.legend(loc="upper right")
        axes.grid(alpha=0.3)
    drawn[0].set_title(title)
    drawn[-1].set_xlabel("time (s)")
    return figure


def draw(force_paths: Mapping[str, Columns], path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) from the `/cycle` columns of each force path of a trial, by title.

    Forces in N, time in s.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10 * len(force_paths), 6.2), layout="constrained")
    axes = figure.subplots(2, len(force_paths), squeeze=False)
    for (title, columns), (over_time, over_phase) in zip(force_paths.items(), axes.T, strict=True):
        _draw_path(over_time, over_phase, columns, title)
    figure.savefig(path, dpi=120)


def _draw_path(over_time: Axes, over_phase: Axes, columns: Columns, title: str) -> None:
    """Draw the forces of one force path over time, and its cycles over each other."""
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
