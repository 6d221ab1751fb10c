"""Figures of `trial --json`, from the closed file, the picture and the HTML page, with the paper's figures beside them.

A signal that was not recorded has no figure; a full disk is no error here.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bowden import output_files
from bowden.deferred import on_first_use
from bowden.pages import load_prediction as load
from bowden.progress import SILENT, Progress
from eds.bench import bus_load
from eds.bench.bench_network import Network, wire
from parameters import InputError, from_table
from trial import metrics, read
from trial.read import one_path
from trial.truth_file import open_truth

with on_first_use():
    from bowden.pages.picture import draw
    from master.motion.experiment_run import ExperimentSetup, Result
    from trial.report import trial_page

Floats = NDArray[np.float64]
UNCOUNTED = 10**9
"""More gait cycles than any trial has: strides and rests of a drawn walk all count."""


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
    recorded = read.open_file(output) if kept else None
    if paths:
        return _of_paths(experiment, result, output, truth, wall_s, paths, recorded, serial=serial, simulated=simulated,
                         progress=progress)
    force: dict[str, Any] = _of_force(recorded, truth, gait.peak_n, experiment, progress)
    if experiment.walk.differs:
        force["walk"] = None if recorded is None else _of_strides(experiment, recorded, truth, progress)
    found = _with_force(experiment, result, wall_s, force, serial=serial, simulated=simulated)
    load_percent = math.nan if recorded is None else load.measured_percent(recorded, network.bitrate)
    return found | {"trial": str(output), "cycles": experiment.walk.strides or gait.cycles,
                    "bus_load_percent": load_percent}


def _of_strides(
    experiment: ExperimentSetup, recorded: read.TrialFile, truth: Path | None, progress: Progress
) -> dict[str, Any] | None:
    """Return the figures of a walk stride by stride; None if the walk ended before its first stride."""
    side = None if truth is None else _opened(truth, progress)
    true = None if side is None else TrueEnd(side, "")
    blocks = [(columns, None if true is None else true.at(times))
              for times, columns in recorded.blocks(metrics.STRIDE_COLUMNS)]
    columns = metrics.stride_columns(block for block, _ in blocks)
    if not np.isfinite(columns["stride_percent"]).any():
        return None
    ends = [end for _, end in blocks if end is not None]
    return metrics.stride_figures(
        columns, peak_n=experiment.gait.peak_n, rate_hz=experiment.network.rate_hz,
        settle=experiment.gait.settle, true_end_n=np.concatenate(ends) if ends else None)


def _of_paths(
    experiment: ExperimentSetup, result: Result, output: Path, truth: Path | None, wall_s: float,
    paths: Mapping[str, ExperimentSetup], recorded: read.TrialFile | None, *, serial: int | None, simulated: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Return the figures of a trial of several force paths: those of force by path."""
    found = refused(experiment, result, wall_s, serial=serial, simulated=simulated) | {"trial": str(output)}
    found["paths"] = {}
    for name, setup in paths.items():
        one = None if recorded is None else one_path(recorded, name)
        figures = _of_force(one, truth, setup.reference.peak_n, setup, progress, f"{name}.")
        found["paths"][name] = {"peak_n": setup.reference.peak_n, "calibration": setup.calibration.label, **figures}
    if recorded is not None:
        found["bus_load_percent"] = load.measured_percent(recorded, experiment.network.bitrate)
    return found


def refused(
    experiment: ExperimentSetup, result: Result, wall_s: float, *, serial: int | None, simulated: bool
) -> dict[str, Any]:
    """Return the keys of `figures` for a run that ended before its first control cycle, of which no file is kept."""
    nothing = _of_force(None, None, experiment.gait.peak_n, experiment, SILENT)
    return _with_force(experiment, result, wall_s, nothing, serial=serial, simulated=simulated)


def _with_force(
    experiment: ExperimentSetup, result: Result, wall_s: float, force: Mapping[str, Any], *, serial: int | None,
    simulated: bool,
) -> dict[str, Any]:
    """Return the figures of a run from its result and its force figures `force`, with the keys of `figures`."""
    gait, network = experiment.gait, experiment.network
    return {
        "trial": None, "peak_n": gait.peak_n, "period_s": gait.period_s, "cycles": gait.cycles,
        "rate_hz": network.rate_hz, "serial": serial, "controller": gait.controller,
        "calibration": experiment.calibration.label, **force,
        "missed_cycles": result.missed_cycles, "stale_inputs": result.stale_inputs, "bus_load_percent": math.nan,
        "bus_load_bound_percent": bus_load.load_percent(wire(network)),
        "simulated_s": result.duration_s if simulated else None, "wall_s": wall_s,
        "outcome": result.outcome, "stop_reason": result.stop_reason,
    }


