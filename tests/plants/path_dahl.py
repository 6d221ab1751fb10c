"""Dahl with two sites: the sheath as one continuous capstan, the knee as another, three springs, implicit time steps.

The rule of this file: each site has one Dahl state that follows the slip in closed form, and closes the capstan over
its whole angle, T_out = T_in·e^(−z·exponent); the rope's mass is at the two sites.  Backward Euler, Newton's method on
the two velocities.  All the elasticity is in three springs: before the sheath's middle, up to the knee, behind it.
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
EVERY = 1
"""Steps of the mechanics for one of the path."""
Q1, Q2, V1, V2, Z1, Z2, U1, U2 = range(OWN, OWN + 8)
"""State: rope at the sheath, fabric at the knee, their speeds, Dahl states, remembered sliding speeds."""
MID, LAST = FIRST, FIRST + TABLE + 1
MOST, WHOLE = 320, 40
"""Newton's steps at most, and how many are taken whole, halved, halved again: what goes to and fro over a kink ends."""
STILL_M_S = 2e-3
"""Speed about which the loose rope's own friction turns over."""


def parameters(bench: b.Bench) -> np.ndarray:
    """Common parameters, then the tables of the springs before and behind the knee."""
    p = b.pack(bench)
    before, over, after = p[BEFORE], p[OVER], p[AFTER]
    return np.concatenate([
        p, table(p, 0.5 * p[SHEATH], before + 0.5 * over), table(p, 0.0, after + 0.5 * over)])


def state(bench: b.Bench) -> np.ndarray:
    """At rest and slack."""
    del bench
    return np.zeros(OWN + 8)


def settle(z: np.ndarray, p: np.ndarray, x: float, w: float) -> None:
    """Rope loose at `x`, anchor at `w`, nothing strained."""
    del p, x
    z[:] = 0.0
    z[[Q1, Q2, OLD_W]] = w


@njit
def turned(s, travel, delta):
    """(Dahl state after `travel`, its derivative): s → ±1 by e^(−|travel|/δ)."""
    sign = 1.0 if travel >= 0.0 else -1.0
    fade = math.exp(-abs(travel) / delta)
    return sign + (s - sign) * fade, (sign - s) * fade / delta * sign


@njit
def balance(up, k_up, down, k_down, s, ds, exponent):
    """Force on a site, N, and its derivatives by the tension above, below (through stiffness) and the slip."""
    low, high = math.exp(-0.5 * s * exponent), math.exp(0.5 * s * exponent)
    force = up * low - down * high
    own = -k_up * low - k_down * high - 0.5 * exponent * ds * (up * low + down * high)
    return force, own, k_down * high, k_up * low


@njit
def loose(p, weight, speed, loaded_n):
    """Drag of a site's own weight, N, and its derivative by speed; gone where the rope is taut."""
    size = p[LOOSE] * weight / (1.0 + loaded_n)
    t = math.tanh(speed / STILL_M_S)
    return size * t, size * (1.0 - t * t) / STILL_M_S


@njit
def step(z, p, x, w, theta, dt):
    """Move the path by `dt` to rope `x` at the drum and anchor `w`."""
    before = z[END]
    torn = softer(z, p)
    e1, e2 = exponents(z, p, theta)
    grip1 = e1 * loaded(p, 0.5 * (z[START] + z[MIDDLE])) * breakaway(p, p[RATIO1], z[U1])
    grip2 = e2 * loaded(p, 0.5 * (z[MIDDLE] + z[END])) * breakaway(p, p[RATIO2], z[U2])
    k0, mass = 1.0 / (p[LEAD] + 0.5 * p[SHEATH]), 0.5 * p[MASS]
    slow_mid, slow_end = (p[BEFORE] + 0.5 * p[OVER]) * z[GAMMA], (p[AFTER] + 0.5 * p[OVER]) * z[GAMMA]
    light = 0.5 * p[LIGHT]
    surface = (w - z[OLD_W]) / dt
    v1, v2 = z[V1], z[V2]
    t0 = t1 = t2 = s1 = s2 = 0.0
    for k in range(MOST):
        share = 0.5 ** (k // WHOLE)
        q1, q2 = z[Q1] + v1 * dt, z[Q2] + v2 * dt
        k_0 = k0 if x > q1 else 0.0
        t0 = k_0 * (x - q1)
        t1, k_1 = looked_up((q1 - q2 - slow_mid) / torn, p, MID)
        t2, k_2 = looked_up((q2 - w - slow_end) / torn, p, LAST)
        s1, ds1 = turned(z[Z1], v1 * dt, p[DELTA1])
        s2, ds2 = turned(z[Z2], (v2 - surface) * dt, p[DELTA2])
        f1, a11, a12, _ = balance(t0, k_0, t1, k_1 / torn, s1, ds1, grip1)
        f2, a22, _, a21 = balance(t1, k_1 / torn, t2, k_2 / torn, s2, ds2, grip2)
        d1, c1 = loose(p, GRAVITY * mass, v1, t0 + t1)
        d2, c2 = loose(p, GRAVITY * mass, v2, t1 + t2)
        grease = p[VISCOUS] * greased(0.5 * (t0 + t1))
        r1 = f1 - mass * (v1 - z[V1]) / dt - (grease + light) * v1 - d1
        r2 = f2 - mass * (v2 - z[V2]) / dt - light * (v2 - surface) - d2
        j11, j22 = a11 * dt - mass / dt - grease - light - c1, a22 * dt - mass / dt - light - c2
        j12, j21 = a12 * dt, a21 * dt
        det = j11 * j22 - j12 * j21
        dv1, dv2 = (r1 * j22 - r2 * j12) / det, (r2 * j11 - r1 * j21) / det
        v1, v2 = v1 - share * dv1, v2 - share * dv2
        if abs(dv1) + abs(dv2) < 1e-9:
            break
    z[Q1], z[Q2], z[V1], z[V2], z[Z1], z[Z2] = z[Q1] + v1 * dt, z[Q2] + v2 * dt, v1, v2, s1, s2
    z[U1], z[U2] = remembered(p, z[U1], v1, dt), remembered(p, z[U2], v2 - surface, dt)
    z[START], z[MIDDLE], z[END], z[OLD_W] = t0, t1, t2, w
    age(z, p, before, dt)


drive, run = mechanics.loops(step, __name__, EVERY, SUBSTEP_S)
"""`drive(count, …)`: so many steps under held torques; `run(…)`: the path under imposed encoder and knee motion."""
