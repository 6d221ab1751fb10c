"""Measured bus load: the recorded frames' own bits, stuffing included."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from trial.mcap_file import cdr
from trial.read import Trial
from virtual_bus.wire.bit_counts import bits_of
from virtual_bus.wire.bits import INTERMISSION_BITS


def frame_bits(frames: NDArray[np.void]) -> NDArray[np.int64]:
    """Bits that each of the recorded `frames` takes on the wire, up to the next one."""
    flags = frames["flags"]
    return INTERMISSION_BITS + bits_of(
        frames["can_id"], frames["dlc"], frames["data"], flags & cdr.REMOTE != 0, flags & cdr.EXTENDED != 0)


def measured_percent(recorded: Trial, bitrate: int) -> float:
    """Return the bits of the frames between the first and the last control cycle, % of the bus's capacity; NaN
    without."""
    if len(recorded.time_ns) < 2:
        return math.nan
    first, last = int(recorded.time_ns[0]), int(recorded.time_ns[-1])
    frames = recorded.frames
    chosen = frames[(frames["time_ns"] > first) & (frames["time_ns"] <= last) & (frames["flags"] & cdr.ERROR == 0)]
    return 100.0 * float(frame_bits(chosen).sum()) / (bitrate * (last - first) * 1e-9)
