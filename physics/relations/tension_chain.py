"""Tension along fabric and cable from measured signals, with elasticity on both sides of the friction.

The rule of this file: compiled, one sample after another, the few nodes that a relation needs (the plant's own
chain has many and moves in time; this one is solved at rest in each sample).  Friction at a node is
T·e^(s·μθ) with ds/du = (1 − s·sgn du)/δ over the node's own sliding u: the rope's in the sheath, the
fabric's on the knee, whose surface moves with the leg.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from physics.laws import Array
from physics.path_laws import (
    capstan,
    load_dependence,
    presliding_from,
    presliding_left,
    presliding_shaped,
    stretch,
    stribeck,
)

Mask = NDArray[np.bool_]

CABLE_NODES: Final = 3
FABRIC_NODES: Final = 2
SPREAD: Final = np.array([0.4, 1.0, 2.5])
"""Pre-sliding distances of the cable's nodes against the mean: a segmented rope turns over gradually."""
SHARE_AFTER: Final = 0.4
SHARE_OVER: Final = 0.35
SHARES: Final = np.array([SHARE_AFTER + SHARE_OVER * 0.5 / FABRIC_NODES,
                          *[SHARE_OVER / FABRIC_NODES] * (FABRIC_NODES - 1),
                          1.0 - SHARE_AFTER - SHARE_OVER * (1.0 - 0.5 / FABRIC_NODES)])
"""Shares of the fabric's stretch behind its first node, between them, and before its last."""
ITERATIONS: Final = 50
TOE_N: Final = 6.0
UNSURE_N: Final = 1.0
"""Tension below which a sensor's word does not decide whether a rope that is dragged is taut."""
CLOSE_N: Final = 1e-6
CLOSE_M: Final = 1e-9


@njit(inline="always")
def grip(force: float, speed: float, load: float, ratio: float, calm: float) -> float:
    """Return the friction's factor at a tension and a sliding speed: load dependence times Stribeck."""
    factor = load_dependence(load, force)
    return factor if ratio == 1.0 else factor * stribeck(ratio, calm, speed)


@njit(inline="always")
def recalled(recent: float, speed: float, before: float, seconds: float, memory: float) -> float:
    """Return the lagged sliding speed of the friction, m/s, `seconds` after `recent` (Hess and Soom)."""
    if memory <= 0.0:
        return speed
    fade = math.exp(-seconds / memory)
    return fade * recent + (1.0 - fade) * 0.5 * (speed + before)


@njit(inline="always")
def stretch_of(force: float, linear: float, bend: float, toe: float) -> float:
    """Return the stretch at a tension, m: (10), continued along its tangent from 90 % of the turning point.

    `toe`: additional stretch of the first newtons; (10) was fitted from 20 N up.
    """
    force = max(force, 0.0)
    if toe != 0.0:
        return toe * (1.0 - math.exp(-force / TOE_N)) + stretch(force, linear, bend)
    return stretch(force, linear, bend)


@njit(inline="always")
def compliance_of(force: float, linear: float, bend: float, toe: float) -> float:
    """Return the slope of `stretch_of`, m/N; on (10)'s tangent that of (10), which serves a search as well."""
    force = max(force, 0.0)
    steep = linear + 2.0 * bend * force
    return steep if toe == 0.0 else steep + toe / TOE_N * math.exp(-force / TOE_N)


@njit(cache=True)
def over_fabric(
    end: Array, calmed: Array, exponent: Array, creep: Array, time: Array, fresh: Mask,
    linear: float, bend: float, toe: float, distance: float, shape: float,
    load: float, ratio: float, calm: float, memory: float, slack_n: float,
) -> Array:
    """Return the tension before the knee, N, from that behind it; `exponent` is μ2·φ at each sample.

    `calmed`: the same tension without its sensor's noise, whose stretch slides the fabric.
    """
    out = np.empty(end.size)
    s, q = np.zeros(FABRIC_NODES), np.zeros(FABRIC_NODES)
    recent, before = np.zeros(FABRIC_NODES), np.zeros(FABRIC_NODES)
    for k in range(end.size):
        force, moved, at = end[k], calmed[k], 0.0
        for i in range(FABRIC_NODES):
            at += SHARES[i] * (stretch_of(moved, linear, bend, toe) + creep[k])
            if fresh[k] or end[k] < slack_n:
                s[i] = 0.0
            else:
                s[i] = presliding_shaped(s[i], at - q[i], distance, shape)
            if ratio != 1.0 and not fresh[k]:
                speed = (at - q[i]) / (time[k] - time[k - 1])
                recent[i] = recalled(recent[i], speed, before[i], time[k] - time[k - 1], memory)
                before[i] = speed
            q[i] = at
            if s[i] != 0.0:
                factor = math.exp(s[i] * exponent[k] / FABRIC_NODES * grip(force, recent[i], load, ratio, calm))
                force *= factor
                moved *= factor
        out[k] = force
    return out


