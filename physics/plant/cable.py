"""The Bowden cable: a wire rope in a sheath, as lumped segments with capstan friction and pre-sliding.

The rule of this file: (3) distributed along the sheath.  A node that slides over dθ satisfies
T1/T2 = e^(μ·dθ) exactly: the friction force is s·(T1 + T2)·tanh(μ·dθ/2), s the pre-sliding state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from numba import njit

from parameters import parameter


@dataclass(frozen=True)
class CableParameters:
    """Rope, sheath and the friction between them."""

    mu1: float = parameter(
        0.08, "", "friction coefficient μ1 of rope and sheath", low=0.0, high=0.5,
        source="assumed: lubricated steel in a lined sheath; with theta1 an exponent of 0.126")
    theta1_rad: float = parameter(
        math.pi / 2, "rad", "total bend θ1 of the sheath", low=0.0, high=4 * math.pi, source="assumed: a quarter turn")
    cable_bend: float = parameter(
        0.0, "1/rad", "κb: θ1 = θ10·(1 + κb·|θk|)", low=-0.7, high=2.0, source="assumed: the sheath is clamped")
    load_slope: float = parameter(
        0.0, "", "λ: μ1 and μ2 times 1 + λ·(T/40 N − 1)", low=-0.9, high=2.0,
        source="assumed: Amontons' law")
    viscous: float = parameter(
        0.0, "N·s/m", "viscous friction of rope in sheath, whole length", low=0.0, high=60.0,
        source="paper, 3.1: Coulomb friction only")
    stribeck_ratio: float = parameter(
        1.0, "", "static over sliding friction μs/μc, of rope and fabric", low=0.3, high=5.0,
        source="paper, 3.1: Coulomb friction only")
    stribeck_speed_m_s: float = parameter(
        0.01, "m/s", "Stribeck speed vs", low=5e-4, high=0.2, source="assumed: greased steel")
    stribeck_memory_s: float = parameter(
        20e-3, "s", "time by which the Stribeck curve lags the sliding speed", low=10e-3, high=0.1,
        source="assumed: frictional memory (Hess and Soom)")
    presliding_m: float = parameter(
        0.1e-3, "m", "rope travel δ over which friction turns over", low=0.02e-3, high=3e-3,
        source="assumed: Dahl model of tendon sheaths (Palli)")
    friction_drift: float = parameter(
        0.0, "", "relative change of μ1 and μ2 over friction_drift_s (wear, heat)", low=-0.95, high=5.0,
        source="assumed: none")
    friction_drift_s: float = parameter(
        20.0, "s", "time, from the start of the plant, that friction_drift refers to", low=1.0, high=1e6,
        source="assumed: ten gait cycles of 2 s")
    lead_compliance: float = parameter(
        0.024e-3, "m/N", "compliance of drum, START sensor and rope before the sheath", low=0.005e-3, high=0.1e-3,
        source="assumed: with pre-sliding, about 27 N/mm at the drum against a stuck rope")
    sheath_compliance: float = parameter(
        0.008e-3, "m/N", "compliance of the rope inside the sheath", low=0.002e-3, high=0.1e-3,
        source="assumed: 1 m of 1.5 mm rope")
    slack_m: float = parameter(
        0.0, "m", "length to be wound up before the rope is taut", low=-5e-3, high=20e-3, source="assumed: none")
    encoder_zero_m: float = parameter(
        9.7e-3, "m", "servo position of the taut, unloaded rope at the knee angle of 13 % of gait",
        low=-1.0, high=1.0, source="(10): ck")
    slack_drag: float = parameter(
        0.02, "N·s/m", "drag of a slack segment by its own weight", low=0.0, high=1.0,
        source="assumed: keeps a slack rope at rest; gone above 0.5 N")


@njit(inline="always")
def stribeck(ratio: float, speed: float, v: float) -> float:
    """Return the friction's factor at the sliding speed `v`: 1 + (μs/μc − 1)·e^(−(v/vs)²)."""
    return 1.0 + (ratio - 1.0) * math.exp(-((v / speed) ** 2))


@njit(inline="always")
def load_dependence(slope: float, tension: float) -> float:
    """Return the friction's factor at the tension, N: 1 + λ·(T/40 N − 1), at least 0.05."""
    return max(0.05, 1.0 + slope * (tension / 40.0 - 1.0))


@njit(inline="always")
def spring(elongation: float, rate: float, stiffness: float, damping: float) -> float:
    """Return the tension of an element of rope, N: linear, never pushing; damping at most as large as the force."""
    elastic = stiffness * max(0.0, elongation)
    return elastic + min(elastic, max(-elastic, damping * rate))
