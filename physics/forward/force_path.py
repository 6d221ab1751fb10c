"""Simulation of the force path under measured rope and knee motion, for a batch of parameter sets at once.

Two nodes carry friction, the rope in its sheath and the fabric on the knee; three springs join drum, nodes and leg.
Each time step solves the two force balances implicitly (backward Euler, Newton's method), and every term is smooth or
continuous in the parameters, so that finite differences give usable Jacobians.  Rope positive pulling, knee flexion
negative; SI.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from physics.laws import Array

NAMES: Final = (
    "zero", "arm", "arm2", "arm3", "eccentric_sin", "eccentric_cos", "drum_radius", "play", "gap",
    "stiffness", "curve2", "curve3", "cable_compliance", "fabric_share", "prompt", "slow", "creep_compliance",
    "creep_time", "cable", "bend", "load", "friction_drift", "viscous", "drag", "dry",
    "fabric", "wrap", "surface", "cable_travel", "fabric_travel",
    "breakaway", "fabric_breakaway", "stribeck_speed", "stribeck_memory",
)
"""Parameters of the path, one row each of the array that `simulate` takes.

`zero` m: encoder at the taut, unloaded rope at the knee angle `KNEE_RAD`.  `arm`, `arm2`, `arm3` m/radⁿ: displacement
of the anchor on the leg by knee angle.  `eccentric_sin`, `eccentric_cos` m, `drum_radius` m: payout of an eccentric
drum.  `play` rad: half dead band of the knee; `gap` rad: half dead band that the load closes.  `stiffness` N at 10 mm
of stretch, `curve2`, `curve3` its quadratic and cubic shares.  `cable_compliance` m/N: compliance between drum and
sheath.  `fabric_share`: share of the fabric's stretch before the knee.  `prompt`, `slow` m/N: retarded compliance with
time constants `PROMPT_S`, `SLOW_S`; `creep_compliance` m/N, `creep_time` s: a further one.  `cable`, `fabric`: friction
exponents μ1·θ1 and μ2·φ at `KNEE_RAD`, `LOAD_N`.  `bend` 1/rad: relative change of the cable's exponent with knee
angle; `wrap` 1/rad: that of the fabric's.  `surface`: share of the anchor's displacement by which the surface under the
fabric moves.  `load`: relative change of both exponents for each 40 N; `friction_drift`: over the trial.  `viscous`
N·s/m: viscous friction that a loose rope does not have, `drag` N·s/m: that of any taut one; `dry` N: friction that no
load changes.  `cable_travel`, `fabric_travel` m: pre-sliding distance.  `breakaway`, `fabric_breakaway`: relative
excess of static over sliding friction, `stribeck_speed` m/s the Stribeck speed, `stribeck_memory` s its lag."""
INDEX: Final = {name: i for i, name in enumerate(NAMES)}
(ZERO, ARM, ARM2, ARM3, ECC_SIN, ECC_COS, DRUM, PLAY, GAP, STIFF, CURVE2, CURVE3, LEAD, BEFORE, PROMPT, SLOW, CREEP,
 CREEP_TIME, CABLE, BEND, LOAD, DRIFT, VISCOUS, DRAG, DRY, FABRIC, WRAP, SURFACE, CABLE_TRAVEL, FABRIC_TRAVEL,
 CABLE_REST, FABRIC_REST, REST_SPEED, MEMORY) = range(len(NAMES))
KNEE_RAD: Final = -0.5
"""Knee angle, rad, to which exponents and anchor displacement refer: about that of the loading, 13–20 % of gait."""
LOAD_N: Final = 30.0
"""Tension, N, to which exponents refer: the middle of a 40 to 60 N gait."""
STRETCH_M: Final = 0.01
"""Stretch, m, at which `stiffness` is the force of the linear term: the paper's stretch at 40 N."""
PROMPT_S: Final = 0.08
SLOW_S: Final = 1.0
"""Time constants, s, of the two standing retarded compliances: within and beyond one loading of a gait cycle."""
GREASE_N: Final = 10.0
"""Tension, N, at which half the viscous friction acts (`viscous_tension` of the parameter table)."""
LIGHT: Final = 0.3
"""Viscous drag of the unloaded path, N·s/m: makes a slack rope's position unique; changes tensions by less than 0.1 N.
"""
SOFT_N: Final = 0.1
"""Half width, N, of the transition from slack to taut: below sensor noise."""
SOFT: Final = 2e-3
"""Transition in stretch that corresponds to `STRETCH_M`."""
SPREAD: Final = (0.4, 1.0, 2.2)
"""Pre-sliding distances of the three friction elements of a node, in the node's: friction is distributed."""
ROUNDS: Final = 40
"""Most Newton steps in a time step; a step that does not reduce the residual is shortened."""
CLOSE_N: Final = 1e-7
"""Residual of the two force balances, N, at which a time step counts as solved."""
COMPILED: Final[dict[str, Any]] = {"cache": True, "fastmath": {"arcp"}}
"""Options of numba: a division may become a multiplication by the reciprocal, which saves a third of the time."""
(Q1, Q2, ANCHOR, SPEED1, SPEED2, S1, S2, GAMMA_PROMPT, GAMMA_SLOW, GAMMA, LEG, T0, T1, T2, LAST1, LAST2,
 STATES) = (0, 1, 2, 3, 4, 5, 8, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20)
