"""Which cases count: whether the truth plant itself, its own constants free but without the effect, fits as well.

The rule of this file: no finder decides.  The healthy bench's constants are fitted to what the changed bench shows,
each held by the tolerance of like benches; what χ² that leaves above the truth's, in the trial's own noise, is how much
the data can tell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from tests.plants.bench import Bench, replaced
from tests.plants.imposed import Array, Motion, felt, forced, repeated

FORCE_NOISE_N = 0.3
COUNTS_FROM = 132.0
"""Least χ² that counts, as the bars are stated: 66 nats; thirty names give 3 by chance."""

BLOCK_S = 0.02
"""Blocks over which signals are averaged: where a loose rope snaps tight, single samples jump with the least change of
a constant, and the fit would end far from the truth.  What the wire does is in single samples: no blocks there."""
STEP = 0.1
"""Step of the slopes, in σ."""
TOLERANCE: dict[str, tuple[str, float]] = {
    "mu1": ("share", 0.03), "mu2": ("share", 0.05), "stiffness": ("share", 0.03), "zero": ("plus", 2e-4),
    "start_gain": ("plus", 0.003), "end_gain": ("plus", 0.003), "start_offset": ("plus", 0.1),
    "end_offset": ("plus", 0.1), "presliding": ("share", 0.2), "fabric_presliding": ("share", 0.2),
    "viscous": ("plus", 1.0), "wrap_slope": ("plus", 0.05), "curve": ("share", 0.02), "moment_arm": ("share", 0.003),
    "drive_coulomb": ("share", 0.1), "drive_viscous": ("share", 0.1), "drive_kg": ("share", 0.03),
}
"""Constant → how far like benches differ, 1σ: a share of it, or so much."""


def shown(bench: Bench, motion: Motion, rate_hz: int, noise_n: float, block_s: float = BLOCK_S) -> Array:
    """Means of START, END and servo force over blocks, in units of their noise, one after the other; noise-free."""
    bench = replaced(bench, drift_s=float(motion.time[-1]))
    true = forced(bench, motion.time, motion.rope, motion.knee)
    every = slice(None, None, round(1000 / rate_hz))
    start, end, force = (signal[every] for signal in felt(bench, motion, true))
    step = bench.quantum
    if step:
        start, end = step * np.round(start / step), step * np.round(end / step)
    given = {"time_s": motion.time[every], "servo_position_m": motion.rope[every], "servo_force_n": force,
             "knee_angle_rad": motion.knee[every], "tension_start_n": start, "tension_end_n": end}
    given = repeated(bench, given, np.random.default_rng(0))
    n = max(1, round(block_s * rate_hz))
    blocks = start.size // n

    def means(name: str, noise: float) -> Array:
        return given[name][: blocks * n].reshape(blocks, n).mean(axis=1) * (math.sqrt(n) / noise)

    return np.concatenate([means("tension_start_n", noise_n), means("tension_end_n", noise_n),
                           means("servo_force_n", FORCE_NOISE_N)])


def _moved(bench: Bench, sigmas: Mapping[str, float]) -> Bench:
    changes = {}
    for name, sigma in sigmas.items():
        kind, size = TOLERANCE[name]
        value = getattr(bench, name)
        changes[name] = value * (1.0 + size * sigma) if kind == "share" else value + size * sigma
    return replaced(bench, **changes)


def separation(healthy: Bench, changed: Bench, motion: Motion, noise_n: float, rate_hz: int = 1000,
               rounds: int = 10) -> float:
    """χ² that the best fit without the effect leaves above the truth, prior included; no noise is drawn.

    Levenberg–Marquardt on the constants of `TOLERANCE` in units of their σ, at most `rounds` slopes; it ends where a
    round gains less than 1 %.
    """
    block_s = 0.0 if changed.quantum or changed.lost_share or changed.late_share else BLOCK_S
    goal = shown(changed, motion, rate_hz, noise_n, block_s)

    def lacks(at: Array) -> Array:
        moved = _moved(healthy, dict(zip(TOLERANCE, at.tolist(), strict=True)))
        try:
            return np.concatenate([goal - shown(moved, motion, rate_hz, noise_n, block_s), -at])
        except ZeroDivisionError:  # a pre-sliding distance of 0, five σ below: no bench has it
            return np.full(goal.size + at.size, np.inf)

    at = np.zeros(len(TOLERANCE))
    rest = lacks(at)
    best, damping = float(rest @ rest), 1e-3
    for _ in range(rounds):
        slope = np.array([(rest - lacks(at + step)) / STEP for step in STEP * np.eye(at.size)]).T
        before = best
        square, pull = slope.T @ slope, slope.T @ rest
        for _ in range(5):
            tried = np.clip(at + np.linalg.solve(square + damping * np.diag(np.diag(square)), pull), -10.0, 10.0)
            there = lacks(tried)
            if there @ there < best:
                at, rest, best, damping = tried, there, float(there @ there), 0.3 * damping
                break
            damping *= 10.0
        if best > 0.99 * before:
            break
    return best


def counts(healthy: Bench, changed: Bench, motion: Motion, noise_n: float, rate_hz: int = 1000) -> bool:
    """Whether a case counts: the data can tell the changed bench from every like bench without the effect."""
    return separation(healthy, changed, motion, noise_n, rate_hz) >= COUNTS_FROM
