"""What a third socket sees of a master's cycle: rate, jitter, ages, misses.

The rule of this file: it knows frames and their time stamps, nothing of who sent them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eds.bench.bench_network import FILES, TARGETS_COB_ID
from eds.cia301 import SYNC_COB_ID, TPDO_BASE
from master.network.socketcan import KernelBus
from tests.socketcan import rig

EDGE = 50
"""Cycles at either end that are left out: starting and ending."""


Row = tuple[int, int]
"""A frame's time stamp, ns, and identifier."""


def watched(tap: KernelBus, process: rig.Process) -> tuple[rig.Told, list[Row]]:
    """Wait until a master has ended, then take every frame: who looks earlier takes the processor from the cycle."""
    told = process.wait()
    return told, [(each.time_ns, each.arbitration_id) for each in iter(lambda: tap.recv(0), None)]


def shown(rows: list[Row], rate_hz: int) -> dict[str, Any]:
    """What frames show of the cycle; `EDGE` cycles at either end are left out."""
    times = {can_id: np.array([row[0] for row in rows if row[1] == can_id], dtype=np.int64)
             for can_id in (SYNC_COB_ID, TARGETS_COB_ID, *(TPDO_BASE + node for node in FILES))}
    sync = times[SYNC_COB_ID][EDGE:-EDGE]
    inputs = np.column_stack([_after(sync, times[TPDO_BASE + node]) for node in FILES]).max(axis=1)
    targets = _after(sync, times[TARGETS_COB_ID])
    jitter = np.abs(np.diff(sync) - 1e9 / rate_hz)
    return {
        "cycles": len(sync) - 1, "held_hz": (len(sync) - 1) * 1e9 / float(sync[-1] - sync[0]),
        "missed": int(np.count_nonzero(np.isnan(inputs) | np.isnan(targets))),
        "jitter_us": [float(np.quantile(jitter, 0.99)) / 1e3, float(jitter.max()) / 1e3],
        "inputs_us": _middle_and_worst(inputs), "targets_us": _middle_and_worst(targets),
    }


def _after(sync: np.ndarray[Any, Any], stamps: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Time from each SYNC but the last to the first such frame before the next one, ns; NaN where there is none."""
    place = np.searchsorted(stamps, sync[:-1])
    found = np.append(stamps, np.iinfo(np.int64).max)[place]
    return np.where(found < sync[1:], (found - sync[:-1]).astype(np.float64), np.nan)


def _middle_and_worst(times_ns: np.ndarray[Any, Any]) -> list[float | None]:
    there = times_ns[~np.isnan(times_ns)] / 1e3
    return [float(np.median(there)), float(there.max())] if len(there) else [None, None]