@njit(cache=True)
def along_cable(
    tension: Array, position: Array, exponent: Array, time: Array, fresh: Mask,
    distance: float, shape: float, compliance: float,
    load: float, ratio: float, calm: float, memory: float, slack_n: float, gain: float,
) -> tuple[Array, Array]:
    """Return (START tension, N, mean slip state) from the tension behind the cable and the drum's position.

    The rope slides by x − c·T_START, c the `compliance` before the friction: T_START is solved for in each
    sample (monotone, with a kink where the rope turns: Newton while it halves the miss, else bisection).
    `gain`: START per tension behind the cable without friction.
    """
    start, mean = np.empty(tension.size), np.empty(tension.size)
    s, u, per_m = np.zeros(CABLE_NODES), 0.0, 1.0 / (distance * SPREAD)
    trial, left, back = np.zeros(CABLE_NODES), np.zeros(CABLE_NODES), np.zeros(CABLE_NODES)
    recent, before, taken = 0.0, 0.0, 0.0
    for k in range(tension.size):
        base = gain * tension[k]
        if ratio != 1.0 and not fresh[k]:
            # what the rope's stretch takes of the drum's speed is that of the sample before
            seconds = time[k] - time[k - 1]
            speed = (position[k] - position[k - 1] - taken) / seconds
            recent, before = recalled(recent, speed, before, seconds, memory), speed
        force, target = base, base
        if fresh[k] or tension[k] < slack_n:
            s[:] = 0.0
        else:
            whole = exponent[k] * grip(tension[k], recent, load, ratio, calm) / CABLE_NODES
            high = abs(base) * math.exp(abs(whole) * CABLE_NODES)
            low, known, known_back, last = -high, False, False, np.inf
            force = start[k - 1] * (tension[k] / tension[k - 1] if tension[k - 1] != 0.0 else 1.0)
            force = min(max(force, low), high)
            for _ in range(ITERATIONS):
                step = position[k] - compliance * force - u
                if step > 0.0 and not known:
                    known = True
                    for i in range(CABLE_NODES):
                        left[i] = presliding_left(s[i], 1.0, shape)
                elif step <= 0.0 and not known_back:
                    known_back = True
                    for i in range(CABLE_NODES):
                        back[i] = presliding_left(s[i], -1.0, shape)
                turn, steep = 0.0, 0.0
                for i in range(CABLE_NODES):
                    travel = abs(step) * per_m[i]
                    if step > 0.0:
                        trial[i], rate = presliding_from(left[i], 1.0, travel, shape)
                    else:
                        trial[i], rate = presliding_from(back[i], -1.0, travel, shape)
                    turn += trial[i]
                    steep += rate * per_m[i]
                target = capstan(base, whole * turn)
                miss = force - target
                if abs(miss) < CLOSE_N:
                    break
                if miss > 0.0:
                    high = force
                else:
                    low = force
                newton = force - miss / (1.0 + abs(target * whole) * steep * compliance)
                newton = min(max(newton, low), high)  # a rope that slides in full is at the end of its bracket
                falls = abs(miss) < 0.5 * last
                force, last = newton if falls else 0.5 * (low + high), abs(miss)
            s[:] = trial
        u = position[k] - compliance * force
        start[k], mean[k] = target, (s[0] + s[1] + s[2]) / CABLE_NODES
        taken = 0.0 if fresh[k] else compliance * (target - start[k - 1])
    return start, mean


@njit(inline="always")
def _slid(s: float, ahead: float, back: float, travel: float, shape: float) -> tuple[float, float, float, float]:
    """Return the state after `travel`, in units of δ, and its slope; then `presliding_left` towards +1 and −1.

    Of those two, a negative one was not needed yet.
    """
    if travel > 0.0:
        ahead = presliding_left(s, 1.0, shape) if ahead < 0.0 else ahead
        state, rate = presliding_from(ahead, 1.0, travel, shape)
    else:
        back = presliding_left(s, -1.0, shape) if back < 0.0 else back
        state, rate = presliding_from(back, -1.0, -travel, shape)
    return state, rate, ahead, back


