"""The plugin beside a user's own folders of the project's package names, as editable install and as wheel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from eds.dictionary import packaged

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = sorted({name.partition(".")[0] for name in PROJECT["tool"]["setuptools"]["packages"]})
TEST = """
def test_a_drive_boots(can_bus, canopen_node):
    canopen_node("eds/drive.eds", node_id=5)
    can_bus.run(0.01)
    assert can_bus.frames(cob_id=0x705)
"""


@pytest.fixture(params=["editable", "wheel"])
def install(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, str]:
    """Environment in which the packages come after the user's folder: the checkout, or as a wheel has them."""
    if request.param == "editable":
        return {"PYTHONPATH": ""}  # the checkout, by the import hook of an editable install
    site = tmp_path / "site"
    site.mkdir()
    for name in PACKAGES:
        shutil.copytree(ROOT / name, site / name, ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc"))
    return {"PYTHONPATH": str(site)}


def run_pytest(folder: Path, install: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run the user's test as `pytest` does it: the test's folder goes before everything else on the path."""
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "bowden.testing.plugin"], cwd=folder,
        text=True, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**os.environ, **install, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's folder with a test and a folder `eds` of EDS files."""
    own = tmp_path / "own"
    (own / "eds").mkdir(parents=True)
    shutil.copy(packaged("knee_drive"), own / "eds" / "drive.eds")
    (own / "test_own.py").write_text(TEST)
    return own


def test_folders_of_data_hide_nothing(folder: Path, install: dict[str, str]) -> None:
    (folder / "nodes").mkdir()
    (folder / "nodes" / "wiring.txt").write_text("node 5\n")
    done = run_pytest(folder, install)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("hides", ["parameters.py", "nodes/__init__.py"])
def test_what_hides_a_package_is_named_in_one_sentence(folder: Path, install: dict[str, str], hides: str) -> None:
    (folder / hides).parent.mkdir(exist_ok=True)
    (folder / hides).write_text("MINE = 1\n")
    done = run_pytest(folder, install)
    assert done.returncode == 1
    assert f"bowden.testing: {folder / hides} hides the package {hides.partition('.')[0].partition('/')[0]}" in (
        done.stdout)
    assert "rename that file" in done.stdout
    assert "Traceback" not in done.stdout
