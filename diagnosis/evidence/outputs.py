"""Outputs of a bench trial, predicted by simulating the force path for a batch of coordinate vectors."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

from diagnosis.evidence.likelihood_data import GRID_S, PathRecording
from physics import force_path
from physics.force_path import PathResponse
from physics.laws import Array
from physics.path_constants import INDEX, PATH_ROWS, values

GRAVITY: Final = 9.81
SMALL_S: Final = 4e-3
"""Lag, s, up to which a signal is delayed by its derivative, which is exact to 1 % below 40 Hz."""


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
    distinct, row = np.unique(given[PATH_ROWS].T, axis=0, return_inverse=True)
    row = row.ravel()
    path = force_path.simulate(distinct.T, trial.rope_m, trial.knee_rad, GRID_S)

    def column(name: str) -> Array:
        return np.asarray(given[INDEX[name]][:, None])

    start = _late(path.start[row], given[INDEX["start_lag"]])
    signals = {"tension_start_n": (column("start_gain") * start + column("start_offset")
                                   + column("start_drift") * trial.progress)}
    if "tension_end_n" in trial.outputs:
        carried = path.end[row] + GRAVITY * column("end_mass") * np.cos(trial.knee_rad) + (
            column("end_swing") * trial.knee_rad_s2)
        end = _filtered(_late(carried, given[INDEX["end_lag"]]), given[INDEX["end_filter"]])
        signals["tension_end_n"] = column("end_gain") * end + column("end_offset") + (
            column("end_drift") * trial.progress)
    if "servo_force_n" in trial.outputs:
        signals["servo_force_n"] = _drive(given, trial)
    data = np.concatenate([trial.binned(trial.weighed(signals, name)) for name in trial.outputs], axis=1)
    return Prediction(data, path, row)


def _drive(given: Array, trial: PathRecording) -> Array:
    """Return the servo force, N, by the prediction equation `drive_force`, shape (sets, samples).

    Terms: measured START tension at the drum, friction, inertia, offset.
    """
    def column(name: str) -> Array:
        return np.asarray(given[INDEX[name]][:, None])

    start = trial.start_n + column("start_lag") * np.gradient(trial.start_n, GRID_S)
    tension = (start - column("start_offset") - column("start_drift") * trial.progress) / column("start_gain")
    angle = trial.rope_m / column("drum")
    arm = 1.0 + (column("eccentric_sin") * np.cos(angle) - column("eccentric_cos") * np.sin(angle)) / column("drum")
    travels, row = np.unique(given[INDEX["drive_travel"]], return_inverse=True)
    slip = dahl_states(trial.rope_m, travels)[row]
    coulomb = column("drive_coulomb") * slip * (1.0 + column("drive_asymmetry") * slip)
    viscous = column("drive_viscous") * (
        trial.rope_m_s + column("drive_viscous_asymmetry") * np.abs(trial.rope_m_s))
    force = tension * arm + coulomb + viscous + column("drive_inertia") * trial.rope_m_s2 + column("drive_offset")
    return np.asarray(force / column("demand_gain"))


@njit(cache=True)
def dahl_states(rope, travels):  # type: ignore[no-untyped-def]
    """Return the friction state −1…1 for each pre-sliding distance, shape (travels, samples)."""
    out = np.zeros((travels.size, rope.size))
    for j in range(travels.size):
        s = 0.0
        for i in range(1, rope.size):
            way = (rope[i] - rope[i - 1]) / travels[j]
            s = (s + way) / (1.0 + abs(way))
            out[j, i] = s
    return out


def _late(signals: Array, lag_s: Array) -> Array:
    """Return each row of `signals` delayed by its lag, s."""
    out = signals - lag_s[:, None] * np.gradient(signals, GRID_S, axis=-1)
    time = GRID_S * np.arange(signals.shape[1])
    for j in np.flatnonzero(np.abs(lag_s) > SMALL_S):
        out[j] = np.interp(time - lag_s[j], time, signals[j])
    return np.asarray(out)


def _filtered(signals: Array, time_s: Array) -> Array:
    """Return each row of `signals` after a first-order low-pass with its time constant, s."""
    time = GRID_S * np.arange(signals.shape[1])
    for j in np.flatnonzero(time_s > 1e-5):
        keep = float(np.exp(-GRID_S / time_s[j]))
        behind, _ = lfilter([1.0 - keep], [1.0, -keep], signals[j], zi=[keep * signals[j, 0]])
        signals[j] = np.interp(time + 0.5 * GRID_S, time, behind)
    return signals
