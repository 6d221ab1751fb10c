"""The examples of `docs/testing.md` pass, and as many as the page shows; from the wheel: `tests/test_package.py`."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

PAGE = runpy.run_path(str(Path(__file__).with_name("page.py")))


def test_the_page_runs(tmp_path: Path) -> None:
    PAGE["written"](tmp_path)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "bowden.testing.plugin", "-c", "/dev/null", "-W", "error",
               "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(tmp_path)]
    told = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert PAGE["shown"]() in told.stdout, told.stdout + told.stderr
