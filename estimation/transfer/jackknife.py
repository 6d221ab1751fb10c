"""Uncertainty of an estimate, from leaving out one part of the data at a time (delete-one jackknife; Efron, 1982).

Pure functions; complete laps of an experiment are left out, since samples of one lap are not independent.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from physics.calibration import ScalarEvidence

Part = TypeVar("Part")


class LineFit(NamedTuple):
    """A fit as the paper makes it: coefficients, highest power first, R², and half of each one's 95 % interval."""

    coefficients: tuple[float, ...]
    r_squared: float
    half: tuple[float, ...]

    @property
    def evidence(self) -> tuple[ScalarEvidence, ...]:
        """Return the evidence of each coefficient."""
        return tuple(ScalarEvidence(value - half, value + half, self.r_squared)
                     for value, half in zip(self.coefficients, self.half, strict=True))


class MeasuredScalar(NamedTuple):
    """A scalar and half of its 95 % interval."""

    value: float
    half: float

    @property
    def evidence(self) -> ScalarEvidence:
        """Return the evidence of the value."""
        return ScalarEvidence(self.value - self.half, self.value + self.half)


def half_width(parts: Sequence[Part], estimate: Callable[[list[Part]], Any]) -> NDArray[np.float64]:
    """Return half of the 95 % interval of `estimate`, in its unit and shape; NaN for fewer than two parts.

    `estimate` takes a list of parts and gives a number or an array of them.
    """
    count = len(parts)
    if count < 2:
        return np.full(np.shape(estimate(list(parts))), np.nan)
    others = np.array([estimate([*parts[:i], *parts[i + 1:]]) for i in range(count)], dtype=np.float64)
    spread = ((others - others.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(t.ppf(0.975, count - 1) * np.sqrt((count - 1) / count * spread))
