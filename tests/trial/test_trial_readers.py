"""Files written here open in readers that know nothing of this project."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from trial.recover import recover

pytestmark = pytest.mark.exhaustive
SCRIPT = Path(__file__).with_name("read_with_mcap_core.mjs")


def mcap_core() -> str | None:
    """Return the node_modules with @mcap/core: BOWDEN_NODE_MODULES, else `npm root`; None where it is not there."""
    given = os.environ.get("BOWDEN_NODE_MODULES")
    if given is None and shutil.which("npm"):
        given = subprocess.run(["npm", "root"], capture_output=True, text=True, check=True).stdout.strip()
    there = given and all((Path(given) / "@mcap" / name).is_dir() for name in ("core", "support"))
    return given if there and shutil.which("node") else None


def made(recorded: Path, how: str) -> Path:
    """Return a file as it was closed, or torn and recovered."""
    if how == "closed":
        return recorded
    torn, whole = recorded.with_name("torn.mcap"), recorded.with_name("whole.mcap")
    torn.write_bytes(recorded.read_bytes()[:-1000])
    recover(torn, whole)
    return whole


@pytest.mark.parametrize("how", ["closed", "recovered"])
def test_mcap_core_for_javascript_reads_every_message_in_order(recorded: Path, how: str) -> None:
    modules = mcap_core()
    if modules is None:
        pytest.skip("@mcap/core and @mcap/support are absent; name a node_modules that has them in BOWDEN_NODE_MODULES")
    told = subprocess.run(["node", str(SCRIPT), str(made(recorded, how))], env={**os.environ, "NODE_PATH": modules},
                          check=True, capture_output=True, text=True).stdout
    assert json.loads(told) == {
        "counts": {"/can/frames": 5600, "/cycle": 700, "/events": 14}, "ordered": True, "messages": 6314,
        "attachments": ["servo_drive.eds", "commit"],
        "metadata": ["trial", "result"] + ["recovered"] * (how == "recovered"),
    }


@pytest.mark.parametrize("how", ["closed", "recovered"])
def test_rerun_finds_no_fault(recorded: Path, how: str) -> None:
    rerun = os.environ.get("BOWDEN_RERUN") or shutil.which("rerun")
    if rerun is None:
        pytest.skip("rerun is absent; put it on the path or name it in BOWDEN_RERUN")
    path = str(made(recorded, how))
    told = subprocess.run([rerun, "mcap", "info", path], check=True, capture_output=True, text=True).stdout
    assert "Messages                 6314" in told
    words = [rerun, "mcap", "check", "--full", path]
    checked = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert [line.split()[0] for line in checked.splitlines() if " /c" in line or " /e" in line] == ["ok"] * 3
