"""A disk that fills while a trial runs: the rope is let go, the file closed, and the answer says so."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
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


@pytest.fixture
def full(tmp_path: Path) -> Iterator[Path]:
    """A folder on a disk of 64 kB that has no room left; only root can mount one."""
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path], check=False,
                                      capture_output=True).returncode:
        pytest.skip("mounting a small disk needs root")
    (tmp_path / "other").write_bytes(bytes(60_000))
    yield tmp_path
    subprocess.run(["umount", "--lazy", tmp_path], check=True)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a.mcap, a trial, and a.log, its frames."""
    from bowden.cli.app import run

    folder = tmp_path_factory.mktemp("recorded")
    assert run(["trial", "--cycles", "1", "--settle", "0", "--period", "1", "-o", f"{folder / 'a.mcap'}"]) == 0
    assert run(["export", f"{folder / 'a.mcap'}", "-o", f"{folder / 'a.log'}"]) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("command", [
    "trial --cycles 1 --settle 0 --period 1 -o FULL/x.mcap", "report a.mcap -o FULL/x.html",
    "export a.mcap -o FULL/x.csv", "export a.mcap -o FULL/x.xlsx", "export a.mcap -o FULL/x.mf4",
    "export a.mcap -o FULL/x.log", "import a.log -o FULL/y.mcap", "recover a.mcap -o FULL/r.mcap",
    "cut a.mcap --from 0.5 --to 2 -o FULL/c.mcap", "monitor a.log --table --mf4 FULL/x.mf4", "logbook init FULL/book"])
def test_a_full_disk_is_one_sentence_and_leaves_nothing_that_blocks_the_next_try(
        full: Path, recorded: Path, command: str) -> None:
    words = [sys.executable, "-c", "from bowden.cli import main; main()", *command.replace("FULL", str(full)).split()]
    told = subprocess.run(words, cwd=recorded, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout) == (2, ""), told
    sentences = [line for line in told.stderr.splitlines() if "SIMULATED" not in line]
    assert len(sentences) == 1, told.stderr
    assert "No space left on device" in sentences[0] or "disk is full" in sentences[0]
    assert [path.name for path in full.rglob("*") if path.is_file()] == ["other"]
