"""Compiled laws for guests: their processors differ from this one's, and compiling inside takes minutes.

The rule of this file: compiled here, for the plainest x86-64, into a cache that the guests share.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CACHE = Path(__file__).resolve().parents[2] / "build" / "guest-numba"
ENVIRONMENT = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(CACHE),
               "PYTHONDONTWRITEBYTECODE": ""}
_COMPILE = """
import can, tempfile
from bowden.cli.app import run
from master.network import kernel_frames
from pathlib import Path
kernel_frames.prepare()
with tempfile.TemporaryDirectory() as folder:
    run(["trial", "--rate", "100", "--cycles", "1", "--settle", "0", "--period", "1", "--peak", "20", "--json",
         "-o", str(Path(folder, "warm.mcap"))])
"""


def warm() -> None:
    """Compile whatever a trial needs; quick where the cache has it."""
    CACHE.mkdir(parents=True, exist_ok=True)
    subprocess.run([sys.executable, "-c", _COMPILE], env={**os.environ, **ENVIRONMENT}, cwd=CACHE.parents[1],
                   check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
