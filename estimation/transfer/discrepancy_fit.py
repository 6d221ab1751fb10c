"""Fit of the discrepancy START → END to gait trials: a Bayesian linear model of the controller's simulated state.

Each control cycle gives y = ln(estimated END / measured END): the controller's own estimate from START against END.
The features are those that the controller computes again in its cycle, from the desired force and the knee's angle.
Prior: coefficients are independent, of zero mean, with the standard deviation of y.  Features of `OF_GAIN` have that of
a load cell's gain, since START's gain was identified against END.  The noise is the residual of y.  It is systematic:
the effective sample size of a gait trial is `WORTH` control cycles.

END's gain and the zeros of both load cells change between sessions.  They are nuisance parameters of the same fit and
no part of the discrepancy.  The gain has its session deviation.  Both zeros were measured at rest before the gait
trials, and have the error of that measurement.  Friction is the identification's: y is freed of the factor that homing
before a gait trial estimated.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numba import njit
from scipy.linalg import block_diag
from scipy.signal import butter, sosfiltfilt

from estimation.transfer.calibration_fit import Rest, Segment
from estimation.transfer.homing_fit import lag_compensated
from physics import end_discrepancy, inverse
from physics.calibration import Calibration
from physics.end_discrepancy import EndDiscrepancy
from physics.forward.path_constants import INDEX, SESSION_SD
from physics.laws import Array

LOWPASS_HZ: Final = 25.0
"""Zero-phase low-pass of both estimates of END: above it END's noise is larger than what friction changes."""
LOADED: Final = 0.15
"""Share of the peak from which a control cycle counts: below, offsets of START and END decide."""
TURNING_S: Final = 0.3
"""Assumed time shift between START and END, s: it weighs samples near a friction reversal less."""
WORTH: Final = 60.0
LEAST: Final = 2e-3
"""Least standard deviation of the noise, relative: the uncertainty of START's gain."""
ROUNDS: Final = 10
CAUCHY: Final = 2.385
"""Residual, in standard deviations, at which a control cycle counts half: Cauchy's weight, 95 % as efficient as least
squares on normal residuals.  A rope that turns over later than the model's is off by a third for a moment."""
OF_A_TRIAL: Final = ("start_offset",)
OF_END: Final = ("end_gain", "end_offset")
"""Nuisance parameters, by constants of a session: of each gait trial, which homes anew, and of the load cell END."""
ZERO_N: Final = 0.02
"""Standard deviation of a zero measured at rest, N: the mean over 0.4 to 1 s of a load cell with up to 0.4 N of noise.
With 0.1 N, a session's, errors of the model at low load went into the zeros, and their reverse into the gain."""
GAIN_SD: Final = float(SESSION_SD[INDEX["end_gain"]])
"""Standard deviation of a load cell's gain between sessions, relative."""
OF_GAIN: Final = ("level", "load")
"""Features that a load cell with another gain, or one that depends on load, would have, too."""
TURN: Final = 21
"""Control cycles at 1 kHz over which the speed of the friction's turning is averaged."""


def fit(segments: Sequence[Segment], calibration: Calibration, still: Rest) -> EndDiscrepancy | None:
    """Fit the discrepancy to the gait segments of an identification; None without such segments.

    The ramps among `segments` determine END's lag.
    """
    gaits = [segment for segment in segments if segment.kind == "gait"]
    if not gaits:
        return None
    lag_s = _end_lag(segments, calibration, still)
    parts = [_rows(segment, calibration, still, lag_s) for segment in gaits]
    features, y, weight = (np.concatenate([part[i] for part in parts]) for i in range(3))
    nuisance, nuisance_sd = _nuisance([part[3] for part in parts])
    at = np.concatenate([features, nuisance], axis=1)
    prior = max(LEAST, math.sqrt(float(np.average(y**2, weights=weight))))
    narrow = np.diag(np.concatenate([_coefficient_sd(prior), nuisance_sd]) ** -2.0)
    noise, counted = prior, weight
    for _ in range(ROUNDS):
        precision = (at * (counted / noise**2)[:, None]).T @ at + narrow
        mean = np.linalg.solve(precision, at.T @ (counted * y) / noise**2)
        apart = y - at @ mean
        noise = max(LEAST, math.sqrt(float(np.average(apart**2, weights=counted))))
        counted = weight / (1.0 + (apart / (CAUCHY * noise)) ** 2)
    kept = end_discrepancy.COUNT
    covariance = np.linalg.inv(precision)[:kept, :kept]
    ranges = np.array([part[4] for part in parts])
    return EndDiscrepancy(
        tuple(mean[:kept].tolist()), tuple(tuple(row) for row in covariance.tolist()),
        (float(ranges[:, 0].min()), float(ranges[:, 1].max())), (float(ranges[:, 2].min()), float(ranges[:, 3].max())),
        float(ranges[:, 4].max()), prior, noise)


def _coefficient_sd(prior: float) -> Array:
    """Return 1σ of each feature's coefficient before the fit; `prior`: 1σ of y."""
    return np.array([min(prior, GAIN_SD) if name in OF_GAIN else prior for name in end_discrepancy.FEATURES])


