"""Columns recorded at a lower rate than the rows of their table, such as a position at 100 Hz beside a force at 1 kHz.

Such a column has empty cells in most rows. A line between two known values replaces them; a gap in the column's own
clock stays unknown.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STEADY = 1.5
"""Ratio of two steps up to which they count as equal, so that a step between two rates, 2, counts as longer."""


def on_rows(time_s: Floats, values: Floats) -> tuple[Floats, float | None]:
    """Return a column on every row, and the step of its own clock, s.

    The step is None, and the column unchanged, if the column has no steady clock of its own that is slower than the
    rows'.  `time_s` and `values` have one value a row.
    """
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 3 or known.size == values.size or not (np.diff(time_s) > 0.0).all():
        return values, None
    at = time_s[known]
    steps = np.diff(at)
    step = float(np.median(steps))
    if step <= STEADY * float(np.median(np.diff(time_s))) or float(np.quantile(steps, 0.9)) > STEADY * step:
        return values, None
    filled = np.interp(time_s, at, values[known], left=np.nan, right=np.nan)
    after = np.searchsorted(at, time_s)
    early, late = at[np.maximum(after - 1, 0)], at[np.minimum(after, at.size - 1)]
    missed = (late - early > STEADY * step) & (time_s != early) & (time_s != late)
    filled[missed] = np.nan
    return filled, step
