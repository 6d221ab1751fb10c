"""CAN frames in bulk, from any source.

Frames are a structured array of `cdr.FRAME_ROW`, in the order of the log; anomalies are counted under a name.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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
    """Frames gathered one by one, packed every 65 536, so that memory is 24 bytes a frame."""

    def __init__(self) -> None:
        self._blocks: list[NDArray[np.void]] = []
        self._loose: list[Row] = []

    def __len__(self) -> int:
        return sum(len(block) for block in self._blocks) + len(self._loose)

    def add(self, row: Row) -> None:
        """Add one frame."""
        self._loose.append(row)
        if len(self._loose) == 65_536:
            self._blocks.append(rows_of(self._loose))
            self._loose.clear()

    def rows(self) -> NDArray[np.void]:
        """Return all rows, in the order of the file."""
        return np.concatenate([*self._blocks, rows_of(self._loose)])


@dataclass
class LoggedFrames:
    """Frames of a log, the names of its channels, and the anomalies counted in reading it."""

    rows: NDArray[np.void]
    channels: dict[str, int]
    counts: dict[str, int] = field(default_factory=dict)


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
