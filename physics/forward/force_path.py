"""Simulation of the force path under measured rope and knee motion, for a batch of parameter sets at once.

Friction acts at `CABLE_NODES` nodes of the rope in its sheath and at `FABRIC_NODES` of the fabric on the knee, in
series; springs join drum, nodes and leg.  Each time step solves the force balances of all nodes implicitly (backward
Euler, Newton's method).  Every term is smooth or continuous in the parameters, so that finite differences give usable
Jacobians.  Rope positive pulling, knee flexion negative; SI.
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
    "breakaway", "fabric_breakaway", "stribeck_speed", "stribeck_memory", "sharpness",
)
"""Parameters of the path, one row each of the array that `simulate` takes.

`zero` m: encoder at the taut, unloaded rope at the knee angle `KNEE_RAD`.  `arm`, `arm2`, `arm3` m/radⁿ: displacement
of the anchor on the leg by knee angle.  `eccentric_sin`, `eccentric_cos` m, `drum_radius` m: payout of an eccentric
drum.  `play` rad: half dead band of the knee; `gap` rad: half dead band that the load closes.  `stiffness` N at 10 mm
of stretch, `curve2`, `curve3` its quadratic and cubic shares.  `cable_compliance` m/N: compliance of the rope from the
drum to the sheath's end.  `fabric_share`: share of the fabric's stretch before the middle of the knee.  `prompt`,
`slow` m/N: retarded compliance with time constants `PROMPT_S`, `SLOW_S`; `creep_compliance` m/N, `creep_time` s: a
further one.  `cable`, `fabric`: friction exponents μ1·θ1 and μ2·φ at `KNEE_RAD`, `LOAD_N`.  `bend` 1/rad: relative
change of the cable's exponent with knee angle; `wrap` 1/rad: that of the fabric's.  `surface`: share of the anchor's
displacement by which the surface under the fabric moves.  `load`: relative change of both exponents for each 40 N;
`friction_drift`: over the trial.  `viscous` N·s/m: viscous friction that a loose rope does not have, `drag` N·s/m: that
of any taut one; `dry` N: friction that no load changes.  `cable_travel`, `fabric_travel` m: pre-sliding distance.
`breakaway`, `fabric_breakaway`: relative excess of static over sliding friction, `stribeck_speed` m/s the Stribeck
speed, `stribeck_memory` s its lag.  `sharpness`: share of friction that is full after a finite distance."""
INDEX: Final = {name: i for i, name in enumerate(NAMES)}
(ZERO, ARM, ARM2, ARM3, ECC_SIN, ECC_COS, DRUM, PLAY, GAP, STIFF, CURVE2, CURVE3, COMPLIANCE, SHARE, PROMPT, SLOW,
 CREEP, CREEP_TIME, CABLE, BEND, LOAD, DRIFT, VISCOUS, DRAG, DRY, FABRIC, WRAP, SURFACE, CABLE_TRAVEL, FABRIC_TRAVEL,
 CABLE_REST, FABRIC_REST, REST_SPEED, MEMORY, SHARP) = range(len(NAMES))
CABLE_NODES: Final = 3
FABRIC_NODES: Final = 2
"""Nodes with friction of the rope and of the fabric, along which friction and compliance are distributed (decision 50).

