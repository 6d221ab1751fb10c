"""What a drive's axis does with a set-point and with START's tension as they come over the bus.

The rule of this file: compiled laws over the arrays of `nodes.axis_law`; whether a set-point is taken at all is
decided by whoever calls them.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from numba import njit

from nodes.axis_law import FRESH, TARGET, TENSION, TENSION_AGE_S

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


@njit(cache=True)
def target(s: Any, unit: float, origin: float, raw: int) -> None:
    """Begin the straight line to a new target: `raw` counts of `unit`, m or rad, from `origin`."""
    s[TARGET] = raw * unit + origin
    s[FRESH] = 1.0


@njit(cache=True)
def way(s: Any, unit: float, origin: float, raw: int) -> float:
    """Return how far a new target is from the last one, counts."""
    return float(abs(raw * unit + origin - s[TARGET]) / abs(unit))


@njit(cache=True)
def feel(s: Any, raw: int) -> float:
    """Take a tension, counts of `NEWTON`; return it, N."""
    tension = NEWTON * raw
    s[TENSION] = tension
    s[TENSION_AGE_S] = 0.0
    return tension
