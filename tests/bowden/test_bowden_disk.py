"""A disk that fills while a trial runs: the rope is let go, the file closed, and the answer says so."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

import trial
from trial.recover import recover
from virtual_bus.bus import BowdenBus

LIMIT = 1_500_000
"""Bytes of a file: it is full after the rope has been loaded for the first time."""


def limited(folder: Path, *arguments: str) -> dict[str, object]:
    """What a command line answers whose files may have `LIMIT` bytes; it ends with status 1."""
    told = subprocess.run(
        [sys.executable, "-c", "from bowden.cli import main; main()", *arguments, "--json"],
        cwd=folder, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, LIMIT)))  # refuses as a full disk does
    assert told.returncode == 1, told.stderr
    answer: dict[str, object] = json.loads(told.stdout)
    return answer


@pytest.mark.slow
def test_a_full_disk_stops_a_trial_safely_with_its_file_whole(tmp_path: Path) -> None:
    result = limited(tmp_path, "trial", "--cycles", "2", "-o", "full.mcap")
    assert result["outcome"] == "stopped"
    assert str(result["stop_reason"]).startswith("recording failed: full.mcap: recording stopped (File too large)")
    assert result["relative_rmse_percent"] is None
    assert (tmp_path / "full.mcap").stat().st_size <= LIMIT
    assert recover(tmp_path / "full.mcap", tmp_path / "whole.mcap").damaged == 0
    kept = trial.open(tmp_path / "whole.mcap")
    truth = trial.read.open_table(tmp_path / "full.truth.mcap", "/truth")
    assert np.nanmax(kept.columns["tension_start_n"]) > 20.0
    assert truth.time_ns[-1] > kept.time_ns[-1]
    assert truth.columns["true_start_n"][-1] < 2.0


@pytest.mark.exhaustive
def test_a_full_disk_stops_an_identification_and_writes_no_calibration(tmp_path: Path) -> None:
    result = limited(tmp_path, "identify", "all", "-o", "c.toml")
    assert (result["outcome"], result["calibration"], result["scalars"]) == ("stopped", None, {})
    assert str(result["stop_reason"]).startswith("recording failed: c.mcap: recording stopped (File too large)")
    assert not (tmp_path / "c.toml").exists()
    assert recover(tmp_path / "c.mcap", tmp_path / "whole.mcap").damaged == 0


def test_a_side_file_without_room_ends_and_the_bench_goes_on(tmp_path: Path) -> None:
    truth, limit = tmp_path / "trial.truth.mcap", 30_000
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with BowdenBus("full side file", truth=str(truth)) as bus:
        bus.send_periodic(can.Message(arbitration_id=0x080, is_extended_id=False), 0.001)
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
            while bus.time_ns() < 2_000_000_000:
                bus.recv(0.1)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert truth.stat().st_size <= limit
    assert recover(truth, tmp_path / "whole.mcap").damaged == 0
