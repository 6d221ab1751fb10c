"""Constants that one relation alone reads, a drive's loop: fitted to it from every corner, before all others.

The rule of this file: a loop that is not quite of second order is followed equally well by a slow one and by a quick
one with a dead time, and neither says anything of the rest of the bench.  A bench is learnt in the better minimum, and
every fit of a search starts in that one, so that two models never differ by it.
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
"""Constants of a relation's own, beyond which it is no loop."""
CORNER: Final = 2.0
"""How far from the mean the corners are, in 1σ."""


def settled(problem: Problem, values: Values, free: Sequence[Free], corners: bool = True) -> dict[str, float]:
    """Return those constants of `free` that one relation alone reads, where they fit it best; the rest is at `values`.

    Without `corners` in the minimum that they are in: where the bench is known, that it is another one says nothing.
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