@njit(inline="always")
def _expected(node: int, moved: float, strain: float) -> float:
    """Return the slip of a node if the path stretches evenly, m, from the drum's motion and the path's strain.

    The cable's nodes are last.
    """
    return moved if node == FABRIC_NODES else (SHARE_AFTER + SHARE_OVER * (node + 0.5) / FABRIC_NODES) * strain


@njit(cache=True)
def from_motion(
    drum: Array, anchor: Array, time: Array, fresh: Mask, fabric: Array, cable: Array,
    linear: float, bend: float, toe: float, compliance: float, creep_rate: float, creep_time: float, distance_f: float,
    distance: float, shape: float, load: float, ratio: float, calm: float, memory: float,
) -> tuple[Array, Array]:
    """Return (END, START) tension, N, required by the positions of drum and leg anchor, m: (10), (11), (3), (7).

    `linear`, `bend`: the whole path's stretch, of which `compliance` is the rope's own, before the friction. END is
    found in each sample by Newton's method kept in its bracket (monotone); zero if the rope is slack. It is one
    function because numba counts references of arrays passed on within a loop, which costs more than the computation.
    """
    n, nodes = drum.size, FABRIC_NODES + CABLE_NODES
    end_out, start_out = np.zeros(n), np.zeros(n)
    s, u, new_s, new_u = np.zeros(nodes), np.zeros(nodes), np.zeros(nodes), np.zeros(nodes)
    ahead, back, slow, per_m = np.zeros(nodes), np.zeros(nodes), np.ones(FABRIC_NODES + 1), np.empty(nodes)
    per_m[:FABRIC_NODES], per_m[FABRIC_NODES:] = 1.0 / distance_f, 1.0 / (distance * SPREAD)
    own = max(linear - compliance, 1e-6)
    slid, speed, lacks = np.zeros(FABRIC_NODES + 1), np.zeros(FABRIC_NODES + 1), np.zeros(FABRIC_NODES + 1)
    gamma, end, slope, before = 0.0, 0.0, linear, 0.0
    for k in range(n):
        seconds, moved, strain = 0.0, 0.0, 0.0
        if not fresh[k]:
            seconds, moved = time[k] - time[k - 1], drum[k] - drum[k - 1]
            strain = moved - anchor[k] + anchor[k - 1]
        if ratio != 1.0 and not fresh[k]:
            for i in range(FABRIC_NODES + 1):
                rate = _expected(i, moved, strain) / seconds + lacks[i]
                slid[i] = recalled(slid[i], rate, speed[i], seconds, memory)
                speed[i] = rate
        if fresh[k]:
            gamma = 0.0
        elif creep_rate > 0.0:
            fade = math.exp(-seconds / creep_time)
            gamma = gamma * fade + creep_rate * end * (1.0 - fade)
        if drum[k] - anchor[k] - gamma <= 0.0 or fresh[k]:
            end, before = 0.0, 0.0
            for i in range(nodes):
                s[i] = 0.0
                u[i] = ((SHARE_AFTER + SHARE_OVER * (i + 0.5) / FABRIC_NODES) * gamma if i < FABRIC_NODES
                        else anchor[k] + gamma)
            for i in range(FABRIC_NODES + 1):
                lacks[i] = 0.0
            continue
        for i in range(FABRIC_NODES + 1):
            slow[i] = 1.0 if ratio == 1.0 else stribeck(ratio, calm, slid[i])
        for i in range(nodes):
            ahead[i], back[i] = -1.0, -1.0
        low, high, start, missed = 0.0, 1e6, 0.0, np.inf
        guess = max(end + (drum[k] - anchor[k] - before) / slope, 1e-3)
        for _ in range(ITERATIONS):
            end = guess
            # force and at: tension and position along the path from END to the drum; pull and steep: their slopes
            force, pull, at, steep = end, 1.0, 0.0, 0.0
            for i in range(FABRIC_NODES):
                at += SHARES[i] * (stretch_of(force, own, bend, toe) + gamma)
                steep += SHARES[i] * pull * compliance_of(force, own, bend, toe)
                new_u[i] = at
                new_s[i], rate, ahead[i], back[i] = _slid(s[i], ahead[i], back[i], (at - u[i]) * per_m[i], shape)
                whole = fabric[k] * load_dependence(load, force) * slow[i] / FABRIC_NODES
                factor = capstan(1.0, new_s[i] * whole)
                pull = factor * (pull + force * whole * rate * per_m[i] * steep)
                force *= factor
            at += anchor[k] + SHARES[FABRIC_NODES] * (stretch_of(force, own, bend, toe) + gamma)
            steep += SHARES[FABRIC_NODES] * pull * compliance_of(force, own, bend, toe)
            whole = cable[k] * load_dependence(load, force) * slow[FABRIC_NODES] / CABLE_NODES
            turn, turning = 0.0, 0.0
            for i in range(FABRIC_NODES, FABRIC_NODES + CABLE_NODES):
                new_u[i] = at
                new_s[i], rate, ahead[i], back[i] = _slid(s[i], ahead[i], back[i], (at - u[i]) * per_m[i], shape)
                turn += new_s[i]
                turning += rate * per_m[i]
            factor = capstan(1.0, whole * turn)
            pull = factor * (pull + force * whole * turning * steep)
            start = force * factor
            slope = min(max(steep + compliance * pull, 0.2 * own), 20.0 * own)
            miss = at + compliance * start - drum[k]
            if abs(miss) < CLOSE_M or high - low < CLOSE_N:
                # what is left is made up along the slope
                end, start = end - miss / slope, start - pull * miss / slope
                break
            if miss > 0.0:
                high = end
            else:
                low = end
            guess = end - miss / slope
            if not low < guess < high or abs(miss) > 0.5 * missed:
                guess = 0.5 * (low + min(high, 2.0 * end + 1.0))
            missed = abs(miss)
        if ratio != 1.0 and before > 0.0:
            for i in range(FABRIC_NODES + 1):
                lacks[i] = (new_u[i] - u[i] - _expected(i, moved, strain)) / seconds
        for i in range(nodes):
            s[i], u[i] = new_s[i], new_u[i]
        before = drum[k] - anchor[k]
        end_out[k], start_out[k] = end, start
    return end_out, start_out


