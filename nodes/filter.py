"""Filters of a measuring channel (CiA 404, 0x61A0 and 0x61A1), on whole numbers.

The rule of this file: sums of counts are exact, so a filter forgets what leaves its window without a trace.
"""

from __future__ import annotations

from collections import deque
from enum import IntEnum


class FilterType(IntEnum):
    """Values of 0x61A0."""

    NONE = 0
    MOVING_AVERAGE = 1
    REPEATING_AVERAGE = 2


class Filter:
    """The mean of the last `constant` samples: at every sample, or (repeating) once for each block of them.

    A window that is not yet full gives the mean of what it holds; a repeating average starts with its first sample.
    """

    __slots__ = ("_block", "_counts", "_length", "_sum", "_window", "value")

    def __init__(self, kind: int, constant: int) -> None:
        self._block = kind == FilterType.REPEATING_AVERAGE
        self._length = 1 if kind == FilterType.NONE else constant
        self._window: deque[int] = deque()
        self._sum = 0
        self._counts = 0
        self.value: float | None = None
        """The filtered value, None before the first sample."""

    def add(self, sample: int) -> None:
        """Take a sample."""
        if self._length == 1:
            self.value = float(sample)
            return
        if self._block:
            self._add_to_block(sample)
            return
        window = self._window
        window.append(sample)
        self._sum += sample
        if len(window) > self._length:
            self._sum -= window.popleft()
        self.value = self._sum / len(window)

    def _add_to_block(self, sample: int) -> None:
        self._sum += sample
        self._counts += 1
        if self.value is None:
            self.value = float(sample)
        if self._counts == self._length:
            self.value = self._sum / self._length
            self._sum = self._counts = 0
