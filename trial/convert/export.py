"""A trial for other programs: `/cycle` as CSV, Excel, TDMS, Parquet, MDF or for MATLAB, `/can/frames` as a CAN log.

The rule of this file: a file appears under its name only when it is whole; a column that is unknown throughout is
left out, an unknown value is an empty cell, and every number reads back as the same float.
"""

from __future__ import annotations

import gzip
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from parameters import InputError
from parameters.files import replaced
from trial.assemble import Progress, silent
from trial.convert import candump
from trial.read import Trial

ROWS_AT_ONCE = 4096
Writer = Callable[[Trial, Path, Progress], int]
PYTHON_CAN = (".asc", ".blf", ".trc")


def export(
    trial: Trial, target: str | Path, *, mat73: bool = False, overwrite: bool = False, progress: Progress = silent
) -> int:
    """Write `trial` in the format that the ending of `target` names; returns the rows or frames written.

    .csv, .csv.gz, .xlsx, .tdms, .parquet, .mf4 and .mat (v5; v7.3 with `mat73`) hold cycles; .log (candump), .asc,
    .blf and .trc hold frames. `progress` receives the share done, 0 … 1. Raises `InputError`.
    """
    target = Path(target)
    write = _writer(target)
    if mat73:
        if write is not _matlab5:
            raise InputError(f"{target}: --mat73 belongs to a .mat file; leave it out.")
        write = _matlab73
    with replaced(target, overwrite=overwrite) as part:
        return write(trial, part, progress)


def _writer(target: Path) -> Writer:
    name = target.name.lower()
    for endings, write in (
        ((".csv",), _csv), ((".csv.gz",), _csv_gz), ((".parquet",), _parquet), ((".xlsx",), _excel),
        ((".tdms",), _tdms), ((".mf4",), _mdf), ((".mat",), _matlab5),
        ((".log",), _candump),
        (PYTHON_CAN, _can_log),
    ):
        if name.endswith(endings):
            return write
    raise InputError(f"{target}: the ending {target.suffix or 'is missing and'} names no format; expected .csv, "
                     f".csv.gz, .xlsx, .tdms, .parquet, .mf4, .mat, .log, {', '.join(PYTHON_CAN)}.")


def known_columns(trial: Trial) -> list[str]:
    """Return the names of the columns that are not unknown throughout; raises `InputError` without any."""
    names = [name for name, column in trial.columns.items() if not np.isnan(column).all()]
    if not names:
        raise InputError(f"{trial.path}: has no cycles to write; export its frames to a .log, .asc, .blf or .trc file.")
    return names


def csv_lines(trial: Trial, progress: Progress = silent) -> Iterator[str]:
    """Write the header and the rows."""
    names = known_columns(trial)
    yield ",".join(names) + "\n"
    columns = [trial.columns[name] for name in names]
    for at in range(0, len(trial.time_ns), ROWS_AT_ONCE):
        for row in np.array([column[at:at + ROWS_AT_ONCE] for column in columns]).T.tolist():
            yield ",".join([_cell(value) for value in row]) + "\n"
        progress(min(1.0, (at + ROWS_AT_ONCE) / len(trial.time_ns)))


def _cell(value: float) -> str:
    return "" if value != value else repr(value).removesuffix(".0")


def _csv(trial: Trial, part: Path, progress: Progress) -> int:
    lines = csv_lines(trial, progress)
    with part.open("w", encoding="utf-8") as file:
        file.writelines(lines)
    return len(trial.time_ns)


def _csv_gz(trial: Trial, part: Path, progress: Progress) -> int:
    with part.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as file:  # no name, no time: repeatable
        file.writelines(line.encode() for line in csv_lines(trial, progress))
    return len(trial.time_ns)


def _parquet(trial: Trial, part: Path, progress: Progress) -> int:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise InputError(f"{trial.path}: Parquet needs pyarrow; say pip install bowden-bench[parquet].") from None
    fields, arrays = [], []
    for name in known_columns(trial):
        fields.append(pa.field(name, pa.float64(), metadata={"unit": trial.units[name]}))
        arrays.append(pa.array(trial.columns[name], from_pandas=True))  # an unknown value becomes null
    parquet.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), part)
    progress(1.0)
    return len(trial.time_ns)


EXCEL_ROWS = (1 << 20) - 2  # below a header and a row of units


