"""Stability of the force loop with the delay of the control rate, and the remedy if it is unstable.

The loop is START → impedance 1/(B·s + K) → rope → force, with two control cycles of delay, half a cycle of hold and
the drive's lag. A gain margin below two is not run: B is raised until it is two, with a remark. This slows the
correction and changes nothing else.
"""

import cmath
import dataclasses
import math

from master.control.gait_table import slope
from master.settings import Impedance
from physics.calibration import Calibration

GAIN_MARGIN = 2.0
DELAY_CYCLES = 2.5
_HIGHEST = 2_000.0


def crossing_rad_s(lag_s: float, delay_s: float) -> float:
    """Return the angular frequency, rad/s, at which an integrator, a lag and a dead time together have a phase of
    −180°."""
    low, high = 0.0, _HIGHEST
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle * delay_s + math.atan(middle * lag_s) < 0.5 * math.pi:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def gain_margin(calibration: Calibration, impedance: Impedance, period_s: float, peak_n: float) -> float:
    """Return the gain margin: the factor on the loop's gain at which it becomes unstable, at the stiffest desired
    force."""
    stiff_n_m = 1.0 / float(slope(calibration, min(peak_n, 0.98 * calibration.turning_point_n)))
    lag_s, delay_s = 1.0 / (2.0 * math.pi * calibration.servo_bandwidth), DELAY_CYCLES * period_s
    s = 1j * crossing_rad_s(lag_s, delay_s)
    loop = stiff_n_m * cmath.exp(-s * delay_s) / (1.0 + s * lag_s)
    return abs(impedance.damping_n_s_m * s + impedance.stiffness_n_m) / abs(loop)


def derated(
    calibration: Calibration, impedance: Impedance, period_s: float, peak_n: float
) -> tuple[Impedance, str | None]:
    """Return the impedance that keeps the gain margin, and a remark if it is not the requested one."""
    margin = gain_margin(calibration, impedance, period_s, peak_n)
    if margin >= GAIN_MARGIN:
        return impedance, None
    damping = impedance.damping_n_s_m
    slower = impedance
    while gain_margin(calibration, slower, period_s, peak_n) < GAIN_MARGIN:
        damping *= 1.01
        slower = dataclasses.replace(impedance, damping_n_s_m=damping)
    return slower, (
        f"at {1.0 / period_s:.0f} Hz and {peak_n:g} N the force loop has a gain margin of {margin:.2f}; "
        f"B is raised from {impedance.damping_n_s_m:g} to {damping:.0f} N·s/m for one of {GAIN_MARGIN:g}."
    )
