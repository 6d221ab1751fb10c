"""The paper's formulas (1)–(11), each once, as pure functions.

SI and radians in and out, arrays welcome, the equation number in the docstring. Paper: Li, Ma, Wang, Appl. Sci. 2023,
13, 11766. Its constants are in mm, N, degrees and % of the gait cycle; they keep those units here, with the unit in
the name, and are converted at use. Signs: rope position and velocity > 0 pulling; knee flexion negative; strain rate
> 0 stretching.
"""

from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
T = TypeVar("T", float, Array)

MILLI: Final = 1e-3
DEGREE: Final = np.pi / 180.0

KNEE_AMPLITUDE_DEG: Final = (48.16, 525.2, 540.2)
KNEE_RATE_PER_PERCENT: Final = (0.01951, 0.1239, 0.1232)
KNEE_PHASE: Final = (-3.112, -0.02836, -3.159)

FORCE_START_PERCENT: Final = 10.0
FORCE_PEAK_PERCENT: Final = 20.0
FORCE_END_PERCENT: Final = 30.0

STIFFNESS_A_MM_N2: Final = -0.0017
STIFFNESS_B_MM_N: Final = 0.3
STIFFNESS_C_MM: Final = 9.7
STIFFNESS_KNEE_PERCENT: Final = 13.0

SWING_K_MM_DEG: Final = 0.706
SWING_P_MM: Final = 22.17


def knee_angle(percent: T, derivative: int = 0) -> T:
    """Return the knee angle of (1), rad, or its derivative of the given order, rad/%^n.

    `percent`: gait phase, 0…100 %. The formula does not close: see `physics.reference`.
    """
    turned = derivative * np.pi / 2.0
    total: Any = 0.0
    for a, b, c in zip(KNEE_AMPLITUDE_DEG, KNEE_RATE_PER_PERCENT, KNEE_PHASE, strict=True):
        total = total + a * b**derivative * np.sin(b * percent + c + turned)
    angle: T = total * DEGREE
    return angle


def desired_force(percent: T, peak_n: float) -> T:
    """Return the desired END force of (2), N: two quarter sines between 10, 20 and 30 % of the gait."""
    start, peak, end = FORCE_START_PERCENT, FORCE_PEAK_PERCENT, FORCE_END_PERCENT
    rising = np.sin(np.pi * (percent - start) / (2.0 * (peak - start)))
    falling = np.sin(np.pi * (end - percent) / (2.0 * (end - peak)))
    loaded = (percent >= start) & (percent < end)
    shape = np.where(np.less(percent, peak), rising, falling)
    force: Any = np.where(loaded, shape, 0.0)[()]
    desired: T = peak_n * force
    return desired


def cable_loss(desired_n: T, exponent: float, velocity: T) -> T:
    """Return the cable's friction force fL of (4), N, when its output is to be `desired_n`; `exponent` is μ1·θ.

    The text of the paper prints v̇; Coulomb friction turns with the sign of the rope's `velocity` itself.
    """
    loss: T = desired_n * np.expm1(exponent * np.sign(velocity))
    return loss


def fabric_loss(desired_n: T, exponent: float | T, strain_rate: T) -> T:
    """Return the fabric's friction force fT of (8), N, when its output is to be `desired_n`.

    `exponent` is μ2·φ(t), `strain_rate` the fabric's.
    """
    loss: T = desired_n * np.expm1(exponent * np.sign(strain_rate))
    return loss


def series_input(
    desired_n: T, cable_exponent: float, velocity: T, fabric_exponent: float | T, strain_rate: T
) -> T:
    """Return START tension, N, for `desired_n` at END: (9) then (5), in series.

    fL and fT added separately drop the product term, 1.8 % at exponents of 0.157 and 0.1.
    """
    start: T = desired_n * np.exp(cable_exponent * np.sign(velocity) + fabric_exponent * np.sign(strain_rate))
    return start


def stiffness_displacement(force_n: T) -> T:
    """Return the encoder position x1 of (10), m, in the paper's own zero; fitted from 20 to 60 N."""
    return MILLI * (STIFFNESS_A_MM_N2 * force_n**2 + STIFFNESS_B_MM_N * force_n + STIFFNESS_C_MM)


def swing_displacement(knee_rad: T) -> T:
    """Return the rope displacement x2 of (11), m, in the paper's own zero, which is not that of (10)."""
    return MILLI * (SWING_K_MM_DEG * (knee_rad / DEGREE) + SWING_P_MM)
