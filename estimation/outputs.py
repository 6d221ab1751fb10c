"""Outputs of a bench trial, predicted by simulating the force path for a batch of coordinate vectors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimation.likelihood_data import GRID_S, PathRecording
from physics.forward import force_path
from physics.forward.force_path import PathResponse
from physics.forward.path_constants import PATH_ROWS, values
from physics.forward.path_outputs import distinct, drive_force, end_reading, start_reading
from physics.laws import Array


class Prediction(NamedTuple):
    """Predicted data of each coordinate vector, and the simulated force path.

    `data`: shape (sets, data).  `path`: simulated once per distinct set of path constants.  `row`: for each set, its
    row in `path`.
    """

    data: Array
    path: PathResponse
    row: NDArray[np.intp]


def predict(q: Array, trial: PathRecording) -> Prediction:
    """Predict the data of a trial for each column of coordinates `q`, shape (constants, sets)."""
    given = values(q)
    sets, row = distinct(given[PATH_ROWS])
    path = force_path.simulate(sets, trial.rope_m, trial.knee_rad, GRID_S)

    signals = {"tension_start_n": start_reading(given, path.start[row], trial, GRID_S)}
    if "tension_end_n" in trial.outputs:
        signals["tension_end_n"] = end_reading(given, path.end[row], trial, GRID_S)
    if "servo_force_n" in trial.outputs:
        signals["servo_force_n"] = drive_force(given, trial, GRID_S)
    data = np.concatenate([trial.binned(trial.weighed(signals, name)) for name in trial.outputs], axis=1)
    return Prediction(data, path, row)
