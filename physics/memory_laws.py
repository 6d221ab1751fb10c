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

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@njit(cache=True)
def presliding(position: Array, fresh: Mask, distance: float) -> Array:
    """Return s of ds/dx = (1 − s·sgn v)/δ, −1…1, exact for motion that is monotone between samples.

    `position` m, `distance` δ in m, > 0.  Source: Dahl 1968; DIAGNOSIS catalogue, `presliding`.
    """
    state = np.empty(position.size)
    s = 0.0
    for k in range(position.size):
        if fresh[k]:
            s = 0.0
        else:
            step = position[k] - position[k - 1]
            end = 1.0 if step > 0.0 else -1.0
            s = end + (s - end) * math.exp(-abs(step) / distance)
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
def stretched_force(stretch: float, linear: float, bend: float) -> float:
    """Return F ≥ 0 with bend·F² + linear·F = stretch: (10) about its own zero, up to its turning point.

    `stretch` m, `linear` m/N > 0, `bend` m/N² (negative: stiffer with load).
    """
    if stretch <= 0.0:
        return 0.0
    if abs(bend) < 1e-12:
        return stretch / linear
    root = linear * linear + 4.0 * bend * stretch
    if root <= 0.0:
        return -linear / (2.0 * bend)
    return (math.sqrt(root) - linear) / (2.0 * bend)


@njit(cache=True)
def elastic_force(
    stretch: Array, time: Array, fresh: Mask, linear: float, bend: float, creep: float, creep_time: float
) -> Array:
    """Return the force, N, of (10) at `stretch`, m, less the creep γ̇ = (J·F − γ)/τ; zero where slack.

    `creep` J in m/N (0: none), `creep_time` τ in s.
    """
    force = np.empty(stretch.size)
    gamma = 0.0
    for k in range(stretch.size):
        if fresh[k]:
            gamma = 0.0
        elif creep > 0.0:
            fade = math.exp(-(time[k] - time[k - 1]) / creep_time)
            gamma = gamma * fade + creep * force[k - 1] * (1.0 - fade)
        force[k] = stretched_force(stretch[k] - gamma, linear, bend)
    return force


@njit(cache=True)
def crept(force: Array, time: Array, fresh: Mask, creep: float, creep_time: float) -> Array:
    """Return γ, m, of γ̇ = (J·F − γ)/τ under a measured `force`, N."""
    gamma = np.zeros(force.size)
    for k in range(1, force.size):
        if not fresh[k]:
            fade = math.exp(-(time[k] - time[k - 1]) / creep_time)
            gamma[k] = gamma[k - 1] * fade + creep * force[k - 1] * (1.0 - fade)
    return gamma