With one node each the fitted compliance of the cable is a third of the true one on rigs of 7 to 19 nodes."""
NODES: Final = CABLE_NODES + FABRIC_NODES
KNEE_RAD: Final = -0.5
"""Knee angle, rad, to which exponents and anchor displacement refer: about that of the loading, 13–20 % of gait."""
LOAD_N: Final = 30.0
"""Tension, N, to which exponents refer: the middle of a 40 to 60 N gait."""
STRETCH_M: Final = 0.01
"""Stretch, m, at which `stiffness` is the force of the linear term: the paper's stretch at 40 N."""
PROMPT_S: Final = 0.08
SLOW_S: Final = 1.0
"""Time constants, s, of the two creep elements that every bench has: shorter and longer than one loading of a gait."""
GREASE_N: Final = 10.0
"""Tension, N, at which half the viscous friction acts (`viscous_tension` of the parameter table)."""
LIGHT: Final = 0.3
"""Viscous drag of the unloaded path, N·s/m: makes a slack rope's position unique; changes tensions by less than 0.1 N.
"""
SOFT_N: Final = 0.1
"""Half width, N, of the transition from slack to taut: below sensor noise."""
SOFT: Final = 2e-3
"""Transition in stretch that corresponds to `STRETCH_M`."""
NEAR: Final = 1.0 / 0.4
FAR: Final = 1.0 / 2.2
"""A node has three friction elements in parallel. The first and third slide after 0.4 and 2.2 times the distance of the
second; these are the reciprocals."""
FINITE: Final = 0.67
"""A fourth element, of Dahl's exponent 1/2, is full after 1.5 times the distance; this is the reciprocal.

With it friction rises from −1 to 0 over the same distance as in the three, whatever the `sharpness`."""
ROUNDS: Final = 40
"""Most Newton steps in a time step; a step that does not reduce the residual is shortened."""
CLOSE_N: Final = 1e-7
"""Sum of the residuals of all force balances, N, at which a time step counts as solved."""
COMPILED: Final[dict[str, Any]] = {"cache": True, "fastmath": {"arcp"}, "error_model": "numpy"}
"""Options of numba: a division may become a multiplication by the reciprocal, and is not tested for zero; each saves a
third of the time."""
INLINED: Final = COMPILED | {"inline": "always"}
"""Options for parts of a time step: a call would pass every array, which takes half of the time."""


class PathResponse(NamedTuple):
    """Simulated path, one row a parameter set: tensions N at drum, between cable and fabric, and at END; friction
    states, means over the nodes."""

    start: Array
    middle: Array
    end: Array
    cable_slip: Array
    fabric_slip: Array


class _State(NamedTuple):
    """State of the path.

    By node: position, last move and the one before it, m, lagged sliding speed, m/s, friction elements.  By spring:
    tension, N.  `retarded`: stretch of the three retarded compliances, m.
    """

    position: Array
    moved: Array
    before: Array
    speed: Array
    slip: Array
    tension: Array
    retarded: Array


class _Balance(NamedTuple):
    """Force balances of one time step.

    By node: position `at`, its value without sliding, `rest`, and before Newton's step, `back`, m; expected `change` of
    its move, m; friction state `slip` and its slope `turn`; residual, N; half the friction exponent; drag, N/m; dry
    friction, N; Newton's step, m; diagonals of the Jacobian; `turned`, reciprocal of the pre-sliding distance.  By
    spring: tension, N, and its slope; share of the fabric's stretch; `per_stretch`, N/m of the cable, 1/m of fabric.
    """

    at: Array
    rest: Array
    change: Array
    back: Array
    slip: Array
    turn: Array
    residual: Array
    exponent: Array
    drag: Array
    dry: Array
    step: Array
    below: Array
    diagonal: Array
    above: Array
    turned: Array
    tension: Array
    slope: Array
    share: Array
    per_stretch: Array


def simulate(parameters: Array, rope_m: Array, knee_rad: Array, dt_s: float) -> PathResponse:
    """Simulate the path for each column of `parameters`, shape (len(NAMES), sets).

    `rope_m`, `knee_rad`: measured motion, shape (samples,), every `dt_s`.  Returns arrays of shape (sets, samples).
    The sets of a Jacobian differ little: beside the first one, which leads, the others take half of its time.
    """
    out = np.zeros((5, parameters.shape[1], rope_m.size))
    led = np.zeros((rope_m.size + 1, NODES))
    balance = _Balance(*np.zeros((len(_Balance._fields), NODES + 1)))
    for j, p in enumerate(np.ascontiguousarray(parameters.T)):
        state = _State(*(np.zeros(shape) for shape in (NODES, NODES, NODES, NODES, (NODES, 4), NODES + 1, 3)))
        _run(p, np.ascontiguousarray(rope_m), np.ascontiguousarray(knee_rad), dt_s, state, balance, led, j == 0,
             out[:, j])
    return PathResponse(*out)


