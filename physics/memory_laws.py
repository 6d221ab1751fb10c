"""Laws with memory between measured signals: pre-sliding, play, creep, first-order lag.

The rule of this file: one recursion a function, compiled, arguments in SI, no parameter read from anywhere
but the arguments.  `fresh[k]` is True where sample k does not follow sample k − 1 (a trial's start, a gap):
there the memory starts again.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from physics.laws import Array
from physics.path_laws import presliding

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
