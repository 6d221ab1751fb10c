"""The fabric over the knee: quadratic stiffness, wrap friction, creep.

The rule of this file: the whole rope-and-fabric path stretches by (10); what the rope's own linear
compliance does not account for is the fabric's, by shares of its length.  A share w stretches by
w·(b·T + a·T²), a < 0, and is continued along its tangent from 90 % of the turning tension.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from numba import njit

from parameters import parameter
from physics import laws

TANGENT_FROM: Final = 0.9
"""Share of the turning tension −b/2a above which the stretch goes on linearly."""


@dataclass(frozen=True)
class FabricParameters:
    """The fabric and its friction over the knee."""

    mu2: float = parameter(
        0.15, "", "friction coefficient μ2 of fabric on the knee", low=0.0, high=1.0,
        source="assumed: with the wrap an exponent of 0.10 at 13–20 % of gait")
    wrap_rad: float = parameter(
        0.15, "rad", "wrap angle φ0 at the upright knee", low=0.0, high=4.0, source="assumed: strap held off the knee")
    fabric_wrap: float = parameter(
        1.0, "", "κ: φ = φ0 + κ·|θk|", low=0.0, high=4.0, source="assumed: the wrap grows with the flexion")
    fabric_presliding_m: float = parameter(
        0.1e-3, "m", "travel on the knee over which friction turns over", low=0.02e-3, high=3e-3,
        source="assumed: as the rope's")
    stretch_a: float = parameter(
        laws.STIFFNESS_A_MM_N2 * 1e-3, "m/N²", "quadratic coefficient of the whole stretch", low=-1e-5, high=-1e-8,
        source="(10): ak")
    stretch_b: float = parameter(
        laws.STIFFNESS_B_MM_N * 1e-3, "m/N", "linear coefficient of the whole stretch", low=5e-5, high=5e-3,
        source="(10): bk")
    stiffness_scale: float = parameter(
        1.0, "", "stiffness of rope and fabric against (10)", low=0.3, high=3.0, source="(10)")
    stiffness_shape: float = parameter(
        0.0, "", "relative change of the quadratic coefficient", low=-0.9, high=1.0, source="(10)")
    share_before: float = parameter(
        0.25, "", "share of the fabric between cable and knee", low=0.05, high=0.9, source="assumed: geometry")
    share_after: float = parameter(
        0.40, "", "share of the fabric between knee and END sensor", low=0.05, high=0.9, source="assumed: geometry")
    creep_compliance: float = parameter(
        0.0, "m/N", "J: creep γ̇ = (J·T − γ)/τ", low=0.0, high=0.2e-3, source="paper, 3.2: elastic fabric")
    creep_s: float = parameter(5.0, "s", "τ of the creep", low=0.01, high=1e4, source="assumed: woven strap")


@njit(inline="always")
def strap(
    elongation: float, rate: float, damping: float, per_share: float, b: float, a4: float, half: float,
    e_tangent: float, t_tangent: float, k_tangent: float,
) -> float:
    """Return the tension of an element of fabric, N; `per_share` = 1/w, `a4` = −4a, `half` = −1/(2a).

    Never pushing; damping at most as large as the elastic force.
    """
    e = max(0.0, elongation) * per_share
    bent = (b - math.sqrt(max(0.0, b * b - a4 * min(e, e_tangent)))) * half
    elastic = bent + k_tangent * max(0.0, e - e_tangent)
    return elastic + min(elastic, max(-elastic, damping * rate))
