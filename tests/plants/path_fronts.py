"""Slip fronts: a finely divided sheath and strap that stick and slip, solved for displacements at each instant.

The rule of this file: a node sticks elastically up to the capstan's limit and then slips at it, so that a reversal
runs along the sheath as a front; all nodes are found at once by Newton's method on a tridiagonal system.  No mass; a
loose rope lies with its own weight in the sheath.
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
    DELTA1,
    DELTA2,
    END,
    FIRST,
    GAMMA,
    GRAVITY,
    LEAD,
    LIGHT,
    LOOSE,
    MASS,
    MIDDLE,
    N1,
    N2,
    OLD_W,
    OVER,
    OWN,
    RATIO1,
    RATIO2,
    SHEATH,
    START,
    VISCOUS,
)
from tests.plants.friction import age, breakaway, exponents, greased, loaded, remembered, softer
from tests.plants.stretch import TABLE, looked_up, table

SUBSTEP_S = 0.5e-3
EVERY = 2
"""Steps of the mechanics for one of the path."""
TABLES = FIRST, FIRST + TABLE + 1, FIRST + 2 * (TABLE + 1)
CLOSE_M = 1e-9
MOST, WHOLE = 480, 60
"""Newton's steps at most, and how many are taken whole, halved, halved again: what goes to and fro over a kink ends."""
ROWS = 10
"""Numbers kept for each node: position, stick state, remembered speed, grip, new stick state, force, three diagonals,
new position."""


def parameters(bench: b.Bench) -> np.ndarray:
    """Common parameters, then tables of the fabric before, on and behind the knee."""
    p = b.pack(bench)
    return np.concatenate(
        [p, *(table(p, 0.0, share) for share in (p[BEFORE], p[OVER] / (bench.structure.fabric_nodes - 1), p[AFTER]))])


def state(bench: b.Bench) -> np.ndarray:
    """At rest and slack; see `ROWS`, then tension and stiffness of each element."""
    nodes = bench.structure.sheath_nodes + bench.structure.fabric_nodes
    return np.zeros(OWN + ROWS * nodes + 2 * (nodes + 1))


def settle(z: np.ndarray, p: np.ndarray, x: float, w: float) -> None:
    """Rope loose at `x`, anchor at `w`, nothing strained."""
    del x
    z[:] = 0.0
    z[OWN : OWN + int(p[N1] + p[N2])] = w
    z[OLD_W] = w


@njit
def pull(z, p, x, w, nodes, torn):
    """Set tension and stiffness of every element for the tried positions."""
    n1 = int(p[N1])
    q, t = OWN + 9 * nodes, OWN + ROWS * nodes
    k_lead, k = 1.0 / p[LEAD], (n1 - 1) / p[SHEATH]
    for e in range(nodes + 1):
        above = x if e == 0 else z[q + e - 1]
        below = w if e == nodes else z[q + e]
        if e < n1:
            stiff = (k_lead if e == 0 else k) if above > below else 0.0
            z[t + e], z[t + nodes + 1 + e] = stiff * (above - below), stiff
        else:
            place = 0 if e == n1 else 2 if e == nodes else 1
            share = p[BEFORE] if e == n1 else p[AFTER] if e == nodes else p[OVER] / (nodes - n1 - 1)
            force, stiff = looked_up((above - below - share * z[GAMMA]) / torn, p, TABLES[place])
            z[t + e], z[t + nodes + 1 + e] = force, stiff / torn


