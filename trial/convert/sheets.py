"""Tables of several formats as sheets: CSV, Excel, TDMS, Parquet, MATLAB and MDF.

A format's library is imported when such a file is read; if it is absent, the error names the package to install.
Columns that are not numeric are left out and counted.
"""

import csv
import datetime
import importlib
import io
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from parameters import InputError
from parameters.files import READ_LIMIT, refuse_special
from trial.convert import csv_file, unpacked_size
from trial.convert.lab_table import Floats, LabTable, unique

TEXT = (".csv", ".tsv", ".dat", ".txt")
ENDINGS = (*TEXT, ".xlsx", ".tdms", ".parquet", ".mat", ".mf4", ".mdf")
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
    if path.stat().st_size > READ_LIMIT:
        raise InputError(f"{path}: is longer than {READ_LIMIT} bytes; cut it.")
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
        unpacked_size.check_parquet(path, file.metadata)
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
    unpacked_size.check_zip(path)
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
    """Return the rows of a sheet that hold anything as comma-separated text."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in sheet.iter_rows(values_only=True):
        if any(cell is not None for cell in row):
            writer.writerow([_excel_cell(cell) for cell in row])
    return text.getvalue()


def _excel_table(path: Path, text: str) -> LabTable | str:
    """Return the table in a sheet's text, or the reason why it holds none."""
    if not text:
        return "empty"
    try:
        table = csv_file.read_text(path, text)
    except InputError:
        return "no table"
    return table if len(set(table.names) - set(table.faults)) > 1 else "no columns of numbers"


def _excel_cell(cell: Any) -> str:
    if isinstance(cell, datetime.datetime):
        return cell.isoformat()
    return "" if cell is None else repr(cell) if isinstance(cell, float) else str(cell)


def tdms(path: Path) -> LabTable:
    """Read the channels of a TDMS file of the commonest length; a waveform's increment gives the time."""
    columns: Arrays = {}
    units: dict[str, str] = {}
    for group in library(path, "nptdms", "TDMS", "tdms").TdmsFile.read(path).groups():
        for channel in group.channels():
            values = np.asarray(channel[:])
            name = channel.name if channel.name not in columns else f"{group.name}.{channel.name}"
            columns[name] = values
            units[name] = str(channel.properties.get("unit_string", "") or "")
            step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
            if step > 0 and "time_s" not in columns and values.dtype.kind in "fiu":
                begins_s = float(channel.properties.get("wf_start_offset", 0.0))
                columns["time_s"] = begins_s + step * np.arange(len(values))
                units["time_s"] = "s"
    return _sheet(path, columns, units, ["TDMS"])


def matlab(path: Path) -> LabTable:
    """Read the vectors of a MATLAB file, those of equal length; of v7.3 ones, which are HDF5, by h5py."""
    with path.open("rb") as file:
        head = file.read(520)
    hdf = b"MATLAB 7.3" in head[:128] or head[512:516] == b"\x89HDF" or head[:4] == b"\x89HDF"
    found = _hdf(path) if hdf else _matlab5(path)
    units = {name: str(text) for name, text in found.pop("units", {}).items()} if isinstance(
        found.get("units"), dict) else {}
    flat: Arrays = {}
    _flatten("", found, flat)
    return _sheet(path, flat, units, [f"MATLAB v{'7.3' if hdf else '5'}"])


def _matlab5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    unpacked_size.check_matlab5(path)
    found = loadmat(path, simplify_cells=True)
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _hdf(path: Path) -> dict[str, Any]:
    with library(path, "h5py", "MATLAB v7.3", "mat73").File(path, "r") as file:
        unpacked_size.check_hdf(path, file)
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
        unpacked_size.check_mdf(path, file)
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
    unpacked_size.check_mdf_blocks(path)
    try:
        with asammdf.MDF(path) as file:
            unpacked_size.check_mdf(path, file)
            return any(map(len, getattr(file, "bus_logging_map", {}).get("CAN", {}).values()))
    except InputError:
        raise
    except Exception:  # whoever reads it says what is wrong
        return False


def _sheet(path: Path, columns: Arrays, units: Mapping[str, str], remarks: list[str]) -> LabTable:
    """Make a sheet of the columns of numbers that have the commonest length; the others are listed as left out."""
    numbers = {name: values for name, values in columns.items() if values.dtype.kind in "fiub"}
    stamps = {name: values for name, values in columns.items() if values.dtype.kind == "M"}
    lengths = Counter(len(values) for values in (*numbers.values(), *stamps.values()) if len(values) > 1)
    if not lengths:
        raise InputError(f"{path}: holds no column of numbers; give a table.")
    length = max(lengths, key=lambda one: (lengths[one], one))
    values: dict[str, Floats] = {}
    begins: dict[str, int] = {}
    for name, column in (numbers | stamps).items():
        if len(column) == length:
            if name in stamps:
                whole = column.astype("datetime64[ns]").astype(np.int64)
                begins[name] = int(whole[0])
                values[name] = (whole - whole[0]) / 1e9
            else:
                values[name] = np.ascontiguousarray(column, np.float64)
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


def _shortest(names: list[str]) -> list[str]:
    """Return the names of a structure's fields without the structure's if the short name is a signal's and unique."""
    last = [name.rsplit(".", 1)[-1] for name in names]
    return [short if csv_file.reserved(short) and last.count(short) == 1 else name
            for name, short in zip(names, last, strict=True)]
