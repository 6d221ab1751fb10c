"""The mutation check of the devices notices a mutant: a check whose mutants are never imported finds nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CHECK = Path(__file__).with_name("mutation_check.py")


@pytest.mark.exhaustive
def test_a_transition_that_leads_astray_is_noticed() -> None:
    told = subprocess.run([sys.executable, CHECK, "--only", "TRANSITIONS astray: Transition(1,"], capture_output=True,
                          text=True, check=False)
    assert told.returncode == 0, told.stderr
    first, last = told.stdout.splitlines()
    assert "noticed   tests/nodes/test_drive_" in first
    assert last == "1 mutants, 0 unexplained survivors"
