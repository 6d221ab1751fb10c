"""The truth beside a simulated trial: `trial.truth.mcap`.

The rule of this file: whoever judges a simulated bench may open it; master and diagnosis, which have to find out
by themselves, may not import it.
"""

from pathlib import Path

from trial.read import TrialFile, open_file

TABLE = "/truth"


def open_truth(path: str | Path) -> TrialFile:
    """Open a side file: its columns are the plant's true values at each SYNC; raises `InputError` as `open_file`."""
    return open_file(path, TABLE)
