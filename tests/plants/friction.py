"""What the family's implementations say alike of friction: exponents, load, breakaway, and slow memory.

The rule of this file: how a method *uses* an exponent is its own affair; here is only how large it is.  Compiled, pure.
"""

from __future__ import annotations

import math

from numba import njit

from tests.plants.bench import (
    BEND,
    CREEP,
    CREEP_S,
    DRIFT,
    DRIFT_S,
    E1,
    END,
    GAMMA,
    LOAD,
    LOAD_N,
    MEMORY,
    MIDDLE,
    MU2,
    RISING,
    SPEED,
    TIME,
    TORN,
    WRAP,
    WRAP_SLOPE,
)

GREASE_N = 20.0
"""Tension from which grease drags in full; a loose rope has `loose_viscous` alone."""
TURNED_N = 3.0
"""Change of END tension over which a torn strand's direction turns over, N."""


@njit
def exponents(z, p, theta):
    """(sheath's, fabric's) exponent at the reference load, sliding fast, at a knee angle, rad, and now."""
    scale = max(0.05, 1.0 + p[DRIFT] * z[TIME] / p[DRIFT_S])
    bent = max(0.0, 1.0 + p[BEND] * abs(theta))
    return scale * p[E1] * bent, scale * p[MU2] * max(0.0, p[WRAP] + p[WRAP_SLOPE] * abs(theta))


@njit
def loaded(p, force):
    """Factor of the friction at a tension, N: 1 at the bench's reference, changing by the slope for each 40 N."""
    return max(0.05, 1.0 + p[LOAD] * (force - p[LOAD_N]) / 40.0)


@njit
def greased(tension):
    """Share of the grease's drag at a tension, N: the film is sheared where the rope is pressed to the sheath."""
    return min(1.0, max(0.0, tension) / GREASE_N)


@njit
def breakaway(p, ratio, speed):
    """Factor of the friction at a sliding speed, m/s: `ratio` at rest, 1 when fast."""
    return 1.0 + (ratio - 1.0) * math.exp(-((speed / p[SPEED]) ** 2))


@njit
def remembered(p, old, speed, dt):
    """The sliding speed that friction knows of, m/s, `dt` after it knew `old`."""
    return old + (speed - old) * (1.0 - math.exp(-dt / max(p[MEMORY], 1e-6)))


@njit
def softer(z, p):
    """Factor of the fabric's stretch: more than 1 with a torn strand while the load rises."""
    return 1.0 + p[TORN] * (0.5 + 0.5 * z[RISING])


@njit
def age(z, p, before, dt):
    """Move creep, the load's direction and time on by `dt`, with END tension that was `before`."""
    change = z[END] - before
    z[RISING] += (math.copysign(1.0, change) - z[RISING]) * (1.0 - math.exp(-abs(change) / TURNED_N))
    load = 0.5 * (z[END] + z[MIDDLE])
    z[GAMMA] += (p[CREEP] * load - z[GAMMA]) * (1.0 - math.exp(-dt / p[CREEP_S]))
    z[TIME] += dt