"""State rows: node positions, anchor, lagged sliding speeds of the friction, three friction elements a node, retarded
stretch, leg, tensions."""


class PathResponse(NamedTuple):
    """Simulated path, one row a parameter set: tensions N at drum, between the nodes and at END; friction states."""

    start: Array
    middle: Array
    end: Array
    cable_slip: Array
    fabric_slip: Array


def simulate(parameters: Array, rope_m: Array, knee_rad: Array, dt_s: float) -> PathResponse:
    """Simulate the path for each column of `parameters`, shape (len(NAMES), sets).

    `rope_m`, `knee_rad`: measured motion, shape (samples,), every `dt_s`.  Returns arrays of shape (sets, samples).
    """
    out = np.zeros((5, parameters.shape[1], rope_m.size))
    _run(np.ascontiguousarray(parameters), np.ascontiguousarray(rope_m), np.ascontiguousarray(knee_rad), dt_s, out)
    return PathResponse(*out)


@njit(**COMPILED)
def _run(p, rope, knee, dt, out):  # type: ignore[no-untyped-def]
    sets = p.shape[1]
    z = np.zeros((STATES, sets))
    for j in range(sets):
        on = knee[0] - KNEE_RAD
        w = (p[ARM, j] + (p[ARM2, j] + p[ARM3, j] * on) * on) * on
        taut = max(rope[0] - p[ZERO, j] - w, 0.0)
        z[Q1, j], z[Q2, j] = w + taut, w + (1.0 - p[BEFORE, j]) * taut
        z[ANCHOR, j], z[LEG, j] = w, knee[0]
    for i in range(rope.size):
        _step(p, rope[i], knee[i], i / rope.size, dt, z, out[:, :, i])


@njit(**COMPILED)
def _spring(strain, share, stiff, c2, c3):  # type: ignore[no-untyped-def]
    # (10) with a cubic term, K·e·(1 + c2·e + c3·e²); e, a smooth maximum of the strain and 0, lets a slack spring be
    y = strain / (share * STRETCH_M)
    root = math.sqrt(y * y + SOFT * SOFT)
    e = 0.5 * (y + root)
    slope = 0.5 * (1.0 + y / root) / (share * STRETCH_M)
    return stiff * e * (1.0 + e * (c2 + e * c3)), stiff * (1.0 + e * (2.0 * c2 + 3.0 * e * c3)) * slope


