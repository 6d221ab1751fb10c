"""Arrays for a page: thinned to screen resolution, and packed as base64.

Thinning never hides an extreme. Of every bin the least and the greatest value stay, in the order in which the bin
rises or falls; a bin without a finite value stays unknown.
"""

import base64
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Number = TypeVar("Number", bound=np.generic)


def thinned(x: Floats, columns: Sequence[Floats], bins: int) -> tuple[Floats, list[Floats]]:
    """Return at most two points of each of `bins` equal bins of `x`, which must not fall; unchanged if that is no gain.

    The two points stand at the first and last `x` of their bin, so a peak is at most one bin away from its place.
    """
    if len(x) <= 2 * bins:
        return x, list(columns)
    first = np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], bins + 1)[:-1]))
    last = np.append(first[1:], len(x)) - 1
    return interleaved(x[first], x[last]), [extremes(column, first, last) for column in columns]


def extremes(values: Floats, first: NDArray[np.intp], last: NDArray[np.intp]) -> Floats:
    """Return least and greatest value of each bin, interleaved in the order in which the bin rises or falls.

    `first`, `last`: ends of the bins along the last axis of `values`, shape (…, rows).
    """
    low, high = np.fmin.reduceat(values, first, axis=-1), np.fmax.reduceat(values, first, axis=-1)
    falls = values[..., first] > values[..., last]
    return interleaved(np.where(falls, high, low), np.where(falls, low, high))


def interleaved(one: NDArray[Number], other: NDArray[Number]) -> NDArray[Number]:
    """Return the entries of two arrays in turns along the last axis."""
    return np.stack([one, other], axis=-1).reshape(*one.shape[:-1], -1)


def broken(x: Floats, columns: Sequence[Floats], gap: float) -> tuple[Floats, list[Floats]]:
    """Return the arrays with an unknown point in every step of `x` above `gap`, where a line must not go on."""
    places = np.flatnonzero(np.diff(x) > gap) + 1
    if not len(places):
        return x, list(columns)
    between = (x[places - 1] + x[places]) / 2
    return np.insert(x, places, between), [np.insert(column, places, np.nan) for column in columns]


class Pool:
    """The arrays of a page, each packed once, little-endian: float32 (f4); float64 (f8) where an abscissa needs it."""

    def __init__(self) -> None:
        self._numbers: dict[bytes, int] = {}
        self.packed: list[dict[str, str]] = []

    def abscissa(self, values: Floats) -> int:
        """Pack values that rise; float64 where float32 would merge neighbours.  Returns the array's number."""
        short = values.astype("<f4")
        merged = bool(np.any((np.diff(short) == 0) & (np.diff(values) > 0)))
        return self._number(values.astype("<f8") if merged else short)

    def ordinate(self, values: Floats) -> int:
        """Pack values as float32; returns the array's number."""
        with np.errstate(over="ignore"):
            return self._number(values.astype("<f4"))

    def _number(self, values: NDArray[np.floating]) -> int:
        data = values.tobytes()
        kind = f"f{values.itemsize}"
        key = kind.encode() + data
        if key not in self._numbers:
            self._numbers[key] = len(self.packed)
            self.packed.append({"type": kind, "data": base64.b64encode(data).decode()})
        return self._numbers[key]
