"""Filters of a measuring channel (CiA 404, 0x61A0 and 0x61A1), on whole numbers.

The rule of this file: it names the filters; what they do is `nodes.sensors.channel_law`'s.
"""

from __future__ import annotations

from enum import IntEnum

from nodes.sensors import channel_law as law


class FilterType(IntEnum):
    """Values of 0x61A0."""

    NONE = 0
    MOVING_AVERAGE = 1
    REPEATING_AVERAGE = 2


def settings(kind: int, constant: int) -> tuple[int, bool]:
    """Return a filter's length, samples, and whether it gives one value for each block of them."""
    return 1 if kind == FilterType.NONE else constant, kind == FilterType.REPEATING_AVERAGE


class Filter:
    """The mean of the last `constant` samples by itself, without a channel around it."""

    __slots__ = ("_channel",)

    def __init__(self, kind: int, constant: int) -> None:
        self._channel = law.channel(*settings(kind, constant))

    @property
    def value(self) -> float | None:
        """The filtered value, None before the first sample."""
        return float(self._channel[law.MEAN]) if self._channel[law.FILLED] else None

    def add(self, sample: int) -> None:
        """Add a sample."""
        law.add(self._channel, float(sample))