def _of_force(
    recorded: read.TrialFile | None, truth: Path | None, peak_n: float, experiment: ExperimentSetup, progress: Progress,
    prefix: str = "",
) -> dict[str, float | None]:
    """Return the figures of force, each None without a recording; `prefix`: of the path's columns in `truth`."""
    side = None if truth is None or recorded is None else _opened(truth, progress)

    def blocks() -> Iterator[Mapping[str, Floats]]:
        if recorded is None:
            return
        true = None if side is None else TrueEnd(side, prefix)
        for times, columns in recorded.blocks(metrics.NEEDED):
            yield columns if true is None else {**columns, metrics.TRUE_END: true.at(times)}

    cycles = UNCOUNTED if experiment.walk.strides else experiment.gait.cycles
    return metrics.figures_of_blocks(blocks, peak_n=peak_n, rate_hz=experiment.network.rate_hz, cycles=cycles,
                                     settle=experiment.gait.settle)


def _opened(truth: Path, progress: Progress) -> read.TrialFile | None:
    """Open a side file; None, and a remark, where it was not closed."""
    try:
        side = open_truth(truth)
        return side if side.extent else None  # reads, and so checks, every row
    except InputError as error:
        progress.remark(str(error))
        return None


class TrueEnd:
    """True END, N, of a simulated bench's side file at the times of successive blocks of its trial."""

    def __init__(self, truth: read.TrialFile, prefix: str = "") -> None:
        self._name = prefix + metrics.TRUE_END
        self._blocks = truth.blocks([self._name])
        self._times, self._values = np.empty(0, np.int64), np.empty(0)

    def at(self, time_ns: NDArray[np.int64]) -> Floats:
        """Return the force at each of `time_ns`, which rise from call to call; NaN where the side file has no row."""
        while not len(self._times) or self._times[-1] < time_ns[-1]:
            block = next(self._blocks, None)
            if block is None:
                break
            kept = self._times >= time_ns[0]
            self._times = np.concatenate([self._times[kept], block.time_ns])
            self._values = np.concatenate([self._values[kept], block.columns[self._name]])
        if not len(self._times):
            return np.full(len(time_ns), np.nan)
        places = np.searchsorted(self._times, time_ns).clip(0, len(self._times) - 1)
        return np.where(self._times[places] == time_ns, self._values[places], np.nan)


def true_end(truth: Path, recorded: read.Trial) -> Floats:
    """Return true END, N, at the rows of a trial in memory; NaN at a row without one."""
    return TrueEnd(open_truth(truth)).at(recorded.time_ns)


def picture(output: Path, path: Path, experiment: ExperimentSetup,
            paths: Mapping[str, ExperimentSetup] = MappingProxyType({})) -> None:
    """Draw the trial; `paths`: as in `figures`."""
    gait, recorded = experiment.gait, read.open(output)
    title = f"{gait.peak_n:g} N, {gait.period_s:g} s, controller {gait.controller}"
    draw({f"{name}: {title}": one_path(recorded, name).columns for name in paths} or {title: recorded.columns}, path)


PAPER_RMSE_PERCENT = {40.0: 2.53, 50.0: 2.16, 60.0: 2.07}
"""Relative RMSE that the paper's experiment gives by peak, N, its section 5.2."""


def write_trial_page(
    recorded: read.TrialFile, path: Path, *, overwrite: bool = False, progress: Progress = SILENT
) -> int:
    """Write a trial as one HTML page that needs no network; return the page's size, bytes. Raises `InputError`."""
    output_files.refuse([path], overwrite=overwrite, inputs=[recorded.path])
    with progress.running("report") as update:
        return trial_page.write(
            recorded, path, load.frame_bits, published=_published(recorded), bound_percent=_bound(recorded),
            overwrite=overwrite, progress=update)


def _bound(recorded: read.TrialFile) -> float | None:
    """Return the sustained load, %, computed for the network that the trial carries; None if it carries none."""
    try:
        table = tomllib.loads(recorded.attachments["bench.toml"].decode())["network"]
        return bus_load.load_percent(wire(from_table(Network, table, where="bench.toml [network]")))
    except (KeyError, ValueError, InputError):
        return None


def _published(recorded: read.TrialFile) -> dict[str, str]:
    """Return the paper's figures at the same peak."""
    try:
        rmse = PAPER_RMSE_PERCENT.get(float(recorded.metadata.get("peak_n", "")))
    except ValueError:
        return {}
    return {} if rmse is None else {"relative_rmse_percent": f"{rmse} %", "max_idle_tension_n": "< 1 N"}
