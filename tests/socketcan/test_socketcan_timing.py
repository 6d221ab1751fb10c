"""Cycle times held on the kernel's CAN, in guest time: it counts instructions, so any machine sees the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eds.cia301 import SYNC_COB_ID
from tests.socketcan import rig

pytestmark = pytest.mark.guest("icount")

JITTER_NS = 100_000
"""The broadcast manager's timer is served within this; bench and master share the guest's one processor."""


@pytest.mark.parametrize(("rate", "master", "nodes"), [(500, "vcan0", "vcan0"), (500, "can0", "can1")])
def test_no_cycle_is_missed(tmp_path: Path, rate: int, master: str, nodes: str) -> None:
    with rig.bench(tmp_path, nodes, "--rate", rate):
        told = rig.trial(tmp_path, master, "--rate", rate, "--cycles", 1, "--settle", 0, "--period", 1, "--peak", 20,
                         "--dry-run").wait()
    assert told.result["outcome"] == "completed", told
    assert (told.result["missed_cycles"], told.result["stale_inputs"]) == (0, 0), told
    frames = rig.recorded(tmp_path).frames
    sync_ns = frames["time_ns"][frames["can_id"] == SYNC_COB_ID]
    assert np.ptp(np.diff(sync_ns)) < 2 * JITTER_NS
