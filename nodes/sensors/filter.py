"""Filters of a measuring channel (CiA 404, 0x61A0 and 0x61A1), on whole numbers.

The rule of this file: it names the filters; what they do is `nodes.sensors.channel_law`'s.
"""

from enum import IntEnum


class FilterType(IntEnum):
    """Values of 0x61A0."""

    NONE = 0
    MOVING_AVERAGE = 1
    REPEATING_AVERAGE = 2


def settings(kind: int, constant: int) -> tuple[int, bool]:
    """Return a filter's length, samples, and whether it gives one value for each block of them."""
    return 1 if kind == FilterType.NONE else constant, kind == FilterType.REPEATING_AVERAGE
