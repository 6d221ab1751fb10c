"""One measured signal with its errors under three models: reference, session adapted, with effects or terms."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from physics.laws import Array


@dataclass(frozen=True)
class Figures:
    """Figures of one output, in its unit: RMSE on held-out cycles and on held-out trials; gain, %, with 95 % interval.

    `before`: the reference condition's model.  `session`: that with the session's constants adapted.  `after`: with the
    named effects, or with the terms of a law.  The gain is that of `after` over `session`.  `floor`: reference RMSE.
    """

    unit: str
    floor: float | None = None
    rmse_before: float | None = None
    rmse_session: float | None = None
    rmse_after: float | None = None
    holdout_before: float | None = None
    holdout_session: float | None = None
    holdout_after: float | None = None
    gain_percent: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def rmse_last(self) -> float | None:
        """RMSE on held-out cycles with the named effects; without one, with the session adapted."""
        return self.rmse_session if self.rmse_after is None else self.rmse_after

    def as_errors(self) -> dict[str, Any]:
        """Return the three errors on held-out cycles and the gain as JSON values."""
        return {"reference": self.rmse_before, "session": self.rmse_session, "named": self.rmse_after,
                "gain_percent": self.gain_percent, "gain_interval": None if self.low is None else [self.low, self.high]}


@dataclass(frozen=True)
class SignalResiduals:
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
