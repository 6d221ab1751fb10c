"""Readings of a bench's sensors and drive from the simulated force path, for a batch of sets of constants.

`given`: constants of `physics.forward.path_constants`, shape (constants, sets).  Signals have shape (samples,), SI, on
a time grid of `step_s`; results have shape (sets, samples).
"""

import math
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

from physics.forward.path_constants import INDEX, WANDER
from physics.forward.rig_forces import dahl_states
from physics.laws import Array
from physics.plant.components import GRAVITY

OF_DRIVE: Final = (
    "start_lag", "start_offset", "start_drift", *(f"start_wander{k}" for k in range(1, WANDER + 1)), "start_gain",
    "drum_radius", "eccentric_sin", "eccentric_cos", "drive_travel",
    "drive_coulomb", "drive_asymmetry", "drive_viscous", "drive_viscous_asymmetry", "drive_inertia", "drive_offset",
    "demand_gain")
"""Constants of `drive_force`, which is computed once per distinct set of them and has access to no others."""


class PathMotion(Protocol):
    """Measured motion of rope and knee with its derivatives, measured START, N, and `zero_courses` of the trial."""

    rope_m: Array
    rope_m_s: Array
    rope_m_s2: Array
    knee_rad: Array
    knee_rad_s2: Array
    start_n: Array

    @property
    def zero_courses(self) -> Array: ...


def start_reading(given: Array, start: Array, motion: PathMotion, step_s: float) -> Array:
    """Return the reading of START, N, of the tension `start`: gain, offset, drift and lag."""
    return _read(given, "start", _late(start, given[INDEX["start_lag"]], step_s), motion)


def end_reading(given: Array, end: Array, motion: PathMotion, step_s: float) -> Array:
    """Return the reading of END, N, of the tension `end`: carried mass, lag, low-pass, gain, offset and drift."""
    mass, swing = (given[INDEX[name]][:, None] for name in ("end_mass", "end_swing"))
    carried = end + GRAVITY * mass * np.cos(motion.knee_rad) + swing * motion.knee_rad_s2
    return _read(given, "end", _filtered(_late(carried, given[INDEX["end_lag"]], step_s),
                                         given[INDEX["end_filter"]], step_s), motion)


def _read(given: Array, sensor: str, tension: Array, motion: PathMotion) -> Array:
    def column(name: str) -> Array:
        return np.asarray(given[INDEX[f"{sensor}_{name}"]][:, None])
    return np.asarray(column("gain") * tension + _zero(column, motion.zero_courses))


def zero_courses(progress: Array) -> Array:
    """Return how offset, drift and wander of a sensor's zero go on over a trial, of `progress` 0 … 1; a row each."""
    waves = np.sin(math.pi * np.arange(1, WANDER + 1)[:, None] * progress)
    return np.concatenate([np.ones((1, progress.size)), progress[None], waves])


def _zero(column: Callable[[str], Array], courses: Array) -> Array:
    """Return a sensor's zero over a trial from its constants, shape (sets, samples)."""
    sizes = [column("offset"), column("drift"), *(column(f"wander{k}") for k in range(1, WANDER + 1))]
    return np.asarray(np.concatenate(sizes, axis=1) @ courses)


def distinct(given: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the distinct columns of `given`, in the order of their first occurrence, and the number of each column's.
    """
    first: dict[bytes, int] = {}
    row = np.array([first.setdefault(column.tobytes(), len(first)) for column in given.T])
    return given[:, np.unique(row, return_index=True)[1]], row


def drive_force(given: Array, motion: PathMotion, step_s: float) -> Array:
    """Return the servo force, N, by friction and inertia of the drive, shape (sets, samples).

    Terms: measured START tension at the drum, friction, inertia, offset.
    """
    sets, same = distinct(given[[INDEX[name] for name in OF_DRIVE]])
    constants = dict(zip(OF_DRIVE, sets, strict=True))

    def column(name: str) -> Array:
        return np.asarray(constants[name][:, None])

    start = _late(np.tile(motion.start_n, (sets.shape[1], 1)), -constants["start_lag"], step_s)
    tension = (start - _zero(lambda name: column(f"start_{name}"), motion.zero_courses)) / column("start_gain")
    radius = column("drum_radius")
    angle = motion.rope_m / radius
    arm = 1.0 + (column("eccentric_sin") * np.cos(angle) - column("eccentric_cos") * np.sin(angle)) / radius
    travels, row = np.unique(column("drive_travel"), return_inverse=True)
    slip = dahl_states(motion.rope_m, travels)[row.ravel()]
    coulomb = column("drive_coulomb") * slip * (1.0 + column("drive_asymmetry") * slip)
    viscous = column("drive_viscous") * (
        motion.rope_m_s + column("drive_viscous_asymmetry") * np.abs(motion.rope_m_s))
    force = tension * arm + coulomb + viscous + column("drive_inertia") * motion.rope_m_s2 + column("drive_offset")
    return np.asarray((force / column("demand_gain"))[same])


def _late(signals: Array, lag_s: Array, step_s: float) -> Array:
    """Return each row of `signals` delayed by its lag, s, interpolated by cubic Hermite polynomials (Catmull–Rom)."""
    out = np.empty_like(signals)
    _delayed(np.ascontiguousarray(signals), lag_s / step_s, out)
    return out


@njit(cache=True)
def _delayed(signals, lags, out):  # type: ignore[no-untyped-def]
    last = signals.shape[1] - 1
    for row in range(signals.shape[0]):
        whole = math.floor(lags[row])
        part = lags[row] - whole
        for i in range(last + 1):
            at = i - whole
            second, first = signals[row, min(max(at - 2, 0), last)], signals[row, min(max(at - 1, 0), last)]
            now, ahead = signals[row, min(max(at, 0), last)], signals[row, min(max(at + 1, 0), last)]
            out[row, i] = now + 0.5 * part * (first - ahead + part * (
                2.0 * ahead - 5.0 * now + 4.0 * first - second + part * (3.0 * (now - first) + second - ahead)))


def _filtered(signals: Array, time_s: Array, step_s: float) -> Array:
    """Return each row of `signals` after a first-order low-pass with its time constant, s; exact if linear in a step.
    """
    for constant in np.unique(time_s[time_s > 0.0]):
        rows, keep = time_s == constant, float(np.exp(-step_s / constant))
        share = constant / step_s * (1.0 - keep)
        signals[rows], _ = lfilter([1.0 - share, share - keep], [1.0, -keep], signals[rows],
                                   zi=share * signals[rows, :1])
    return signals
