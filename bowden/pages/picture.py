"""Pictures of a trial: desired, START and END force over time, with the cycles overlaid below; chosen signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.report.plot import Plot, Series, picture, save
from trial.report.sections import BY_PHASE, COLOURS, DASHED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Columns = Mapping[str, NDArray[np.float64]]
LABELS = dict(zip(BY_PHASE, ("START", "END", "desired"), strict=True))


def signals(columns: Columns, units: Mapping[str, str], names: Sequence[str], title: str) -> Figure:
    """Return a figure of signals over time, one axis for each unit; raises `InputError` for an unknown name."""
    chosen = list(names) or [name for name in BY_PHASE if name in columns]
    for name in chosen:
        if name not in columns:
            raise InputError(f"plot: {name} is no signal of this trial; expected any of {', '.join(columns)}.")
    by_unit: dict[str, list[Series]] = {}
    for name in chosen:
        by_unit.setdefault(units[name], []).append(_series(name, name, columns[name], 1.0))
    plots = [Plot("" if number else title, columns["time_s"], series, "time (s)" if number == len(by_unit) - 1 else "",
                  unit) for number, (unit, series) in enumerate(by_unit.items())]
    return picture(plots, (10, 1.2 + 2.6 * max(len(plots), 1)), share_x=True)


def draw(force_paths: Mapping[str, Columns], path: Path) -> None:
    """Write a PNG, SVG or PDF (by suffix) from the `/cycle` columns of each force path of a trial, by title.

    Forces in N, time in s.
    """
    over_time = [Plot(title, columns["time_s"], [_series(name, LABELS[name], columns[name], 1.0) for name in BY_PHASE],
                      "time (s)", "force (N)") for title, columns in force_paths.items()]
    over_phase = [Plot("", (), _cycles(columns), "gait cycle (%)", "force (N)") for columns in force_paths.values()]
    save(picture([*over_time, *over_phase], (10 * len(force_paths), 6.2), columns=len(force_paths)), path)


def _cycles(columns: Columns) -> list[Series]:
    """Return the forces of each gait cycle over its phase."""
    rows = [columns["cycle"] == cycle for cycle in np.unique(columns["cycle"][columns["cycle"] >= 0])]
    return [_series(name, "", columns[name][chosen], 0.7)._replace(x=columns["gait_percent"][chosen])
            for name in BY_PHASE for chosen in rows]


def _series(name: str, label: str, values: NDArray[np.float64], width: float) -> Series:
    return Series(label, values, COLOURS.get(name, ""), width=width, dash=name in DASHED)
