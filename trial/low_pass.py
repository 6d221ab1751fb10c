"""Zero-phase low-pass of the published figures, without SciPy, whose import takes longer than a short trial."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
EDGE = 9
"""Samples by which a signal is continued at both ends, point-symmetric: three times the filter's taps."""


def zero_phase(values: Floats, cutoff_hz: float, rate_hz: float) -> Floats:
    """Return a signal filtered forward and backward by a second-order Butterworth low-pass.

    The signal has more than `EDGE` samples; the bilinear transform keeps the cut-off exact.
    """
    k = math.tan(math.pi * cutoff_hz / rate_hz)
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0, a1, a2 = k * k * norm, 2.0 * (k * k - 1.0) * norm, (1.0 - math.sqrt(2.0) * k + k * k) * norm
    longer = np.concatenate([2.0 * values[0] - values[EDGE:0:-1], values,
                             2.0 * values[-1] - values[-2:-EDGE - 2:-1]])
    return _filtered(_filtered(longer, b0, a1, a2)[::-1].copy(), b0, a1, a2)[::-1][EDGE:-EDGE].copy()


@njit(cache=True)
def _filtered(values: Floats, b0: float, a1: float, a2: float) -> Floats:
    """Return the output of the filter b0·(1 + z⁻¹)²/(1 + a1·z⁻¹ + a2·z⁻²) that was at rest at the first value."""
    first, second = (1.0 - b0) * values[0], (b0 - a2) * values[0]
    made = np.empty_like(values)
    for i in range(values.size):
        x = values[i]
        y = b0 * x + first
        first = 2.0 * b0 * x - a1 * y + second
        second = b0 * x - a2 * y
        made[i] = y
    return made
