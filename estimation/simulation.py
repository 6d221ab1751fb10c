"""Simulated START and END tension, N, under the measured motion of a trial, and their errors against the measured ones.

Inputs of the simulation are the measured rope position and knee angle; the other columns are only compared with it.
The model is the many-segment path of `physics.plant` with its sensors.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from estimation.data.table import Table
from estimation.likelihood_data import START_S
from parameters import InputError
from physics.forward.path_parameters import SimulatedTensions, plant_of, readings
from physics.path_laws import play
from physics.plant import imposed
from physics.plant.components import KNEE_AT_FIT
from physics.plant.imposed import ImposedMotion

Array = NDArray[np.float64]
Values = Mapping[str, float]


def simulate(given: Table, values: Values) -> SimulatedTensions:
    """Return the sensor readings of a bench with parameters `values`, simulated under the motion of `given`.

    A knee that is not recorded counts as locked.  Raises `InputError` if the rope position is missing.
    """
    true = imposed.simulate(plant_of(values, length_s(given)), motion(given, values["knee_backlash"]))
    return readings(given["time_s"], true, values)


def length_s(given: Table) -> float:
    """Return the length of a trial, s."""
    return float(given["time_s"][-1] - given["time_s"][0])


def motion(given: Table, backlash_rad: float) -> ImposedMotion:
    """Return the motion of rope and leg in `given`; the leg follows the knee drive with a backlash of `backlash_rad`.

    A knee that is not recorded counts as locked.  Raises `InputError` if the rope position is missing.
    """
    if "servo_position_m" not in given or not np.isfinite(given["servo_position_m"]).any():
        raise InputError(f"{given.source}: no column servo_position_m with values; the simulation needs the rope's "
                         "motion.")
    time = given["time_s"]
    if time.size < 4 or (np.diff(time) <= 0.0).any():
        raise InputError(f"{given.source}: time_s must rise in each of at least four rows; sort or cut the file.")
    knee = given["knee_angle_rad"] if "knee_angle_rad" in given else np.full(time.size, KNEE_AT_FIT)
    knee = play(knee, np.arange(time.size) == 0, backlash_rad) if backlash_rad > 0.0 else knee
    return imposed.motion(time, _filled(given["servo_position_m"]), _filled(knee))


def _filled(values: Array) -> Array:
    """Return a signal whose missing samples are interpolated linearly between their neighbours."""
    known = np.isfinite(values)
    at = np.arange(values.size)
    return values if known.all() else np.interp(at, at[known], values[known])


SIGNALS: Final = ("tension_start_n", "tension_end_n")


def compared(given: Table, told: SimulatedTensions) -> dict[str, Any]:
    """Return RMS, mean and peak, N, by tension signal of `given`: of measured less simulated, over all and by class.

    The peak is of the measured tension.  Classes: `by_phase` (tenths of the gait, if `gait_percent` is recorded),
    `by_load` (N, of that signal) and `by_direction` of the rope.
    """
    return {name: _figures(given, name, getattr(told, name)) for name in SIGNALS if name in given}


def counted(given: Table) -> NDArray[np.bool_]:
    """Return a mask of the samples later than `START_S` after the start."""
    return np.asarray(given["time_s"] > given["time_s"][0] + START_S)


def _figures(given: Table, name: str, simulated: Array, loads_n: Sequence[float] = (5.0, 20.0, 40.0), phases: int = 10
             ) -> dict[str, Any]:
    measured = given[name]
    keep = counted(given) & np.isfinite(measured)
    rest = (measured - simulated)[keep]
    figures: dict[str, Any] = {
        "rms_n": _rms(rest), "mean_n": float(rest.mean()) if rest.size else None, "peak_n": float(np.nanmax(measured))}
    if "gait_percent" in given:
        tenth = np.clip(given["gait_percent"][keep] * phases / 100.0, 0, phases - 1).astype(np.intp)
        figures["by_phase"] = [_class(f"{100 * k // phases}…{100 * (k + 1) // phases} %", rest[tenth == k])
                               for k in range(phases)]
    bounds = (-math.inf, *loads_n, math.inf)
    load = measured[keep]
    figures["by_load"] = [_class(_between(low, high), rest[(load >= low) & (load < high)])
                          for low, high in pairwise(bounds)]
    speed = np.gradient(given["servo_position_m"], given["time_s"])[keep]
    figures["by_direction"] = [_class(way, rest[mask]) for way, mask in directions(speed).items()]
    return figures


def directions(speed: Array, still_m_s: float = 1e-3) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the samples with the rope pulled, paid out or still, from the rope's `speed`, m/s."""
    return {"pulled": speed > still_m_s, "paid out": speed < -still_m_s, "still": np.abs(speed) <= still_m_s}


def _between(low: float, high: float) -> str:
    return f"below {high:g} N" if math.isinf(low) else f"above {low:g} N" if math.isinf(high) else f"{low:g}…{high:g} N"


def _class(name: str, rest: Array) -> dict[str, Any]:
    return {"class": name, "samples": int(rest.size), "rms_n": _rms(rest),
            "mean_n": float(rest.mean()) if rest.size else None}


def _rms(rest: Array) -> float | None:
    return math.sqrt(float(np.mean(rest**2))) if rest.size else None
