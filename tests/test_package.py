"""The distribution: sdist and wheel are built, installed in an empty environment, and run outside the repository.

Without a network: what the package needs is taken from the environment that runs the tests, and nothing else of it.
With BOWDEN_EMPTY_ENVIRONMENT=1 (`.ci/run` sets it) pip gets all of it from its index, into an environment of its own.
"""

from __future__ import annotations

import json
import os
import runpy
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

import trial

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = PROJECT["tool"]["setuptools"]["packages"]
BUILD = "import sys; from setuptools import build_meta as b; print(getattr(b, sys.argv[1])(sys.argv[2]))"
LEFT_OUT = shutil.ignore_patterns(".*", "build", "out", "*.egg-info", "__pycache__", "tests", "docs", "node_modules")
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")


def run(*command: object, at: Path) -> str:
    """Run a program outside the repository, with nothing of this process's Python in its environment."""
    bare = {name: value for name, value in os.environ.items()
            if not name.startswith(("PYTHON", "VIRTUAL_ENV", "COVERAGE"))}
    told = subprocess.run([*map(str, command)], cwd=at, capture_output=True, text=True, env=bare, check=False)
    assert told.returncode == 0, f"{command}: {told.stdout}{told.stderr}"
    return told.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The sdist of this tree, and the wheel that is built from the sdist alone."""
    place = tmp_path_factory.mktemp("dist")
    shutil.copytree(ROOT, place / "tree", ignore=LEFT_OUT)
    sdist = place / run(sys.executable, "-c", BUILD, "build_sdist", place, at=place / "tree").splitlines()[-1]
    with tarfile.open(sdist) as packed:
        packed.extractall(place, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))  # from 3.11.4 on
    source = place / sdist.name.removesuffix(".tar.gz")
    wheel = place / run(sys.executable, "-c", BUILD, "build_wheel", place, at=source).splitlines()[-1]
    return sdist, wheel


@pytest.fixture(scope="module")
def empty(built: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment that has the wheel and what it needs."""
    place = tmp_path_factory.mktemp("empty") / "environment"
    whole = os.environ.get("BOWDEN_EMPTY_ENVIRONMENT") == "1"
    run(sys.executable, "-m", "venv", *(() if whole else ("--without-pip",)), place, at=place.parent)
    python = place / "bin" / "python"
    if whole:
        run(python, "-m", "pip", "--quiet", "install", "-c", ROOT / "constraints.txt", f"{built[1]}[all]",
            at=place.parent)
        return place / "bin"
    run(*PIP, "--python", python, "install", "--no-index", "--no-deps", built[1], at=place.parent)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", at=place).strip())
    # a folder that a .pth names is searched, but its own .pth, which is the editable install of this tree, is not read
    (site / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return place / "bin"


def test_sdist_and_wheel_hold_every_package_its_data_and_the_licence(built: tuple[Path, Path]) -> None:
    sdist, wheel = built
    with tarfile.open(sdist) as packed, zipfile.ZipFile(wheel) as zipped:
        in_sdist = {name.partition("/")[2] for name in packed.getnames()}
        in_wheel = set(zipped.namelist())
    wanted = {str(path.relative_to(ROOT)) for package in PACKAGES
              for path in (ROOT / package.replace(".", "/")).glob("*") if path.suffix in (".py", ".typed", ".eds")}
    wanted |= {str(path.relative_to(ROOT)) for folder in ("trial/assets", "bowden/live/assets")
               for path in (ROOT / folder).iterdir() if path.is_file()}
    assert wanted - in_wheel == set()
    assert wanted - in_sdist == set()
    assert {"LICENSE", "README.md", "pyproject.toml"} <= in_sdist
    assert [name for name in in_wheel if name.endswith("licenses/LICENSE")]
    assert {name.partition("/")[0] for name in in_wheel if ".dist-info" not in name} == {
        package.partition(".")[0] for package in PACKAGES}


def test_every_package_of_the_tree_is_named() -> None:
    rooms = {package.partition(".")[0] for package in PACKAGES}
    assert {".".join(path.parent.relative_to(ROOT).parts) for room in rooms
            for path in (ROOT / room).rglob("__init__.py")} == set(PACKAGES)


@pytest.mark.exhaustive
def test_the_page_of_the_testing_plugin_runs_from_the_wheel(empty: Path, tmp_path: Path) -> None:
    page = runpy.run_path(str(ROOT / "tests" / "testing" / "page.py"))
    page["written"](tmp_path)
    told = run(empty / "python", "-m", "pytest", "-q", "-n", 2, "-W", "error", at=tmp_path)
    assert page["shown"]() in told


@pytest.mark.exhaustive
def test_installed_in_an_empty_environment_it_runs_outside_the_repository(empty: Path, tmp_path: Path) -> None:
    where = run(empty / "python", "-c", "import bowden, sys; print(bowden.__file__, sys.prefix)", at=tmp_path).split()
    assert Path(where[0]).is_relative_to(where[1])
    assert run(empty / "bowden", "--version", at=tmp_path) == f"bowden {PROJECT['project']['version']}\n"
    told = json.loads(run(empty / "bowden", "trial", "--cycles", 1, "--settle", 0, "--period", 1, "-o", "a.mcap",
                          "--json", at=tmp_path))
    assert told["outcome"] == "completed"
    run(empty / "bowden", "report", "a.mcap", "-o", "a.html", at=tmp_path)
    run(empty / "bowden", "export", "a.mcap", "-o", "a.csv", at=tmp_path)
    run(empty / "bowden", "init", "-o", "bench.toml", at=tmp_path)
    assert (trial.open(tmp_path / "a.mcap").result or {})["outcome"] == "completed"
    assert "uPlot" in (tmp_path / "a.html").read_text(encoding="utf-8")
    opened = "import can; bus = can.Bus(interface='bowden', channel='empty'); print(bus.recv(1.0) is not None)"
    assert run(empty / "python", "-c", f"{opened}; bus.shutdown()", at=tmp_path) == "True\n"
