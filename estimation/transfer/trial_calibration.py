"""Calibration of a bench from trials of any motion: what `bowden identify` estimates from its own experiments.

The scalars start at the fitted force path, converted, and are those of the transfer model that controllers invert,
fitted to all trials jointly (`calibration_fit.loops`).  The discrepancy START → END follows from trials with END.
An interval is that of the force path's posterior, widened by the difference between the two models' estimates.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from estimation.data.table import Table
from estimation.transfer import calibration_fit, discrepancy_fit
from estimation.transfer.calibration_fit import Rest, Segment
from estimation.transfer.homing_fit import lag_compensated
from physics import inverse, laws, stretch
from physics.calibration import Calibration, ScalarEvidence, nominal
from physics.conversions import UNRELATED, converted, to_scalars
from physics.forward.force_path import KNEE_RAD
from physics.forward.path_constants import LOAD_PER_STEP
from physics.forward.path_parameters import simulation_values
from physics.laws import Array
from physics.parameters import PARAMETERS

Values = Mapping[str, float]

LOWPASS_HZ: Final = 25.0
"""Zero-phase low-pass on all signals: START's noise must not turn the model's friction over."""
WRAP: Final = (0.25, 1.8)
"""Bounds of the fabric exponent's relative change, 1/rad: beyond, its offset would be outside 0.05 … 3.5 rad."""
HELD_N: Final = 20.0
"""START tension of (11), N, to which `swing_p` refers."""


LEAST_TOP_N: Final = 10.0
"""Least top of a pull, N, that counts as homing: any homing pulls to 12 N or more."""
SLACK_N: Final = 1.0
"""START tension, N, at which homing begins and ends its pull."""


def scalars_of(path: Values) -> dict[str, float]:
    """Return the scalars of a calibration, each inside its bounds, from constants of the force path.

    Of the wrap φ0 + κ·|θk| and μ2 only the products μ2·φ0 and μ2·κ act: κ is 1, as identification assumes.
    """
    values = simulation_values(path)
    known = to_scalars({**converted(UNRELATED, values), **values})
    known.pop("home_preload", None)
    wrap = min(max(path["wrap"], WRAP[0]), WRAP[1])
    known |= {"mu2": path["fabric"] * (1.0 + LOAD_PER_STEP * path["load"]) * wrap,
              "phi0": 1.0 / wrap + KNEE_RAD, "fabric_wrap": 1.0}
    known |= {name: path[name] for name in ("breakaway", "fabric_breakaway", "start_lag", "fabric_share")}
    bounds = {name: PARAMETERS[name].assumed for name in known}
    return {name: value if (row := bounds[name]) is None else min(max(value, row.low), row.high)
            for name, value in known.items()}


def calibrated(trials: Sequence[Table], start: Mapping[str, Any], sigma: Values, end_offset_n: float) -> Calibration:
    """Return the calibration of the bench of `trials`, with its discrepancy if END was measured.

    `start`: scalars that follow from the fitted force path.  `sigma`: 1σ of those that the trials determine.
    `end_offset_n`: zero of END.
    """
    inverse.prepare()
    still = _at_rest(trials, Rest(start["start_offset"], end_offset_n, _noise(trials)))
    start = {**start, "start_offset": still.start_offset}
    guess = dataclasses.replace(nominal(), **start)
    ramps = [_segment(given, "ramp") for given in trials]
    found, proof = calibration_fit.loops(ramps, guess, still)
    more: dict[str, Any] = {"start_offset": still.start_offset, "start_noise": still.start_noise,
                            "swing_p": float(stretch.position(found, HELD_N)) - found.rope_per_knee * float(
                                laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))}
    if all("servo_target_m" in given for given in trials):
        more["servo_bandwidth"] = calibration_fit.bandwidth(ramps).value
    found = dataclasses.replace(found, **more)
    homings = [calibration_fit.homed(homing, found, still) for given in trials
               if (homing := _homing(given)) is not None]
    if homings:
        friction, softness = np.mean(homings, axis=0).tolist()
        found = dataclasses.replace(found, homed_friction=friction, homed_softness=softness)
    names = ", ".join(given.source.rpartition("/")[2] for given in trials)
    evidence = {name: _evidence(float(getattr(found, name)), start[name], sd, proof.get(name), names)
                for name, sd in sigma.items()}
    # homing replaces a lag without an interval by the one that the sensor declares
    evidence["start_lag"] = dataclasses.replace(evidence.get("start_lag", proof["start_lag"]), trial=names)
    gaits = [_estimated(ramp._replace(kind="gait"), found, still) for ramp in ramps
             if not np.isnan(ramp.end).any()]
    beyond = discrepancy_fit.fit([*gaits, *ramps], found, still) if gaits else None
    return dataclasses.replace(found, evidence=evidence, discrepancy=beyond, label=names)


