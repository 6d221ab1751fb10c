"""Dates and times of day, as tables have them, to seconds.

A date is accepted only if it is unambiguous (ISO 8601, year first, or day.month.year); 03/04/2024 could be March or
April, so it is refused.
"""

import datetime
import re
from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_ISO = re.compile(
    r"\s*(\d{4})[-/](\d{1,2})[-/](\d{1,2})[T ]+(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*"
    r"(Z|[+-]\d{2}:?\d{2})?\s*$", re.IGNORECASE)
_DOTTED = re.compile(
    r"\s*(\d{1,2})\.(\d{1,2})\.(\d{4})[T ]+(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*()$")
_CLOCK = re.compile(r"\s*(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*$")
DAY_NS, SECOND_NS = 86_400_000_000_000, 1_000_000_000
_EPOCH = datetime.datetime(1970, 1, 1)


class TimeColumn(NamedTuple):
    """A column of times: seconds since the first known one, and when that was, ns since 1970 (−1: day unknown)."""

    seconds: NDArray[np.float64]
    begins_ns: int


def is_time(cell: str) -> bool:
    """Return whether a cell is a date with a time, or a time of day."""
    return ":" in cell and bool(_ISO.match(cell) or _DOTTED.match(cell) or _CLOCK.match(cell))


def description(begins_ns: int) -> str:
    """Return a sentence with the start of a column's times."""
    if begins_ns < 0:
        return "a time of day, taken from the first on"
    seconds, rest = divmod(begins_ns, SECOND_NS)
    at = _EPOCH + datetime.timedelta(seconds=seconds)
    return f"absolute, from {at.isoformat()}.{rest // 1000:06d} on"


def seconds(cells: Sequence[str], unknown: Container[str]) -> TimeColumn | None:
    """Return a column's times; None if a cell is not a time."""
    found: list[int | None] = []
    days, before, dated = 0, -1, True
    for cell in cells:
        if cell.strip().lower() in unknown:
            found.append(None)
            continue
        at = _absolute(cell)
        if at is None:
            clock = _CLOCK.match(cell)
            if clock is None:
                return None
            hours, minutes, second, fraction = clock.groups()
            at = ((int(hours) * 60 + int(minutes)) * 60 + int(second)) * SECOND_NS + _fraction(fraction)
            days += before >= 0 and at < before - DAY_NS // 2  # past midnight
            before, dated = at, False
            at += days * DAY_NS
        found.append(at)
    first = next((at for at in found if at is not None), 0)
    values = np.array([np.nan if at is None else (at - first) / 1e9 for at in found])
    return TimeColumn(values, first if dated else -1)


def _fraction(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0"))


def _absolute(cell: str) -> int | None:
    iso, dotted = _ISO.match(cell), _DOTTED.match(cell)
    if iso is not None:
        year, month, day, hour, minute, second, fraction, zone = iso.groups()
    elif dotted is not None:
        day, month, year, hour, minute, second, fraction, zone = dotted.groups()
    else:
        return None
    try:
        at = datetime.datetime(int(year), int(month), int(day), int(hour), int(minute), int(second or 0))
    except ValueError:
        return None
    away = 0
    if zone and zone.upper() != "Z":
        sign = -1 if zone[0] == "-" else 1
        away = sign * (int(zone[1:3]) * 60 + int(zone[-2:])) * 60
    past = at - _EPOCH
    return (past.days * 86_400 + past.seconds - away) * SECOND_NS + _fraction(fraction)
