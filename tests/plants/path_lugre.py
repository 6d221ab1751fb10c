"""LuGre: a chain of masses with bristles, integrated explicitly in steps of 10 µs.

The rule of this file: nothing is solved for; rope and fabric are nodes with mass between springs, each node has one
bristle state, ds/dt = (v − |v|·s/g(v))/δ, whose steady value g(v) carries the breakaway.  A node's mass is its share
of the rope's, and never less than the step can carry.
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
    OLD_X,
    OVER,
    OWN,
    RATIO1,
    RATIO2,
    SHEATH,
    START,
    VISCOUS,
)
from tests.plants.friction import age, breakaway, exponents, greased, loaded, remembered, softer
from tests.plants.stretch import TABLE, TOP_N, looked_up, table

SUBSTEP_S = 10e-6
EVERY = 1
"""Steps of the mechanics for one of the path."""
SLOW = 10
"""Substeps between refreshes of what changes slowly."""
TABLES = FIRST, FIRST + TABLE + 1, FIRST + 2 * (TABLE + 1)
MASSES = FIRST + 3 * (TABLE + 1)
FABRIC_KG = 0.006
DAMPING = 10.0
"""N·s/m of an element."""


def parameters(bench: b.Bench) -> np.ndarray:
    """Common parameters; tables of the fabric before, on and behind the knee; node masses."""
    p = b.pack(bench)
    n1, n2 = bench.structure.sheath_nodes, bench.structure.fabric_nodes
    tables = [table(p, 0.0, share) for share in (p[BEFORE], p[OVER] / (n2 - 1), p[AFTER])]
    reach = [np.diff(t[:TABLE])[: np.searchsorted(t[:TABLE], 0.4 * TOP_N)].max() / t[TABLE] for t in tables]
    stiff = [1.0 / p[LEAD], *[(n1 - 1) / p[SHEATH]] * (n1 - 1), reach[0], *[reach[1]] * (n2 - 1), reach[2]]
    least = 2.0 * (np.array(stiff[:-1]) + np.array(stiff[1:])) * (SUBSTEP_S / 0.8) ** 2
    share = np.array([p[MASS] / n1] * n1 + [FABRIC_KG / n2] * n2)
    return np.concatenate([p, *tables, np.maximum(share, least)])


def state(bench: b.Bench) -> np.ndarray:
    """Per node position, speed, bristle, remembered speed, grip; then tensions of the elements."""
    nodes = bench.structure.sheath_nodes + bench.structure.fabric_nodes
    return np.zeros(OWN + 6 * nodes + 1)


def settle(z: np.ndarray, p: np.ndarray, x: float, w: float) -> None:
    """Rope loose at `x`, anchor at `w`, nothing strained."""
    z[:] = 0.0
    z[OWN : OWN + int(p[N1] + p[N2])] = w
    z[OLD_X], z[OLD_W] = x, w


@njit
def damped(force, rate):
    """Tension with damping, N: never pushing, damped by at most as much."""
    return force + min(force, max(-0.9 * force, DAMPING * rate))


@njit
def pull(z, p, x, vx, w, vw, nodes, torn):
    """Set the tension of every element."""
    n1 = int(p[N1])
    t, v = OWN + 5 * nodes, OWN + nodes
    z[t] = damped(max(0.0, (x - z[OWN]) / p[LEAD]), vx - z[v])
    k = (n1 - 1) / p[SHEATH]
    for i in range(1, n1):
        z[t + i] = damped(max(0.0, k * (z[OWN + i - 1] - z[OWN + i])), z[v + i - 1] - z[v + i])
    for i in range(n1, nodes + 1):
        after, rate = (z[OWN + i], z[v + i]) if i < nodes else (w, vw)
        place = 0 if i == n1 else 2 if i == nodes else 1
        share = p[BEFORE] if i == n1 else p[AFTER] if i == nodes else p[OVER] / (nodes - n1 - 1)
        force, _ = looked_up((z[OWN + i - 1] - after - share * z[GAMMA]) / torn, p, TABLES[place])
        z[t + i] = damped(force, z[v + i - 1] - rate)


@njit
def refresh(z, p, theta, vw, nodes, dt):
    """Set grip and steady bristle state of every node for load and remembered speed, `dt` after the last time."""
    n1, n2 = int(p[N1]), int(p[N2])
    e1, e2 = exponents(z, p, theta)
    t = OWN + 5 * nodes
    for i in range(nodes):
        sheathed = i < n1
        slip = z[OWN + nodes + i] - (0.0 if sheathed else vw)
        z[OWN + 3 * nodes + i] = remembered(p, z[OWN + 3 * nodes + i], slip, dt)
        exponent = (e1 / n1 if sheathed else e2 / n2) * loaded(p, 0.5 * (z[t + i] + z[t + i + 1]))
        z[OWN + 4 * nodes + i] = math.tanh(0.5 * exponent)


@njit
def glide(z, p, vw, nodes, dt):
    """Move every node by `dt`."""
    n1 = int(p[N1])
    t = OWN + 5 * nodes
    for i in range(nodes):
        sheathed = i < n1
        surface = 0.0 if sheathed else vw
        normal = z[t + i] + z[t + i + 1]
        mass = p[MASSES + i]
        s = z[OWN + 2 * nodes + i]
        drag = p[LIGHT] / nodes + (p[VISCOUS] / n1 * greased(0.5 * normal) if sheathed else 0.0)
        rub = s * (z[OWN + 4 * nodes + i] * normal + p[LOOSE] * mass * GRAVITY / (1.0 + normal))
        v = z[OWN + nodes + i] + dt / mass * (
            z[t + i] - z[t + i + 1] - rub - drag * (z[OWN + nodes + i] - surface))
        z[OWN + nodes + i] = v
        z[OWN + i] += dt * v
        slip = v - surface
        steady = breakaway(p, p[RATIO1] if sheathed else p[RATIO2], z[OWN + 3 * nodes + i])
        way = dt * slip / (p[DELTA1] if sheathed else p[DELTA2])
        z[OWN + 2 * nodes + i] = s + (way - abs(way) * s / steady) / (1.0 + abs(way) / steady)


@njit
def step(z, p, x, w, theta, dt):
    """Move the path by `dt` to rope `x` at the drum and anchor `w`, both led there evenly, in substeps."""
    nodes = int(p[N1] + p[N2])
    count = max(1, round(dt / SUBSTEP_S))
    h = dt / count
    vx, vw, x0, w0 = (x - z[OLD_X]) / dt, (w - z[OLD_W]) / dt, z[OLD_X], z[OLD_W]
    before, torn = z[END], softer(z, p)
    for k in range(1, count + 1):
        if (k - 1) % SLOW == 0:
            refresh(z, p, theta, vw, nodes, h * min(SLOW, count - k + 1))
        pull(z, p, x0 + k * h * vx, vx, w0 + k * h * vw, vw, nodes, torn)
        glide(z, p, vw, nodes, h)
    t = OWN + 5 * nodes
    z[START], z[MIDDLE], z[END] = z[t], z[t + int(p[N1])], z[t + nodes]
    z[OLD_X], z[OLD_W] = x, w
    age(z, p, before, dt)


drive, run = mechanics.loops(step, __name__, EVERY, SUBSTEP_S)
"""`drive(count, …)`: so many steps under held torques; `run(…)`: the path under imposed encoder and knee motion."""