def _nuisance(trials: Sequence[Array]) -> tuple[Array, Array]:
    """Return dy/d(nuisance parameter), shape (rows, nuisance parameters), and the parameters' 1σ before the fit.

    `trials`: of each gait trial the columns of `OF_A_TRIAL` and `OF_END`.
    """
    own = block_diag(*(columns[:, :len(OF_A_TRIAL)] for columns in trials))
    whole = np.concatenate([own, np.concatenate(trials)[:, len(OF_A_TRIAL):]], axis=1)
    spread = {"start_offset": ZERO_N, "end_offset": ZERO_N, "end_gain": GAIN_SD}
    return whole, np.array([spread[name] for name in (*OF_A_TRIAL * len(trials), *OF_END)])


def _rows(segment: Segment, calibration: Calibration, still: Rest, lag_s: float
          ) -> tuple[Array, Array, Array, Array, Any]:
    """Return features, y, weights and columns of the nuisance parameters of the loaded control cycles of one gait
    trial, and the ranges seen."""
    period_s = segment.period_s
    desired, estimated = np.nan_to_num(segment.desired), np.nan_to_num(segment.estimated)
    state = np.zeros((desired.size, end_discrepancy.COUNT + 3))
    _along(inverse.law(calibration, period_s), tuple(inverse.Slip()), desired, segment.knee, state)
    smooth = butter(2, 2.0 * LOWPASS_HZ * period_s, output="sos")
    end = lag_compensated(sosfiltfilt(smooth, segment.end - still.end_offset), period_s, lag_s)
    y = np.log(np.maximum(sosfiltfilt(smooth, estimated), 0.1) / np.maximum(end, 0.1))
    loaded = desired > LOADED * desired.max()
    exponents = state[:, -2:]
    turning = np.gradient(exponents.sum(axis=1), period_s) ** 2
    points = max(1, round(TURN * 1e-3 / period_s))
    speed = np.sqrt(np.convolve(turning, np.full(points, 1.0 / points), "same"))
    weight = 1.0 / (1.0 + (TURNING_S * speed) ** 2)
    force, flexion, exponent = desired[loaded], np.abs(segment.knee[loaded]), exponents.sum(axis=1)[loaded]
    factor = segment.homed[0] / calibration.homed_friction if segment.homed else 1.0
    nuisance = np.column_stack([np.exp(-exponent) / force, np.ones_like(force), 1.0 / force])
    return (state[loaded, :end_discrepancy.COUNT], y[loaded] + (factor - 1.0) * exponent,
            weight[loaded] * WORTH / np.count_nonzero(loaded), nuisance,
            (force.min(), force.max(), flexion.min(), flexion.max(), np.abs(state[loaded, -3]).max() / period_s))


@njit(cache=True)
def _along(law: Any, slip: Any, force: Any, knee: Any, out: Any) -> None:
    """Write features, travel in the sheath and the exponents of sheath and knee by control cycle."""
    slips = end_discrepancy.UNTURNED
    for i in range(force.size):
        before = slip
        _position, _start, by_sheath, by_knee, sheath_slow, fabric_slow, slip = inverse.inverse(
            law, slip, force[i], knee[i])
        moved, on_knee = (slip[2] - before[2], slip[3] - before[3]) if i > 0 else (0.0, 0.0)
        slips = end_discrepancy.turned(slips, moved, on_knee, law[9], law[10])
        at = end_discrepancy.features(force[i], knee[i], slip[0], slip[1], sheath_slow, fabric_slow, slips)
        for j in range(len(at)):
            out[i, j] = at[j]
        out[i, len(at)] = moved
        out[i, len(at) + 1], out[i, len(at) + 2] = by_sheath, by_knee


def _end_lag(segments: Sequence[Segment], calibration: Calibration, still: Rest) -> float:
    """Return END's lag, s, by the ramps: its tension against the model's behind START, over its rate.

    Reversals of a ramp do not count: the model's friction error there is larger than the effect of a lag.
    """
    lag, whole = 0.0, 0.0
    for ramp in (segment for segment in segments if segment.kind == "ramp"):
        smooth = butter(2, 2.0 * LOWPASS_HZ * ramp.period_s, output="sos")
        start, end = (sosfiltfilt(smooth, column) for column in (
            (ramp.start - still.start_offset) / calibration.start_gain, ramp.end - still.end_offset))
        start = lag_compensated(start, ramp.period_s, calibration.start_lag)
        model, _ = inverse.end_from_start(inverse.law(calibration, ramp.period_s), ramp.position, start, ramp.knee)
        rate, taut = np.gradient(end, ramp.period_s), end > TAUT_N
        if not taut.any():
            continue
        steady = taut & (np.abs(rate) > 0.5 * np.median(np.abs(rate[taut])))
        lag += float(np.sum((rate * (model - end))[steady]))
        whole += float(np.sum(rate[steady] ** 2))
    return min(max(lag / whole, 0.0), MOST_LAG_S) if whole else calibration.start_lag


TAUT_N: Final = 3.0
"""END tension, N, above which a ramp is used."""
MOST_LAG_S: Final = 5e-3
"""Largest accepted lag of END, s."""
