"""Acceptance of received values: finite, within the node's range, and no faster than anything can move.

An impossible value is not used and not repaired: its cycle counts as one without that input. A node that sends such
values for `ENOUGH` cycles in a row contradicts its earlier values, and the trial stops.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from master.settings import Limits

ENOUGH: Final = 5
"""Refused values in a row that stop.  Fewer: a burst of disturbed frames stops.  More: the rope is pulled blindly."""
SPAN_N: Final = 230.0
"""Range of the tension sensors, N, with a margin for their offset."""
TENSION_STEP_N: Final = 25.0
TENSION_RATE_N_S: Final = 30_000.0
"""Rate of the stiffest path (27 N/mm, stuck) at the drum's greatest speed, plus a tenth."""
REACH_M: Final = 1.0
"""Rope on the drum; the drive's own position limits are a fifth of it."""
POSITION_STEP_M: Final = 1e-3
KNEE_REACH_RAD: Final = 3.2
KNEE_STEP_RAD: Final = 0.03
NEW: Final = [0, 0, 0, 0]
"""Ages of the last values, in cycles, if all of them were accepted in the cycle before."""


class Bounds(NamedTuple):
    """Bounds of one input: range, and largest change since the last value, `step` + `rate` for each cycle since."""

    column: int
    unit: str
    low: float
    high: float
    step: float
    rate: float


class Reception:
    """Acceptance of the decoded values of servo, knee, START and END (0 … 3), in that order."""

    def __init__(self, period_s: float, limits: Limits) -> None:
        tension = Bounds(0, "N", -SPAN_N, SPAN_N, TENSION_STEP_N, TENSION_RATE_N_S * period_s)
        self.bounds = (
            Bounds(1, "m", -REACH_M, REACH_M, POSITION_STEP_M, limits.rope_m_s * period_s),
            # the drive permits 12.5 % more than the limit: a leg that fast is out of bounds, its angle is right
            Bounds(1, "rad", -KNEE_REACH_RAD, KNEE_REACH_RAD, KNEE_STEP_RAD, limits.knee_rad_s * 1.15 * period_s),
            tension, tension)
        self.refused = [0, 0, 0, 0]
        self._last = [math.nan] * 4
        self._age = [0] * 4
        self._wrong = [math.nan] * 4
        self._fast = tuple((b.column, b.low, b.high, b.step, b.rate) for b in self.bounds)
        self._greatest = [b.step + b.rate for b in self.bounds]

    def takes_all(self, servo: float, knee: float, start: float, end: float) -> bool:
        """Accept one cycle's four values in one call, in place of `begin` and `accepts`; False, and no change, if that
        is impossible.

        That is so if a value of the last cycle or of this one is refused: the values are then accepted one by one.
        """
        a, b, c, d = self._last
        most = self._greatest
        if (self._age == NEW and -REACH_M <= servo <= REACH_M and -KNEE_REACH_RAD <= knee <= KNEE_REACH_RAD
                and -SPAN_N <= start <= SPAN_N and -SPAN_N <= end <= SPAN_N
                and -most[0] <= servo - a <= most[0] and -most[1] <= knee - b <= most[1]
                and -most[2] <= start - c <= most[2] and -most[3] <= end - d <= most[3]):
            self._last = [servo, knee, start, end]
            return True
        return False

    def begin(self) -> None:
        """Begin a cycle: the age of every last value increases by one."""
        self._age = [cycles + 1 for cycles in self._age]

    def accepts(self, i: int, values: Sequence[float], anew: bool) -> bool:
        """Return whether these values pass the check; `anew`: the encoder may count from another zero than before."""
        column, low, high, step, rate = self._fast[i]
        value, last = values[column], self._last[i]
        near = anew or last != last or abs(value - last) <= step + rate * self._age[i]
        if not (low <= value <= high and near):
            self.refused[i] += 1
            self._wrong[i] = value
            return False
        self._last[i], self._age[i] = value, 0
        self.refused[i] = 0
        return True

    def refusal(self, i: int) -> str:
        """Return the last refused value, and its limits."""
        bounds, wrong = self.bounds[i], self._wrong[i]
        scale, unit = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "degrees")}.get(bounds.unit, (1.0, bounds.unit))
        if not bounds.low <= wrong <= bounds.high:
            return f"{scale * wrong:.6g} {unit} is outside {scale * bounds.low:.4g} … {scale * bounds.high:.4g} {unit}"
        return f"{scale * wrong:.5g} {unit} right after {scale * self._last[i]:.5g} {unit}"
