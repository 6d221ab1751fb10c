"""One measured signal of one trial with its errors under three models: reference, session adapted, with effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from physics.laws import Array


@dataclass(frozen=True)
class Compared:
    """A measured signal and its residuals, measured less simulated, in `unit`, each of shape (samples,).

    `output`: name of the signal.  `before`: residual of the reference condition.  `session`: residual with the
    session's constants adapted.  `after`: residual with the effects found, too.  `signals`: other columns at the same
    samples.  `cycle`: number of the gait cycle.
    """

    output: str
    unit: str
    measured: Array
    before: Array
    session: Array
    after: Array
    cycle: NDArray[np.intp]
    signals: Mapping[str, Array]

    def along(self, name: str) -> Array:
        """Return another signal at the same samples; NaN if the trial lacks that signal."""
        return self.signals[name] if name in self.signals else np.full(self.measured.size, np.nan)
