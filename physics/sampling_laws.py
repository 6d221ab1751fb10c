"""Staleness of values on the wire, and runs of equal values by a converter's quantisation step.

The rule of this file: counts of cycles and probabilities, nothing of signals. A value comes in its own cycle, or, with
probability p, only `most` cycles later or never (`most` infinite); the newest that has come is read.
"""

from typing import Final, NamedTuple

import numpy as np

from physics.laws import Array

COUNTED: Final = 24
"""Largest staleness that is counted separately, in cycles; older values count as this one."""


class Staleness(NamedTuple):
    """Staleness of a signal: the share of values that miss their own cycle, and the largest age of a value, `most`
    cycles."""

    share: float
    most: float


def ages(stale: Staleness) -> Array:
    """Return the probability of each age, 0…`COUNTED` cycles: P(age ≥ n) = pⁿ while n ≤ most, else 0."""
    n = np.arange(COUNTED + 2)
    beyond = np.where(n <= stale.most, stale.share**n.astype(np.float64), 0.0)
    beyond[-1] = 0.0
    return np.asarray(beyond[:-1] - beyond[1:])


def repeats(stale: Staleness, chance: float) -> Array:
    """Return the probability of each run of equal values, 0…`COUNTED`; `chance`: that a fresh value equals the last
    one.

    Once `most` is reached each cycle brings a newer value: P(run ≥ n) = pⁿ − p^(most+1).
    """
    n = np.arange(COUNTED + 2)
    last = stale.share ** (stale.most + 1.0) if np.isfinite(stale.most) else 0.0
    beyond = np.where((n <= stale.most) & (n > 0), stale.share**n.astype(np.float64) - last, n == 0)
    beyond[-1] = 0.0
    own = beyond[:-1] - beyond[1:]
    by_chance = (1.0 - chance) * chance ** n[:-1].astype(np.float64)
    return np.asarray(np.convolve(own, by_chance)[:COUNTED + 1])
