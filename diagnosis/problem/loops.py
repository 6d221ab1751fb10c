"""Constants that a single equation reads (a drive's loop), fitted to it from all corners before other fits.

A loop that is not exactly of second order is fitted equally well by a slow model and by a quick one with dead time.
Neither minimum carries information about the rest of the bench. A bench is identified in the better one. Every fit of a
search starts in it, so that two models never differ by this choice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final

from diagnosis.problem.fit import Problem, solve
from diagnosis.problem.prior import Free

Values = Mapping[str, float]

MOST: Final = 3
"""Most constants that only one equation reads; with more of them the equation is not treated as a loop."""
CORNER: Final = 2.0
"""Distance of the corners from the prior mean, in 1σ."""


def settled(problem: Problem, values: Values, free: Sequence[Free], corners: bool = True) -> dict[str, float]:
    """Return the constants of `free` that one equation alone reads, fitted to it; the others stay at `values`.

    Without `corners` only the minimum around `values` is searched. On an identified bench another minimum carries no
    information.
    """
    found: dict[str, float] = {}
    names = dict.fromkeys(b.relation.name for b in problem.blocks)
    reads = {n: frozenset().union(*(b.uses for b in problem.blocks if b.relation.name == n)) for n in names}
    for name in names:
        others = frozenset().union(*(reads[n] for n in names if n != name))
        own = [f for f in free if f.name in reads[name] - others and math.isfinite(f.sigma)]
        if 0 < len(own) <= MOST:
            alone = problem.only(name)
            ends = [(values[f.name], *((max(f.low, f.mean - CORNER * f.sigma), min(f.high, f.mean + CORNER * f.sigma))
                                      if corners else ())) for f in own]
            best = min((solve(alone, {**values, **dict(zip([f.name for f in own], at, strict=True))}, own)
                        for at in itertools.product(*ends)), key=lambda fit: fit.cost)
            found |= {f.name: best.values[f.name] for f in own}
    return found
