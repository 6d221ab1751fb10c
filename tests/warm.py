"""Compilation of what a trial runs, once, before several processes or guests need it.

A guest's processor differs from this one's, and compiling in a guest takes minutes: for guests the plainest x86-64 is
compiled, into a cache that they share.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GUEST_CACHE = ROOT / "build" / "guest-numba"
FOR_GUESTS = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(GUEST_CACHE),
              "PYTHONDONTWRITEBYTECODE": ""}
_COMPILE_LAWS = "from bowden.trials.session import compile_laws; compile_laws(simulated=True)"
_RUN_A_TRIAL = """
import can, tempfile
import numpy as np
from bowden.cli.app import run
from estimation.data import table
from estimation.likelihood_data import PathRecording
from estimation.outputs import predict
from master.network import kernel_frames
from pathlib import Path
from physics.forward.path_constants import TABLE
kernel_frames.prepare()
with tempfile.TemporaryDirectory() as folder:
    trial = Path(folder, "warm.mcap")
    run(["trial", "--rate", "100", "--cycles", "1", "--settle", "0", "--period", "1", "--peak", "20", "--json",
         "-o", str(trial)])
    predict(np.zeros((len(TABLE), 1)), PathRecording(table.read(trial)))
"""


def warm() -> None:
    """Compile what a trial needs, in another process."""
    _run(_COMPILE_LAWS, {})


def warm_guests() -> None:
    """Compile what a trial and a diagnosis need into the guests' cache."""
    GUEST_CACHE.mkdir(parents=True, exist_ok=True)
    _run(_RUN_A_TRIAL, FOR_GUESTS)


def _run(code: str, environment: Mapping[str, str]) -> None:
    subprocess.run([sys.executable, "-c", code], env={**os.environ, **environment}, cwd=ROOT,
                   check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
