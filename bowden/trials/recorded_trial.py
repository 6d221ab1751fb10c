"""A recorded trial for programs: its columns, its settings, and its outcome.

The file is the trial; everything here is read from it, and a temporary file is removed with the object that owns it.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bowden import output_files
from bowden.deferred import on_first_use
from parameters import InputError
from trial import read

with on_first_use():
    import pandas
    from matplotlib.figure import Figure

    from bowden.pages import picture
    from bowden.pages.figures import write_trial_page
    from trial.compare import TrialComparison
    from trial.compare import compare as compared
    from trial.convert.csv_table import read_map
    from trial.convert.export import export as exported
    from trial.convert.imports import import_file
    from trial.report import words


class Trial:
    """One recorded experiment.

    `columns`: float64 arrays of equal length by signal name, one value a control cycle, NaN where unknown; `units` by
    the same names (SI); `time_ns`: int64, the time of each SYNC, ns.  `metadata`, `attachments`: its provenance, as
    `bowden trial` records it (configuration, calibration, EDS files, packages, commit).  `figures`: what
    `bowden trial --json` prints, {} for a trial that was not run here.
    """

    def __init__(self, path: str | Path, figures: Mapping[str, Any] | None = None) -> None:
        """Open a recorded file (.mcap); raises `InputError` where it is torn, damaged or no trial."""
        self.recorded = read.open(path)
        self.path = self.recorded.path
        self.columns: Mapping[str, NDArray[np.float64]] = self.recorded.columns
        self.units = self.recorded.units
        self.time_ns = self.recorded.time_ns
        self.events = self.recorded.events
        self.metadata = self.recorded.metadata
        self.attachments = self.recorded.attachments
        self.figures = dict(figures or {})

    def __repr__(self) -> str:
        return f"Trial({str(self.path)!r}, {len(self.time_ns)} control cycles, {self.outcome or 'not closed'})"

    def __len__(self) -> int:
        return len(self.time_ns)

    def _repr_html_(self) -> str:
        """Return a table for a notebook: file, how it was run, how it ended, and a row for each signal."""
        told = words.shown({**self.metadata, **(self.recorded.result or {})})
        about = "".join(f"<tr><td>{escape(name)}</td><td>{escape(str(value))}</td></tr>"
                        for name, value in told.items())
        rows = "".join(
            f"<tr><td>{escape(name)}</td><td>{escape(self.units[name])}</td><td>{known.min():.4g}</td>"
            f"<td>{known.max():.4g}</td></tr>" for name, values in self.columns.items()
            if len(known := values[np.isfinite(values)]))
        return (f"<p><b>{escape(self.path.name)}</b>: {len(self.time_ns)} control cycles</p>"
                f"<table>{about}</table><table><tr><th>signal</th><th>unit</th><th>least</th><th>greatest</th></tr>{rows}</table>")

    def plot(self, *names: str) -> Figure:
        """Return a Matplotlib figure of signals over time (s), one axis for each unit.

        Without `names`: desired, START and END force, as far as they are known.  Raises `InputError` for a name that is
        no signal of the trial.
        """
        return picture.signals(self.columns, self.units, names, self.path.name)

    @property
    def outcome(self) -> str | None:
        """Outcome of the trial: "completed" or "stopped"; None if none was recorded."""
        return self._result("outcome")

    @property
    def stop_reason(self) -> str | None:
        """Reason of the stop, in one sentence; None for a completed trial."""
        return self._result("stop_reason")

    def _result(self, key: str) -> str | None:
        value = (self.recorded.result or {}).get(key)
        return value if isinstance(value, str) else None

    @property
    def frames(self) -> NDArray[np.void]:
        """The CAN frames: time_ns, can_id, flags, dlc, channel, sent, data."""
        return self.recorded.frames

    def digest(self) -> str:
        """Return a SHA-256 over every signal, frame and event: equal trials have equal digests."""
        return self.recorded.digest()

    def to_pandas(self) -> pandas.DataFrame:
        """Return the columns as a DataFrame, one row a control cycle, indexed by `time_ns`; `attrs["units"]` by name.

        Raises `InputError` where pandas is not installed.
        """
        try:
            frame = pandas.DataFrame(dict(self.columns), index=pandas.Index(self.time_ns, name="time_ns"))
        except ImportError:
            raise InputError("to_pandas needs pandas; say pip install 'bowden-bench[notebook]'.") from None
        frame.attrs["units"] = dict(self.units)
        return frame

    def save(self, path: str | Path, *, overwrite: bool = False) -> Trial:
        """Copy the file to `path` and return the trial there; raises `InputError` for an existing file."""
        output_files.refuse([Path(path)], overwrite=overwrite)
        try:
            shutil.copyfile(self.path, path)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror}); give a writable place.") from None
        return Trial(path, self.figures)

    def report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the trial as one HTML page that needs no network, as `bowden report` does."""
        write_trial_page(self.recorded, Path(path), overwrite=overwrite)
        return Path(path)


def read_trial(path: str | Path, *, columns: str | Path | None = None) -> Trial:
    """Return the trial in a file that `bowden import` takes: .mcap, .csv, .xlsx, .parquet, .mat, .mf4, a CAN log.

    `columns` is a map (TOML) of the file's columns, as `bowden import --guess` writes it.  A table is converted into a
    temporary file that lives as long as the trial.  Raises `InputError` for what cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() == ".mcap" and columns is None:
        return Trial(path)
    with ExitStack() as folder:
        made = Path(folder.enter_context(TemporaryDirectory(prefix="bowden-")), f"{path.name.partition('.')[0]}.mcap")
        import_file(path, made, mapped=None if columns is None else read_map(Path(columns)))
        trial = Trial(made)
        weakref.finalize(trial, folder.pop_all().close)
    return trial


def export(
    trial: Trial | str | Path, path: str | Path, *, mat73: bool = False, overwrite: bool = False,
) -> int:
    """Write a trial in the format that the ending of `path` names; return the rows or frames written.

    .csv, .csv.gz, .xlsx, .tdms, .parquet, .mf4 and .mat (v5; v7.3 with `mat73`) hold its cycles, .log (candump), .asc,
    .blf and .trc its frames.  Raises `InputError`.
    """
    given = trial if isinstance(trial, Trial) else Trial(trial)
    output_files.refuse([Path(path)], overwrite=overwrite, inputs=[given.path])
    return exported(given.recorded, path, mat73=mat73, overwrite=overwrite)


def compare(a: Trial | str | Path, b: Trial | str | Path) -> TrialComparison:
    """Return the differences between two trials, A − B: metadata, attached files, results and signals.

    Signals are compared row by row, by gait phase or by time; `matched` names which. Raises `InputError`.
    """
    return compared(*((each if isinstance(each, Trial) else Trial(each)).recorded for each in (a, b)))
