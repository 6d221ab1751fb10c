"""Measured bus load: the recorded frames' own bits, stuffing included."""

import math

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr
from trial.read import TrialFile
from virtual_bus.wire.bit_counts import bits_of
from virtual_bus.wire.bits import INTERMISSION_BITS


def frame_bits(frames: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the bits that each of the recorded `frames` takes on the wire, up to the next one."""
    flags = frames["flags"]
    return INTERMISSION_BITS + bits_of(
        frames["can_id"], frames["dlc"], frames["data"], flags & cdr.REMOTE != 0, flags & cdr.EXTENDED != 0)


def measured_percent(recorded: TrialFile, bitrate: int) -> float:
    """Return the bits of the frames between the first and the last control cycle, % of the bus's capacity; NaN
    without."""
    rows, first, last, _lost = recorded.extent
    if rows < 2:
        return math.nan
    bits = 0
    for frames in recorded.frame_blocks():
        times = frames["time_ns"]
        bits += int(frame_bits(frames[(times > first) & (times <= last) & (frames["flags"] & cdr.ERROR == 0)]).sum())
    return 100.0 * bits / (bitrate * (last - first) * 1e-9)
