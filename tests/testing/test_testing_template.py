"""The folder `docs/own_node`, which a newcomer copies: it passes as it is, and its EDS has no finding."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "own_node"


@pytest.mark.slow
def test_a_copy_of_the_folder_passes(tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path / "mine")
    done = subprocess.run([sys.executable, "-m", "pytest", "-q", "-p", "bowden.testing.plugin", "-p",
                           "no:cacheprovider", "-W", "error"], cwd=tmp_path / "mine", text=True, capture_output=True,
                          check=False)
    assert "5 passed" in done.stdout, done.stdout + done.stderr
