"""Prior of a fit's parameters: each one's 1σ, and the joint covariance of those identified together.

Reference trials determine sums and ratios of constants better than each constant. A fit may therefore move undetermined
combinations at little cost (friction of cable against fabric, when all pulls were alike), but not the determined ones.
The variance of a parameter is its spread in the bench population plus its identification variance. The covariance of
two parameters is that of their identification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Free:
    """A parameter of a fit: bounds, prior `mean` ± `sigma` (infinite: no prior); `scale`: unit of its steps."""

    name: str
    low: float
    high: float
    mean: float
    sigma: float
    scale: float


@dataclass(frozen=True)
class Prior:
    """Identification covariance (names, names) of the parameters `names`, in the product of their units."""

    names: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    def together(self, free: Sequence[Free]) -> Array:
        """Return the covariance of `free`, all of finite 1σ; off the diagonal it is that of the identification."""
        found = np.diag([f.sigma**2 for f in free])
        place = {name: i for i, name in enumerate(self.names)}
        here = [j for j, f in enumerate(free) if f.name in place]
        there = [place[free[j].name] for j in here]
        apart = self.covariance[np.ix_(there, there)]
        unlearnt = np.maximum(np.diag(apart), np.finfo(float).tiny)
        # a parameter with a prior tighter than its identification shares only this part of its covariance
        share = np.minimum(1.0, np.sqrt(np.diag(found)[here] / unlearnt))
        found[np.ix_(here, here)] += np.outer(share, share) * (apart - np.diag(np.diag(apart)))
        return found

    def precision(self, free: Sequence[Free]) -> Array:
        """Return the precision (free, free) of the prior; rows of parameters without prior are 0."""
        known = [j for j, f in enumerate(free) if np.isfinite(f.sigma)]
        found = np.zeros((len(free), len(free)))
        if known:
            sigma = np.array([free[j].sigma for j in known])
            even = self.together([free[j] for j in known]) / np.outer(sigma, sigma)
            found[np.ix_(known, known)] = np.linalg.inv(even) / np.outer(sigma, sigma)
        return found

    def squares(self, changes: Mapping[str, float]) -> float:
        """Return the squared distance, in 1σ, of joint `changes` of constants, marginal over the others."""
        held = [name for name in changes if name in self.names]
        at = [self.names.index(name) for name in held]
        off = np.array([changes[name] for name in held])
        return float(off @ np.linalg.solve(self.covariance[np.ix_(at, at)], off))

    def expected(self, one: Free, rest: Sequence[Free], values: Values) -> tuple[float, float]:
        """Return mean and 1σ of a parameter, conditional on the parameters `rest` at `values`."""
        rest = [f for f in rest if f.name != one.name and np.isfinite(f.sigma)]
        whole = self.together([one, *rest])
        off = np.array([values[f.name] - f.mean for f in rest])
        share = np.linalg.solve(whole[1:, 1:], whole[1:, 0])
        return one.mean + float(share @ off), float(np.sqrt(max(whole[0, 0] - share @ whole[1:, 0], 0.0)))


NOTHING_TOGETHER: Final = Prior()
"""Prior without covariance between parameters."""
