"""A trial for other programs: `/cycle` as CSV, Excel, TDMS, Parquet, MDF or for MATLAB, `/can/frames` as a CAN log.

The rule of this file: a file appears under its name only when it is whole; a column that is unknown throughout is
left out, an unknown value is an empty cell, and every number reads back as the same float.
"""

import gzip
import io
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parameters import InputError
from parameters.files import replaced
from trial.convert import candump
from trial.convert.sheets import library
from trial.read import ROWS_AT_ONCE, TrialFile
from trial.record import Progress, silent

Writer = Callable[[TrialFile, Path, Progress], int | None]
"""Function that writes a trial's cycles and returns None, or its frames and returns their number."""
BLOCKS_IN_GROUP = 4  # of a Parquet file: with one block a group it is half as large again
PYTHON_CAN = (".asc", ".blf", ".trc")


def export(
    trial: TrialFile, target: str | Path, *, mat73: bool = False, overwrite: bool = False, progress: Progress = silent
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
        frames = write(trial, part, progress)
    return trial.extent.rows if frames is None else frames


def _writer(target: Path) -> Writer:
    name = target.name.lower()
    for ending, write in (
        (".csv", _csv), (".csv.gz", _csv_gz), (".parquet", _parquet), (".xlsx", _excel), (".tdms", _tdms),
        (".mf4", _mdf), (".mat", _matlab5), (".log", _candump), (PYTHON_CAN, _can_log),
    ):
        if name.endswith(ending):
            return write
    raise InputError(f"{target}: the ending {target.suffix or 'is missing and'} names no format; expected .csv, "
                     f".csv.gz, .xlsx, .tdms, .parquet, .mf4, .mat, .log, {', '.join(PYTHON_CAN)}.")


def known_columns(trial: TrialFile) -> list[str]:
    """Return the names of the columns that are not unknown throughout; raises `InputError` without any."""
    known = set[str]()
    for block in trial.blocks():
        known |= {name for name, column in block.columns.items() if name not in known and not np.isnan(column).all()}
        if len(known) == len(block.columns):
            break
    if not known:
        raise InputError(f"{trial.path}: has no cycles to write; export its frames to a .log, .asc, .blf or .trc file.")
    return [name for name in trial.units if name in known]


def _rows(trial: TrialFile, names: list[str], progress: Progress) -> Iterator[list[float]]:
    """Yield the control cycles as rows of the columns `names`."""
    done, rows = 0, trial.extent.rows
    for times, columns in trial.blocks(names):
        yield from np.array([columns[name] for name in names]).T.tolist()
        done += len(times)
        progress(done / rows)


def csv_lines(trial: TrialFile, progress: Progress = silent) -> Iterator[str]:
    """Write the header and the rows."""
    names = known_columns(trial)
    yield ",".join(names) + "\n"
    for row in _rows(trial, names, progress):
        yield ",".join(["" if value != value else repr(value).removesuffix(".0") for value in row]) + "\n"


def _csv(trial: TrialFile, part: Path, progress: Progress) -> None:
    with part.open("w", encoding="utf-8") as file:
        file.writelines(csv_lines(trial, progress))


def _csv_gz(trial: TrialFile, part: Path, progress: Progress) -> None:
    with part.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=0) as file:  # no name, no time: repeatable
        file.writelines(line.encode() for line in csv_lines(trial, progress))


