"""The HTML page of a trial, with the paper's figures and the network's computed load beside the measured ones."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from bowden.progress import SILENT, Progress
from parameters import InputError, from_table

if TYPE_CHECKING:
    from trial.read import TrialFile

PAPER_RMSE_PERCENT = {40.0: 2.53, 50.0: 2.16, 60.0: 2.07}
"""Relative RMSE that the paper's experiment gives by peak, N, its section 5.2."""


def write_trial_page(recorded: TrialFile, path: Path, *, overwrite: bool = False, progress: Progress = SILENT) -> int:
    """Write a trial as one HTML page that needs no network; returns its bytes.  Raises `InputError`."""
    from bowden import output_files
    from bowden.pages.load_prediction import frame_bits
    from trial.report import trial_page

    output_files.refuse([path], overwrite=overwrite, inputs=[recorded.path])
    with progress.running("report") as update:
        return trial_page.write(
            recorded, path, frame_bits, published=_published(recorded), bound_percent=_bound(recorded),
            overwrite=overwrite, progress=update)


def _bound(recorded: TrialFile) -> float | None:
    """Return the sustained load, %, computed for the network that the trial carries; None if it carries none."""
    from eds.bench import bus_load
    from eds.bench.bench_network import Network, wire

    try:
        table = tomllib.loads(recorded.attachments["bench.toml"].decode())["network"]
        return bus_load.load_percent(wire(from_table(Network, table, where="bench.toml [network]")))
    except (KeyError, ValueError, InputError):
        return None


def _published(recorded: TrialFile) -> dict[str, str]:
    """Return the paper's figures at the same peak."""
    try:
        rmse = PAPER_RMSE_PERCENT.get(float(recorded.metadata.get("peak_n", "")))
    except ValueError:
        return {}
    return {} if rmse is None else {"relative_rmse_percent": f"{rmse} %", "max_idle_tension_n": "< 1 N"}
