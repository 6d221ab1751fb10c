"""EDS files of packages from the registries boot and answer their own dictionary; nothing of them is kept here."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from bowden.testing import CanBus, CanopenNode
from bowden.testing.conversation import SdoStep, converse
from eds.cia301 import Abort
from eds.datatype import encode

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.exhaustive


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """EDS and DCF files by name: from canopen's source distribution, and from npm's canopen where it is installed."""
    place = tmp_path_factory.mktemp("registry")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", "canopen",
               f"canopen=={version('canopen')}", "--dest", str(place)]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    for packed in place.glob("*.tar.gz"):
        with tarfile.open(packed) as archive:
            archive.extractall(place, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
    found = [*place.rglob("*"), *(ROOT / "build" / "foreign").rglob("*")]
    named = {path.name: path for path in found if path.suffix.lower() in (".eds", ".dcf")}
    if not named:
        pytest.skip(f"no package with EDS files could be had: {told.stderr.strip().splitlines()[-1:]}")
    return named


@pytest.mark.parametrize("name", ["sample.eds", "datatypes.eds", "e35.eds", "example.eds"])
def test_a_foreign_eds_boots_and_answers_its_own_dictionary(
    can_bus: CanBus, canopen_node: Callable[..., CanopenNode], files: dict[str, Path], name: str,
) -> None:
    if name not in files:
        pytest.skip(f"{name} is in none of the packages that could be had")
    node = canopen_node(files[name], 5)
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
