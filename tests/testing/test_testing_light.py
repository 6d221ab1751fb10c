"""The base install: `bowden.testing`, node access, recording and reading, without a compiler and SciPy."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from parameters.extras import EXTRAS

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LARGEST_MB = 120
"""Size of the base install's files, without bytecode; numpy is half of it."""

HEAVY = ("numba", "llvmlite", "scipy", "matplotlib", "threadpoolctl")
USED = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError("No module named " + repr(name), name=name)
sys.meta_path.insert(0, Absent())
{program}
print(sorted(set(sys.modules) & set({heavy!r})))
"""
COMMAND = """
from bowden.cli import main
for words in {lines!r}:
    try:
        main(words)
    except SystemExit as ended:
        if ended.code: raise
"""
IMPORT = "import bowden.testing"
BUS = """
import nodes
from bowden.testing import CanBus
from bowden.testing.conversation import SdoStep, converse
bus = CanBus()
drive = bus.add_node("knee_drive", 5, profile=nodes.GenericDrive())
converse(bus, 5, [SdoStep(0x6040, 0, b"\\x06\\x00")])
assert drive[0x6041] & 0x6F == 0x21
"""


@pytest.mark.parametrize("program", [IMPORT, BUS], ids=["import", "bus"])
@pytest.mark.parametrize("absent", [(), HEAVY], ids=["installed", "absent"])
def test_no_compiler_is_loaded(program: str, absent: tuple[str, ...]) -> None:
    text = USED.format(program=program, absent=absent, heavy=(*HEAVY, "numpy") if program == IMPORT else HEAVY)
    done = subprocess.run([sys.executable, "-c", text], text=True, capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr


def ran(at: Path, *lines: list[str]) -> subprocess.CompletedProcess[str]:
    """Run command lines, one after the other, where the libraries of the extras are missing."""
    text = USED.format(program=COMMAND.format(lines=lines), absent=HEAVY, heavy=HEAVY)
    return subprocess.run([sys.executable, "-c", text], text=True, capture_output=True, check=False, cwd=at)


def test_the_base_install_scans_monitors_checks_and_records(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(1.0) can0 701#05\n")
    done = ran(tmp_path, ["monitor", "a.log"], ["check", "eds", str(ROOT / "eds" / "servo_drive.eds")],
               ["import", "a.log", "-o", "a.mcap"], ["info", "a.mcap"], ["node", "emcy", "8611"], ["--help"],
               ["node", "--help"])
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("[]\n")


@pytest.mark.parametrize("words", [["trial", "-o", "b.mcap"], ["node", "scan"], ["monitor"]])
def test_a_missing_extra_is_one_sentence_with_its_command(tmp_path: Path, words: list[str]) -> None:
    done = ran(tmp_path, words)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert re.search(r"this needs \w+, which is not installed; say pip install 'bowden-bench\[(bench|diagnosis)\]'",
                     done.stderr)


def closure(requirements: list[str], found: dict[str, int]) -> dict[str, int]:
    """Return the sizes, bytes, of installed distributions that requirements need, without extras and bytecode."""
    for requirement in requirements:
        match = re.match(r"[A-Za-z0-9._-]+", requirement)
        if "extra ==" in requirement or match is None or match[0].lower() in found:
            continue
        try:
            installed = distribution(match[0])
        except PackageNotFoundError:  # for another platform
            continue
        found[match[0].lower()] = sum(file.size or 0 for file in installed.files or () if file.suffix != ".pyc")
        closure(installed.requires or [], found)
    return found


def test_the_base_install_is_small() -> None:
    sizes = closure(PROJECT["dependencies"], {})
    assert {"numpy", "python-can", "canopen", "mcap", "typer", "rich"} <= set(sizes)
    assert not set(sizes) & set(EXTRAS)
    assert 50e6 < sum(sizes.values()) < LARGEST_MB * 1e6, sizes


def test_each_library_is_of_the_extra_that_its_sentence_names() -> None:
    extras = PROJECT["optional-dependencies"]
    for library, extra in EXTRAS.items():
        if library != "llvmlite":  # numba's own
            assert [one for one in extras[extra] if one.startswith(library)], library
    assert extras["all"] == ["bowden-bench[diagnosis,report]"]
    assert "bowden-bench[bench]" in extras["diagnosis"]
    assert "bowden-bench[all]" in extras["test"]
