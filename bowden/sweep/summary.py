"""Figures over the rows of a sweep: of all its trials, by cell of the grid, and of its controllers, which are ranked.

A row is a mapping of a table's columns to cells as text.  Every figure is over the trials that completed.
"""

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from bowden.sweep.sweep_table import lines_of
from parameters import InputError

Rows = Sequence[Mapping[str, Any]]
ERROR, IDLE, JUMP = "true_relative_rmse_percent", "true_max_idle_tension_n", "true_peak_jump_n"
FIGURES: Final = {
    ERROR: "relative RMSE, true END (%)", "relative_rmse_percent": "relative RMSE, END (%)",
    IDLE: "largest true END at idle (N)", JUMP: "jump of true END at the peak (N)", "missed_cycles": "missed cycles",
}
"""Figures that are summarised, in words."""
REPEATED: Final = ("bench.serial", "bench.day", "bench.seed")
"""Axes over which a cell of the grid is repeated: other benches, sessions and noise."""
CONTROLLER, TUNING = "gait.controller", "gait.tuning"


class FigureRange(NamedTuple):
    """Median, least and greatest value of a figure over `trials` trials; `worst_row`: row of the greatest, from 1."""

    trials: int
    median: float
    least: float
    greatest: float
    worst_row: int


def completed(rows: Rows) -> int:
    """Return how many trials completed."""
    return sum(row.get("outcome") == "completed" for row in rows)


def stopped(rows: Rows) -> dict[str, int]:
    """Return how many trials did not complete, by reason."""
    return dict(Counter(str(row.get("stop_reason") or row.get("outcome") or "not run") for row in rows
                        if row.get("outcome") != "completed"))


def known(rows: Rows, figure: str) -> dict[int, float]:
    """Return the values of a figure by number of the row, from 1."""
    values = {number: float(row[figure]) for number, row in enumerate(rows, start=1)
              if row.get("outcome") == "completed" and row.get(figure) not in (None, "")}
    return {number: value for number, value in values.items() if math.isfinite(value)}


def spreads(rows: Rows) -> dict[str, FigureRange]:
    """Return the spread of each of `FIGURES` that some trial has."""
    found = {}
    for figure in FIGURES:
        if values := known(rows, figure):
            worst = max(values, key=lambda number: values[number])
            found[figure] = FigureRange(
                len(values), statistics.median(values.values()), min(values.values()), values[worst], worst)
    return found


def grouped(rows: Rows, name: Callable[[Mapping[str, Any]], Any]) -> dict[Any, list[Mapping[str, Any]]]:
    """Return the rows by the value of `name`, in the order of its first row."""
    members: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        members.setdefault(name(row), []).append(row)
    return members


def cells(rows: Rows, axes: Sequence[str]) -> list[dict[str, Any]]:
    """Return for each cell of the grid its values, trials, medians of the figures, and reasons of stops."""
    names = [name for name in axes if name not in REPEATED and len({str(row.get(name)) for row in rows}) > 1]
    members = grouped(rows if names else (), lambda row: tuple(str(row.get(name, "")) for name in names))
    return [{"cell": dict(zip(names, values, strict=True)), "trials": len(own), "completed": completed(own),
             "median": {name: spread.median for name, spread in spreads(own).items()}, "stopped": stopped(own)}
            for values, own in members.items()]


MOST_CELLS = 200
"""Cells of the grid that a list shows at the most."""


def cell_lines(cells: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line for each of several cells of the grid, and below it why its trials stopped."""
    if len(cells) < 2:
        return
    names = [name for name in FIGURES if any(name in cell["median"] for cell in cells)][:3]
    yield "By cell of the grid" + (f", medians of: {'; '.join(FIGURES[name] for name in names)}" if names else "")
    for cell in cells[:MOST_CELLS]:
        where = ", ".join(f"{name.partition('.')[2]} = {value}" for name, value in cell["cell"].items() if value != "")
        figures = "".join(f", {cell['median'][name]:.2f}" if name in cell["median"] else ", –" for name in names)
        yield f"  {where}: {cell['completed']} of {cell['trials']} completed{figures}"
        yield from (f"    {count} not completed: {reason}" for reason, count in cell["stopped"].items())
    if len(cells) > MOST_CELLS:
        yield f"  and {len(cells) - MOST_CELLS} more cells, in the table."


class RankedController(NamedTuple):
    """One controller: its trials, how many completed, and medians over those (None: none completed).

    `error_percent`: relative RMSE of true END's force, %, with the least and the `worst`; `idle_n`, `jump_n`: largest
    END force while none is desired and jump at the peak, N; `stopped`: how many trials ended by each reason.
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


def ranked_rows(path: Path) -> list[dict[str, str]]:
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
    """Return the controllers of a sweep, the smallest median error first.

    Controllers with a trial that did not complete come last, whatever their error.
    """
    found = []
    for name, own in grouped(rows, name_of).items():
        error, idle, jump = map(spreads(own).get, (ERROR, IDLE, JUMP))
        found.append(RankedController(
            name, len(own), completed(own), error and error.median, error and error.least, error and error.greatest,
            idle and idle.median, jump and jump.median, stopped(own)))
    return sorted(found, key=lambda one: (one.completed < one.trials, math.inf if one.error_percent is None
                                          else one.error_percent, one.controller))


def draw_ranking(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Write a picture (PNG, SVG or PDF by suffix): each trial's error a dot, the median a bar, the best on top."""
    from matplotlib.figure import Figure

    order, members = ranked(rows), grouped(rows, name_of)
    figure: Any = Figure(figsize=(8, 1.2 + 0.6 * len(order)), layout="constrained")
    axes = figure.subplots()
    for place, one in enumerate(order):
        errors = list(known(members[one.controller], ERROR).values())
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
