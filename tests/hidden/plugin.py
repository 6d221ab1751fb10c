"""The bench of `truth` behind the real nodes: a plug-in plant, one factory for each hidden effect.

The rule of this file: `tests.hidden.plugin:healthy`, `…:EFFECT`, `…:EFFECT+EFFECT` and `…:resonance`, which is outside
the catalogue, are factories as `bowden.plants` has them; what is hidden is drawn from the seed, nothing of the
package's laws is used, and only what devices can feel comes out.  Mechanics: two inertias with friction, leap-frog at
50 µs around the quasi-static chain.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numba import njit

from tests.hidden import cases, truth
from tests.hidden.bench import K2, THETA_13, Bench, chain, like, zero

STEP_NS = 50_000
DRUM_M = 0.020
LEG_INERTIA, LEG_MOMENT_NM, KNEE_RUB_NM, KNEE_DRAG = 0.05, 1.1, 0.35, 0.15
STILL_M_S, STILL_RAD_S = 1.5e-3, 2e-3
START_SLACK_M = 0.012
SLOW_S = 0.03
"""Memory of the coloured noise."""


class Outputs(NamedTuple):
    """What the bench's devices can feel."""

    servo_position_m: float
    servo_velocity_m_s: float
    knee_motor_rad: float
    knee_motor_rad_s: float
    knee_angle_rad: float
    start_n: float
    end_n: float


@njit(cache=True)
def steps(count, s, servo_nm, knee_nm, m, p, span, old, new, z, z_new, widths, weights, slopes):
    """Move `count` steps on; `s`: rope, its speed, knee, its speed, leg, END, START, creep, time, knee acceleration."""
    dt = STEP_NS * 1e-9
    for _ in range(count):
        x, v, q, w = s[0], s[1], s[2], s[3]
        rub = math.tanh(v / STILL_M_S)
        pull = s[6] * (1.0 + m[7] / DRUM_M * math.cos(x / DRUM_M + m[8]))
        force = servo_nm / DRUM_M - pull - m[0] * rub * (1.0 + m[1] * rub) - m[2] * v - m[3]
        v += dt * force / m[4]
        x += dt * v
        arm = K2 + 2.0 * m[6] * (s[4] - THETA_13)
        torque = knee_nm + arm * s[5] - LEG_MOMENT_NM * math.sin(s[4])
        w += dt * (torque - KNEE_RUB_NM * math.tanh(w / STILL_RAD_S) - KNEE_DRAG * w) / LEG_INERTIA
        q += dt * w
        leg = min(max(s[4], q - 0.5 * m[5]), q + 0.5 * m[5])
        s[9] = (w - s[3]) / dt
        taken = K2 * (leg - THETA_13) + m[6] * (leg - THETA_13) ** 2
        paid = x + m[7] * math.sin(x / DRUM_M + m[8]) + m[9]
        s[8] += dt
        s[5], s[6], s[7] = truth.advance(
            paid, taken, leg, v, s[8], dt, p, span, s[7], s[5], old, new, z, z_new, widths, weights, slopes)
        s[0], s[1], s[2], s[3], s[4] = x, v, q, w, leg


