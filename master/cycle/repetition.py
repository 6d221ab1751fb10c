"""Slow faults of a gait trial: END against the desired force, and each gait cycle against the first two.

One compiled step over flat arrays, called once in every control cycle of a gait. It compares and names; END is read
here and reaches no target. Each comparison is made at the same phase of the gait, so that errors of controller and
model that are alike in every cycle cancel out:

    desired  END − desired force, mean over `MEAN_S`, against 0, N;
    first    the same mean against the first gait cycle, N;
    second   the same mean against the second gait cycle, from the third on, N;
    wound    rope position against both cycles, m; errors common to START, END and torque show there alone.

A gait cycle is compared with an earlier one only if desired force and knee angle agree at that phase; without a phase
END is compared with the desired force alone. Rope positions are those beyond the zero that the controller follows. On
a bench without END (NaN) the rope alone is compared.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from master.cycle.inputs import CycleAnnotations, Inputs
from master.cycle.safety import Condition, StopError

DESIRED, FIRST, SECOND, WOUND_FIRST, WOUND_SECOND, COMPARISONS = range(6)
"""Comparisons, in the order of their counts and results; `COMPARISONS` is their number."""

BINS: Final = 1024
"""Number of phases of a gait cycle at which cycles are compared."""
MEAN_S: Final = 0.05
"""Time over which END and the desired force are averaged, s: longer than any noise, a quarter of the fastest pull."""
RING: Final = 64
"""Greatest number of control cycles in the mean."""
PERSIST: Final = 4
"""Consecutive phases beyond a tolerance that make a finding."""
SAME_FORCE_N, SAME_KNEE_RAD = 0.05, 0.01
"""Differences of desired force and knee angle up to which two gait cycles count as alike at a phase."""

TOLERANCES: Final = ((4.0, 0.25), (2.0, 0.055), (1.5, 0.035), (0.8e-3, 10e-6), (0.5e-3, 6e-6))
"""Tolerance of each comparison: N (m for the rope), and for each newton of the desired force's peak.

Healthy trials over own, foreign and family plants, all packaged controllers and periods of 0.8 to 3.0 s stay below all
of them (`python -m benchmarks.supervision --healthy 500`).
Too small: healthy trials stop.  Too large: a slow fault moves END by that much unsaid (`docs/faults.md`)."""
BRISK_S: Final = 1.1
"""Gait period below which gait cycles may differ by more, in proportion to their speed, s.

A controller that learns removes the drive's tracking error after the first gait cycle, which grows with the speed."""

(FILLED, PLACE, SUM, SUM_START, LAST_BIN, LAST_CYCLE, READING, EXPECTED, END_MOVED, START_MOVED, ROPE_MOVED) = range(11)
"""Indices of `s`: number and place of the values in the mean, its sums, the last phase and gait cycle; of the last
comparison that failed, the reading and the expected value, and the departures of END, START (N) and the rope (m)."""
COUNTS = 11
WORST = COUNTS + COMPARISONS
"""The greatest share of its tolerance that each comparison has reached."""
RINGS = WORST + COMPARISONS
STATES = RINGS + 2 * RING
(M_DESIRED, M_KNEE, M_ERROR, M_START, M_ROPE, KEPT) = range(6)
"""Columns of the memory: signals of a gait cycle by phase."""


@njit(inline="always")
def _compare(s: Any, g: Any, which: int, seen: float, expected: float) -> bool:
    share = abs(seen - expected) / g[which]
    s[WORST + which] = max(s[WORST + which], share)
    s[COUNTS + which] = s[COUNTS + which] + 1.0 if share > 1.0 else 0.0
    if s[COUNTS + which] < PERSIST:
        return False
    s[READING], s[EXPECTED] = seen, expected
    return True


@njit(inline="always")
def _against(s: Any, g: Any, row: Any, by_force: int, by_rope: int, rope: float, knee: float, desired: float,
             error: float, start: float) -> int:
    """Compare with one earlier gait cycle's `row`; return the number of the failed comparison, or −1."""
    if abs(row[M_DESIRED] - desired) > SAME_FORCE_N or abs(row[M_KNEE] - knee) > SAME_KNEE_RAD:
        return -1
    found = -1
    if _compare(s, g, by_rope, rope, row[M_ROPE]):
        found = by_rope
    if _compare(s, g, by_force, desired + error, desired + row[M_ERROR]):
        found = by_force
    if found >= 0:
        s[END_MOVED], s[START_MOVED] = error - row[M_ERROR], start - row[M_START]
        s[ROPE_MOVED] = rope - row[M_ROPE]
    return found