def _evidence(value: float, by_path: float, sd: float, fitted: ScalarEvidence | None, trial: str) -> ScalarEvidence:
    half = 1.96 * math.hypot(sd, value - by_path)
    again = math.nan if fitted is None else fitted.repeatability
    return ScalarEvidence(value - half, value + half, trial=trial, repeatability=again)


def _at_rest(trials: Sequence[Table], path: Rest) -> Rest:
    """Return the zeros with those measured on the slack rope before a gait, where trials have it; else the path's."""
    rows = [given.before for given in trials if {"tension_start_n", "tension_end_n"} <= set(given.before)]
    slack = [np.flatnonzero(before["tension_start_n"] < SLACK_N) for before in rows]
    if not rows or not all(at.size for at in slack):
        return path
    start, end = (float(np.nanmedian(np.concatenate([
        before[name][at] for before, at in zip(rows, slack, strict=True)])))
        for name in ("tension_start_n", "tension_end_n"))
    return Rest(start, end, path.start_noise)


def _noise(trials: Sequence[Table]) -> float:
    """Return the standard deviation of a sample of START, N, from third differences, about 0 for a smooth signal."""
    thirds = np.concatenate([np.diff(given["tension_start_n"], 3) for given in trials])
    return float(np.median(np.abs(thirds))) / 0.6745 / math.sqrt(20.0)


def _segment(given: Table, kind: str) -> Segment:
    """Return a trial as one experiment, its signals low-passed; END is NaN if it was not measured.

    The measured END takes the place of the desired force: a controller on another calibration may miss that by 5 %.
    """
    period_s = float(np.median(np.diff(given["time_s"])))
    smooth = butter(2, min(2.0 * LOWPASS_HZ * period_s, 0.9), output="sos")

    def column(name: str) -> Array:
        values = given[name]
        known = np.isfinite(values)
        at = np.arange(values.size)
        return np.asarray(sosfiltfilt(smooth, np.interp(at, at[known], values[known])))

    position = column("servo_position_m")
    end = column("tension_end_n") if "tension_end_n" in given else np.full(position.size, np.nan)
    target = given.columns.get("servo_target_m", position)
    target = np.where(np.isfinite(target), target, position)
    return Segment(kind, period_s, target, position, column("knee_angle_rad"), column("tension_start_n"), end,
                   np.maximum(end, 0.0))


def _homing(given: Table) -> Segment | None:
    """Return the last pull and release before the gait, as the homing fit reads it; None without one."""
    columns = [given.before.get(name) for name in (
        "servo_target_m", "servo_position_m", "knee_angle_rad", "tension_start_n")]
    if any(column is None or column.size == 0 for column in columns):
        return None
    target, position, knee, start = (np.asarray(column) for column in columns)
    known = np.isfinite(position + knee + start)
    target, position, knee, start = (column[known] for column in (target, position, knee, start))
    if not start.size or float(start.max()) < LEAST_TOP_N:
        return None
    top = int(np.flatnonzero(start > 0.9 * start.max())[-1])
    slack = np.flatnonzero(start < SLACK_N)
    first, last = slack[slack < top], slack[slack > top]
    if not first.size or not last.size:
        return None
    rows = slice(int(first[-1]), int(last[0]))
    period_s = float(np.median(np.diff(given.before["time_s"])))
    end = np.full(position[rows].size, np.nan)
    return Segment("ramp", period_s, target[rows], position[rows], knee[rows], start[rows], end)


def _estimated(segment: Segment, calibration: Calibration, still: Rest) -> Segment:
    """Return the segment with END as the calibrated transfer model estimates it from START."""
    start = lag_compensated((segment.start - still.start_offset) / calibration.start_gain, segment.period_s,
                            calibration.start_lag)
    drag, exponent = inverse.loss(inverse.law(calibration, segment.period_s), segment.desired, segment.knee)
    return segment._replace(estimated=(start - drag) * np.exp(-exponent))