@njit(cache=True)
def read_at_start(
    start: Array, speed: Array, measured: Array, progress: Array, viscous: float, pressed_n: float, slack_n: float,
    gain: float, offset: float, drift: float,
) -> Array:
    """Return the START sensor's reading, N, of the tension `start` with the rope's viscous drag added while taut.

    `pressed_n` above 0: tension from which the rope is pressed to its sheath and drags in full; in proportion below.
    `slack_n` above 0: a rope that can be slack never pushes. Its drag at the edge of slack is anything from none to
    all of it, and END cannot determine it. Below `UNSURE_N` the result is START itself (`measured`, N, empty without
    one) within that range. Up to twice that the range narrows to the equation, since a step there would depend on
    each constant.
    """
    out = np.empty(start.size)
    for k in range(start.size):
        force = start[k]
        shift = offset + drift * progress[k]
        drag = viscous * speed[k]
        if drag != 0.0 and slack_n <= 0.0:
            force += drag
        elif drag != 0.0:
            least = min(force, 0.0)
            pressed = min(max(force, 0.0) / pressed_n, 1.0) if pressed_n > 0.0 else 1.0
            dragged = max(force + drag * pressed * min(max(2.0 * force, 0.0), 1.0), least)
            unsure = min(max(2.0 - force / UNSURE_N, 0.0), 1.0) if measured.size > 0 else 0.0
            if unsure > 0.0:
                taut = max(force + drag, least)
                said = (measured[k] - shift) / gain
                low, high = min(force, taut), max(force, taut)
                dragged = min(max(said, dragged + unsure * (low - dragged)), dragged + unsure * (high - dragged))
            force = dragged
        out[k] = gain * force + shift
    return out


@njit(cache=True)
def toed(end: Array, middle: Array, before: Array, shares: Array) -> Array:
    """Return e^(−T/TOE_N) − 1 of the tensions along the fabric, N, by their shares."""
    out = np.empty(end.size)
    for k in range(end.size):
        out[k] = (shares[0] * math.expm1(-max(end[k], 0.0) / TOE_N)
                  + shares[1] * math.expm1(-max(middle[k], 0.0) / TOE_N)
                  + shares[2] * math.expm1(-max(before[k], 0.0) / TOE_N))
    return out
