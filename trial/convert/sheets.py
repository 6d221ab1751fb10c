"""Tables of several formats as sheets: CSV, Excel, TDMS, Parquet, MATLAB and MDF.

A format's library is imported when such a file is read; if it is absent, the error names the package to install.
Columns that are not numeric are left out and counted. A file of a few kilobytes can declare arrays of gigabytes:
dimensions without values, run lengths, fill values. `check_…` reads the declarations and raises `InputError` above
the limit of the file, before the library unpacks anything.
"""

import csv
import datetime
import importlib
import io
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from parameters import InputError
from parameters.files import refuse_large, refuse_special, unpacked_limit
from trial.convert import csv_file
from trial.convert.lab_table import Floats, LabTable, unique

ENDINGS = (".csv", ".tsv", ".dat", ".txt", ".xlsx", ".tdms", ".parquet", ".mat", ".mf4", ".mdf")
Arrays = dict[str, np.ndarray[Any, Any]]


def sheet_of(path: Path, dialect: csv_file.Dialect | None = None) -> LabTable:
    """Read the table in a file; CSV where its ending names none of the other formats."""
    ending = path.suffix.lower()
    readers: dict[str, Callable[[Path], LabTable]] = {
        ".xlsx": excel, ".tdms": tdms, ".parquet": parquet, ".mat": matlab, ".mf4": mdf, ".mdf": mdf}
    if ending not in readers:
        if dialect is not None and dialect.sheet:
            raise InputError(f"{path}: is no workbook and has no sheet {dialect.sheet!r}; leave the sheet out.")
        return csv_file.read(path, dialect)
    chosen = "" if dialect is None else dialect.sheet
    if dialect is not None and dialect != csv_file.Dialect(sheet=chosen if ending == ".xlsx" else ""):
        raise InputError(f"{path}: is no CSV file; leave [csv] out of the map.")
    refuse_special(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; give the path of a table.")
    refuse_large(path)
    try:
        return excel(path, chosen) if ending == ".xlsx" else readers[ending](path)
    except InputError:
        raise
    except MemoryError:
        raise InputError(f"{path}: is too large for this computer's memory; cut it.") from None
    except Exception as error:  # what these libraries raise for a damaged file is theirs
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise InputError(f"{path}: cannot be read ({reason}); give a whole {ending} file.") from None


def library(path: Path, module: str, what: str, extra: str) -> Any:
    """Import the library of a format; raises `InputError` with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{path}: {what} needs {module.partition('.')[0]}; say pip install bowden-bench[{extra}]."
                         ) from None


def parquet(path: Path) -> LabTable:
    """Read a Parquet file; units are those of its fields' metadata."""
    with library(path, "pyarrow.parquet", "Parquet", "parquet").ParquetFile(path) as file:
        check_parquet(path, file.metadata)
        # text is left out unread: one long word in a thousand rows is kept once in the file, but not in memory
        table = file.read([field.name for field in file.schema_arrow if _fixed_width(field.type)])
        left_out = [field.name for field in file.schema_arrow if not _fixed_width(field.type)]
    columns: Arrays = {name: np.empty(0, object) for name in left_out}
    units: dict[str, str] = {}
    for field in table.schema:
        values = np.asarray(table.column(field.name).to_numpy())
        columns[field.name] = values
        units[field.name] = ((field.metadata or {}).get(b"unit") or b"").decode("utf-8", "replace")
    return _sheet(path, columns, units, [])


def _fixed_width(kind: Any) -> bool:
    """Return whether a column of Arrow type `kind` holds numbers, truth values or times."""
    from pyarrow import types

    return bool(types.is_primitive(kind) or (types.is_dictionary(kind) and types.is_primitive(kind.value_type)))


def excel(path: Path, chosen: str = "") -> LabTable:
    """Read a sheet of an Excel file as its CSV would be: header, perhaps a row of units, then numbers.

    It is the sheet `chosen`, else the first one that holds a table of numbers; the others are listed as left out.
    """
    openpyxl = library(path, "openpyxl", "Excel", "xlsx")
    check_zip(path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        texts = {sheet.title: _excel_text(sheet) for sheet in book.worksheets}
    finally:
        book.close()
    if chosen and chosen not in texts:
        raise InputError(f"{path}: has no sheet {chosen!r}; expected one of {_quoted(texts)}.")
    found, reasons = None, dict[str, str]()
    for name, text in texts.items():
        table = _excel_table(path, text)
        if found is None and (name == chosen or not chosen) and isinstance(table, LabTable):
            found, title = table, name
        else:
            reasons[f"sheet {name!r}"] = table if isinstance(table, str) else "another table; --sheet takes it"
    if found is None:
        raise InputError(f"{path}: " + (f"sheet {chosen!r}" if chosen else f"none of its sheets {_quoted(texts)}")
                         + " holds a header with rows of numbers; name the sheet with --sheet.")
    found.remarks.insert(0, f"Excel, sheet {title!r}")
    found.dialect = {"sheet": title}
    found.left_out = reasons
    return found


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(map(repr, names))


def _excel_text(sheet: Any) -> str:
    """Return the rows of a sheet as comma-separated text, an empty line for a row that holds nothing."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in sheet.iter_rows(values_only=True):
        held = any(cell is not None for cell in row)
        writer.writerow([_excel_cell(cell) for cell in row] if held else [])
    return text.getvalue()


def _excel_table(path: Path, text: str) -> LabTable | str:
    """Return the table in a sheet's text, or the reason why it holds none."""
    if not text.strip():
        return "empty"
    try:
        table = csv_file.read_text(path, text)
    except InputError:
        return "no table"
    return table if len(set(table.names) - set(table.faults)) > 1 else "no columns of numbers"


def _excel_cell(cell: Any) -> str:
    if isinstance(cell, datetime.datetime):
        return cell.isoformat()
    return "" if cell is None else repr(cell) if isinstance(cell, float) else " ".join(str(cell).split())


def tdms(path: Path) -> LabTable:
    """Read the channels of a TDMS file; a waveform's increment gives the time."""
    columns: Arrays = {}
    clocks: Arrays = {}
    units: dict[str, str] = {}
    for group in library(path, "nptdms", "TDMS", "tdms").TdmsFile.read(path).groups():
        for channel in group.channels():
            values = np.asarray(channel[:])
            name = channel.name if channel.name not in columns else f"{group.name}.{channel.name}"
            columns[name] = values
            units[name] = str(channel.properties.get("unit_string", "") or "")
            step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
            if step > 0 and values.dtype.kind in "fiu":
                begins_s = float(channel.properties.get("wf_start_offset", 0.0))
                clocks[name] = begins_s + step * np.arange(len(values))
    if "time_s" not in columns and clocks:
        length = _length({name: columns[name] for name in clocks})
        columns["time_s"], units["time_s"] = max(clocks.values(), key=lambda one: (len(one) == length, len(one))), "s"
    return _sheet(path, columns, units, ["TDMS"], clocks)


def matlab(path: Path) -> LabTable:
    """Read the vectors of a MATLAB file; of v7.3 ones, which are HDF5, by h5py.

    Structures of another rate are read if each has a vector of times, with one name in all.
    """
    with path.open("rb") as file:
        head = file.read(520)
    hdf = b"MATLAB 7.3" in head[:128] or head[512:516] == b"\x89HDF" or head[:4] == b"\x89HDF"
    found = _hdf(path) if hdf else _matlab5(path)
    units = {name: str(text) for name, text in found.pop("units", {}).items()} if isinstance(
        found.get("units"), dict) else {}
    flat: Arrays = {}
    _flatten("", found, flat)
    return _sheet(path, flat, units, [f"MATLAB v{'7.3' if hdf else '5'}"], _own_times(flat))


_TIMES = re.compile(r"(?:t|times?|timestamps?|zeit|clock|seconds|temps|tiempo)(?:_?(?:s|ms|us|sec|seconds))?",
                    re.IGNORECASE)
"""Names of vectors that are times of the structure they are in."""


def _own_times(flat: Arrays) -> Arrays:
    """Return the times of each vector that has some beside it, in its structure, of its length."""
    times = {(name.rpartition(".")[0], len(values)): name for name, values in flat.items()
             if _TIMES.fullmatch(name.rpartition(".")[2]) and values.dtype.kind in "fiu"}
    names = {name.rpartition(".")[2] for name in times.values()}
    beside = {name: times.get((name.rpartition(".")[0], len(values))) for name, values in flat.items()}
    return {name: flat[clock].astype(np.float64) for name, clock in beside.items() if clock is not None
            } if len(names) == 1 else {}


def _matlab5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    check_matlab5(path)
    found = loadmat(path, simplify_cells=True)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _hdf(path: Path) -> dict[str, Any]:
    with library(path, "h5py", "MATLAB v7.3", "mat73").File(path, "r") as file:
        check_hdf(path, file)
        return _group(file)


def _group(group: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if hasattr(item, "items"):
            found[name] = _group(item)
        elif item.dtype.kind in "fiu":
            values = np.asarray(item).T
            text = item.attrs.get("MATLAB_class", b"") == b"char"
            found[name] = "".join(map(chr, values.ravel(order="F"))) if text else values
    return found


def _flatten(prefix: str, found: Mapping[str, Any], flat: Arrays) -> None:
    """Gather vectors by name, those of structures as structure.field, columns of a matrix as name(:,1) …"""
    for name, value in found.items():
        full = f"{prefix}{name}"
        if isinstance(value, Mapping):
            _flatten(f"{full}.", value, flat)
        elif isinstance(value, np.ndarray) and value.ndim == 2 and min(value.shape) > 1:
            flat |= {f"{full}(:,{place + 1})": value[:, place] for place in range(value.shape[1])}
        else:
            flat[full] = np.ravel(np.asarray(value))


def mdf(path: Path) -> LabTable:
    """Read the signals of an MDF file on the clock of its largest group; slower ones are held."""
    with library(path, "asammdf", "MDF", "mf4").MDF(path) as file:
        check_mdf(path, file)
        begins = file.header.start_time
        signals = [signal for signal in file.iter_channels(skip_master=True) if signal.samples.ndim == 1
                   and signal.samples.dtype.kind in "fiub" and len(signal.samples)]
        if not signals:
            raise InputError(f"{path}: holds no signal of numbers; its CAN frames, if any, could not be read.")
        clock = max((signal.timestamps for signal in signals), key=len)
        columns: Arrays = {"time": clock}
        units = {"time": "s"}
        for signal in signals:
            place = np.searchsorted(signal.timestamps, clock, side="right") - 1
            values = signal.samples.astype(np.float64)[np.maximum(place, 0)]
            name = signal.name if signal.name not in columns else f"{signal.name} ({len(columns)})"
            columns[name] = np.where(place >= 0, values, np.nan)
            units[name] = signal.unit or ""
    if "time_s" not in columns:
        columns = {"time_s" if name == "time" else name: values for name, values in columns.items()}
        units["time_s"] = units.pop("time")
    return _sheet(path, columns, units, [f"MDF, begun {begins:%Y-%m-%dT%H:%M:%S}"])


def has_can_frames(path: Path) -> bool:
    """Return whether an MDF file is a log of CAN frames."""
    refuse_special(path)
    asammdf = library(path, "asammdf", "MDF", "mf4")
    check_mdf_blocks(path)
    try:
        with asammdf.MDF(path) as file:
            check_mdf(path, file)
            return any(map(len, getattr(file, "bus_logging_map", {}).get("CAN", {}).values()))
    except InputError:
        raise
    except Exception:  # whoever reads it says what is wrong
        return False


def _sheet(path: Path, columns: Arrays, units: Mapping[str, str], remarks: list[str], clocks: Mapping[str, Any] = {}
           ) -> LabTable:
    """Make a sheet of the columns of numbers that have one length; the others are listed as left out.

    `clocks`: times, by column, of those that have some of their own; such columns of another length are placed by them.
    """
    numbers = {name: values for name, values in columns.items() if values.dtype.kind in "fiub"}
    stamps = {name: values for name, values in columns.items() if values.dtype.kind == "M"}
    length = _length(numbers | stamps)
    if not length:
        raise InputError(f"{path}: holds no column of numbers; give a table.")
    values: dict[str, Floats] = {}
    begins: dict[str, int] = {}
    clock = next((clocks[name] for name, column in numbers.items() if len(column) == length and name in clocks), None)
    placed = 0
    for name, column in (numbers | stamps).items():
        if len(column) == length:
            if name in stamps:
                whole = column.astype("datetime64[ns]").astype(np.int64)
                begins[name] = int(whole[0])
                values[name] = (whole - whole[0]) / 1e9
            else:
                values[name] = np.ascontiguousarray(column, np.float64)
        elif (clock is not None and name in clocks and not np.array_equal(column, clocks[name])
              and _rising(clocks[name]) and _rising(clock)):
            values[name] = _placed(clocks[name], column.astype(np.float64), clock)
            placed += 1
    if placed:
        remarks.append(f"{placed} column{'' if placed == 1 else 's'} of another rate by their own times")
    reasons = {name: f"{len(column)} value{'' if len(column) == 1 else 's'}, the table has {length} rows"
               if name in numbers | stamps else "no numbers" for name, column in columns.items() if name not in values}
    unread = sum(reason == "no numbers" for reason in reasons.values())
    counts = {"columns_of_no_numbers": unread} if unread else {}
    names = _shortest(list(values))
    stated = ["s" if name in begins else units.get(name, "") for name in values]
    found = LabTable(path, unique(names, csv_file.reserved), list(values.values()), stated, range(1, length + 1),
                     counts=counts, remarks=remarks, header_row=0, left_out=reasons)
    found.begins_ns = {name: begins[full] for name, full in zip(names, values, strict=True) if full in begins}
    return found


def _length(columns: Arrays) -> int:
    """Return the length of the columns that make the table, 0 without any: most signals' names, then most values.

    A matrix counts as one column, and a single column makes a table only if there are no two.
    """
    lengths = {len(values) for values in columns.values() if len(values) > 1}
    alike = {length: [name for name, values in columns.items() if len(values) == length] for length in lengths}
    return max(lengths, key=lambda one: (
        sum(csv_file.reserved(name.rpartition(".")[2]) for name in alike[one]),
        min(2, len({name.partition("(:,")[0] for name in alike[one]})), one * len(alike[one])), default=0)


def _rising(times: Floats) -> bool:
    return bool((np.diff(times) > 0.0).all())


def _placed(times: Floats, values: Floats, clock: Floats) -> Floats:
    """Return values of other times on a clock: slower ones in the rows nearest to them, faster ones interpolated."""
    if len(values) > len(clock):
        return np.interp(clock, times, values, left=np.nan, right=np.nan)
    inside = (times >= clock[0]) & (times <= clock[-1])
    found = np.full(len(clock), np.nan)
    found[np.searchsorted((clock[1:] + clock[:-1]) / 2, times[inside])] = values[inside]
    return found


def _shortest(names: list[str]) -> list[str]:
    """Return the names of a structure's fields without the structure's if the short name is a signal's and unique."""
    last = [name.rsplit(".", 1)[-1] for name in names]
    return [short if csv_file.reserved(short) and last.count(short) == 1 else name
            for name, short in zip(names, last, strict=True)]


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