@njit
def unbalanced(z, p, moved_w, nodes, dt):
    """Set the force on every node and its derivatives by the positions; return the largest, N."""
    n1 = int(p[N1])
    t = OWN + ROWS * nodes
    worst = 0.0
    for i in range(nodes):
        sheathed = i < n1
        delta = p[DELTA1] if sheathed else p[DELTA2]
        slip = z[OWN + 9 * nodes + i] - z[OWN + i] - (0.0 if sheathed else moved_w)
        s = z[OWN + nodes + i] + slip / delta
        sticks = 1.0 if abs(s) < 1.0 else 0.0
        s = min(1.0, max(-1.0, s))
        z[OWN + 4 * nodes + i] = s
        half = 0.5 * z[OWN + 3 * nodes + i]
        low, high = math.exp(-s * half), math.exp(s * half)
        up, down = z[t + i], z[t + i + 1]
        k_up, k_down = z[t + nodes + 1 + i], z[t + nodes + 2 + i]
        weight = p[LOOSE] * GRAVITY * p[MASS] / nodes
        drag = p[LIGHT] / nodes + (p[VISCOUS] / n1 * greased(0.5 * (up + down)) if sheathed else 0.0)
        force = up * low - down * high - s * weight - drag * slip / dt
        z[OWN + 5 * nodes + i] = force
        z[OWN + 6 * nodes + i] = k_up * low
        z[OWN + 7 * nodes + i] = -k_up * low - k_down * high - sticks / delta * (
            half * (up * low + down * high) + weight) - drag / dt
        z[OWN + 8 * nodes + i] = k_down * high
        worst = max(worst, abs(force))
    return worst


@njit
def correct(z, nodes, share):
    """Solve the tridiagonal system (Thomas), move the tried positions by a share of it; return the largest move, m."""
    r, a, d, c, q = OWN + 5 * nodes, OWN + 6 * nodes, OWN + 7 * nodes, OWN + 8 * nodes, OWN + 9 * nodes
    for i in range(1, nodes):
        f = z[a + i] / z[d + i - 1]
        z[d + i] -= f * z[c + i - 1]
        z[r + i] -= f * z[r + i - 1]
    far, move = 0.0, 0.0
    for i in range(nodes - 1, -1, -1):
        move = (z[r + i] - (z[c + i] * move if i < nodes - 1 else 0.0)) / z[d + i]
        z[q + i] -= share * move
        far = max(far, abs(move))
    return far


@njit
def grip(z, p, theta, nodes):
    """Set the limit of every node, as an exponent."""
    n1, n2 = int(p[N1]), int(p[N2])
    e1, e2 = exponents(z, p, theta)
    t = OWN + ROWS * nodes
    for i in range(nodes):
        exponent, ratio = (e1 / n1, p[RATIO1]) if i < n1 else (e2 / n2, p[RATIO2])
        z[OWN + 3 * nodes + i] = exponent * loaded(p, 0.5 * (z[t + i] + z[t + i + 1])) * breakaway(
            p, ratio, z[OWN + 2 * nodes + i])


@njit
def step(z, p, x, w, theta, dt):
    """Move the path by `dt` to rope `x` at the drum and anchor `w`."""
    n1 = int(p[N1])
    nodes = n1 + int(p[N2])
    before, torn, moved_w = z[END], softer(z, p), w - z[OLD_W]
    grip(z, p, theta, nodes)
    for i in range(nodes):
        z[OWN + 9 * nodes + i] = z[OWN + i]
    for k in range(MOST):
        pull(z, p, x, w, nodes, torn)
        unbalanced(z, p, moved_w, nodes, dt)
        if correct(z, nodes, 0.5 ** (k // WHOLE)) < CLOSE_M:
            break
    pull(z, p, x, w, nodes, torn)
    unbalanced(z, p, moved_w, nodes, dt)
    for i in range(nodes):
        slip = z[OWN + 9 * nodes + i] - z[OWN + i] - (0.0 if i < n1 else moved_w)
        z[OWN + 2 * nodes + i] = remembered(p, z[OWN + 2 * nodes + i], slip / dt, dt)
        z[OWN + i], z[OWN + nodes + i] = z[OWN + 9 * nodes + i], z[OWN + 4 * nodes + i]
    t = OWN + ROWS * nodes
    z[START], z[MIDDLE], z[END], z[OLD_W] = z[t], z[t + n1], z[t + nodes], w
    age(z, p, before, dt)


drive, run = mechanics.loops(step, __name__, EVERY, SUBSTEP_S)
"""`drive(count, …)`: so many steps under held torques; `run(…)`: the path under imposed encoder and knee motion."""
