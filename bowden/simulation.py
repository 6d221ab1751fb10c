"""What the simulation says of a recorded trial: the recorded commands into a simulated bench, residuals beside them.

The rule of this file: the bench is that of the model, without the scatter of a serial number; SI throughout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bowden import bench_model, buses
from bowden.bench_model import Model
from bowden.progress import SILENT, Progress
from bowden.recorded_trial import Trial

if TYPE_CHECKING:
    from bowden.replay.plant_residuals import Residual


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
    figures: Mapping[str, Residual]


def simulate(model: Model | None, trial: Trial | str | Path, *, progress: Progress = SILENT) -> Simulation:
    """Play what the master sent in `trial` to a simulated bench of `model`; raises `InputError`.

    The trial needs its CAN frames.
    """
    from bowden.replay import onto_plant

    recorded = (trial if isinstance(trial, Trial) else Trial(trial)).recorded
    known = bench_model.given(model)
    found = onto_plant.replay(recorded, buses.simulated(0, plant_model=known), progress=progress)
    return Simulation(found.time_ns, found.recorded, found.simulated, found.columns, found.figures)
