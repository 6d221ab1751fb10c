"""How far the fabric stretches under a force: four laws, each a curved part of unit scale plus a line.

The rule of this file: x(T) = curve·c(T) + linear·T, rising for every T ≥ 0; compiled, pure.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tests.plants.bench import BEND_N, CURVE, KIND, LINEAR, POWER, SOFT

TABLE = 2048
TOP_N = 400.0


@njit
def curved(force, kind, bend_n, power):
    """The curved part at `force`, N: parabola turned to its tangent, exponential, power law, toe."""
    if kind == 0:
        turn = 0.9 * bend_n
        t = min(force, turn)
        return t - 0.5 * t * t / bend_n + (force - t) * (1.0 - turn / bend_n)
    if kind == 1:
        return bend_n * (1.0 - math.exp(-force / bend_n))
    if kind == 2:
        return bend_n / power * ((1.0 + force / bend_n) ** power - 1.0)
    return force / (1.0 + force / bend_n)


@njit
def stretch(force, p):
    """Stretch of the whole fabric, m, at a force, N, without creep; below zero continued along its first slope."""
    if force < 0.0:
        return p[SOFT] * (p[CURVE] + p[LINEAR]) * force
    return p[SOFT] * (p[CURVE] * curved(force, int(p[KIND]), p[BEND_N], p[POWER]) + p[LINEAR] * force)


def table(p: np.ndarray, rope: float, share: float) -> np.ndarray:
    """Tension of an element over its elongation: `TABLE` values at even steps, the last number the step, m.

    `rope`: linear compliance in series, m/N; `share`: of the fabric.
    """
    force = np.concatenate([[0.0], np.geomspace(1e-4, TOP_N, 6000)])
    length = np.array([rope * t + share * stretch(t, p) for t in force])
    step = length[-1] / (TABLE - 1)
    return np.append(np.interp(step * np.arange(TABLE), length, force), step)


@njit
def looked_up(elongation, p, first):
    """(tension, N; stiffness, N/m) of the element whose table begins at `first` of `p`; both 0 where slack."""
    if elongation <= 0.0:
        return 0.0, 0.0
    step = p[first + TABLE]
    place = elongation / step
    i = min(int(place), TABLE - 2)
    slope = p[first + i + 1] - p[first + i]
    return p[first + i] + (place - i) * slope, slope / step
