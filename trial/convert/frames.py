"""CAN frames in bulk, from any source.

Frames are a structured array of `cdr.FRAME_ROW`, in the order of the log; anomalies are counted under a name.
A time stamp (int64, ns) is changed only if it cannot be right, and every change is counted.
"""

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from trial.mcap_file import cdr

MOST_CHANNELS = 16


class ChannelNumbers:
    """Numbers channels 0 … 15 by name: its own number where that is free, else the next free one.

    `names` is what each became; a seventeenth channel raises ValueError.
    """

    def __init__(self) -> None:
        self.names: dict[str, int] = {}

    def number(self, channel: object) -> int:
        """Return the number of a channel; None is a channel like any other."""
        name = str(channel)
        known = self.names.get(name)
        if known is not None:
            return known
        taken = set(self.names.values())
        digits = re.search(r"(\d+)$", name)
        wished = int(digits[1]) if digits else 0
        if wished in taken or wished >= MOST_CHANNELS:
            wished = next((free for free in range(MOST_CHANNELS) if free not in taken), -1)
        if wished < 0:
            raise ValueError(f"channel {name} is the seventeenth; a trial holds {MOST_CHANNELS} channels")
        self.names[name] = wished
        return wished


Row = tuple[int, int, int, int, int, bool, bytes]  # the fields of `cdr.FRAME_ROW`
_PACKED = np.dtype([(name, "S8" if name == "data" else cdr.FRAME_ROW[name]) for name in cdr.FRAME_ROW.names or ()])


def rows_of(rows: Sequence[Row]) -> NDArray[np.void]:
    """Make frames of tuples; data shorter than eight bytes is filled up with zeros."""
    return np.array(rows, _PACKED).view(cdr.FRAME_ROW)


class FrameRows:
    """Frames gathered one by one, packed every 65 536, so that memory is 24 bytes a frame, 28 with `lines`.

    `lines` has the line of each frame in a text, from 1; it is empty for a binary log.
    """

    def __init__(self) -> None:
        self.lines = array("I")
        self._blocks: list[NDArray[np.void]] = []
        self._loose: list[Row] = []

    def __len__(self) -> int:
        return sum(len(block) for block in self._blocks) + len(self._loose)

    def add(self, row: Row, line: int = 0) -> None:
        """Add one frame, of a text with its line."""
        self._loose.append(row)
        if line:
            self.lines.append(line)
        if len(self._loose) == 65_536:
            self._blocks.append(rows_of(self._loose))
            self._loose.clear()

    def rows(self) -> NDArray[np.void]:
        """Return all rows, in the order of the file."""
        return np.concatenate([*self._blocks, rows_of(self._loose)])


MOST_REMARKS = 20
"""Damaged places of a log that are listed one by one; of more, their number is stated."""
END_MISSING = "the last line has no end, so bytes of its frame may be missing; kept"
"""Remark on the last line of a log that a killed logger may have cut."""


class DamageRemarks:
    """Sentences on damaged places of a log: one for each of the first `MOST_REMARKS`, and one that counts the rest."""

    def __init__(self) -> None:
        self._first: list[str] = []
        self._others = self._read = 0

    def add(self, place: str, damage: str) -> None:
        """Add the damage at one place, such as "line 7"."""
        if len(self._first) < MOST_REMARKS:
            self._first.append(f"{place}: {damage}")
        else:
            self._others += 1

    def unread(self) -> list[str]:
        """Return the sentences on the listed places that were added since the last call."""
        new, self._read = self._first[self._read:], len(self._first)
        return new

    @property
    def full(self) -> bool:
        """True if `MOST_REMARKS` places are listed: later ones are only counted."""
        return len(self._first) == MOST_REMARKS

    @property
    def further(self) -> str:
        """Sentence on how many places there are beyond the first `MOST_REMARKS`; "" if there are none."""
        return f"and {self._others} more such places" if self._others else ""

    @property
    def sentences(self) -> list[str]:
        """Return the sentences in the order of the log."""
        return [*self._first, *([self.further] if self.further else [])]


@dataclass
class LoggedFrames:
    """Frames of a log, the names of its channels, the anomalies counted in reading it, and where it is damaged.

    `lines` has the line of each frame in a text, from 1; it is empty for a binary log.
    """

    rows: NDArray[np.void]
    channels: dict[str, int]
    counts: dict[str, int] = field(default_factory=dict)
    damage: DamageRemarks = field(default_factory=DamageRemarks)
    lines: Sequence[int] = ()

    def place(self, index: int) -> str:
        """Return where a frame stands in the log: its line in a text, else its number, from 1."""
        return f"line {self.lines[index]}" if self.lines else f"frame {index + 1}"


def oddities(rows: NDArray[np.void]) -> dict[str, int]:
    """Count what real logs carry and a bench of CANopen nodes does not expect; all of it is kept."""
    flags, can_id, dlc = rows["flags"], rows["can_id"], rows["dlc"]
    plain = flags == 0
    return {
        "remote_frames": int(np.count_nonzero(flags & cdr.REMOTE)),
        "extended_frames": int(np.count_nonzero(flags & cdr.EXTENDED)),
        "error_frames": int(np.count_nonzero(flags & cdr.ERROR)),
        "short_emcy": int(np.count_nonzero(plain & (can_id > 0x080) & (can_id < 0x100) & (dlc < 8))),
        "short_nmt": int(np.count_nonzero(plain & (can_id == 0) & (dlc < 2))),
    }


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
