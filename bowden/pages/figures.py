"""Figures of `trial --json`, from the closed file, and the picture.

A signal that was not recorded has no figure; a full disk is no error here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from bowden.pages import load_prediction as load
from bowden.progress import SILENT, Progress
from eds.bench import bus_load
from eds.bench.bench_network import wire
from parameters import InputError
from trial import metrics, read
from trial.paths import one_path
from trial.signals import COLUMNS
from trial.truth_file import open_truth

if TYPE_CHECKING:
    from master.motion.experiment_run import ExperimentSetup, Result

TRUE_END = "true_end_n"


def figures(
    experiment: ExperimentSetup, result: Result, output: Path, truth: Path | None, wall_s: float, *,
    serial: int | None, simulated: bool, kept: bool = True, progress: Progress = SILENT,
    paths: Mapping[str, ExperimentSetup] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return every figure that `trial --json` publishes, in the order of the documentation.

    `paths`: the experiments of a bench of several force paths; the figures of force are then under `paths`, by path.
    `serial`: of the simulated bench, None on hardware; not `kept`: the disk did not take the whole trial.
    """
    gait, network = experiment.gait, experiment.network
    recorded = read.open(output) if kept else None
    if paths:
        return _of_paths(experiment, result, output, truth, wall_s, paths, recorded, serial=serial, simulated=simulated,
                         progress=progress)
    columns = {name: np.empty(0) for name in COLUMNS} if recorded is None else recorded.columns
    found = metrics.figures(
        columns, peak_n=gait.peak_n, rate_hz=network.rate_hz, cycles=gait.cycles, settle=gait.settle,
        true_end_n=None if truth is None or recorded is None else _true_end(truth, recorded, progress))
    return {
        "trial": str(output),
        "peak_n": gait.peak_n,
        "period_s": gait.period_s,
        "cycles": gait.cycles,
        "rate_hz": network.rate_hz,
        "serial": serial,
        "controller": gait.controller,
        "calibration": experiment.calibration.label,
        **found,
        "missed_cycles": result.missed_cycles,
        "stale_inputs": result.stale_inputs,
        "bus_load_percent": math.nan if recorded is None else load.measured_percent(recorded, network.bitrate),
        "bus_load_bound_percent": bus_load.load_percent(wire(network)),
        "simulated_s": result.duration_s if simulated else None,
        "wall_s": wall_s,
        "outcome": result.outcome,
        "stop_reason": result.stop_reason,
    }


def _of_paths(
    experiment: ExperimentSetup, result: Result, output: Path, truth: Path | None, wall_s: float,
    paths: Mapping[str, ExperimentSetup], recorded: read.Trial | None, *, serial: int | None, simulated: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Return the figures of a trial of several force paths: those of force by path."""
    found = refused(experiment, result, wall_s, serial=serial, simulated=simulated) | {"trial": str(output)}
    found["paths"] = {}
    for name, setup in paths.items():
        one = None if recorded is None else one_path(recorded, name)
        true = None if truth is None or one is None else _true_end(truth, one, progress, f"{name}.")
        figures = metrics.figures(
            {name: np.empty(0) for name in COLUMNS} if one is None else one.columns, peak_n=setup.reference.peak_n,
            rate_hz=setup.network.rate_hz, cycles=setup.gait.cycles, settle=setup.gait.settle, true_end_n=true)
        found["paths"][name] = {"peak_n": setup.reference.peak_n, "calibration": setup.calibration.label, **figures}
    if recorded is not None:
        found["bus_load_percent"] = load.measured_percent(recorded, experiment.network.bitrate)
    return found


def refused(
    experiment: ExperimentSetup, result: Result, wall_s: float, *, serial: int | None, simulated: bool
) -> dict[str, Any]:
    """The keys of `figures` for a run that ended before its first control cycle, of which no file is kept."""
    nothing = dict.fromkeys(metrics.figures(
        {name: np.empty(0) for name in COLUMNS}, peak_n=experiment.gait.peak_n, rate_hz=experiment.network.rate_hz,
        cycles=experiment.gait.cycles, settle=experiment.gait.settle, true_end_n=None))
    return {
        "trial": None, "peak_n": experiment.gait.peak_n, "period_s": experiment.gait.period_s,
        "cycles": experiment.gait.cycles, "rate_hz": experiment.network.rate_hz, "serial": serial,
        "controller": experiment.gait.controller, "calibration": experiment.calibration.label, **nothing,
        "missed_cycles": result.missed_cycles, "stale_inputs": result.stale_inputs, "bus_load_percent": math.nan,
        "bus_load_bound_percent": bus_load.load_percent(wire(experiment.network)),
        "simulated_s": result.duration_s if simulated else None, "wall_s": wall_s,
        "outcome": result.outcome, "stop_reason": result.stop_reason,
    }


def _true_end(
    truth: Path, recorded: read.Trial, progress: Progress, prefix: str = ""
) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """True END as `true_end`; None, and a remark, where the side file was not closed."""
    try:
        return true_end(truth, recorded, prefix)
    except InputError as error:
        progress.remark(str(error))
        return None


def true_end(truth: Path, recorded: read.Trial, prefix: str = "") -> np.ndarray[Any, np.dtype[np.float64]]:
    """True END, N, at the SYNCs that latched the recorded rows; NaN at a row without one; `prefix`: the path's."""
    side = open_truth(truth)
    places = np.searchsorted(side.time_ns, recorded.time_ns).clip(0, len(side.time_ns) - 1)
    hit = side.time_ns[places] == recorded.time_ns
    return np.where(hit, side.columns[prefix + TRUE_END][places], np.nan)


def picture(output: Path, path: Path, experiment: ExperimentSetup) -> None:
    """Draw the trial."""
    from bowden.pages.picture import draw

    gait = experiment.gait
    draw(read.open(output).columns, f"{gait.peak_n:g} N, {gait.period_s:g} s, controller {gait.controller}", path)
