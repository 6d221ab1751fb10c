"""Field value to process value: the straight line of CiA 404 and the integers that carry it.

The rule of this file: pure functions; a line that cannot be drawn is refused, never guessed.
"""

import math
from typing import Final, NamedTuple

from parameters import InputError

INTEGER16: Final = 16
INTEGER32: Final = 32
_REAL32_MAX: Final = (2.0 - 2.0**-23) * 2.0**127


class LinearScaling(NamedTuple):
    """PV = FV · factor + offset: 0x6126 and 0x6127."""

    factor: float
    offset: float


def two_point(fv_1: float, pv_1: float, fv_2: float, pv_2: float) -> LinearScaling:
    """Draw the line through two calibration points (0x6120 … 0x6123); `InputError` where they give none."""
    if fv_1 == fv_2 or not all(map(math.isfinite, (fv_1, pv_1, fv_2, pv_2))):
        raise InputError(f"calibration points ({fv_1}, {pv_1}) and ({fv_2}, {pv_2}): expected two different finite "
                         "field values; write 0x6120 to 0x6123 again.")
    factor = (pv_2 - pv_1) / (fv_2 - fv_1)
    return LinearScaling(factor, pv_1 - factor * fv_1)


def integer(value: float, bits: int) -> int:
    """Round to a signed integer of so many bits, held at its ends; the least one is kept for `invalid`."""
    high = (1 << bits - 1) - 1
    return round(min(high, max(-high, value)))


def real32(value: float) -> float:
    """Clip a finite value to the range of REAL32."""
    return min(_REAL32_MAX, max(-_REAL32_MAX, value))


def invalid(bits: int) -> int:
    """Return the integer that means "no valid value": the least one."""
    return -(1 << bits - 1)
