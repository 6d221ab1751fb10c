"""The stretch over force: (10), and a bench's departure from it.

x(F) = c + b·F + a·F² + s1·g1(F) + s2·g2(F), linear in its five scalars. g is d·(1 − e^(−F/d)) for d = 8 N and 30 N,
less the parabola nearest to it over 0…60 N. So a, b and c keep their meaning in (10), and s1 and s2 describe shapes
outside any parabola: a toe, or a stretch that saturates.  `of`: a calibration, which has the scalars.
"""

from typing import Any, Final

import numpy as np

SHORT_N: Final = 8.0
WIDE_N: Final = 30.0
"""Scale of the wider saturating term, N."""
FITTED_N: Final = 60.0
"""Upper end, N, of the range in which the parabola nearest to a saturating term is fitted: that of (10), and below it.
"""


def saturating(force: Any, scale_n: float) -> Any:
    """Return d·(1 − e^(−F/d)): a stretch whose slope fades over `scale_n`, N."""
    return -scale_n * np.expm1(-np.asarray(force) / scale_n)


def _nearest(scale_n: float) -> tuple[float, float, float]:
    """Return the coefficients, highest power first, of the parabola nearest to a saturating term."""
    force = np.linspace(0.0, FITTED_N, 601)
    a, b, c = np.polyfit(force, saturating(force, scale_n), 2).tolist()
    return a, b, c


_SHORT: Final = _nearest(SHORT_N)
_WIDE: Final = _nearest(WIDE_N)


def coefficients(of: Any) -> tuple[float, float, float]:
    """Return constant, m, quadratic, m/N², and linear coefficient, m/N, of the polynomial part of the stretch.

    The other part saturates: s1·8 N·(1 − e^(−F/8 N)) + s2·30 N·(1 − e^(−F/30 N)).
    """
    short, wide = of.stretch_short, of.stretch_wide
    quadratic, linear, constant = (
        own - short * by_short - wide * by_wide
        for own, by_short, by_wide in zip((of.stiffness_a, of.stiffness_b, of.rope_zero), _SHORT, _WIDE, strict=True))
    return constant, quadratic, linear


def position(of: Any, force: Any) -> Any:
    """Return x(F), m, at a force, N; arrays are accepted."""
    constant, quadratic, linear = coefficients(of)
    return constant + (quadratic * force + linear) * force + of.stretch_short * saturating(
        force, SHORT_N) + of.stretch_wide * saturating(force, WIDE_N)


def slope(of: Any, force: Any) -> Any:
    """Return dx/dF, m/N, at a force, N."""
    _, quadratic, linear = coefficients(of)
    return (2.0 * quadratic * force + linear + of.stretch_short * np.exp(-np.asarray(force) / SHORT_N)
            + of.stretch_wide * np.exp(-np.asarray(force) / WIDE_N))


def limit_n(of: Any, least_m_n: float) -> float:
    """Return the force, N, at which the slope falls to `least_m_n`, at most 300 N."""
    force = np.linspace(0.0, 300.0, 3001)
    flat = force[slope(of, force) <= least_m_n]
    return float(flat[0]) if flat.size else 300.0
