"""The controllers of a sweep, ranked by the error of END's force against the desired one.

A controller whose trials stopped ranks behind every one whose trials completed; a figure is the median over the
trials that completed, the true END's if the sweep has it.
"""

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from bowden.sweep.sweep_table import lines_of
from parameters import InputError

CONTROLLER, TUNING = "gait.controller", "gait.tuning"
ERROR = "true_relative_rmse_percent"
IDLE = "true_max_idle_tension_n"
JUMP = "true_peak_jump_n"


class RankedController(NamedTuple):
    """One controller: its trials, how many completed, and medians over those (None: none completed).

    `error_percent`: relative RMSE of END's force, %, with the least and the `worst`; `idle_n`, `jump_n`: largest END
    force while none is desired and jump at the peak, N; `stopped`: how many trials ended by each reason.
    """

    controller: str
    trials: int
    completed: int
    error_percent: float | None
    least: float | None
    worst: float | None
    idle_n: float | None
    jump_n: float | None
    stopped: Mapping[str, int]


def read(path: Path) -> list[dict[str, str]]:
    """Return the rows of a sweep's table; raises `InputError` for any other file, or if it has one controller only."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the table that bowden sweep --grid controller=… wrote.")
    header, *lines = lines_of(path) or [[]]
    if CONTROLLER not in header or ERROR not in header:
        raise InputError(f"{path}: has no columns {CONTROLLER} and {ERROR}; give the table of a bowden sweep.")
    rows = [dict(zip(header, line, strict=True)) for line in lines if len(line) == len(header)]
    names = {name_of(row) for row in rows}
    if len(names) < 2:
        raise InputError(f"{path}: has trials of {len(names)} controller; sweep several, such as --grid "
                         "controller=paper,extended, or values of its parameters.")
    return rows


def name_of(row: Mapping[str, str]) -> str:
    """Return a row's controller with the values of its own parameters."""
    return f"{row[CONTROLLER]} {row.get(TUNING, '')}".rstrip()


def ranked(rows: Sequence[Mapping[str, str]]) -> list[RankedController]:
    """Return the controllers of a sweep's rows, the best first."""
    names = dict.fromkeys(map(name_of, rows))
    found = [_of(name, [row for row in rows if name_of(row) == name]) for name in names]
    return sorted(found, key=lambda one: (one.completed < one.trials, math.inf if one.error_percent is None
                                          else one.error_percent, one.controller))


def _of(name: str, rows: Sequence[Mapping[str, str]]) -> RankedController:
    done = [row for row in rows if row["outcome"] == "completed"]
    reasons = Counter(row["stop_reason"] or row["outcome"] for row in rows if row["outcome"] != "completed")
    errors, idle, jump = (_known(done, figure) for figure in (ERROR, IDLE, JUMP))
    return RankedController(
        name, len(rows), len(done), _median(errors), min(errors, default=None), max(errors, default=None),
        _median(idle), _median(jump), dict(reasons))


def _median(values: Sequence[float]) -> float | None:
    return statistics.median(values) if values else None


def _known(rows: Sequence[Mapping[str, str]], figure: str) -> list[float]:
    return [float(row[figure]) for row in rows if row.get(figure)]


def draw(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Write a picture (PNG, SVG or PDF by suffix): each trial's error a dot, the median a bar, the best on top."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    order = ranked(rows)
    figure: Any = Figure(figsize=(8, 1.2 + 0.6 * len(order)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for place, one in enumerate(order):
        errors = _known([row for row in rows if name_of(row) == one.controller and row["outcome"] == "completed"],
                        ERROR)
        axes.plot(errors, [place] * len(errors), "o", color="tab:blue", alpha=0.4)
        if one.error_percent is not None:
            axes.plot([one.error_percent] * 2, [place - 0.3, place + 0.3], color="0.15", lw=2.0)
    stops = [f" ({one.trials - one.completed} of {one.trials} stopped)" if one.completed < one.trials else ""
             for one in order]
    axes.set_yticks(range(len(order)), [one.controller + more for one, more in zip(order, stops, strict=True)])
    axes.invert_yaxis()
    axes.set(xlabel="relative RMSE of END's force (%); bar: median over trials", xlim=(0, None))
    axes.grid(alpha=0.3, axis="x")
    figure.savefig(path, dpi=120)
