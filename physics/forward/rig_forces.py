"""Forces of a rig other than the bench from its measured motion, for a batch of sets of constants.

Each function takes constants by name, of shape (sets, 1), and signals of shape (samples,), SI, and returns an array of
shape (sets, samples).  A set of constants is a row of `physics.forward.rig_constants`.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numba import njit

from physics.forward.rig_constants import BETWEEN, LINK, RigColumns, RigScale, gravity_of, links_of
from physics.laws import Array

Constants = Mapping[str, Array]


class RigMotion(NamedTuple):
    """Motion of a rig: position `x`, m or rad, its derivatives `v` and `a`; progress of the recording, 0 … 1.

    `links`: angle against the base, rad, and its two derivatives, of each link of an arm, shape (3, joints, samples).
    """

    x: Array
    v: Array
    a: Array
    progress: Array
    links: Array


@njit(cache=True)
def dahl_states(rope, travels):  # type: ignore[no-untyped-def]
    """Return the friction state −1…1 for each pre-sliding distance, shape (travels, samples)."""
    out = np.zeros((travels.size, rope.size))
    for j in range(travels.size):
        s = 0.0
        for i in range(1, rope.size):
            # backward Euler of Dahl's ds/dx = (1 − s·sgn v)/δ: stable for any step
            way = (rope[i] - rope[i - 1]) / travels[j]
            s = (s + way) / (1.0 + abs(way))
            out[j, i] = s
    return out


def drive_friction(given: Constants, motion: RigMotion, load: Array, speed: float) -> Array:
    """Return the friction force of a drive by the equation of `physics.effects.rig_hypotheses`.

    `load`: relative to its RMS or scale.  `speed`: RMS speed, at which the Stribeck curve is 1, so that `friction` is
    the sliding friction of the trials that gave it.
    """
    travels, row = np.unique(given["drive_travel"][:, 0], return_inverse=True)
    slip = dahl_states(motion.x, travels)[row.ravel()]
    curve, drag = _sliding(given, motion, "drive_", speed)
    dry, a, b = shares_of(given, "drive_")
    dry = dry * (1.0 + given["drive_asymmetry"] * slip)
    drag = drag + given["drive_viscous_asymmetry"] * np.abs(drag)
    return np.asarray(given["drive_friction"] * ((dry + a * load) * slip * curve + b * drag))


def _sliding(given: Constants, motion: RigMotion, prefix: str, speed: float) -> tuple[Array, Array]:
    """Return the Stribeck curve and the speed relative to its RMS `speed`, at which the curve is 1."""
    slow = given[prefix + "rest_speed"]
    curve = 1.0 + given[prefix + "rest"] * (np.exp(-((motion.v / slow) ** 2)) - np.exp(-((speed / slow) ** 2)))
    return curve, motion.v / speed


def shares_of(given: Constants | Mapping[str, float], prefix: str) -> tuple[Array, Array, Array]:
    """Return the shares of dry, load-dependent and viscous friction, whose sum is 1.

    The dry share is 1 less the other two, where positive, rounded over 0.02.
    """
    a, b = np.asarray(given[prefix + "load_share"]), np.asarray(given[prefix + "viscous_share"])
    dry = 0.5 * (1.0 - a - b + np.sqrt((1.0 - a - b) ** 2 + 4e-4))
    return dry / (dry + a + b), a / (dry + a + b), b / (dry + a + b)


def start_force(given: Constants, motion: RigMotion, end: Array, sense: float, scale: RigScale, step_s: float) -> Array:
    """Return START from END, N, by the capstan equation beside dry and viscous friction, offset and spring.

    START = ratio·END·e^(±c) + …, c = asinh(friction·load_share/T₀) the exponent μθ: at the RMS of END, T₀, that share
    of the friction is half of what START differs by between the two directions.  A cable that pushes has the friction
    of one that pulls as much.  `sense`: sign of friction over the motion, 1 if a growing position pulls.  The sheath
    begins `lead`·START behind the position.
    """
    curve, drag = _sliding(given, motion, "", scale.speed)
    dry, a, b = shares_of(given, "")
    size = given["friction"] * (1.0 + given["drift"] * (motion.progress - 0.5))
    ratio = given["ratio"] * (1.0 + given["ratio_slope"] * (motion.x - motion.x.mean()) / scale.stroke)
    free = ratio * end + given["offset"] + given["spring"] * (motion.x - motion.x.mean()) + sense * size * b * drag
    start = _stretched(motion.x, free, ratio * np.abs(end), np.arcsinh(size * a / scale.end) * curve,
                       size * dry * curve, given["travel"][:, 0], given["lead"][:, 0], sense)
    return late(start, given["start_lag"], step_s)


@njit(cache=True)
def _stretched(rope, free, load, wrap, dry, travel, lead, sense):  # type: ignore[no-untyped-def]
    """Return START, shape (sets, samples): `free` + `load`·(e^(±wrap·s) − 1) ± dry·s, s Dahl's state of the cable.

    The cable slides where the position less its stretch lead·START moves.  Each step is solved implicitly by Newton's
    method between no slip and the slip of an unchanged friction.
    """
    out = np.empty(free.shape)
    for j in range(free.shape[0]):
        s, out[j, 0] = 0.0, free[j, 0]
        for i in range(1, rope.size):
            f, t, w, d = free[j, i], load[j, i], sense * wrap[j, i], sense * dry[j, i]
            moved = rope[i] - rope[i - 1] + sense * lead[j] * out[j, i - 1]
            low, high = 0.0, (moved - sense * lead[j] * (f + t * (math.exp(w * s) - 1.0) + d * s)) / travel[j]
            way, was, grown = high, s, 1.0
            for _ in range(30):
                s = (was + way) / (1.0 + abs(way))
                grown = math.exp(w * s)
                left = way - (moved - sense * lead[j] * (f + t * (grown - 1.0) + d * s)) / travel[j]
                if abs(left) < 1e-7:
                    break
                if (left > 0.0) == (high > 0.0):
                    high = way
                else:
                    low = way
                # Newton's step on the slip, halved where it leaves the bracket
                slope = (1.0 - was * (1.0 if way > 0.0 else -1.0)) / (1.0 + abs(way)) ** 2
                way -= left / (1.0 + sense * lead[j] / travel[j] * (t * w * grown + d) * slope)
                if (way - low) * (way - high) >= 0.0:
                    way = 0.5 * (low + high)
            out[j, i] = f + t * (grown - 1.0) + d * s
    return out


def spring_force(given: Constants, motion: RigMotion, joint: Array, scale: RigScale, step_s: float) -> Array:
    """Return the force of the spring between drive and joint, N: k·e·(1 + c·e²) + d·ė, e its stretch."""
    stretch = motion.x - given["arm"] * joint - given["zero"]
    signal = given["stiffness"] * stretch * (1.0 + given["cubic"] * (stretch / (0.1 * scale.stroke)) ** 2) + (
        given["damping"] * np.gradient(stretch, step_s, axis=-1))
    return late(signal, given["start_lag"], step_s)


def drive_force(given: Constants, motion: RigMotion, start: Array | None, rig: RigColumns, scale: RigScale,
                step_s: float) -> Array:
    """Return the force that a drive reports: load, friction, inertia, offset, spring of position.

    The load is the torque of gravity on a turning axis, else START (None: no load).  A gear of a turning axis carries
    gravity and what accelerates the links, and its friction grows with both: in a free swing they cancel.
    """
    force = np.zeros_like(motion.x) if start is None else start
    rigid = given["inertia"] * motion.a
    if rig.turning:
        force = _gravity(given, motion.links, rig)
        rigid = rigid + sum(given[name] * torque for name, torque in link_torques(motion.links, rig).items())
    else:
        rigid = rigid + given["drive_spring"] * (motion.x - motion.x.mean())
    carried = force + rigid if rig.turning else force
    force = force + rigid + given["drive_offset"] + drive_friction(
        given, motion, np.abs(carried) / scale.spread["servo_force_n"], scale.speed)
    return late(force, given["drive_lag"], step_s) / given["demand_gain"]


def _gravity(given: Constants, links: Array, rig: RigColumns) -> Array:
    """Return the torque of gravity on the links that a drive of an arm moves, N·m."""
    named = [gravity_of(name, rig) for name in rig.moved]
    return np.asarray(sum(given[weight] * np.sin(angle + given[phase])
                          for (weight, phase), angle in zip(named, links[0, -len(named):], strict=True)))


def link_torques(links: Array, rig: RigColumns) -> dict[str, Array]:
    """Return the torque per unit of each inertia of an arm, by constant, each of shape (samples,).

    Lagrange's equations of a serial arm about parallel axes by the angles θ of its links against the base:
    τⱼ = Σ_{l≥j} Σₘ Aₗₘ·(cos(θₗ − θₘ)·θ̈ₘ + sin(θₗ − θₘ)·θ̇ₘ²).  The part of A of the own angle's acceleration is
    `inertia`.
    """
    angle, rate, acceleration = links
    single, pairs = links_of(rig)
    told = {LINK + name: acceleration[rig.joints.index(name)] for name in single}
    for first, second in pairs:
        a, b = rig.joints.index(first), rig.joints.index(second)
        apart = angle[a] - angle[b]
        torque = np.cos(apart) * acceleration[a] - np.sin(apart) * rate[a] ** 2
        if first in rig.moved:
            torque = torque + np.cos(apart) * acceleration[b] + np.sin(apart) * rate[b] ** 2
        told[f"{BETWEEN}{first}_{second}"] = torque
    return told


def late(signals: Array, lag_s: Array, step_s: float) -> Array:
    """Return signals delayed by a lag, s, that is short beside their changes; `step_s`: step of their time grid."""
    return np.asarray(signals - lag_s * np.gradient(signals, step_s, axis=-1))