@njit(**INLINED)
def _anchor(p, knee):  # type: ignore[no-untyped-def]
    on = knee - KNEE_RAD
    return (p[ARM] + (p[ARM2] + p[ARM3] * on) * on) * on


@njit(**INLINED)
def _begin(p, rope, w, z, a):  # type: ignore[no-untyped-def]
    # the fabric's nodes lie one spring apart, their middle at the share `fabric_share` of its stretch
    whole, left, taut = 1.0 / (FABRIC_NODES + 1), 1.0, max(rope - p[ZERO] - w, 0.0)
    for i in range(NODES + 1):
        a.share[i], a.per_stretch[i] = 0.0, CABLE_NODES / p[COMPLIANCE]
        if i >= CABLE_NODES:
            a.share[i] = whole
            if i == CABLE_NODES:
                a.share[i] = p[SHARE] * FABRIC_NODES * whole
            elif i == NODES:
                a.share[i] = (1.0 - p[SHARE]) * FABRIC_NODES * whole
            a.per_stretch[i] = 1.0 / (a.share[i] * STRETCH_M)
        if i < NODES:
            left -= a.share[i]
            z.position[i] = w + left * taut
            a.turned[i] = 1.0 / (p[CABLE_TRAVEL] if i < CABLE_NODES else p[FABRIC_TRAVEL])


@njit(**INLINED)
def _dahl(slip, i, moved, turned):  # type: ignore[no-untyped-def]
    # backward Euler of Dahl's ds/dx = (1 − s·sgn v)/δ: stable for any step; three δ, with one division for all.  The
    # fourth is the exact step of ds/dx = √(1 − s·sgn v)/δ (Dahl 1968, exponent ½): √(1 − s·sgn v) falls linearly
    way, size = moved * turned, abs(moved) * turned
    d0, d1, d2 = 1.0 + NEAR * size, 1.0 + size, 1.0 + FAR * size
    whole = 1.0 / (d0 * d1 * d2)
    kept0, kept1, kept2 = whole * d1 * d2, whole * d0 * d2, whole * d0 * d1
    s0, s1, s2 = (slip[i, 0] + NEAR * way) * kept0, (slip[i, 1] + way) * kept1, (slip[i, 2] + FAR * way) * kept2
    sign = 1.0 if moved >= 0.0 else -1.0
    turn = turned * (NEAR * (1.0 - s0 * sign) * kept0 + (1.0 - s1 * sign) * kept1 + FAR * (1.0 - s2 * sign) * kept2)
    root = max(0.0, math.sqrt(max(0.0, 1.0 - slip[i, 3] * sign)) - FINITE * size)
    return s0, s1, s2, sign * (1.0 - root * root), turn, 2.0 * FINITE * turned * root