def _excel(trial: Trial, part: Path, progress: Progress) -> int:
    """Write one sheet: a header, a row of units, then the cycles; an unknown value is an empty cell."""
    try:
        new_book = importlib.import_module("openpyxl").Workbook
    except ImportError:
        raise InputError(f"{trial.path}: Excel needs openpyxl; say pip install bowden-bench[xlsx].") from None
    if len(trial.time_ns) > EXCEL_ROWS:
        raise InputError(f"{trial.path}: has {len(trial.time_ns)} cycles, an Excel sheet holds {EXCEL_ROWS}; cut it, "
                         "or write .csv.")
    names = known_columns(trial)
    book = new_book(write_only=True)
    sheet = book.create_sheet("cycle")
    sheet.append(names)
    sheet.append([trial.units[name] for name in names])
    for row in np.array([trial.columns[name] for name in names]).T.tolist():
        sheet.append([None if value != value else value for value in row])
    with part.open("wb") as file:
        book.save(file)
    progress(1.0)
    return len(trial.time_ns)


def _tdms(trial: Trial, part: Path, progress: Progress) -> int:
    """Write one group `cycle`, a channel for each column with its unit."""
    try:
        nptdms = importlib.import_module("nptdms")
    except ImportError:
        raise InputError(f"{trial.path}: TDMS needs nptdms; say pip install bowden-bench[tdms].") from None
    with part.open("wb") as file, nptdms.TdmsWriter(file) as writer:
        writer.write_segment([
            nptdms.ChannelObject("cycle", name, trial.columns[name], {"unit_string": trial.units[name]})
            for name in known_columns(trial)])
    progress(1.0)
    return len(trial.time_ns)


def _mdf(trial: Trial, part: Path, progress: Progress) -> int:
    """Write one channel group over `time_s`."""
    try:
        from asammdf import MDF, Signal
    except ImportError:
        raise InputError(f"{trial.path}: MDF needs asammdf; say pip install bowden-bench[mf4].") from None
    time_s = trial.columns["time_s"]
    with MDF(version="4.10") as file:
        file.append([Signal(trial.columns[name], time_s, name=name, unit=trial.units[name])
                     for name in known_columns(trial) if name != "time_s"])
        saved = file.save(part.with_name(f"{part.name}.mf4"), overwrite=True)
    Path(saved).replace(part)
    progress(1.0)
    return len(trial.time_ns)


V5_LIMIT = (1 << 31) - 1024  # bytes of one variable of a MATLAB v5 file


def _matlab5(trial: Trial, part: Path, progress: Progress) -> int:
    """Write column vectors by name, and the structure `units`; an unknown value is NaN."""
    from scipy.io import savemat

    names = known_columns(trial)
    if 8 * len(trial.time_ns) > V5_LIMIT:
        raise InputError(f"{trial.path}: is too long for a MATLAB v5 file; say --mat73.")
    with part.open("wb") as file:
        savemat(file, {**{name: trial.columns[name] for name in names}, "units": {
            name: trial.units[name] for name in names}}, oned_as="column", long_field_names=True)
    progress(1.0)
    return len(trial.time_ns)


def _matlab73(trial: Trial, part: Path, progress: Progress) -> int:
    """Write HDF5 as MATLAB v7.3 reads it: a user block of 512 bytes that identifies it, and classes as attributes."""
    try:
        import h5py
    except ImportError:
        raise InputError(f"{trial.path}: MATLAB v7.3 needs h5py; say pip install bowden-bench[mat73].") from None
    names = known_columns(trial)
    with h5py.File(part, "w", userblock_size=512) as file:
        for done, name in enumerate(names, start=1):
            made = file.create_dataset(name, data=trial.columns[name][np.newaxis, :], compression="gzip")
            made.attrs["MATLAB_class"] = np.bytes_(b"double")
            progress(done / len(names))
        units = file.create_group("units")
        units.attrs["MATLAB_class"] = np.bytes_(b"struct")
        for name in names:
            text = np.array([[ord(letter)] for letter in trial.units[name]], np.uint16)
            made = units.create_dataset(name, data=text)
            made.attrs["MATLAB_class"] = np.bytes_(b"char")
            made.attrs["MATLAB_int_decode"] = np.int32(2)
    with part.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM")
    return len(trial.time_ns)


def _candump(trial: Trial, part: Path, progress: Progress) -> int:
    candump.write(part, trial.frames, progress)
    return len(trial.frames)


def _can_log(trial: Trial, part: Path, progress: Progress) -> int:
    from trial.convert.python_can import write_log

    write_log(part, trial.frames, progress)
    return len(trial.frames)
