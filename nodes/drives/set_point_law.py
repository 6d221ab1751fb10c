"""Processing of a set-point and of START's tension on arrival from the bus.

Compiled functions over the arrays of `nodes.drives.axis_law`; the caller decides whether a set-point is accepted.
"""

import math
from typing import Any, Final, NamedTuple

from numba import njit

from nodes.drives.axis_law import FRESH, TARGET, TENSION, TENSION_AGE_S

NEWTON: Final = 0.01
"""Newtons per count of the tension objects."""
NO_TENSION: Final = -(1 << 15)
"""Process value of a sensor without a valid measurement."""


KEEPS, FOLLOWS, FEELS = range(3)
"""Effects of a received object in addition to its stored value: none; a new target; a tension."""


class RpdoEffect(NamedTuple):
    """Effect of a received object on the axis.

    `FOLLOWS`: a new target of `unit` (m or rad) per count from `origin`, at most `most` counts. `FEELS`: a tension of
    at most `most` N. Larger values are processed by the drive's own code.
    """

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
