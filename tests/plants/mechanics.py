"""Servo, knee drive, leg and bridges: what moves and feels at both ends of the path, in steps of 50 µs.

The rule of this file: masses at the rope and at the knee, semi-implicit; the drives' own loops live in the devices,
here are torque lag (first or second order), friction and inertia.  A torque becomes force at the rope by the radius
that the servo's unit objects say (20 mm), whatever the bench's drum: its drive has the gear that goes with it.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from types import FunctionType

import numpy as np
from numba import njit

from tests.plants import bench as b
from tests.plants.bench import EDS_DRUM_M, END, GRAVITY, KNEE_AT_FIT, KNEES, MIDDLE, START

STEP_NS = 50_000
STEP_S = STEP_NS * 1e-9
RING_HZ = 9.0
RING_DAMPING = 0.06

(K_COULOMB, K_VISCOUS, K_VISCOUS_ASYM, K_OFFSET, K_ASYM, K_PRESLIDING, K_MASS, K_LAG, K_ORDER, K_GAIN, K_LIMIT, K_DRUM,
 K_ECC, K_PHASE, K_ZERO, K_ARM, K_ARM2, K_PLAY, K_PLAY_S, K_PLAY_NM, K_KNEE, K_INERTIA, K_WEIGHT, K_RUB, K_KNEE_VISCOUS,
 K_KNEE_LAG, K_START_LAG, K_END_LAG, K_FILTER, K_MASS_END, K_ARM_END, K_RING) = range(32)
"""Places of the parameters."""

X, V, FORCE, RATE, RUB, Q, W, TORQUE, KNEE_RUB, LEG, OLD_LEG, LEG_RATE, LEG_SWING, FELT_START, FELT_END, FELT_LATE, \
    RINGING, RING_RATE, OLD_END, DONE, STATES = range(21)
"""Places of the state: rope and its speed, servo force and its rate, servo's bristle; knee motor's angle, speed,
torque, bristle; the leg and what follows from it; the bridges; steps done."""


def parameters(bench: b.Bench) -> np.ndarray:
    """The flat parameters."""
    return np.array([
        bench.drive_coulomb, bench.drive_viscous, bench.drive_viscous_asymmetry, bench.drive_offset,
        bench.drive_asymmetry, bench.drive_presliding, bench.drive_kg, bench.drive_lag, bench.structure.drive_order,
        bench.demand_gain, bench.force_limit, bench.drum, bench.eccentricity, bench.eccentricity_phase,
        bench.zero + bench.slack, bench.moment_arm, bench.moment_arm2, bench.play, bench.play_s, bench.play_nm,
        KNEES.index(bench.structure.knee), bench.leg_inertia, bench.leg_weight, bench.knee_rub, bench.knee_viscous,
        bench.knee_lag, bench.start_lag, bench.end_lag, bench.end_filter, bench.end_mass, bench.end_arm,
        bench.resonance])


@njit
def anchor(k, leg):
    """Displacement of the rope's anchor on the leg, m: zero at 13 % of gait."""
    on = leg - KNEE_AT_FIT
    return k[K_ARM] * on + k[K_ARM2] * on * on


@njit
def paid(k, encoder):
    """Rope at the drum, m, for the encoder's reading: without zero and slack, with what an eccentric drum adds."""
    return encoder - k[K_ZERO] + k[K_ECC] * (math.sin(encoder / k[K_DRUM] + k[K_PHASE]) - math.sin(k[K_PHASE]))


@njit
def follow(k, leg, knee, load_nm, dt):
    """The leg's angle behind the knee motor's, `dt` later; `load_nm`: what pulls the leg towards extension."""
    half = 0.5 * k[K_PLAY]
    if half == 0.0:
        return knee
    if int(k[K_KNEE]) == 0:
        target = knee + half * math.tanh(load_nm / k[K_PLAY_NM])
        leg += (target - leg) * (1.0 - math.exp(-dt / k[K_PLAY_S]))
    return min(max(leg, knee - half), knee + half)


@njit
def bristle(s, way):
    """Dahl's state after a way in units of its length."""
    sign = 1.0 if way >= 0.0 else -1.0
    return sign + (s - sign) * math.exp(-abs(way))


@njit
def servo_friction(k, s, v):
    """The servo's friction at the rope, N."""
    return (k[K_COULOMB] * s * (1.0 + k[K_ASYM] * s) + k[K_VISCOUS] * (v + k[K_VISCOUS_ASYM] * abs(v)) + k[K_OFFSET])