@njit(**INLINED)
def _friction(p, theta, surface, half, dt, z, a):  # type: ignore[no-untyped-def]
    # (3) and (7) of each node: half its exponent by knee angle, tension and lagged sliding speed (Stribeck's curve)
    bend = abs(theta) - abs(KNEE_RAD)
    vs = p[REST_SPEED] * p[REST_SPEED]
    of_cable = half * p[CABLE] / CABLE_NODES * max(0.05, 1.0 + p[BEND] * bend)
    of_fabric = half * p[FABRIC] / FABRIC_NODES * max(0.05, 1.0 + p[WRAP] * bend)
    for i in range(NODES):
        t = z.tension[i]
        loaded = max(0.1, 1.0 + p[LOAD] * (0.5 * (t + z.tension[i + 1]) - LOAD_N) / 40.0)
        slow = vs / (vs + z.speed[i] * z.speed[i])
        if i < CABLE_NODES:
            a.exponent[i] = of_cable * loaded * (1.0 + p[CABLE_REST] * slow)
            a.drag[i] = (p[VISCOUS] * t / (t + GREASE_N) + p[DRAG] * t / (t + SOFT_N) + LIGHT) / dt / CABLE_NODES
            a.dry[i] = p[DRY] / CABLE_NODES
            a.rest[i] = z.position[i]
        else:
            a.exponent[i] = of_fabric * loaded * (1.0 + p[FABRIC_REST] * slow)
            a.drag[i] = LIGHT / dt / FABRIC_NODES
            a.dry[i] = p[DRY] / FABRIC_NODES
            a.rest[i] = z.position[i] + surface
        a.at[i] = a.rest[i] + z.moved[i] + a.change[i]


@njit(**INLINED)
def _residual(p, u, w, late, z, a):  # type: ignore[no-untyped-def]
    # tensions, friction states and the residual of each node's force balance; returns the sum of their sizes
    ahead, stiff, c2, c3 = u, p[STIFF], p[CURVE2], p[CURVE3]
    for i in range(CABLE_NODES):
        lead = a.per_stretch[i]
        y = (ahead - a.at[i]) * lead
        root = math.sqrt(y * y + SOFT_N * SOFT_N)
        a.tension[i], a.slope[i] = 0.5 * (y + root), 0.5 * (1.0 + y / root) * lead
        ahead = a.at[i]
    for i in range(CABLE_NODES, NODES + 1):
        behind = a.at[i] if i < NODES else w
        # (10) with a cubic term, K·e·(1 + c2·e + c3·e²); e: a smooth maximum of strain and 0, so that springs may slack
        y = (ahead - behind - a.share[i] * late) * a.per_stretch[i]
        root = math.sqrt(y * y + SOFT * SOFT)
        e = 0.5 * (y + root)
        a.tension[i] = stiff * e * (1.0 + e * (c2 + e * c3))
        a.slope[i] = stiff * (1.0 + e * (2.0 * c2 + 3.0 * e * c3)) * 0.5 * (1.0 + y / root) * a.per_stretch[i]
        ahead = behind
    size, gradual = 0.0, (1.0 - p[SHARP]) / 3.0
    for i in range(NODES):
        moved = a.at[i] - a.rest[i]
        s0, s1, s2, s3, turn, turn3 = _dahl(z.slip, i, moved, a.turned[i])
        slip = p[SHARP] * s3 + gradual * (s0 + s1 + s2)
        a.slip[i], a.turn[i] = slip, p[SHARP] * turn3 + gradual * turn
        # (3) and (7) as forces s·(T0 + T1)·μθ/2: T0/T1 = (1 + μθ/2)/(1 − μθ/2), to second order e^(μθ)
        rub = a.exponent[i] * (a.tension[i] + a.tension[i + 1]) + a.dry[i]
        a.residual[i] = a.tension[i] - a.tension[i + 1] - rub * slip - a.drag[i] * moved
        size += abs(a.residual[i])
    return size


@njit(**INLINED)
def _newton(a):  # type: ignore[no-untyped-def]
    # Newton's step by the tridiagonal Jacobian of the balances (Thomas' algorithm)
    for i in range(NODES):
        e, rub = a.exponent[i] * a.slip[i], a.exponent[i] * (a.tension[i] + a.tension[i + 1]) + a.dry[i]
        a.below[i], a.above[i] = a.slope[i] * (1.0 - e), a.slope[i + 1] * (1.0 + e)
        a.diagonal[i] = -a.below[i] - a.above[i] - rub * a.turn[i] - a.drag[i]
        a.step[i] = a.residual[i]
        if i > 0:
            m = a.below[i] / a.diagonal[i - 1]
            a.diagonal[i] -= m * a.above[i - 1]
            a.step[i] -= m * a.step[i - 1]
    a.step[NODES - 1] /= a.diagonal[NODES - 1]
    for i in range(NODES - 2, -1, -1):
        a.step[i] = (a.step[i] - a.above[i] * a.step[i + 1]) / a.diagonal[i]


