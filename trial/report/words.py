"""Signals in words, and quantities in units that a hand can feel: END (measured) in N, rope in mm, knee in °.

Pages show words; the column's name is in the tooltip.
"""

import math
from typing import Final

from trial.report.page import UNKNOWN

WORDS: Final = {
    "time_s": "time", "gait_percent": "gait phase", "cycle": "gait cycle", "servo_target_m": "rope (commanded)",
    "servo_position_m": "rope (measured)", "servo_velocity_m_s": "rope speed (derived)",
    "servo_force_n": "servo force (measured)", "knee_target_rad": "knee (commanded)",
    "knee_angle_rad": "knee (measured)", "tension_start_n": "START (measured)", "tension_end_n": "END (measured)",
    "desired_force_n": "END (desired)", "estimated_end_force_n": "END (estimated)",
    "feedforward_m": "stretch and swing fed forward", "impedance_dx_m": "correction of the impedance law",
    "estimated_end_half_n": "half the 95 % interval of END",
    "friction_ratio": "START by END (friction model)",
    "rope_direction": "rope's direction (friction model)", "strain_direction": "strain's direction (friction model)",
    "sync_jitter_ns": "SYNC against its nominal time", "step_duration_ns": "controller's step",
}
"""Signals in words, by column."""
UNITS: Final = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "rad": ("°", 180.0 / math.pi),
                "rad/s": ("°/s", 180.0 / math.pi), "ns": ("µs", 1e-3), "1": ("", 1.0)}
"""Unit shown and factor to it, by SI unit; others are shown as they are."""
SMALLER: Final = {"mm": ("µm", 1e3), "N": ("mN", 1e3), "s": ("ms", 1e3)}
SMALL: Final = 0.1
"""Magnitude below which a quantity is shown in the smaller unit of `SMALLER`."""


def words(name: str) -> str:
    """Return a column's name in words; of one of several paths with the path before it."""
    path, dot, own = name.rpartition(".")
    if own in WORDS:
        text = WORDS[own]
    elif "_pdo_" in own:
        text = f"{own.partition('_pdo_')[0]} inputs"
    else:
        text = own.removesuffix("_ns").replace("_", " ")
    return f"{path}: {text}" if dot else text


def display_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which a page shows values of an SI unit, and the factor to it."""
    return UNITS.get(unit, (unit, 1.0))


def quantity(value: float | None, unit: str = "", digits: int = 3) -> str:
    """Return a value in an SI `unit` as text, with a prefixed unit and `digits` significant digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    shown, factor = display_unit(unit)
    value *= factor
    if shown in SMALLER and 0.0 < abs(value) < SMALL:
        shown, factor = SMALLER[shown]
        value *= factor
    return f"{_rounded(value, digits)} {shown}".rstrip()


def _rounded(value: float, digits: int) -> str:
    if value == 0.0 or 1e-3 <= abs(value) < 1e6:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value)))) if value else 0
        text = f"{value:.{places}f}"
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        text = f"{value:.{digits}g}"
    return text.replace("-", "−")


def axis(name: str, unit: str) -> str:
    """Return the label of an axis: a signal in words, with the unit shown."""
    shown = display_unit(unit)[0]
    return f"{words(name)} ({shown})" if shown else words(name)