@njit(cache=True)
def step(
    s: Any, memory: Any, g: Any, width: int, percent: float, desired: float, cycle: float, rope: float, knee: float,
    start: float, end: float,
) -> int:
    """Compare one control cycle; return the comparison that failed, −1 for none.

    `width`: control cycles in the mean; a `percent` of NaN is no phase.
    """
    if cycle < s[LAST_CYCLE] or (cycle < 0.0 and s[LAST_CYCLE] >= 0.0):
        memory[:] = np.nan
        s[COUNTS:COUNTS + COMPARISONS] = 0.0
    s[LAST_CYCLE] = cycle
    at = int(s[PLACE])
    if s[FILLED] < width:
        s[FILLED] += 1.0
    else:
        s[SUM] -= s[RINGS + at]
        s[SUM_START] -= s[RINGS + RING + at]
    s[RINGS + at], s[RINGS + RING + at] = end - desired, start
    s[SUM] += end - desired
    s[SUM_START] += start
    s[PLACE] = float((at + 1) % width)
    here = -1 if math.isnan(percent) else int(percent * (BINS / 100.0)) % BINS
    if (here >= 0 and here == int(s[LAST_BIN])) or s[FILLED] < width:
        return -1
    s[LAST_BIN] = here
    error, tension = s[SUM] / width, s[SUM_START] / width
    if _compare(s, g, DESIRED, desired + error, desired):
        s[END_MOVED], s[START_MOVED], s[ROPE_MOVED] = error, 0.0, 0.0
        return DESIRED
    if cycle < 0.0 or here < 0:
        return -1
    found = -1
    for older in range(2):
        row = memory[older, here]
        if math.isnan(row[M_DESIRED]):
            row[M_DESIRED], row[M_KNEE], row[M_ERROR] = desired, knee, error
            row[M_START], row[M_ROPE] = tension, rope
            break
        by = _against(s, g, row, FIRST + older, WOUND_FIRST + older, rope, knee, desired, error, tension)
        found = by if found < 0 else found
    return found


class CycleDeparture(NamedTuple):
    """A comparison that failed, N or m, and by how much END, START and the rope departed at that phase."""

    comparison: int
    percent: float
    seen: float
    expected: float
    tolerance: float
    end_n: float
    start_n: float
    rope_m: float


class Repetition:
    """Comparison of a gait trial's cycles; `peak_n` is the peak of its desired force, `period_s` the control period.

    `gait_s`: gait period, s.  `with_rope` False omits rope positions: a joint that is moved by hand never repeats its
    motion. `migration_m`: shift of the rope's zero that is followed from one stride to the next, m; a rope may be off
    by that of two strides, since a stride without a phase is not learnt from.
    """

    def __init__(self, peak_n: float, period_s: float, gait_s: float, *, with_rope: bool = True,
                 migration_m: float = 0.0) -> None:
        self.s = np.zeros(STATES)
        self.s[[LAST_BIN, LAST_CYCLE]] = -1.0
        self.memory = np.full((2, BINS, KEPT), np.nan)
        self.g = np.array([base + share * peak_n for base, share in TOLERANCES])
        self.g[FIRST:] *= max(1.0, BRISK_S / gait_s)
        self.g[[WOUND_FIRST, WOUND_SECOND]] += 2.0 * migration_m
        if not with_rope:
            self.g[[WOUND_FIRST, WOUND_SECOND]] = math.inf
        self._width = min(RING, max(2, round(MEAN_S / period_s)))

    def check(self, inputs: Inputs, annotations: CycleAnnotations) -> CycleDeparture | None:
        """Compare the inputs that a control cycle of the gait answers; the finding, where there is one."""
        if inputs.missing:
            return None
        found = step(
            self.s, self.memory, self.g, self._width,
            annotations.gait_percent if annotations.follows_phase else math.nan, annotations.desired_force_n,
            annotations.cycle, inputs.servo_position_m - annotations.zero_m, inputs.knee_angle_rad,
            inputs.start_n, inputs.end_n)
        if found < 0:
            return None
        s = self.s
        return CycleDeparture(found, annotations.gait_percent, float(s[READING]), float(s[EXPECTED]),
                         float(self.g[found]),
                         float(s[END_MOVED]), float(s[START_MOVED]), float(s[ROPE_MOVED]))

    @property
    def shares(self) -> list[float]:
        """The greatest share of its tolerance that each comparison has reached."""
        return [float(share) for share in self.s[WORST:WORST + COMPARISONS]]


PATH_GAIN: Final = 1.2
"""Ratio START/END of a usual path: scales a departure of END before it is compared with one of START."""
ALIKE_N: Final = 1.5
"""Departure of START from `PATH_GAIN` times that of END, N, up to which both sensors moved alike."""


def stop(found: CycleDeparture) -> StopError:
    """Return the stop that a finding calls for: the suspects by which of END, START and the rope departed."""
    at = f"at {found.percent:.0f} % of the gait"
    if found.comparison == DESIRED:
        return StopError(Condition.IMPLAUSIBLE, "START, END, friction, an encoder, the calibration or the controller: "
                         f"END is {found.seen:.1f} N, desired are {found.expected:.1f} ± {found.tolerance:.1f} N, {at}")
    cycle = "first" if found.comparison in (FIRST, WOUND_FIRST) else "second"
    alike = abs(found.start_n - PATH_GAIN * found.end_n) < ALIKE_N
    if math.isnan(found.end_n):  # a bench without END
        return StopError(Condition.IMPLAUSIBLE, "START, friction, servo encoder, knee encoder, a rope or sheath that "
                         f"slipped, or the controller: START {found.start_n:+.1f} N, rope {1e3 * found.rope_m:+.2f} mm "
                         f"against the {cycle} gait cycle {at}")
    suspects = ("START and END alike, servo encoder, knee encoder, a rope or sheath that slipped, or the controller"
                if alike else "START, END, or friction between them")
    return StopError(Condition.IMPLAUSIBLE, f"{suspects}: END {found.end_n:+.1f} N, START {found.start_n:+.1f} N, rope "
                     f"{1e3 * found.rope_m:+.2f} mm against the {cycle} gait cycle {at}")


def prepare() -> None:
    """Compile the step, or load it from numba's cache, before time matters."""
    Repetition(40.0, 1e-3, BRISK_S).check(Inputs(0, 0, 0.0, 0.0, 0, 0.0, 0.0, 0.0, 0), CycleAnnotations(0.0, 0.0))
