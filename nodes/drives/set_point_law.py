"""What a drive's axis does with a set-point and with START's tension as they come over the bus.

The rule of this file: compiled laws over the arrays of `nodes.drives.axis_law`; whether a set-point is taken at all is
decided by whoever calls them.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from numba import njit

from nodes.drives.axis_law import FRESH, TARGET, TENSION, TENSION_AGE_S

NEWTON: Final = 0.01
"""Newton per count of the tension objects."""
NO_TENSION: Final = -(1 << 15)
"""What a sensor without a valid value sends."""


KEEPS, FOLLOWS, FEELS = range(3)
"""What taking an object does besides keeping its value: nothing; a new target; a tension."""


class Taker(NamedTuple):
    """What taking an object does, and where that ends: `FOLLOWS` by `unit` from `origin` over at most `most` counts;
    `FEELS` up to `most` N.  Beyond, more happens than that."""

    action: int
    unit: float = 0.0
    origin: float = 0.0
    most: float = math.inf


def _compile(slots: int) -> tuple[Any, Any, Any]:
    @njit(cache=True)
    def target(s: Any, unit: float, origin: float, raw: int) -> None:
        _ = slots
        s[TARGET] = raw * unit + origin
        s[FRESH] = 1.0

    @njit(cache=True)
    def way(s: Any, unit: float, origin: float, raw: int) -> float:
        _ = slots
        return float(abs(raw * unit + origin - s[TARGET]) / abs(unit))

    @njit(cache=True)
    def feel(s: Any, raw: int) -> float:
        _ = slots
        tension = NEWTON * raw
        s[TENSION] = tension
        s[TENSION_AGE_S] = 0.0
        return tension

    return target, way, feel


target, way, feel = _compile(hash((TARGET, FRESH, TENSION, TENSION_AGE_S)))
"""`target(s, unit, origin, raw)` begins the straight line to a new target, `raw` counts of `unit` (m or rad) from
`origin`; `way(s, unit, origin, raw)` gives how far that is from the last one, counts; `feel(s, raw)` takes a tension,
counts of `NEWTON`, and returns it, N.  Where the slots lie is a constant of the compiled functions: numba's cache does
not see a change in an imported module."""
