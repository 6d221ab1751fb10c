"""Windows of a long trial, which bound the memory of a diagnosis.

Memory and time of a fit grow with the length of the trial.  Its error does not fall, since the model error and the
scatter between sessions do not average out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.data.table import Table


def bounded(given: Table, most_s: float = 120.0, count: int = 12, seam_s: float = 1.0) -> Table:
    """Return a trial; of one longer than `most_s`, `count` windows that are as long together, spread evenly over it.

    The time between two windows is cut to `seam_s`, a gap after which the friction states are unknown again.  A note
    says so.  A trial whose time stamps do not rise, or have fewer than 100 rows a window, is returned whole.
    """
    time, length = given["time_s"], most_s / count
    if given.seams or time.size < 100 * count or not time[-1] - time[0] > most_s:
        return given
    step = np.diff(time)
    if not (step > 0.0).all() or np.median(step) > length / 100:
        return given
    span = float(time[-1] - time[0])
    begins = np.linspace(0.0, span - length, count)
    first = np.searchsorted(time, time[0] + begins)
    last = np.searchsorted(time, time[0] + begins + length, side="right")
    rows = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True) if b > a])
    kept = {name: values[rows] for name, values in given.columns.items()}
    seams = np.flatnonzero(np.diff(rows) > 1) + 1
    for row in seams:
        kept["time_s"][row:] -= kept["time_s"][row] - kept["time_s"][row - 1] - seam_s
    note = (f"{given.source}: of its {span:.0f} s, {count} windows of {length:.0f} s, spread evenly, were used; times "
            "count these alone.")
    return replace(given, columns=kept, notes=(*given.notes, note), seams=tuple(seams.tolist()))
