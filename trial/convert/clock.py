"""Time stamps of foreign logs, made usable.

The rule of this file: a stamp is changed only where it cannot be right, and every change is counted.  Pure
functions over int64 nanoseconds.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError

Integers = NDArray[np.int64]

STEP_NS = 1_000_000_000  # a clock that falls back by more than this was set; by less, frames were logged out of order

LATEST_NS = 2**62  # in the year 2116; sums and differences of two such times fit int64


class MendedClock(NamedTuple):
    """Time stamps ≥ 0 after repair, the number of clock steps taken out, and the shift of all of them to reach 0."""

    times: Integers
    steps: int
    shift_ns: int


def mend(times: Integers, source: Path | str = "log") -> MendedClock:
    """Take out backward steps of the clock and negative times; what follows a step goes on where it stood.

    Raises `InputError` for times or sums of steps that int64 nanoseconds do not hold: a clock that leaps to and fro.
    """
    if len(times) == 0:
        return MendedClock(times, 0, 0)
    _refuse_beyond(source, float(np.abs(times.astype(np.float64)).max()))
    rise = np.diff(times)
    back = rise < -STEP_NS
    added = -float(rise[back].astype(np.float64).sum())
    _refuse_beyond(source, float(times.max()) + added - min(float(times.min()), 0.0))
    mended = times.copy()
    mended[1:] += np.cumsum(np.where(back, -rise, 0))
    shift = max(0, -int(mended.min()))
    return MendedClock(mended + shift, int(back.sum()), shift)


def _refuse_beyond(source: Path | str, latest_ns: float, most_ns: float = LATEST_NS) -> None:
    """Raise `InputError` if a time is later than `most_ns`."""
    if latest_ns >= most_ns:
        raise InputError(f"{source}: its clock leaps to and fro and adds up to {latest_ns / 1e9:.3g} s; expected "
                         "times of one measurement, so cut it where the clock was set.")


def rising(times: Integers, source: Path | str = "log") -> tuple[Integers, int]:
    """Return strictly rising times, and how many were replaced.

    A stamp that does not exceed all before it (a coarse clock, a late one) lies evenly between those that do;
    behind the last of them times go on at the median step.
    """
    if len(times) < 2:
        return times, 0
    before = np.maximum.accumulate(times)[:-1]
    good = np.flatnonzero(np.concatenate(([True], times[1:] > before)))
    if len(good) == len(times):
        return times, 0
    step = int(np.median(np.diff(times[good]) // np.diff(good))) if len(good) > 1 else 1
    _refuse_beyond(source, float(times[good[-1]]) + float(max(1, step)) * float(len(times) - good[-1]), 2.0**63)
    rows = np.arange(len(times))
    origin = int(times[0])  # np.interp works in float64, which holds nanoseconds of a trial, not of an epoch
    spread = np.interp(rows, good, (times[good] - origin).astype(np.float64)).astype(np.int64) + origin
    spread[good[-1]:] = times[good[-1]] + max(1, step) * (rows[good[-1]:] - good[-1])
    repeated = np.diff(spread) <= 0
    if repeated.any():  # closer than a nanosecond: push apart
        spread = np.maximum.accumulate(spread - rows) + rows
    return spread, len(times) - len(good)