class Plant:
    """One bench of `Bench`'s numbers; see docs/plants.md for the protocol."""

    def __init__(self, bench: Bench, seed: int) -> None:
        self.bench, self.seed = bench, seed
        self.p, self.widths, self.weights, self.slopes = chain(bench)
        self.m = np.array([bench.drive_coulomb, bench.drive_asymmetry, bench.drive_viscous, bench.drive_offset,
                           bench.drive_inertia, bench.backlash, bench.arm2, bench.ecc, bench.ecc_phase, zero(bench)])
        self.reset(0)

    def reset(self, time_ns: int) -> Outputs:
        """At rest, upright, the rope slack."""
        self.now_ns, self.done = time_ns, time_ns
        self.noise = np.random.default_rng((self.seed, 5))
        self.slow = np.zeros(2)
        self.s = np.zeros(10)
        self.s[0] = -K2 * THETA_13 - self.m[9] - START_SLACK_M
        self.old, self.new = np.full(truth.NODES, -K2 * THETA_13), np.zeros(truth.NODES)
        self.z, self.z_new = np.zeros((truth.NODES, truth.STOPS)), np.zeros((truth.NODES, truth.STOPS))
        self.lagged = self.was = self.rate = 0.0
        self.ring = np.zeros(2)
        return self.felt()

    def advance(self, until_ns: int, servo_torque_nm: float, knee_torque_nm: float) -> Outputs:
        """Up to the last whole step not after `until_ns`."""
        if until_ns < self.now_ns or not math.isfinite(servo_torque_nm + knee_torque_nm):
            raise ValueError("time falls or a torque is not finite")
        self.now_ns = until_ns
        count = (until_ns - self.done) // STEP_NS
        self.done += count * STEP_NS
        steps(count, self.s, servo_torque_nm, knee_torque_nm, self.m, self.p, SPAN_S, self.old, self.new, self.z,
              self.z_new, self.widths, self.weights, self.slopes)
        self._colour(count)
        return self.felt()

    def _colour(self, count: int) -> None:
        dt = count * STEP_NS * 1e-9
        fade = math.exp(-dt / SLOW_S)
        self._ring(dt)
        self.slow = fade * self.slow + math.sqrt(1.0 - fade**2) * self.bench.coloured * self.noise.normal(size=2)
        if self.bench.end_filter > 0.0:
            self.lagged += (self._carried() - self.lagged) * (1.0 - math.exp(-dt / self.bench.end_filter))

    def _ring(self, dt: float) -> None:
        """A cantilever at 9 Hz that END's changes kick: some `resonance` N on the gait's loading."""
        if self.bench.resonance > 0.0 and dt > 0.0:
            w, rate = 2.0 * math.pi * 9.0, (self.s[5] - self.was) / dt
            self.ring[1] += dt * (-w * w * self.ring[0] - 0.1 * w * self.ring[1]) + RING * (rate - self.rate)
            self.ring[0] += dt * self.ring[1]
            self.was, self.rate = float(self.s[5]), rate

    def _carried(self) -> float:
        return float(self.s[5] + self.bench.end_mass * (9.81 * math.cos(self.s[4]) + self.bench.end_arm * self.s[9]))

    def felt(self) -> Outputs:
        """What the devices feel now."""
        b, s = self.bench, self.s
        share = min(1.0, self.done * 1e-9 / SPAN_S)
        end = self.lagged if b.end_filter > 0.0 else self._carried()
        return Outputs(
            float(s[0]), float(s[1]), float(s[2]), float(s[3]), float(s[4]),
            float(b.start_gain * s[6] + b.start_offset + b.start_drift * share + self.slow[0]),
            float(b.end_gain * end + b.end_offset + b.end_drift * share + self.slow[1] + b.resonance * self.ring[0]))

    def truth(self) -> Mapping[str, float]:
        """The true END force, for the truth file only."""
        return {"true_end_n": float(self.s[5]), "true_start_n": float(self.s[6])}


RING = 0.15
"""The share of END's acceleration that the cantilever takes, for 1 N of `resonance`."""
SPAN_S = 20.0
"""Time over which what drifts does so."""
OUTSIDE = "resonance"
ELSEWHERE = frozenset({"end_delay", "timestamp_skew"})
"""Effects that a bridge has not: dead times are the converter's and the bus's."""


def drawn(effect: str, seed: int) -> Bench:
    """The bench of a seed: every second one altered in structure, one like the others, with `effect` hidden in it."""
    rng = np.random.default_rng((seed, 6))
    own = like(cases.structure(seed, seed % 2 == 1), int(rng.integers(1 << 30)))
    if effect == "healthy":
        return own
    if effect == OUTSIDE:
        return dataclasses.replace(own, **cases.OUTSIDE[effect](rng))
    for name in effect.split("+"):
        own = dataclasses.replace(own, **cases.EFFECTS[name](rng, own)[0])
    return own


def __getattr__(name: str) -> Callable[[dict[str, float], int], Plant]:
    """`healthy`, `resonance`, an effect's name or two joined by +: its factory."""
    if name not in ("healthy", OUTSIDE) and set(name.split("+")) - (set(cases.EFFECTS) - ELSEWHERE):
        raise AttributeError(name)
    return lambda parameters, seed: Plant(drawn(name, seed), seed)
