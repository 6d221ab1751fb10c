"""Forces of a rig other than the bench from its measured motion, for a batch of sets of constants.

Each function takes constants by name, of shape (sets, 1), and signals of shape (samples,), SI, and returns an array of
shape (sets, samples).  A set of constants is a row of `physics.rig_constants`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numba import njit

from physics.laws import Array
from physics.rig_constants import BETWEEN, LINK, RigColumns, RigScale, gravity_of, links_of

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
            way = (rope[i] - rope[i - 1]) / travels[j]
            s = (s + way) / (1.0 + abs(way))
            out[j, i] = s
    return out


def friction(given: Constants, motion: RigMotion, prefix: str, load: Array, speed: float) -> Array:
    """Return the friction force by the equation of `physics.effects.rig_hypotheses`.

    `load`: relative to its RMS or scale.  `speed`: RMS speed, at which the Stribeck curve is 1, so that `friction` is
    the sliding friction of the trials that gave it.
    """
    travels, row = np.unique(given[prefix + "travel"][:, 0], return_inverse=True)
    slip = dahl_states(motion.x, travels)[row.ravel()]
    a, b = given[prefix + "load_share"], given[prefix + "viscous_share"]
    dry = 1.0 - a - b
    dry = 0.5 * (dry + np.sqrt(dry * dry + 4e-4))
    slow = given[prefix + "rest_speed"]
    curve = 1.0 + given[prefix + "rest"] * (np.exp(-((motion.v / slow) ** 2)) - np.exp(-((speed / slow) ** 2)))
    drag = motion.v / speed
    size = given[prefix + "friction"]
    if prefix:
        dry = dry * (1.0 + given["drive_asymmetry"] * slip)
        drag = drag + given["drive_viscous_asymmetry"] * np.abs(drag)
    else:
        size = size * (1.0 + given["drift"] * (motion.progress - 0.5))
    return np.asarray(size * ((dry + a * load) * slip * curve + b * drag))


def start_force(given: Constants, motion: RigMotion, end: Array, sense: float, scale: RigScale, step_s: float) -> Array:
    """Return START from END, N: ratio by position, offset, spring, friction; `sense`: its sign over the motion."""
    rubbed = friction(given, motion, "", np.abs(end) / scale.end, scale.speed)
    ratio = given["ratio"] * (1.0 + given["ratio_slope"] * (motion.x - motion.x.mean()) / scale.stroke)
    return late(ratio * end + given["offset"] + given["spring"] * (motion.x - motion.x.mean()) + sense * rubbed,
                given["start_lag"], step_s)


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
    force = force + rigid + given["drive_offset"] + friction(
        given, motion, "drive_", np.abs(carried) / scale.spread["servo_force_n"], scale.speed)
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