def _parquet(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write row groups of some blocks, with units as metadata of the fields; an unknown value is null."""
    pa, parquet = (library(trial.path, module, "Parquet", "parquet") for module in ("pyarrow", "pyarrow.parquet"))
    names = known_columns(trial)
    schema = pa.schema([pa.field(name, pa.float64(), metadata={"unit": trial.units[name]}) for name in names])
    with parquet.ParquetWriter(part, schema) as file:
        waiting: list[Any] = []
        for block in trial.blocks(names):
            waiting.append(pa.table([pa.array(block.columns[name], from_pandas=True) for name in names], schema=schema))
            if len(waiting) == BLOCKS_IN_GROUP:
                file.write_table(pa.concat_tables(waiting))
                waiting.clear()
        if waiting:
            file.write_table(pa.concat_tables(waiting))
    progress(1.0)


EXCEL_ROWS = (1 << 20) - 2  # below a header and a row of units


def _excel(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write one sheet: a header, a row of units, then the cycles; an unknown value is an empty cell."""
    openpyxl = library(trial.path, "openpyxl", "Excel", "xlsx")
    if trial.extent.rows > EXCEL_ROWS:
        raise InputError(f"{trial.path}: has {trial.extent.rows} cycles, an Excel sheet holds {EXCEL_ROWS}; cut it, "
                         "or write .csv.")
    names = known_columns(trial)
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("cycle")
    sheet.append(names)
    sheet.append([trial.units[name] for name in names])
    for row in _rows(trial, names, progress):
        sheet.append([None if value != value else value for value in row])
    whole = io.BytesIO()
    book.save(whole)  # a zip file whose disk is full prints a traceback when it is collected
    part.write_bytes(whole.getbuffer())


def _tdms(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write one group `cycle`, a channel for each column with its unit."""
    nptdms = library(trial.path, "nptdms", "TDMS", "tdms")
    names = known_columns(trial)
    with part.open("wb") as file, nptdms.TdmsWriter(file) as writer:
        for block in trial.blocks(names):
            writer.write_segment([
                nptdms.ChannelObject("cycle", name, block.columns[name], {"unit_string": trial.units[name]})
                for name in names])
    progress(1.0)


def _mdf(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write one channel group over `time_s`."""
    asammdf = library(trial.path, "asammdf", "MDF", "mf4")
    names = known_columns(trial)
    with asammdf.MDF(version="4.10") as file:
        others = [name for name in names if name != "time_s"]
        for number, (_, columns) in enumerate(trial.blocks(names)):
            if number:
                file.extend(0, [(columns[name], None) for name in ("time_s", *others)])
            else:
                file.append([asammdf.Signal(columns[name], columns["time_s"], name=name, unit=trial.units[name])
                             for name in others])
        file.save(part, overwrite=True)
    progress(1.0)


V5_LIMIT = (1 << 31) - 1024  # bytes of one variable of a MATLAB v5 file


def _matlab5(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write column vectors by name, and the structure `units`; an unknown value is NaN.

    SciPy writes the header of each variable, with one row; its length and its rows come by block.
    """
    from scipy.io import savemat

    names, rows = known_columns(trial), trial.extent.rows
    if 8 * rows > V5_LIMIT:
        raise InputError(f"{trial.path}: is too long for a MATLAB v5 file; say --mat73.")
    with part.open("wb") as file:
        savemat(file, {"units": {name: trial.units[name] for name in names}}, long_field_names=True)
        starts = {}
        for name in names:
            head = _matlab5_head(name, rows)
            file.write(head)
            starts[name] = file.tell()
            file.seek(8 * rows, 1)
        done = 0
        for times, columns in trial.blocks(names):
            for name, start in starts.items():
                file.seek(start + 8 * done)
                file.write(columns[name].astype("<f8").tobytes())
            done += len(times)
            progress(done / rows)


def _matlab5_head(name: str, rows: int) -> bytes:
    """Return a real double column vector up to its data, as MATLAB's MAT-file format, level 5, tags them."""
    raw = name.encode()
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, rows, 1)  # flags: class double; dimensions
    body += struct.pack("<II", 1, len(raw)) + raw + bytes(-len(raw) % 8) + struct.pack("<II", 9, 8 * rows)
    return struct.pack("<II", 14, len(body) + 8 * rows) + body


def _matlab73(trial: TrialFile, part: Path, progress: Progress) -> None:
    """Write HDF5 as MATLAB v7.3 reads it: a user block of 512 bytes that identifies it, and classes as attributes."""
    h5py = library(trial.path, "h5py", "MATLAB v7.3", "mat73")
    names, rows, done = known_columns(trial), trial.extent.rows, 0
    with h5py.File(part, "w", userblock_size=512) as file:
        for name in names:
            made = file.create_dataset(name, (1, rows), "<f8", chunks=(1, min(rows, ROWS_AT_ONCE)), compression="gzip")
            made.attrs["MATLAB_class"] = np.bytes_(b"double")
        for times, columns in trial.blocks(names):
            for name in names:
                file[name][0, done:done + len(times)] = columns[name]
            done += len(times)
            progress(done / rows)
        units = file.create_group("units")
        units.attrs["MATLAB_class"] = np.bytes_(b"struct")
        for name in names:
            text = np.array([[ord(letter)] for letter in trial.units[name]], np.uint16)
            made = units.create_dataset(name, data=text)
            made.attrs["MATLAB_class"] = np.bytes_(b"char")
            made.attrs["MATLAB_int_decode"] = np.int32(2)
    with part.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM")


def _candump(trial: TrialFile, part: Path, progress: Progress) -> int:
    count = 0
    with part.open("w", encoding="ascii") as file:
        for frames in _frames(trial, progress):
            file.writelines(candump.lines(frames))
            count += len(frames)
    return count


def _can_log(trial: TrialFile, part: Path, progress: Progress) -> int:
    from trial.convert.python_can import write_log

    return write_log(part, _frames(trial, progress))


def _frames(trial: TrialFile, progress: Progress) -> Iterator[NDArray[np.void]]:
    """Yield the CAN frames by block; progress is by trial time."""
    _, first, last, _ = trial.extent
    for frames in trial.frame_blocks():
        yield frames
        progress(min(1.0, max(0.0, (int(frames["time_ns"][-1]) - first) / (last - first))) if last > first else 1.0)
