"""A device that is not ours: npm's `canopen` on npm's `socketcan` serves the knee drive from our EDS."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from eds.bench.bench_network import KNEE
from eds.dictionary import packaged
from tests.socketcan import rig

pytestmark = pytest.mark.guest("native", "uml")

ROOT = Path(__file__).resolve().parents[2]
MODULES = Path(os.environ.get("BOWDEN_NODE_MODULES", ROOT / "build" / "foreign" / "node_modules"))
DEVICE = ROOT / "tests" / "foreign" / "canopen_device.js"
MILLIDEGREE = np.radians(1e-3)
"""The knee drive's position counts in it."""


@pytest.fixture
def knee(own: str) -> Iterator[str]:
    """The channel on which a foreign knee drive listens."""
    absent = [name for name in ("canopen", "socketcan") if not (MODULES / name).is_dir()]
    if absent or shutil.which("node") is None:
        pytest.skip(f"npm's {' and '.join(absent) or 'node'} is absent; .ci/nightly installs it into build/foreign")
    command = ["node", str(DEVICE), own, str(packaged("knee_drive")), str(KNEE)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True,
                          env={**os.environ, "NODE_PATH": str(MODULES)}) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield own
        process.terminate()


def test_a_foreign_knee_drive_is_brought_up_and_exchanges_pdos(tmp_path: Path, knee: str) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text(f'[[fault]]\nkind = "power_off"\nnode = {KNEE}\n')
    with rig.bench(tmp_path, knee, *rig.patient(tmp_path), "--faults", faults, nodes=(1, 3, 4)):
        told = rig.trial(tmp_path, knee, *rig.patient(tmp_path), "--cycles", 1, "--settle", 0, "--period", 1,
                         "--peak", 20, "--dry-run").wait()
    assert told.result["outcome"] == "completed", told
    columns = rig.recorded(tmp_path).columns
    target, angle = columns["knee_target_rad"], columns["knee_angle_rad"]
    known = np.flatnonzero(np.isfinite(angle))  # a cycle that missed the input has none
    first = int(np.argmax(angle[known] != angle[known[0]]))  # before it, no target has come back
    answered = 0
    for cycle in known[first:]:  # an input may be late; an angle is a target sent before, never an older one
        same = np.flatnonzero(np.abs(angle[cycle] - target[answered:cycle]) < MILLIDEGREE)
        assert len(same), f"cycle {cycle}: {angle[cycle]} rad is no target of cycles {answered} to {cycle - 1}"
        answered += int(same[0])
    assert np.ptp(angle[known[first:]]) > 0.5
