"""Trials to the files of others and back, torn ones mended, two compared: by command line."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import trial
from bowden.sweep import row_trial, rows
from tests.bowden.test_missing_columns import table
from trial.convert.frames import rows_of
from trial.record import TrialContent, write

ROWS = 5000
Bowden = Callable[..., Any]


@pytest.fixture
def recorded(here: Path) -> Path:
    """Five seconds of a trial with SYNC frames, in the working directory."""
    time_s = np.arange(ROWS) / 1000
    frames = rows_of([(row * 1_000_000, 0x080, 0, 0, 0, True, b"") for row in range(ROWS)])
    columns = {"time_s": time_s, "tension_end_n": np.sin(time_s)}
    write("trial.mcap", TrialContent(np.arange(ROWS) * 1_000_000, columns, frames),
          metadata={"specimen": "fabric 3"}, result={"outcome": "completed"})
    return here / "trial.mcap"


def test_a_trial_goes_out_as_a_table_and_comes_back_the_same(recorded: Path, bowden: Bowden) -> None:
    told = bowden("export", "trial.mcap", "-o", "trial.csv")
    assert (told.status, told.stdout) == (0, f"trial.csv: {ROWS} rows.\n")
    told = bowden("import", "trial.csv", "-o", "back.mcap", "--json")
    assert told.status == 0
    assert json.loads(told.stdout) == {
        "trial": "back.mcap", "imported_from": "trial.csv", "counts": {"rows": ROWS}, "left_out": [],
        "read_as": [], "channels": {}, "damage": []}
    one, other = trial.open(recorded), trial.open("back.mcap")
    assert all(np.array_equal(one.columns[name], other.columns[name]) for name in one.columns)


def test_what_an_import_changed_is_said(recorded: Path, bowden: Bowden) -> None:
    lines = ("(0.00) can0 080#", "(0.01) can0 081#", "no line at all", "(0.02) can0 080#", "(0.03) can0 080#")
    Path("log.log").write_text("\n".join(lines))
    told = bowden("import", "log.log", "-o", "log.mcap")
    assert told.status == 0
    assert "  malformed lines: 1\n" in told.stdout
    assert "  short emcy: 1\n" in told.stdout


def test_a_torn_trial_is_refused_with_what_to_do_and_mended(recorded: Path, bowden: Bowden) -> None:
    Path("torn.mcap").write_bytes(recorded.read_bytes()[:-2000])
    told = bowden("export", "torn.mcap", "-o", "torn.csv")
    assert (told.status, told.stdout) == (2, "")
    assert told.stderr.count("\n") == 1
    assert "bowden recover torn.mcap -o FILE" in told.stderr
    told = bowden("recover", "torn.mcap", "-o", "whole.mcap", "--json")
    assert told.status == 0
    found = json.loads(told.stdout)
    assert (found["trial"], found["damaged"]) == ("whole.mcap", 0)
    assert len(trial.open("whole.mcap").time_ns) > 0.9 * ROWS


def test_two_trials_side_by_side(recorded: Path, bowden: Bowden) -> None:
    told = bowden("compare", "trial.mcap", "trial.mcap")
    assert (told.status, told.stderr) == (0, "")
    assert "The same, in every channel." in told.stdout
    told = bowden("compare", "trial.mcap", "trial.mcap", "--json")
    assert json.loads(told.stdout)["same"] is True


@pytest.mark.parametrize("words", [
    ("export", "trial.mcap", "-o", "out.csv"), ("import", "trial.mcap", "-o", "out.mcap"),
    ("recover", "trial.mcap", "-o", "out.mcap"),
], ids=lambda words: words[0])
@pytest.mark.slow
def test_a_terminal_sees_how_far_it_is_and_json_sees_nothing(recorded: Path, words: tuple[str, ...]) -> None:
    assert "%" in on_a_terminal(*words)
    assert on_a_terminal(*words, "--overwrite", "--json") == ""


@pytest.mark.parametrize("words", [
    ("fit", "good.csv", "-o", "model.toml"), ("diagnose", "again.csv", "--healthy", "good.csv"),
], ids=lambda words: words[0])
@pytest.mark.slow
def test_a_terminal_sees_the_steps_of_a_fit(here: Path, words: tuple[str, ...]) -> None:
    table(here / "good.csv")
    table(here / "again.csv", phase=0.5)
    steps = [int(number) for number in re.findall(r"step (\d+)", on_a_terminal(*words))]
    assert steps == sorted(steps)
    assert len(set(steps)) > 2


def on_a_terminal(*words: str) -> str:
    """Run a command whose stderr is a terminal; returns what that showed."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    shown = b""
    with subprocess.Popen([sys.executable, "-c", "from bowden.cli import main; main()", *words],
                          stdout=subprocess.DEVNULL, stderr=theirs, env=environment) as command:
        os.close(theirs)
        try:
            # read while it runs: a terminal holds 4 KiB, beyond which the command would wait for its reader
            while part := os.read(ours, 1 << 16):
                shown += part
        except OSError:  # Linux says so where the other end is closed
            pass
    os.close(ours)
    assert command.returncode == 0
    return shown.decode()


def test_a_trial_of_a_sweep_carries_its_files(here: Path) -> None:
    (here / "walk.csv").write_text("time_s,knee_angle_rad\n" + "".join(
        f"{row / 100},{-0.3 + 0.2 * np.cos(row / 100 * np.pi):.6f}\n" for row in range(201)))
    short = {"gait.cycles": 1, "gait.settle": 0, "gait.controller": "none"}
    (row,) = rows.rows({}, {"files.knee": "walk.csv", **short}, ())
    made = row_trial.perform(row, "", "", str(here))
    assert made["outcome"] == "completed", made["stop_reason"]
    assert trial.open(made["trial"]).attachments["knee.csv"] == (here / "walk.csv").read_bytes()
