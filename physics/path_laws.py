"""Compiled equations of the rope path that simulation, inverse and effects share, each once.

Steps are for one node and one sample; the caller chooses the number of nodes and the unknown to solve for. `s` is a
pre-sliding state, −1…1; SI. `slipped` and those after it run over measured signals: `fresh[k]` is True where sample k
does not follow sample k − 1 (a trial's start, a gap); there the memory starts again. numba's cache of a caller does not
see a change in this file: `plant.step` keeps a digest of its sources, other callers need their `__pycache__` deleted.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from physics.laws import Array

LOAD_N: Final = 40.0
"""Tension at which a friction coefficient is its nominal value."""
LEAST_LOAD: Final = 0.05
TANGENT_FROM: Final = 0.9
"""Share of the turning tension −b/2a of (10) above which the stretch goes on along its tangent."""


@njit(inline="always")
def presliding(s: float, travel: float, distance: float) -> float:
    """Return Dahl's pre-sliding state s, −1 … 1 of the friction force, after `travel`, m.

    The exact solution of ds/dx = (1 − s·sgn v)/δ with δ = `distance`, m.
    """
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
def stretched(elongation: float, b: float, a4: float, half: float, e_tangent: float, k_tangent: float) -> float:
    """Return the tension, N, of an elongation: inverse of the quadratic stretch.

    `a4` = −4a, `half` = −1/(2a); the tangent from `e_tangent` on.
    """
    bent = (b - math.sqrt(max(0.0, b * b - a4 * min(elongation, e_tangent)))) * half
    return bent + k_tangent * max(0.0, elongation - e_tangent)


Mask = NDArray[np.bool_]


@njit(cache=True)
def slipped(position: Array, fresh: Mask, distance: float) -> Array:
    """Return s of ds/dx = (1 − s·sgn v)/δ, −1…1, exact for motion that is monotone between samples.

    `position` m, `distance` δ in m, > 0.  Source: Dahl 1968; DIAGNOSIS catalogue, `presliding`.
    """
    state = np.empty(position.size)
    s = 0.0
    for k in range(position.size):
        s = 0.0 if fresh[k] else presliding(s, position[k] - position[k - 1], distance)
        state[k] = s
    return state


@njit(cache=True)
def play(angle: Array, fresh: Mask, width: float) -> Array:
    """Return the output of a dead band of total `width` driven by `angle`: it rests until one flank carries it."""
    out = np.empty(angle.size)
    half = 0.5 * width
    held = 0.0
    for k in range(angle.size):
        held = angle[k] if fresh[k] else min(max(held, angle[k] - half), angle[k] + half)
        out[k] = held
    return out


@njit(cache=True)
def lag(signal: Array, time: Array, fresh: Mask, constant: float) -> Array:
    """Return `signal` behind a first-order low-pass of time `constant`, s, its input linear between samples."""
    out = np.empty(signal.size)
    y = 0.0
    for k in range(signal.size):
        if fresh[k] or constant <= 0.0:
            y = signal[k]
        else:
            step = time[k] - time[k - 1]
            fade = math.exp(-step / constant)
            slope = (signal[k] - signal[k - 1]) / step
            y = signal[k] - slope * constant + (y - signal[k - 1] + slope * constant) * fade
        out[k] = y
    return out


@njit(cache=True)
def crept(force: Array, time: Array, fresh: Mask, creep: float, creep_time: float) -> Array:
    """Return γ, m, of γ̇ = (J·F − γ)/τ under a measured `force`, N."""
    gamma = np.zeros(force.size)
    for k in range(1, force.size):
        if not fresh[k]:
            fade = math.exp(-(time[k] - time[k - 1]) / creep_time)
            gamma[k] = gamma[k - 1] * fade + creep * force[k - 1] * (1.0 - fade)
    return gamma
