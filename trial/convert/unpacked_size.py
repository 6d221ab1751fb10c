"""Size in memory of a packed table, bounded before its library unpacks the table.

A file of a few kilobytes can declare arrays of gigabytes: dimensions without values, run lengths, fill values.
Each function reads declarations only, and raises `InputError` above the limit of the file.
"""

import math
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any, Final

from parameters import InputError
from parameters.files import unpacked_limit

CELL: Final = 8
"""Least bytes of one value in memory: float64, or the pointer to an object."""

DEPTH: Final = 32
"""Structures within structures that a MATLAB file may have; scipy reads each level on the C stack."""

_ZIPPED: Final = struct.Struct("<4s4xQQ2sBxIQQ")
"""Head of a zipped block of MDF 4 (ASAM MDF 4.1, DZ block): name, length, links, type, method, columns, unpacked bytes,
packed bytes."""
_MATRIX, _COMPRESSED, _INT32 = 14, 15, 5  # data types of MAT-file level 5, MathWorks' "MAT-File Format", table 1-1
_HEADER = 128
_DATA_TYPES: Final = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18))
"""Data types of elements within an array (the same table): at another one scipy reads beyond its table of types, which
ends the process."""


def refuse_above(path: Path, size: int) -> None:
    """Raise `InputError` if `size`, bytes, is more than the file may unpack to."""
    limit = unpacked_limit(path)
    if size > limit:
        raise InputError(f"{path}: unpacks to more than {limit} bytes; it is no measured data, do not open it.")


def check_zip(path: Path) -> None:
    """Raise `InputError` if the members of a zip file, such as .xlsx, are too large together."""
    with zipfile.ZipFile(path) as packed:
        refuse_above(path, sum(member.file_size for member in packed.infolist()))


def check_parquet(path: Path, metadata: Any) -> None:
    """Raise `InputError` if a Parquet file declares too many values or bytes; `metadata` is pyarrow's."""
    groups = [metadata.row_group(place) for place in range(metadata.num_row_groups)]
    rows = max(metadata.num_rows, sum(group.num_rows for group in groups))
    refuse_above(path, max(CELL * rows * metadata.num_columns, sum(group.total_byte_size for group in groups)))


def check_matlab5(path: Path) -> None:
    """Raise `InputError` if the arrays of a MATLAB v5 file are too large together; a v4 file holds each value."""
    raw = path.read_bytes()
    if len(raw) < _HEADER or 0 in raw[:4]:
        return
    order = ">" if raw[126:128] == b"MI" else "<"
    at, size = _HEADER, 0
    while at + 8 <= len(raw):
        kind, length = struct.unpack_from(order + "II", raw, at)
        body = raw[at + 8:at + 8 + length]
        if kind == _COMPRESSED:
            packed = zlib.decompressobj()
            body = packed.decompress(body, unpacked_limit(path) + 1)
            size += len(body)
            refuse_above(path, size)
            size += _declared(path, body, order)
        elif kind == _MATRIX:
            size += _declared(path, raw[at:at + 8 + length], order)
        refuse_above(path, size)
        at += 8 + length


def _declared(path: Path, raw: bytes, order: str) -> int:
    """Return the bytes that an array and all arrays in it take by their dimensions."""
    size = 0
    waiting = [(0, len(raw), 0)]
    while waiting:
        at, end, depth = waiting.pop()
        if depth > DEPTH:
            raise InputError(f"{path}: has structures {DEPTH} deep; it is no measured data, do not open it.")
        place = 0
        while at + 8 <= end:
            kind, length = struct.unpack_from(order + "II", raw, at)
            first, after = at + 8, at + 8 + length + -length % 8
            if kind >> 16:  # a small element: its length and up to four bytes in the tag
                kind, length, first, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if kind not in _DATA_TYPES:
                raise InputError(f"{path}: cannot be read (data type {kind} in an array); give a whole .mat file.")
            if kind == _MATRIX:
                waiting.append((first, min(first + length, end), depth + 1))
            elif kind == _INT32 and place == 1 and depth:
                extents = struct.unpack_from(f"{order}{min(length, end - first) // 4}i", raw, first)
                size += CELL * math.prod(max(extent, 0) for extent in extents)
            at, place = after, place + 1
    return size


def check_hdf(path: Path, file: Any) -> None:
    """Raise `InputError` if an HDF5 file is too large in memory, or has values outside itself; `file` is h5py's."""
    waiting, seen, size = [file], {hash(file["/"].id)}, 0
    while waiting:
        group = waiting.pop()
        for name in (name for name in group if not name.startswith("#")):
            link = group.get(name, getlink=True)
            if type(link).__name__ == "ExternalLink":
                raise outside(path, name)
            item = group.get(name)
            if item is None:
                continue
            address = hash(item.id)
            if hasattr(item, "items"):
                if address in seen:
                    raise InputError(f"{path}: group {name!r} stands twice; give a file without loops of links.")
                seen.add(address)
                waiting.append(item)
            elif hasattr(item, "external"):
                if item.external or item.is_virtual:
                    raise outside(path, name)
                size += max(CELL, item.dtype.itemsize) * math.prod(item.shape or ())
                refuse_above(path, size)


def check_mdf_blocks(path: Path) -> None:
    """Raise `InputError` if the zipped blocks of an MDF file unpack to too many bytes, or to more than they declare."""
    raw, limit, size = path.read_bytes(), unpacked_limit(path), 0
    at = raw.find(b"##DZ")
    while at >= 0 and at + _ZIPPED.size <= len(raw):
        _, _, _, _, _, _, declared, packed = _ZIPPED.unpack_from(raw, at)
        if at % 8 == 0:  # every block begins at a multiple of 8; other places are data
            refuse_above(path, size + declared)
            body = raw[at + _ZIPPED.size:at + _ZIPPED.size + packed]
            try:
                size += len(zlib.decompressobj().decompress(body, limit - size + 1))
            except zlib.error:
                size += 0  # whoever reads it says what is wrong
            refuse_above(path, size)
        at = raw.find(b"##DZ", at + 1)


def check_mdf(path: Path, file: Any) -> None:
    """Raise `InputError` if the signals of an MDF file are too large on the clock of its longest group.

    `file` is asammdf's.
    """
    groups = [(group.channel_group.cycles_nr, group.channel_group.samples_byte_nr, len(group.channels))
              for group in file.groups]
    longest = max((rows for rows, _, _ in groups), default=0)
    refuse_above(path, sum(rows * (width + CELL * count) + CELL * count * longest for rows, width, count in groups))


def outside(path: Path, name: str) -> InputError:
    """Return the error for a dataset whose values are in another file."""
    return InputError(f"{path}: {name!r} has its values in another file, which is not opened; copy them into this one.")
