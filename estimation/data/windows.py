"""Windows of a long trial, which bound the memory of a diagnosis.

Memory and time of a fit grow with the length of the trial.  Its error does not fall, since the model error and the
scatter between sessions do not average out.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimation.data import table
from estimation.data.table import Table
from physics.laws import Array


class _Windows(NamedTuple):
    """Rows of all windows of a trial, the places among them at which a window but the first begins, and a sentence."""

    rows: NDArray[np.intp]
    seams: NDArray[np.intp]
    sentence: str


def bounded(given: Table, most_s: float = 120.0) -> Table:
    """Return a trial; of one longer than `most_s`, twelve windows that are as long together, spread evenly over it.

    The time between two windows is cut to a second, a gap after which the friction states are unknown again.  A note
    states this.  A trial whose time stamps do not rise, or have fewer than 100 rows a window, is returned whole.
    """
    found = None if given.seams else _windows(given["time_s"], most_s)
    if found is None:
        return given
    return _joined(replace(given, columns={name: values[found.rows] for name, values in given.columns.items()}), found)


def read(path: str | Path, joint: str | None = None, most_s: float = 120.0) -> Table:
    """Return a trial as `table.read` does, `bounded`; the other rows of a long MCAP file are never in memory."""
    chosen: list[_Windows] = []

    def choose(time_s: Array) -> NDArray[np.intp] | None:
        chosen.extend(filter(None, [_windows(time_s, most_s)]))
        return chosen[0].rows if chosen else None

    given = table.read(path, joint, choose)
    return _joined(given, chosen[0]) if chosen else bounded(given, most_s)


def _windows(time_s: Array, most_s: float, count: int = 12) -> _Windows | None:
    """Return the windows of a trial of these time stamps; None for a trial that is used whole."""
    length = most_s / count
    if time_s.size < 100 * count or not time_s[-1] - time_s[0] > most_s:
        return None
    step = np.diff(time_s)
    if not (step > 0.0).all() or np.median(step) > length / 100:
        return None
    span = float(time_s[-1] - time_s[0])
    begins = np.linspace(0.0, span - length, count)
    first = np.searchsorted(time_s, time_s[0] + begins)
    last = np.searchsorted(time_s, time_s[0] + begins + length, side="right")
    rows = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True) if b > a])
    return _Windows(rows, np.flatnonzero(np.diff(rows) > 1) + 1,
                    f"of its {span:.0f} s, {count} windows of {length:.0f} s, spread evenly, were used; times count "
                    "these alone.")


def _joined(given: Table, found: _Windows, seam_s: float = 1.0) -> Table:
    """Return a trial of the rows of its windows alone, the time between two of them cut to `seam_s`."""
    time = given["time_s"].copy()
    for row in found.seams:
        time[row:] -= time[row] - time[row - 1] - seam_s
    note = f"{given.source}: {found.sentence}"
    return replace(given, columns={**given.columns, "time_s": time}, notes=(*given.notes, note),
                   seams=tuple(found.seams.tolist()))
