"""One signal of one trial beside two simulations of it: before and with what was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from physics.laws import Array


@dataclass(frozen=True)
class Compared:
    """What was measured of a signal, and what both models leave of it, by sample, shape (samples,), in `unit`.

    `output`: name of the signal.  `signals`: other columns at the same samples.  `cycle`: number of the gait cycle.
    """

    output: str
    unit: str
    measured: Array
    before: Array
    after: Array
    cycle: NDArray[np.intp]
    signals: Mapping[str, Array]

    @property
    def time(self) -> Array:
        """Time of the samples, s."""
        return self.along("time_s")

    def along(self, name: str) -> Array:
        """Return a signal at the same samples; NaN where there is none."""
        return self.signals[name] if name in self.signals else np.full(self.measured.size, np.nan)