@njit(**COMPILED)
def _slip(z, first, j, moved, travel):  # type: ignore[no-untyped-def]
    # backward Euler of Dahl's ds/dx = (1 − s·sgn v)/δ: stable for any step; three δ, since friction is distributed
    way, size = moved / travel, abs(moved) / travel
    sign = (1.0 if moved >= 0.0 else -1.0) / travel
    slip = slope = 0.0
    for k in range(3):
        f = 1.0 / SPREAD[k]
        w = 1.0 / (1.0 + f * size)
        s = (z[first + k, j] + f * way) * w
        slip += s / 3.0
        slope += (f / travel - s * f * sign) * w / 3.0
    return slip, slope


@njit(**COMPILED)
def _keep(z, first, j, moved, travel):  # type: ignore[no-untyped-def]
    for k in range(3):
        f = 1.0 / (SPREAD[k] * travel)
        z[first + k, j] = (z[first + k, j] + f * moved) / (1.0 + f * abs(moved))


@njit(**COMPILED)
def _step(p, x, theta, progress, dt, z, out):  # type: ignore[no-untyped-def]
    last1, last2, gain1, gain2 = z[LAST1, 0], z[LAST2, 0], 0.0, 0.0
    for j in range(p.shape[1]):
        u = x - p[ZERO, j]
        if p[ECC_SIN, j] != 0.0 or p[ECC_COS, j] != 0.0:
            u += p[ECC_SIN, j] * math.sin(x / p[DRUM, j]) + p[ECC_COS, j] * (math.cos(x / p[DRUM, j]) - 1.0)
        leg = min(max(z[LEG, j], theta - p[PLAY, j]), theta + p[PLAY, j])
        z[LEG, j] = leg
        # the load closes the gap, N·m: rope at a lever of 40 mm (11) less the leg's weight; 0.3 N·m rounds the reversal
        pull = 0.04 * z[T1, j] - 0.9 * math.sin(theta)
        leg += p[GAP, j] * pull / (abs(pull) + 0.3)
        on = leg - KNEE_RAD
        w = (p[ARM, j] + (p[ARM2, j] + p[ARM3, j] * on) * on) * on
        surface = p[SURFACE, j] * (w - z[ANCHOR, j])
        old1, old2 = z[Q1, j], z[Q2, j] + surface
        lead, before = 1.0 / p[LEAD, j], p[BEFORE, j]
        late = z[GAMMA_PROMPT, j] + z[GAMMA_SLOW, j] + z[GAMMA, j]
        bend = abs(theta) - abs(KNEE_RAD)
        half = 0.5 * (1.0 + p[DRIFT, j] * progress)
        vs = p[REST_SPEED, j] * p[REST_SPEED, j]
        # half of the exponents of (3) and (7), by knee angle, tension and lagged sliding speed (Stribeck's curve)
        e1 = half * p[CABLE, j] * max(0.05, 1.0 + p[BEND, j] * bend) * max(
            0.1, 1.0 + p[LOAD, j] * (0.5 * (z[T0, j] + z[T1, j]) - LOAD_N) / 40.0) * (
            1.0 + p[CABLE_REST, j] * vs / (vs + z[SPEED1, j] * z[SPEED1, j]))
        e2 = half * p[FABRIC, j] * max(0.05, 1.0 + p[WRAP, j] * bend) * max(
            0.1, 1.0 + p[LOAD, j] * (0.5 * (z[T1, j] + z[T2, j]) - LOAD_N) / 40.0) * (
            1.0 + p[FABRIC_REST, j] * vs / (vs + z[SPEED2, j] * z[SPEED2, j]))
        grease = (p[VISCOUS, j] * z[T0, j] / (z[T0, j] + GREASE_N) + p[DRAG, j] * z[T0, j] / (z[T0, j] + SOFT_N)
                  + LIGHT) / dt
        light = LIGHT / dt
        stiff, c2, c3 = p[STIFF, j], p[CURVE2, j], p[CURVE3, j]
        dry = p[DRY, j]
        # sets of a Jacobian are close to each other: each begins with the change of sliding that the first one found
        q1, q2 = old1 + z[LAST1, j] + gain1, old2 + z[LAST2, j] + gain2
        back1, back2 = q1, q2
        t0 = t1 = t2 = s1 = s2 = d1 = d2 = 0.0
        least, share = 1e300, 1.0
        for _ in range(ROUNDS):
            y = (u - q1) * lead
            root = math.sqrt(y * y + SOFT_N * SOFT_N)
            t0, k0 = 0.5 * (y + root), 0.5 * (1.0 + y / root) * lead
            t1, k1 = _spring(q1 - q2 - before * late, before, stiff, c2, c3)
            t2, k2 = _spring(q2 - w - (1.0 - before) * late, 1.0 - before, stiff, c2, c3)
            s1, g1 = _slip(z, S1, j, q1 - old1, p[CABLE_TRAVEL, j])
            s2, g2 = _slip(z, S2, j, q2 - old2, p[FABRIC_TRAVEL, j])
            # (3) and (7) as forces s·(T0 + T1)·μθ/2: T0/T1 = (1 + μθ/2)/(1 − μθ/2), to second order e^(μθ)
            rub1, rub2 = e1 * (t0 + t1) + dry, e2 * (t1 + t2) + dry
            f1 = t0 - t1 - rub1 * s1 - grease * (q1 - old1)
            f2 = t1 - t2 - rub2 * s2 - light * (q2 - old2)
            size = abs(f1) + abs(f2)
            if size < CLOSE_N:
                break
            # Newton's step by the 2 × 2 Jacobian of both balances; shortened where it did not reduce them
            if size < least:
                least, share, back1, back2 = size, 1.0, q1, q2
                j11 = -k0 - k1 - e1 * (k1 - k0) * s1 - rub1 * g1 - grease
                j12 = k1 + e1 * k1 * s1
                j21 = k1 - e2 * k1 * s2
                j22 = -k1 - k2 - e2 * (k2 - k1) * s2 - rub2 * g2 - light
                det = j11 * j22 - j12 * j21
                d1, d2 = (f1 * j22 - f2 * j12) / det, (f2 * j11 - f1 * j21) / det
            else:
                share *= 0.4
            q1, q2 = back1 - share * d1, back2 - share * d2
        v1, v2 = q1 - old1, q2 - old2
        if j == 0:
            gain1, gain2 = v1 - last1, v2 - last2
        _keep(z, S1, j, v1, p[CABLE_TRAVEL, j])
        _keep(z, S2, j, v2, p[FABRIC_TRAVEL, j])
        # backward Euler of v̇s = (v − vs)/τ and of the retarded stretch γ̇ = (J·T − γ)/τ (Kelvin and Voigt)
        z[SPEED1, j] += (v1 / dt - z[SPEED1, j]) * dt / (p[MEMORY, j] + dt)
        z[SPEED2, j] += (v2 / dt - z[SPEED2, j]) * dt / (p[MEMORY, j] + dt)
        z[GAMMA_PROMPT, j] += (p[PROMPT, j] * t2 - z[GAMMA_PROMPT, j]) * dt / (PROMPT_S + dt)
        z[GAMMA_SLOW, j] += (p[SLOW, j] * t2 - z[GAMMA_SLOW, j]) * dt / (SLOW_S + dt)
        z[GAMMA, j] += (p[CREEP, j] * t2 - z[GAMMA, j]) * dt / (p[CREEP_TIME, j] + dt)
        z[Q1, j], z[Q2, j], z[ANCHOR, j], z[LAST1, j], z[LAST2, j] = q1, q2, w, v1, v2
        z[T0, j], z[T1, j], z[T2, j] = t0, t1, t2
        out[0, j], out[1, j], out[2, j], out[3, j], out[4, j] = t0, t1, t2, s1, s2