@njit(**INLINED)
def _solve(p, u, w, late, z, a):  # type: ignore[no-untyped-def]
    least, share = 1e300, 1.0
    for _ in range(ROUNDS):
        size = _residual(p, u, w, late, z, a)
        if size < CLOSE_N:
            return
        # a step that did not reduce the residual is shortened
        if size < least:
            least, share = size, 1.0
            for i in range(NODES):
                a.back[i] = a.at[i]
            _newton(a)
        else:
            share *= 0.4
        for i in range(NODES):
            a.at[i] = a.back[i] - share * a.step[i]


@njit(**COMPILED)
def _run(p, rope, knee, dt, z, a, led, leads, out):  # type: ignore[no-untyped-def]
    w = last = _anchor(p, knee[0])
    leg = knee[0]
    _begin(p, rope[0], w, z, a)
    for k in range(rope.size):
        x, theta = rope[k], knee[k]
        u = x - p[ZERO]
        if p[ECC_SIN] != 0.0 or p[ECC_COS] != 0.0:
            u += p[ECC_SIN] * math.sin(x / p[DRUM]) + p[ECC_COS] * (math.cos(x / p[DRUM]) - 1.0)
        leg = min(max(leg, theta - p[PLAY]), theta + p[PLAY])
        # the load closes the gap, N·m: rope at a lever of 40 mm (11) less the leg's weight; 0.3 N·m rounds the reversal
        pull = 0.04 * z.tension[CABLE_NODES] - 0.9 * math.sin(theta)
        w = _anchor(p, leg + p[GAP] * pull / (abs(pull) + 0.3))
        # the first guess: each move changes as in the set that leads, and in that one as it did in the step before
        for i in range(NODES):
            a.change[i] = z.moved[i] - z.before[i] if leads else led[k + 1, i] - led[k, i]
        _friction(p, theta, p[SURFACE] * (w - last), 0.5 * (1.0 + p[DRIFT] * k / rope.size), dt, z, a)
        _solve(p, u, w, z.retarded[0] + z.retarded[1] + z.retarded[2], z, a)
        for i in range(NODES):
            moved = a.at[i] - a.rest[i]
            z.slip[i, 0], z.slip[i, 1], z.slip[i, 2], z.slip[i, 3], _, _ = _dahl(z.slip, i, moved, a.turned[i])
            # backward Euler of v̇s = (v − vs)/τ
            z.speed[i] += (moved / dt - z.speed[i]) * dt / (p[MEMORY] + dt)
            z.position[i], z.before[i], z.moved[i] = a.at[i], z.moved[i], moved
            if leads:
                led[k + 1, i] = moved
        for i in range(NODES + 1):
            z.tension[i] = a.tension[i]
        # backward Euler of the retarded stretch γ̇ = (J·T − γ)/τ (Kelvin and Voigt)
        end, last = a.tension[NODES], w
        z.retarded[0] += (p[PROMPT] * end - z.retarded[0]) * dt / (PROMPT_S + dt)
        z.retarded[1] += (p[SLOW] * end - z.retarded[1]) * dt / (SLOW_S + dt)
        z.retarded[2] += (p[CREEP] * end - z.retarded[2]) * dt / (p[CREEP_TIME] + dt)
        out[0, k], out[1, k], out[2, k] = a.tension[0], a.tension[CABLE_NODES], end
        for i in range(NODES):
            if i < CABLE_NODES:
                out[3, k] += a.slip[i] / CABLE_NODES
            else:
                out[4, k] += a.slip[i] / FABRIC_NODES
