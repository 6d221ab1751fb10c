"""Zero-phase low-pass and decimation for fits that run them thousands of times: coefficients are computed once.

The result equals `scipy.signal.sosfiltfilt` with the same sections to rounding (Gustafsson's initial state of a steady
signal, odd extension), decimated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt_zi

Array = NDArray[np.float64]

ORDER: Final = 4
SHARE: Final = 0.8
"""Cut-off, as a share of half the rate after decimation."""


@njit(inline="always")
def _run(sections: Any, steady: Any, values: Any) -> None:
    """Filter `values` in place by two sections, started in the steady state of the first value."""
    b00, b01, b02, _, a01, a02 = sections[0]
    b10, b11, b12, _, a11, a12 = sections[1]
    first = values[0]
    z00, z01, z10, z11 = steady[0, 0] * first, steady[0, 1] * first, steady[1, 0] * first, steady[1, 1] * first
    for k in range(values.size):
        x = values[k]
        y = b00 * x + z00
        z00 = b01 * x - a01 * y + z01
        z01 = b02 * x - a02 * y
        out = b10 * y + z10
        z10 = b11 * y - a11 * out + z11
        z11 = b12 * y - a12 * out
        values[k] = out


@njit(cache=True)
def _filtered(sections: Any, steady: Any, values: Any, edge: int, stride: int) -> Any:
    n = values.size
    held = np.empty(n + 2 * edge)
    held[edge:edge + n] = values
    for i in range(edge):
        held[edge - 1 - i] = 2.0 * values[0] - values[i + 1]
        held[edge + n + i] = 2.0 * values[n - 1] - values[n - 2 - i]
    _run(sections, steady, held)
    _run(sections, steady, held[::-1])
    return held[edge:edge + n:stride].copy()


@dataclass(frozen=True)
class Thinning:
    """Every `stride`-th sample of a signal behind a zero-phase Butterworth low-pass."""

    stride: int
    sections: Array
    steady: Array
    edge: int

    def __call__(self, values: Array) -> Array:
        """Return `values` thinned; they must be finite, and more than `edge`."""
        thinned: Array = _filtered(self.sections, self.steady, values, self.edge, self.stride)
        return thinned


@cache
def thinning(stride: int) -> Thinning:
    """Return the thinning to every `stride`-th sample."""
    sections = np.ascontiguousarray(butter(ORDER, SHARE / stride, output="sos"))
    return Thinning(stride, sections, sosfilt_zi(sections), 3 * (2 * len(sections) + 1))
