"""Simulation of a recorded trial: its commands, or its motion, into a simulated bench, with residuals.

The bench is that of the model, without the scatter of a serial number; SI throughout. A trial with CAN frames plays
the master's commands; one without (lab data) imposes the measured motion of rope and knee.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bowden import model_files
from bowden.bench import buses
from bowden.deferred import on_first_use
from bowden.model_files import Model
from bowden.progress import SILENT, Progress
from bowden.trials.recorded_trial import Trial
from trial.signals import SIGNALS

with on_first_use():
    from bowden.replay import onto_plant
    from bowden.replay.onto_plant import SignalResidual, figure
    from estimation import bench_fit, simulation
    from estimation.data import table
    from estimation.data.table import Table
    from physics.bench_model import BenchModel
    from physics.forward.path_parameters import SimulatedTensions


@dataclass(frozen=True)
class Simulation:
    """A trial beside its simulation, by signal name: float64, one value a control cycle, NaN where unknown.

    `time_ns`: int64, time of each SYNC, ns.  `measured` − `simulated` = `residuals`.  `figures`: RMS, mean and
    largest of each residual.
    """

    time_ns: NDArray[np.int64]
    measured: Mapping[str, NDArray[np.float64]]
    simulated: Mapping[str, NDArray[np.float64]]
    residuals: Mapping[str, NDArray[np.float64]]
    figures: Mapping[str, SignalResidual]


def simulate(model: Model | None, trial: Trial | str | Path, *, progress: Progress = SILENT) -> Simulation:
    """Play the master's commands in `trial` to a simulated bench of `model`; raises `InputError`.

    A trial without CAN frames (MCAP or CSV) is simulated under its measured rope and knee motion, START and END
    alone.
    """
    known = model_files.given(model)
    if not isinstance(trial, Trial) and Path(trial).suffix.lower() != ".mcap":
        return _under_motion(known, Path(trial))
    recorded = (trial if isinstance(trial, Trial) else Trial(trial)).recorded
    if not len(recorded.frames):
        return _under_motion(known, recorded.path)
    found = onto_plant.replay(recorded, buses.simulated(0, plant_model=known), progress=progress)
    return Simulation(found.time_ns, found.recorded, found.simulated, found.columns, found.figures)


def as_csv(given: Table, told: SimulatedTensions) -> str:
    """Return time, measured and simulated tensions as CSV."""
    columns = {"time_s": given["time_s"]}
    for name in simulation.SIGNALS:
        columns |= {name: given[name]} if name in given else {}
        columns[f"simulated_{name}"] = getattr(told, name)
    text = io.StringIO()
    np.savetxt(text, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="",
               fmt="%.9g")
    return text.getvalue()


def _under_motion(known: BenchModel, path: Path) -> Simulation:
    """Return both tensions as the simulation has them under the measured motion of a file's rope and knee."""
    given = table.read(path)
    told = simulation.simulate(bench_fit.as_fitted(given, known), known.simulation_values())
    time_ns = np.round(1e9 * given["time_s"]).astype(np.int64)
    declared = {signal.name: signal for signal in SIGNALS}
    simulated = {name: np.asarray(getattr(told, name)) for name in simulation.SIGNALS}
    measured = {name: given[name] if name in given else np.full(time_ns.size, np.nan) for name in simulated}
    walked = np.asarray(simulation.counted(given))
    figures = {name: figure(declared[name], measured[name], simulated[name], time_ns, walked) for name in simulated}
    return Simulation(time_ns, measured, simulated, {n: measured[n] - simulated[n] for n in simulated}, figures)
