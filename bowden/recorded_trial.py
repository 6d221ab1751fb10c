"""A recorded trial in the hands of a program: its columns, what it was run with, and how it ended.

The rule of this file: the file is the trial; everything here is read from it, and a file that nobody named is removed
with the object that owns it.
"""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bowden import output_files
from parameters import InputError
from trial import read

if TYPE_CHECKING:
    import pandas


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

    @property
    def outcome(self) -> str | None:
        """How it ended: "completed" or "stopped"; None where the recording does not say."""
        return self._result("outcome")

    @property
    def stop_reason(self) -> str | None:
        """Why it stopped, in one sentence; None where it did not."""
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
            import pandas
        except ImportError:
            raise InputError("to_pandas needs pandas; say pip install 'bowden-bench[notebook]'.") from None
        frame = pandas.DataFrame(dict(self.columns), index=pandas.Index(self.time_ns, name="time_ns"))
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
        from bowden.reports import write_trial_page

        write_trial_page(self.recorded, Path(path), overwrite=overwrite)
        return Path(path)


class TemporaryFolder:
    """A folder for files that nobody named: removed with the object it was handed to, or when the program ends."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="bowden-"))
        self._remove = weakref.finalize(self, shutil.rmtree, self.path, True)

    def remove(self) -> None:
        """Remove it now."""
        self._remove()

    def hand_to(self, owner: object) -> None:
        """Keep the folder for as long as `owner` lives."""
        self._remove.detach()
        weakref.finalize(owner, shutil.rmtree, self.path, True)
