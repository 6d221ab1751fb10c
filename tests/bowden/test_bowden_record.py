"""Specimen, rope, operator and notes: asked for once, in bench.toml from then on, and in every trial."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from bowden.bench import configuration
from trial import read

TOLD = {"specimen": 'left leg, "tall"', "rope": "Dyneema 1 mm\\batch 7, 3. Tag", "operator": "Åsa", "notes": "",
        "logbook": "", "limb": ""}
Bowden = Callable[..., tuple[int, str, str]]


def test_what_was_told_is_read_again(here: Path) -> None:
    (here / "bench.toml").write_text(configuration.as_template(TOLD), encoding="utf-8")
    sections = configuration.read(here / "bench.toml")
    assert vars(sections["record"]) == TOLD
    (here / "again.toml").write_text(configuration.as_text(sections), encoding="utf-8")
    assert configuration.read(here / "again.toml")["record"] == sections["record"]


def test_a_trial_carries_what_was_told_and_nothing_that_was_not(here: Path, bowden: Bowden) -> None:
    (here / "bench.toml").write_text(configuration.as_template(TOLD), encoding="utf-8")
    status, _, err = bowden("trial", "--config", "bench.toml", "--dry-run", "--rate", 100, "--period", 1, "--cycles", 1,
                            "--settle", 0, "--peak", 20, "-o", "trial.mcap", "--json")
    assert status == 0, err
    carried = read.open(here / "trial.mcap").metadata
    assert {name: carried.get(name, "") for name in TOLD} == TOLD
    assert "notes" not in carried


def test_init_asks_on_a_terminal(here: Path) -> None:
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", "from bowden.cli import main; main()", "init", "-o", "bench.toml"]
    root = Path(__file__).resolve().parents[2]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          env={**os.environ, "PYTHONPATH": str(root)}) as asking:
        os.write(ours, b"left leg\n\n\nN. N.\n\n\n")
        said, _ = asking.communicate()
    os.close(ours)
    os.close(theirs)
    assert asking.returncode == 0, said
    record = configuration.read(here / "bench.toml")["record"]
    assert (record.specimen, record.rope, record.operator, record.notes) == ("left leg", "", "N. N.", "")


def test_init_asks_nobody_where_nobody_is(here: Path, bowden: Bowden) -> None:
    assert bowden("init", "-o", "bench.toml")[0] == 0
    assert configuration.read(here / "bench.toml")["record"].specimen == ""
