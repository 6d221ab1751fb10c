"""Compiled steps that simulation, inverse and effects share: pre-sliding, Stribeck, load, stretch, capstan.

Each equation of the rope path exists here once, for one node and one sample; the caller chooses the number of nodes
and the unknown to solve for. `s` is a pre-sliding state, −1…1; SI. numba's cache of a caller does not see a change in
this file: `plant.step` keeps a digest of its sources, other callers need their `__pycache__` deleted.
"""

from __future__ import annotations

import math
from typing import Final

from numba import njit

LOAD_N: Final = 40.0
"""Tension at which a friction coefficient is its nominal value."""
LEAST_LOAD: Final = 0.05
TANGENT_FROM: Final = 0.9
"""Share of the turning tension −b/2a of (10) above which the stretch goes on along its tangent."""


@njit(inline="always")
def presliding(s: float, travel: float, distance: float) -> float:
    """Return the pre-sliding state after `travel`, m: ds/dx = (1 − s·sgn v)/δ, integrated exactly.  Source: Dahl."""
    if travel == 0.0:
        return s
    end = 1.0 if travel > 0.0 else -1.0
    return end - (end - s) * math.exp(-abs(travel) / distance)


@njit(inline="always")
def presliding_step(s: float, travel: float) -> float:
    """Return the pre-sliding state after a small `travel`, in units of δ, to first order, as the simulation does; |s| ≤
    1 is kept."""
    dz = min(1.0, max(-1.0, travel))
    return s + dz - s * abs(dz)


@njit(inline="always")
def slowness(v: float, scale: float) -> float:
    """Return e^(−(v/vs)²), 1 at rest and 0 in fast sliding; both per second or both per sample."""
    return math.exp(-((v / scale) ** 2))


@njit(inline="always")
def stribeck(ratio: float, scale: float, v: float) -> float:
    """Return the friction's factor at the sliding speed `v`: 1 + (μs/μc − 1)·e^(−(v/vs)²)."""
    return 1.0 if ratio == 1.0 else 1.0 + (ratio - 1.0) * slowness(v, scale)


@njit(inline="always")
def load_dependence(slope: float, tension: float) -> float:
    """Return the friction's factor at the tension, N: 1 + λ·(T/40 N − 1), at least 0.05."""
    return max(LEAST_LOAD, 1.0 + slope * (tension / LOAD_N - 1.0))


@njit(inline="always")
def capstan(tension: float, exponent: float) -> float:
    """Return the tension before a node, N, of (3) and (7): T·e^(s·μθ); `exponent` has the sign of sliding."""
    return tension * math.exp(exponent)


@njit(inline="always")
def capstan_share(exponent: float) -> float:
    """Return tanh(μθ/2): the friction force of a node over the sum of its tensions, the capstan law as a force."""
    return math.tanh(0.5 * exponent)


@njit(inline="always")
def stretch(force: float, linear: float, bend: float) -> float:
    """Return the stretch of (10) at a tension, m, continued along its tangent from 90 % of the turning point."""
    if bend < 0.0:
        last = -0.5 * TANGENT_FROM * linear / bend
        if force > last:
            return linear * last + bend * last * last + (linear + 2.0 * bend * last) * (force - last)
    return linear * force + bend * force * force


@njit(inline="always")
def stretched(elongation: float, b: float, a4: float, half: float, e_tangent: float, k_tangent: float) -> float:
    """Return the tension, N, of an elongation: inverse of the quadratic stretch.

    `a4` = −4a, `half` = −1/(2a); the tangent from `e_tangent` on.
    """
    bent = (b - math.sqrt(max(0.0, b * b - a4 * min(elongation, e_tangent)))) * half
    return bent + k_tangent * max(0.0, elongation - e_tangent)
