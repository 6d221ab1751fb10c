"""Small files that declare gigabytes, and files that point at others, are refused before they are unpacked."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def refused(bowden: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Return what `bowden import` says of a file that it refuses in one sentence, with nothing written."""
    monkeypatch.chdir(tmp_path)

    def said_of(name: str) -> str:
        status, out, err = bowden("import", name, "-o", "back.mcap")
        assert (status, out, err.count("\n")) == (2, "", 1), err
        assert not (tmp_path / "back.mcap").exists()
        return err

    return said_of


def _element(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", kind, len(body)) + body + bytes(-len(body) % 8)


def _struct_array(*extents: int) -> bytes:
    """A MATLAB v5 structure array of those extents without a field: 8 bytes an element in memory, none in the file."""
    head = _element(6, struct.pack("<II", 2, 0)) + _element(5, struct.pack("<2i", *extents)) + _element(1, b"log")
    return _element(14, head + struct.pack("<HHi", 5, 4, 32) + _element(1, b""))


def test_a_matlab_file_that_declares_gigabytes_is_refused(refused: Callable[[str], str], tmp_path: Path) -> None:
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "bomb.mat").write_bytes(header + _struct_array(1, 1_000_000_000))
    assert (tmp_path / "bomb.mat").stat().st_size < 2000
    assert "bomb.mat: unpacks to more than" in refused("bomb.mat")


def test_a_parquet_file_that_declares_gigabytes_is_refused(refused: Callable[[str], str], tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    group = pa.table({"time_s": np.zeros(20_000_000)})
    with parquet.ParquetWriter(tmp_path / "bomb.parquet", group.schema, compression="zstd") as writer:
        writer.write_table(group)
        writer.write_table(group)
    assert (tmp_path / "bomb.parquet").stat().st_size < 1 << 20
    assert "bomb.parquet: unpacks to more than" in refused("bomb.parquet")


def _hdf(path: Path, fill: Callable[[Any], None]) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        fill(file)


def test_an_hdf5_file_never_reads_another_file(refused: Callable[[str], str], tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(bytes(800))
    _hdf(tmp_path / "external.mat", lambda file: file.create_dataset(
        "time_s", (100,), "f8", external=[("secret", 0, 800)]))
    _hdf(tmp_path / "link.mat", lambda file: file.__setitem__("log", h5py.ExternalLink("external.mat", "/")))
    layout = h5py.VirtualLayout((100,), "f8")
    layout[:] = h5py.VirtualSource("external.mat", "time_s", (100,))
    _hdf(tmp_path / "virtual.mat", lambda file: file.create_virtual_dataset("time_s", layout))
    for name in ("external.mat", "link.mat", "virtual.mat"):
        assert "has its values in another file, which is not opened" in refused(name)


def test_an_hdf5_file_that_declares_gigabytes_or_a_loop_is_refused(
    refused: Callable[[str], str], tmp_path: Path
) -> None:
    _hdf(tmp_path / "bomb.mat", lambda file: file.create_dataset("time_s", (10**10,), "f8", chunks=(1000,)))
    assert "bomb.mat: unpacks to more than" in refused("bomb.mat")

    def loop(file: Any) -> None:
        file.create_group("log")["again"] = file["/"]

    _hdf(tmp_path / "loop.mat", loop)
    assert "give a file without loops of links" in refused("loop.mat")
