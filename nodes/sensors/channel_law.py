"""One sample and one SYNC of a measuring channel: filter (CiA 404, 0x61A0, 0x61A1), span, scaling to the process value.

Compiled functions over one flat float64 array `c`; settings are written into it when an object is written, nothing is
looked up at a sample. Sums are of whole numbers below 2⁵³, so subtracting a sample that drops out of the window is
exact.
"""

import math
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from parameters import InputError

MEAN, FACTOR, SHIFT, COUNTS_PER_N, LOW, HIGH, MIDDLE, VERDICT, FIELD, TENSION, PROCESS_16, PROCESS_32, REPEATS, \
    LENGTH, SUM, COUNT, HEAD, FILLED, WINDOW = range(19)
"""Indices of `c`: the filtered counts; the line and the integer's counts per newton; span (counts) and its middle
(N); 0x6150, −1 before the first sample; the results of the last `process`, and the counts they were computed from;
the filter, `WINDOW` its first sample."""
LONGEST: Final = 255
SIZE: Final = WINDOW + LONGEST
NO_VERDICT: Final = -1.0

NOT_VALID, POSITIVE_OVERLOAD, NEGATIVE_OVERLOAD = 1, 2, 4
"""Bits of 0x6150, and of the converter's status that `sample` takes: bit 0 is a broken wire."""
FULL_COUNTS: Final = 1 << 23
"""A 24-bit converter reads −2²³ … 2²³ − 1; at either end it is overloaded."""


def channel(length: int, repeats: bool) -> Any:
    """Return the array of a channel before its first sample, its filter `length` samples long."""
    c = np.zeros(SIZE)
    restart(c, length, repeats)
    return c


def restart(c: Any, length: int, repeats: bool) -> None:
    """Restart with an empty filter."""
    c[[SUM, COUNT, HEAD, FILLED, MEAN]] = 0.0
    c[LENGTH], c[REPEATS], c[VERDICT] = length, repeats, NO_VERDICT


@njit(cache=True)
def add(c: Any, sample: float) -> None:
    """Set `c[MEAN]` to the mean of the last samples: at every one, or (repeating) once for each block of them.

    A window that is not yet full gives the mean of its samples; a repeating average starts with its first sample.
    """
    length = int(c[LENGTH])
    if length == 1:
        c[MEAN] = sample
    elif c[REPEATS] != 0.0:
        c[SUM] += sample
        c[COUNT] += 1.0
        if c[FILLED] == 0.0:
            c[MEAN] = sample
        if c[COUNT] == length:
            c[MEAN] = c[SUM] / length
            c[SUM] = c[COUNT] = 0.0
    else:
        head = int(c[HEAD])
        c[SUM] += sample
        if c[COUNT] == length:
            c[SUM] -= c[WINDOW + head]
        else:
            c[COUNT] += 1.0
        c[WINDOW + head] = sample
        c[HEAD] = (head + 1) % length
        c[MEAN] = c[SUM] / c[COUNT]
    c[FILLED] = 1.0


@njit(cache=True)
def sample(c: Any, counts: int, status: int) -> int:
    """Process a converter sample; return the new value of 0x6150. `c[VERDICT]` stays unchanged."""
    add(c, float(counts))
    mean = c[MEAN]
    if status == 0 and c[LOW] <= mean <= c[HIGH] and -FULL_COUNTS < counts < FULL_COUNTS - 1:
        return 0
    return POSITIVE_OVERLOAD if mean * c[FACTOR] + c[SHIFT] > c[MIDDLE] else NEGATIVE_OVERLOAD


@njit(cache=True)
def process(c: Any) -> None:
    """Set the process value, N, and the integers that carry it; the least of each is kept for "no valid value"."""
    tension = c[MEAN] * c[FACTOR] + c[SHIFT]
    counts = tension * c[COUNTS_PER_N]
    c[FIELD], c[TENSION] = c[MEAN], tension
    c[PROCESS_16] = round(min(32767.0, max(-32767.0, counts)))
    c[PROCESS_32] = round(min(2147483647.0, max(-2147483647.0, counts)))


class FilterType(IntEnum):
    """Values of 0x61A0."""

    NONE = 0
    MOVING_AVERAGE = 1
    REPEATING_AVERAGE = 2


def filter_settings(kind: int, constant: int) -> tuple[int, bool]:
    """Return a filter's length, samples, and whether it gives one value for each block of them."""
    return 1 if kind == FilterType.NONE else constant, kind == FilterType.REPEATING_AVERAGE


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
