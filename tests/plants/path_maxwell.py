"""Maxwell slip: a massless chain, found at each instant by shooting from END tension back to the drum.

The rule of this file: friction at a node is a sum of parallel elastic-slip cells (stop operators of the slip travel,
return mapping, no differential equation); tension above a node is e^(s·exponent) times that below.  Rate-independent
but for breakaway, grease and creep.  A loose rope is straight and without force: its own drag is not in this method.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tests.plants import bench as b
from tests.plants import mechanics
from tests.plants.bench import (
    AFTER,
    BEFORE,
    CELLS,
    DELTA1,
    DELTA2,
    END,
    FIRST,
    GAMMA,
    LEAD,
    MIDDLE,
    N1,
    N2,
    OLD_X,
    OVER,
    OWN,
    RATIO1,
    RATIO2,
    SHEATH,
    START,
    VISCOUS,
)
from tests.plants.draws import stream
from tests.plants.friction import age, breakaway, exponents, greased, loaded, remembered, softer
from tests.plants.stretch import stretch

SUBSTEP_S = 1e-3
"""Longest step of imposed motion."""
EVERY = 2
"""Steps of the mechanics for one of the path."""
CLOSE_M = 3e-9
SLOPE, NODES = OWN, OWN + 1
"""Places of the state: rope per END tension as last met, m/N; the nodes' numbers."""


def parameters(bench: b.Bench) -> np.ndarray:
    """Common parameters, then the cells' widths (in units of δ) and weights, drawn with the structure."""
    rng = stream("structure cells' widths", bench.serial)
    n = bench.structure.cells
    widths = np.geomspace(rng.uniform(0.25, 0.6), rng.uniform(1.6, 3.5), n)
    weights = rng.uniform(0.5, 1.0, n)
    weights /= weights.sum()
    return np.concatenate([b.pack(bench), widths / (weights @ widths), weights])


def state(bench: b.Bench) -> np.ndarray:
    """At rest and slack: per node travel, speed, new travel; per cell state and new state."""
    nodes = bench.structure.sheath_nodes + bench.structure.fabric_nodes
    return np.zeros(NODES + nodes * (3 + 2 * bench.structure.cells))


def settle(z: np.ndarray, p: np.ndarray, x: float, w: float) -> None:
    """Rope loose at `x`, anchor at `w`, nothing strained."""
    z[:] = 0.0
    n2 = int(p[N2])
    z[NODES + n2 : NODES + n2 + int(p[N1])] = w
    z[OLD_X] = x


@njit
def climb(z, p, i, nodes, travel, force, delta, exponent, ratio, viscous, dt):
    """Tension above node `i` whose slip travel is `travel` and tension below is `force`."""
    cells = int(p[CELLS])
    cell, new = NODES + 3 * nodes + i * cells, NODES + 3 * nodes + (nodes + i) * cells
    moved = travel - z[NODES + i]
    s = 0.0
    for j in range(cells):
        z[new + j] = min(1.0, max(-1.0, z[cell + j] + moved / (delta * p[FIRST + j])))
        s += p[FIRST + cells + j] * z[new + j]
    z[NODES + 2 * nodes + i] = travel
    grip = exponent * loaded(p, force) * breakaway(p, ratio, z[NODES + nodes + i])
    grease = viscous * moved / dt * greased(force)
    return max(0.0, force * math.exp(s * grip) + grease)


@njit
def shoot(z, p, end, w, theta, dt):
    """(rope needed at the drum, START, tension before the knee) for an END tension."""
    n1, n2 = int(p[N1]), int(p[N2])
    nodes, torn = n1 + n2, softer(z, p)
    e1, e2 = exponents(z, p, theta)
    travel, force = p[AFTER] * (torn * stretch(end, p) + z[GAMMA]), end
    for i in range(n2):
        force = climb(z, p, i, nodes, travel, force, p[DELTA2], e2 / n2, p[RATIO2], 0.0, dt)
        travel += p[OVER] / n2 * (torn * stretch(force, p) + z[GAMMA])
    middle = force
    travel += p[BEFORE] * (torn * stretch(force, p) + z[GAMMA]) + w
    for i in range(n2, nodes):
        force = climb(z, p, i, nodes, travel, force, p[DELTA1], e1 / n1, p[RATIO1], p[VISCOUS] / n1, dt)
        travel += p[SHEATH] / n1 * force
    return travel + p[LEAD] * force, force, middle


@njit
def find(z, p, x, w, theta, dt):
    """Set START, MIDDLE and END for rope `x` at the drum: secant, then false position (Illinois)."""
    a = z[END]
    at, start, middle = shoot(z, p, a, w, theta, dt)
    f_a = at - x
    way = -f_a / z[SLOPE] if z[SLOPE] > 0.0 else 0.1
    c, f_c = a, f_a
    while abs(f_c) >= CLOSE_M and f_c * f_a > 0.0:
        if c == 0.0 and f_c > 0.0:
            return False
        a, f_a = c, f_c
        c = max(0.0, a + math.copysign(abs(way) + 1e-5, -f_a))
        at, start, middle = shoot(z, p, c, w, theta, dt)
        f_c = at - x
        way *= 2.0
    end = c
    for _ in range(60):
        if abs(f_c) < CLOSE_M:
            break
        end = c - f_c * (c - a) / (f_c - f_a)
        at, start, middle = shoot(z, p, end, w, theta, dt)
        f = at - x
        if f * f_c < 0.0:
            a, f_a = c, f_c
        else:
            f_a *= 0.5
        c, f_c = end, f
    if abs(end - z[END]) > 1e-6 and f_c != f_a:
        z[SLOPE] = min(0.1, max(1e-6, abs((f_c - f_a) / (c - a)))) if c != a else z[SLOPE]
    z[START], z[MIDDLE], z[END] = start, middle, end
    return True


@njit
def step(z, p, x, w, theta, dt):
    """Move the path by `dt` to rope `x` at the drum and anchor `w`; tensions are in z[START], z[MIDDLE], z[END]."""
    n1, n2 = int(p[N1]), int(p[N2])
    nodes, cells = n1 + n2, int(p[CELLS])
    before = z[END]
    first = NODES + 3 * nodes
    if find(z, p, x, w, theta, dt):
        for i in range(nodes):
            slip = z[NODES + 2 * nodes + i] - z[NODES + i]
            z[NODES + nodes + i] = remembered(p, z[NODES + nodes + i], slip / dt, dt)
            z[NODES + i] = z[NODES + 2 * nodes + i]
        z[first : first + nodes * cells] = z[first + nodes * cells : first + 2 * nodes * cells]
    else:
        shoot(z, p, 0.0, w, theta, dt)
        z[START], z[MIDDLE], z[END] = 0.0, 0.0, 0.0
        for i in range(nodes):
            z[NODES + nodes + i] = remembered(p, z[NODES + nodes + i], (x - z[OLD_X]) / dt, dt)
            z[NODES + i] = z[NODES + 2 * nodes + i]
        z[first : first + nodes * cells] = 0.0
    z[OLD_X] = x
    age(z, p, before, dt)


drive, run = mechanics.loops(step, __name__, EVERY, SUBSTEP_S)
"""`drive(count, …)`: so many steps under held torques; `run(…)`: the path under imposed encoder and knee motion."""
