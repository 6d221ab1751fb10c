"""The fabric over the knee: quadratic stiffness, wrap friction, creep.

The whole rope-and-fabric path stretches by (10). The stretch beyond the rope's own linear compliance is the fabric's,
by shares of its length. A share w stretches by w·(b·T + a·T²), a < 0, and is continued along its tangent from 90 % of
the turning tension.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit

from physics.parameters import declared
from physics.path_laws import stretched


@dataclass(frozen=True)
class FabricParameters:
    """Parameters of the fabric and of its friction over the knee."""

    mu2: float = declared("mu2")
    wrap_rad: float = declared("phi0")
    fabric_wrap: float = declared("fabric_wrap")
    fabric_presliding_m: float = declared("fabric_presliding")
    stretch_a: float = declared("stretch_a")
    stretch_b: float = declared("stretch_b")
    stiffness_scale: float = declared("stiffness_scale")
    stiffness_shape: float = declared("stiffness_shape")
    share_before: float = declared("fabric_share_before")
    share_after: float = declared("fabric_share_after")
    creep_compliance: float = declared("creep_compliance")
    creep_s: float = declared("creep_time")


@njit(inline="always")
def strap(
    elongation: float, rate: float, damping: float, per_share: float, b: float, a4: float, half: float,
    e_tangent: float, t_tangent: float, k_tangent: float,
) -> float:
    """Return the tension of an element of fabric, N; `per_share` = 1/w, `a4` = −4a, `half` = −1/(2a).

    Never pushing; damping at most as large as the elastic force.
    """
    e = max(0.0, elongation) * per_share
    elastic = stretched(e, b, a4, half, e_tangent, k_tangent)
    return elastic + min(elastic, max(-elastic, damping * rate))
