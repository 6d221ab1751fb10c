"""What is known beforehand of the parameters of a fit: each by its own 1σ, and what of them was only learnt together.

The rule of this file: healthy trials determine sums and ratios of constants better than each of them; what they leave
open (friction of the cable or of the fabric, when all pulls were alike) a fit may move at little cost, and what they
determine it may not, whichever constants share it.  Variance of a parameter: what like benches differ by, and what was
not learnt; covariance of two: what was not learnt alone.
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
    """A parameter of a fit: bounds, and a prior of `mean` ± `sigma` (infinite: nothing known beforehand)."""

    name: str
    low: float
    high: float
    mean: float
    sigma: float
    scale: float


@dataclass(frozen=True)
class Prior:
    """`covariance` (names, names), in the units of both: what was not learnt of the parameters `names`."""

    names: tuple[str, ...] = ()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    def together(self, free: Sequence[Free]) -> Array:
        """Return the covariance of `free`, all of finite 1σ: theirs on the diagonal, what was not learnt beside it."""
        found = np.diag([f.sigma**2 for f in free])
        place = {name: i for i, name in enumerate(self.names)}
        here = [j for j, f in enumerate(free) if f.name in place]
        there = [place[free[j].name] for j in here]
        apart = self.covariance[np.ix_(there, there)]
        unlearnt = np.maximum(np.diag(apart), np.finfo(float).tiny)
        # of a parameter that is known better than it was learnt, only so much hangs together with others
        share = np.minimum(1.0, np.sqrt(np.diag(found)[here] / unlearnt))
        found[np.ix_(here, here)] += np.outer(share, share) * (apart - np.diag(np.diag(apart)))
        return found

    def precision(self, free: Sequence[Free]) -> Array:
        """Return the precision (free, free): zero for what nothing is known of, which says nothing of the rest."""
        known = [j for j, f in enumerate(free) if np.isfinite(f.sigma)]
        found = np.zeros((len(free), len(free)))
        if known:
            sigma = np.array([free[j].sigma for j in known])
            even = self.together([free[j] for j in known]) / np.outer(sigma, sigma)
            found[np.ix_(known, known)] = np.linalg.inv(even) / np.outer(sigma, sigma)
        return found

    def squares(self, changes: Mapping[str, float]) -> float:
        """Return the square of the distance, in 1σ, of joint `changes` of constants, whatever the others do."""
        held = [name for name in changes if name in self.names]
        at = [self.names.index(name) for name in held]
        off = np.array([changes[name] for name in held])
        return float(off @ np.linalg.solve(self.covariance[np.ix_(at, at)], off))

    def expected(self, one: Free, rest: Sequence[Free], values: Values) -> tuple[float, float]:
        """Return mean and 1σ of a parameter where those of `rest` are what `values` have."""
        rest = [f for f in rest if f.name != one.name and np.isfinite(f.sigma)]
        whole = self.together([one, *rest])
        off = np.array([values[f.name] - f.mean for f in rest])
        share = np.linalg.solve(whole[1:, 1:], whole[1:, 0])
        return one.mean + float(share @ off), float(np.sqrt(max(whole[0, 0] - share @ whole[1:, 0], 0.0)))


NOTHING_TOGETHER: Final = Prior()
"""Each parameter by itself."""