@njit
def move(m, k, servo_nm, knee_nm, start, middle):
    """Move servo, knee drive and leg by one step under held torques and the path's tensions."""
    dt = STEP_S
    asked = k[K_GAIN] * servo_nm / EDS_DRUM_M
    if k[K_ORDER] == 1.0:
        m[FORCE] += (asked - m[FORCE]) * (1.0 - math.exp(-dt / k[K_LAG]))
    else:
        w = 1.0 / k[K_LAG]
        m[RATE] += dt * (w * w * (asked - m[FORCE]) - 1.6 * w * m[RATE])
        m[FORCE] += dt * m[RATE]
    force = min(k[K_LIMIT], max(-k[K_LIMIT], m[FORCE]))
    pull = start * (1.0 + k[K_ECC] / k[K_DRUM] * math.cos(m[X] / k[K_DRUM] + k[K_PHASE]))
    m[V] += dt / k[K_MASS] * (force - pull - servo_friction(k, m[RUB], m[V]))
    m[X] += dt * m[V]
    m[RUB] = bristle(m[RUB], dt * m[V] / k[K_PRESLIDING])
    lever = k[K_ARM] + 2.0 * k[K_ARM2] * (m[LEG] - KNEE_AT_FIT)
    load = lever * middle - k[K_WEIGHT] * math.sin(m[LEG])
    m[TORQUE] += (knee_nm - m[TORQUE]) * (1.0 - math.exp(-dt / k[K_KNEE_LAG]))
    loss = k[K_RUB] * m[KNEE_RUB] + k[K_KNEE_VISCOUS] * m[W]
    m[W] += dt / k[K_INERTIA] * (m[TORQUE] + load - loss)
    m[Q] += dt * m[W]
    m[KNEE_RUB] = bristle(m[KNEE_RUB], dt * m[W] / 1e-3)
    m[OLD_LEG] = m[LEG]
    m[LEG] = follow(k, m[LEG], m[Q], load, dt)
    rate = (m[LEG] - m[OLD_LEG]) / dt
    m[LEG_SWING] = (rate - m[LEG_RATE]) / dt
    m[LEG_RATE] = rate


@njit
def feel(m, k, z):
    """Let the bridges follow the tensions by one step: own lag, END's mass and filter, a cantilever that rings."""
    dt = STEP_S
    end = z[END]
    if k[K_RING] > 0.0:
        w = 2.0 * math.pi * RING_HZ
        m[RING_RATE] += dt * (-w * w * m[RINGING] - 2.0 * RING_DAMPING * w * m[RING_RATE]) + k[K_RING] * (
            end - m[OLD_END]) * w
        m[RINGING] += dt * m[RING_RATE]
    m[OLD_END] = end
    carried = end + m[RINGING] + k[K_MASS_END] * (GRAVITY * math.cos(m[LEG]) + k[K_ARM_END] * m[LEG_SWING])
    m[FELT_START] += (z[START] - m[FELT_START]) * (1.0 - math.exp(-dt / k[K_START_LAG]))
    m[FELT_LATE] += (carried - m[FELT_LATE]) * (1.0 - math.exp(-dt / k[K_END_LAG]))
    fade = 1.0 - math.exp(-dt / k[K_FILTER]) if k[K_FILTER] > 0.0 else 1.0
    m[FELT_END] += (m[FELT_LATE] - m[FELT_END]) * fade


def digest() -> int:
    """A number of the compiled sources: numba's cache does not see a change in an imported module."""
    here = Path(__file__).parent
    laws = [here / f"{name}.py" for name in ("bench", "friction", "mechanics", "stretch")]
    text = b"".join(path.read_bytes() for path in (*laws, *sorted(here.glob("path_*.py"))))
    return int.from_bytes(hashlib.sha256(text).digest()[:7], "big")


SOURCES = digest()


# ---- what is compiled for each method: the loops below, with its `step`, `EVERY` and `SUBSTEP_S` ----


def _loops(sources: int, every: int, substep_s: float):
    """The loops as written, `step` a name that `loops` gives a meaning to."""
    def drive(count, m, k, z, p, servo_nm, knee_nm):
        _ = sources
        for _ in range(count):
            move(m, k, servo_nm, knee_nm, z[START], z[MIDDLE])
            m[DONE] += 1.0
            if m[DONE] % every == 0.0:
                leg = m[LEG]
                step(z, p, paid(k, m[X]), anchor(k, leg), leg, every * STEP_S)  # noqa: F821 (bound by `loops`)
            feel(m, k, z)

    def run(k, z, p, time, encoder, knee, weight, start, middle, end, legs):
        _ = sources
        leg = legs[0]
        for i in range(time.size):
            h = time[i] - time[i - 1] if i else substep_s
            count = max(1, math.ceil(h / max(substep_s, 1e-3)))
            x0, q0 = (encoder[i - 1], knee[i - 1]) if i else (encoder[i], knee[i])
            for j in range(1, count + 1):
                x, q = x0 + (encoder[i] - x0) * j / count, q0 + (knee[i] - q0) * j / count
                load = k[K_ARM] * z[MIDDLE] - weight * math.sin(leg)
                leg = follow(k, leg, q, load, h / count)
                step(z, p, paid(k, x), anchor(k, leg), leg, h / count)  # noqa: F821 (bound by `loops`)
            start[i], middle[i], end[i], legs[i] = z[START], z[MIDDLE], z[END], leg

    return drive, run


def loops(step: Callable, method: str, every: int, substep_s: float) -> tuple[Callable, Callable]:
    """Compile (drive, run) of a method: its path's `step(z, p, x, w, theta, dt)` in every `every`-th mechanical step.

    `step` is a global of the loops and not an argument, and their names have the `method` in them: so numba's cache
    finds each method's own on disk, which it does for no function that closes over a compiled one.
    """
    made = []
    for loop in _loops(SOURCES, every, substep_s):
        own = FunctionType(loop.__code__, {**globals(), "step": step}, loop.__name__, None, loop.__closure__)
        own.__qualname__ = f"{method}.{loop.__name__}"
        made.append(njit(cache=True)(own))
    return made[0], made[1]
