"""EDS files of packages from the registries boot and answer their own dictionary; nothing of them is kept here."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from bowden.testing import CanBus, CanopenNode
from bowden.testing.conversation import SdoStep, converse
from eds.cia301 import Abort
from eds.datatype import encode
from eds.files.check import findings

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.exhaustive


SOURCES = {
    "canopen 2.4.1": "20a84bc498b34dadd79cece467d3bbe19591c1c02a8f39331bcc6065c4d8b2eb",
    "canopen 1.1.0": "b4f114542fae4390f9930a8adfccaa10fef888113dac38bd03009d87c7250a3b",
    "canopen-lens 0.5.1": "5939652e09f0441de7241f7e01c6772fc61e598fc2bd91e3b9c732a61ac5341f",
}
"""Source distributions that carry EDS files, and their SHA-256."""
FILES = {
    ("canopen 2.4.1", "sample.eds"): (54, "SubNumber says 5; write SubNumber=4"),
    ("canopen 2.4.1", "datatypes.eds"): (2, "CiA 301 demands 1000, which is missing"),
    ("canopen 2.4.1", "e35.eds"): (9, "104 objects are listed, the count says 105"),
    ("canopen 1.1.0", "sample.eds"): (46, "6040:00 is mapped, but no such object is described"),
    ("canopen-lens 0.5.1", "sample_drive.eds"): (26, "CiA 402 demands 6041, which is missing"),
    ("npm canopen", "example.eds"): (0, ""),
}
"""Every EDS file of the packages that docs/testing.md lists: number of findings, and words of one of them."""


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return the folder of a package; a source distribution is downloaded once, and refused by another hash."""
    place = tmp_path_factory.mktemp("registry")

    def folder(package: str) -> Path:
        if package not in SOURCES:
            return ROOT / "build" / "foreign"
        name, version = package.split()
        target = place / package
        if not target.exists():
            target.mkdir()
            wanted = place / f"{package}.txt"
            wanted.write_text(f"{name}=={version} --hash=sha256:{SOURCES[package]}\n")
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", name, "-r",
                       str(wanted), "--dest", str(target)]
            told = subprocess.run(command, capture_output=True, text=True, check=False)
            assert "DO NOT MATCH" not in told.stderr
            for packed in target.glob("*.tar.gz"):
                with tarfile.open(packed) as archive:
                    archive.extractall(target, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
        return target

    return folder


@pytest.mark.parametrize(("package", "name"), FILES)
def test_a_foreign_eds_boots_and_answers_its_own_dictionary(
    can_bus: CanBus, canopen_node: Callable[..., CanopenNode], packages: Callable[[str], Path], package: str, name: str,
) -> None:
    file = next(packages(package).rglob(name), None)
    if file is None:
        pytest.skip(f"{package} could not be had")
    count, words = FILES[package, name]
    found = [str(finding) for finding in findings(file)]
    assert (len(found), any(words in each for each in found) or not count) == (count, True)
    node = canopen_node(file, 5)
    can_bus.run(0.001)
    assert can_bus.frames(0x705)[0].data == b"\x00"
    entries = list(node.dictionary.entries.values())
    answers = converse(can_bus, 5, [SdoStep(entry.index, entry.subindex) for entry in entries])
    for entry, answer in zip(entries, answers, strict=True):
        value = node.device.values.get(entry.key, b"")
        data = value if isinstance(value, bytes) else encode(entry.data_type, value)
        wanted = Abort.WRITE_ONLY if not entry.readable else None if data else Abort.NO_DATA
        assert (answer.abort, answer.data or b"") == (wanted, b"" if wanted else data), entry
    assert all(fault.endswith(".") for fault in node.eds_faults)
