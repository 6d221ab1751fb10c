"""The Bowden cable: a wire rope in a sheath, as lumped segments with capstan friction and pre-sliding.

The rule of this file: (3) distributed along the sheath.  A node that slides over dθ satisfies
T1/T2 = e^(μ·dθ) exactly: the friction force is s·(T1 + T2)·tanh(μ·dθ/2), s the pre-sliding state.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit

from physics.parameters import declared


@dataclass(frozen=True)
class CableParameters:
    """Parameters of rope, sheath and the friction between them."""

    mu1: float = declared("mu1")
    theta1_rad: float = declared("theta1")
    cable_bend: float = declared("cable_bend")
    load_slope: float = declared("load_slope")
    viscous: float = declared("viscous")
    stribeck_ratio: float = declared("stribeck_ratio")
    stribeck_speed_m_s: float = declared("stribeck_speed")
    stribeck_memory_s: float = declared("stribeck_memory")
    presliding_m: float = declared("presliding")
    friction_drift: float = declared("friction_drift")
    friction_drift_s: float = declared("friction_drift_time")
    lead_compliance: float = declared("lead_compliance")
    sheath_compliance: float = declared("sheath_compliance")
    slack_m: float = declared("slack")
    encoder_zero_m: float = declared("rope_zero")
    slack_drag: float = declared("slack_drag")


@njit(inline="always")
def spring(elongation: float, rate: float, stiffness: float, damping: float) -> float:
    """Return the tension of an element of rope, N: linear, never pushing; damping at most as large as the force."""
    elastic = stiffness * max(0.0, elongation)
    return elastic + min(elastic, max(-elastic, damping * rate))
