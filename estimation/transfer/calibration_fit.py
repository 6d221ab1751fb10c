"""From recorded experiments to a calibration: the paper's two fits, and the friction loop between them.

Pure functions, columns in and scalars with evidence out, without a bus. END is used here, where a bench is measured,
and nowhere in a control loop.

(10) and (11) are fitted as the paper does, for its R². Their coefficients, the friction's exponents, the share of the
stretch and the pre-sliding travels come from one robust fit of the transfer model to all loops. The loop would bias
(10) alone, since the stretch lies behind the friction. Only μ2·φ0 and μ2·κ can be separated by START, END and the
knee's angle. κ keeps its value in the calibration at hand, and therefore has no evidence.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import lfilter

from estimation.transfer.homing_fit import adapt, lag_compensated, smoothed
from estimation.transfer.jackknife import LineFit, MeasuredScalar, half_width
from parameters import InputError
from physics import inverse, stretch
from physics.calibration import Calibration, ScalarEvidence, correlation_of
from physics.laws import Array

POINT_M = 0.4e-3
"""Rope travel, m, that is averaged into one point of the joint fit."""
TAUT_N = 3.0
ROBUST_N = 0.5
STIFFNESS_AT_N = 30.0
"""Tension whose stiffness weighs a residual in rope position against one in END tension."""
DRIVE_TICKS = 3
"""Control cycles of pure delay: two until a target is reached, and one for what lies below the position loop.

The controller undoes the rest by a derivative, which cannot undo a delay; counting it as lag makes it lead too far.
"""


class Segment(NamedTuple):
    """One experiment: its kind (rest, stiffness, ramp, swing, gait) and columns by control cycle; m, rad, N.

    `desired` and `estimated` are the controller's END forces in a gait, else NaN or empty. `homed`: friction and
    stretch, as factors of the calibration's, that the homing before a gait found; () where it was not recorded.
    """

    kind: str
    period_s: float
    target: Array
    position: Array
    knee: Array
    start: Array
    end: Array
    desired: Array = np.zeros(0)
    estimated: Array = np.zeros(0)
    homed: tuple[float, ...] = ()


LAPS = 10
"""Parts into which a swing and a rest are cut, for intervals by leaving out one lap."""


class Rest(NamedTuple):
    """Readings of the sensors on a slack rope, N."""

    start_offset: float
    end_offset: float
    start_noise: float


class _Unknown(NamedTuple):
    """One unknown of the joint fit: a scalar of the calibration, its scale and bounds.

    `doubt`: prior standard deviation about the guess, for a scalar that these motions hardly determine (infinite: no
    prior).
    """

    name: str
    scale: float
    low: float
    high: float
    doubt: float = math.inf


END_LAG = "end_lag"
"""Name of END's lag among the unknowns: no calibration stores it, since END is not in the loop."""
_UNKNOWNS = (
    _Unknown("stiffness_a", 1e-7, -2e-5, 0.0), _Unknown("stiffness_b", 1e-5, 2e-5, 2e-3),
    _Unknown("rope_zero", 1e-4, -0.5, 0.5), _Unknown("stretch_short", 1e-5, -1e-4, 4e-3, 2e-4),
    _Unknown("stretch_wide", 1e-5, -1e-4, 2e-3, 2e-4), _Unknown("cable_compliance", 1e-5, 2e-6, 2e-4),
    _Unknown("fabric_share", 0.1, 0.02, 0.98, 0.3), _Unknown("cable_exponent", 0.05, 0.0, 1.0),
    _Unknown("mu2", 0.05, 0.0, 1.0), _Unknown("phi0", 0.2, 0.0, 6.0, 0.3),
    _Unknown("presliding", 5e-5, 1e-5, 3e-3), _Unknown("fabric_presliding", 5e-5, 1e-5, 3e-3),
    _Unknown("rope_per_knee", 1e-3, 0.005, 0.2), _Unknown("load_slope", 0.1, -0.6, 1.0, 0.2),
    _Unknown("viscous", 5.0, 0.0, 100.0, 20.0), _Unknown("viscous_tension", 5.0, 0.5, 60.0, 15.0),
    _Unknown("breakaway", 0.1, 0.0, 3.0, 0.5),
    _Unknown("fabric_breakaway", 0.1, 0.0, 3.0, 0.5), _Unknown("stribeck_speed", 5e-3, 2e-3, 0.05, 0.01),
    _Unknown("stribeck_memory", 5e-3, 0.01, 0.1, 0.03), _Unknown("start_lag", 5e-4, 0.0, 0.02, 1e-3),
    _Unknown("start_gain", 5e-3, 0.98, 1.02, 0.004),
    _Unknown(END_LAG, 5e-4, 0.0, 0.02, 1e-3),
)
WEIGHT = 20.0
"""Square root of the effective number of residuals of one segment."""
SLID_M = 2e-3
BELIEVED_N = 0.3
"""Assumed error of the model over a segment, N: scales the prior of an unknown in the joint fit."""
NORMAL_95 = 1.96
MEMORY_S, SEEN_BREAKAWAY = 0.05, 0.02
"""Second start of the search: memory of breakaway, s, and least breakaway for which this start is tried.

A long memory makes a hump of friction after each reversal, which a short one puts into the fabric's breakaway: two
minima, and no step leads from one to the other.
"""
NONE = 1e-9
"""Bound of an unknown that is not fitted: the search needs a positive width."""


def rest(segments: Sequence[Segment]) -> Rest:
    """Return offsets and START's noise from the segments at rest; raises `InputError` without such a segment."""
    still = _of(segments, "rest")
    return Rest(_mean([s.start for s in still]), _mean([s.end for s in still]), _noise([s.start for s in still]))


def start_at_rest(segments: Sequence[Segment]) -> dict[str, MeasuredScalar]:
    """Return START's offset and noise, N, by the calibration's names, with their intervals."""
    still, parts = rest(segments), [
        part for s in _of(segments, "rest") for part in np.array_split(s.start, LAPS)]
    return {"start_offset": MeasuredScalar(still.start_offset, float(half_width(parts, _mean))),
            "start_noise": MeasuredScalar(still.start_noise, float(half_width(parts, _noise)))}


def _mean(parts: Sequence[Array]) -> float:
    return float(np.concatenate(parts).mean())


def _noise(parts: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean([np.var(part) for part in parts])))


def stiffness(segments: Sequence[Segment], offset_n: float) -> LineFit:
    """Fit (10) as the paper does: rope position over START tension, quadratic, through pulls and releases."""
    return _line([(s.start - offset_n, s.position) for s in _of(segments, "stiffness")], 2)


def swing(segments: Sequence[Segment]) -> LineFit:
    """Fit (11) as the paper does: rope position over knee angle at a constant START tension, linear."""
    laps = [zip(np.array_split(s.knee, LAPS), np.array_split(s.position, LAPS), strict=True)
            for s in _of(segments, "swing")]
    return _line([lap for swings in laps for lap in swings], 1)


def bandwidth(segments: Sequence[Segment]) -> MeasuredScalar:
    """Return the bandwidth, Hz, of the first-order lag from the delayed target to rope position."""
    moving = [segment for segment in segments if segment.kind in ("stiffness", "ramp")]
    if not moving:
        raise InputError("identification: no loop among the recorded experiments; run identify stiffness or friction.")
    return MeasuredScalar(_bandwidth(moving), float(half_width(moving, _bandwidth)))


def _bandwidth(moving: Sequence[Segment]) -> float:
    def misses(log_lag: float) -> float:
        return sum(_lag_error(segment, math.exp(log_lag)) for segment in moving)

    found = minimize_scalar(misses, bounds=(math.log(5e-4), math.log(0.1)), method="bounded")
    return 1.0 / (2.0 * math.pi * math.exp(found.x))


def _lag_error(segment: Segment, lag_s: float) -> float:
    decay = math.exp(-segment.period_s / lag_s)
    delayed = segment.target[:-DRIVE_TICKS]
    followed, _ = lfilter([1.0 - decay], [1.0, -decay], delayed, zi=[decay * delayed[0]])
    return float(np.sum((followed - segment.position[DRIVE_TICKS:]) ** 2))


def loops(
    segments: Sequence[Segment], guess: Calibration, offsets: Rest
) -> tuple[Calibration, Mapping[str, ScalarEvidence]]:
    """Fit the transfer model to every loop and swing jointly; return scalars and their intervals.

    Intervals are 95 %, of `_covariance`; the repeatability is that of leaving out one segment at a time. An unknown
    that ends at a non-zero limit of the search is not determined and has no interval. A breakaway whose speed ends
    there is a model error about a reversal: it is left out. If breakaway remains, the search starts once more from a
    long memory of it, and the better fit is kept.
    """
    data = [_averaged(segment, offsets) for segment in segments if segment.kind not in ("rest", "gait")]
    start = np.array([getattr(guess, unknown.name, guess.start_lag) for unknown in _UNKNOWNS])
    low, high = (np.array([getattr(unknown, side) for unknown in _UNKNOWNS]) for side in ("low", "high"))
    doubt = np.array([unknown.doubt for unknown in _UNKNOWNS])
    doubted = np.isfinite(doubt)
    heavy, stiff = WEIGHT * BELIEVED_N, 1.0 / float(stretch.slope(guess, STIFFNESS_AT_N))

    def residual(point: Array) -> Array:
        made = _with(guess, point)
        return np.concatenate([*(_residual(made, segment, stiff, float(point[-1])) for segment in data),
                               heavy * ((point - start) / doubt)[doubted]])

    def solved(from_: Array, high: Array) -> Any:
        return least_squares(
            residual, np.clip(from_, low, high), bounds=(low, high), x_scale=[u.scale for u in _UNKNOWNS],
            loss="soft_l1", f_scale=ROBUST_N, ftol=1e-5, xtol=1e-6)

    found = solved(start, high)
    if max(found.x[_place("breakaway")], found.x[_place("fabric_breakaway")]) > SEEN_BREAKAWAY:
        longer = start.copy()
        longer[_place("stribeck_memory")] = MEMORY_S
        found = min(found, solved(longer, high), key=lambda each: float(each.cost))
    if _ended(found.x, low, high)[_place("stribeck_speed")]:
        none = high.copy()
        none[[_place("breakaway"), _place("fabric_breakaway")]] = NONE
        moved = found.x.copy()
        moved[_place("stribeck_speed")] = start[_place("stribeck_speed")]
        moved[_place("stribeck_memory")] = start[_place("stribeck_memory")]
        found = solved(moved, none)
    sizes = [len(_residual(guess, segment, stiff, 0.0)) for segment in data]
    rows = sum(sizes)
    fun, slopes = np.asarray(found.fun), np.asarray(found.jac)
    robust = (1.0 + (fun / ROBUST_N) ** 2) ** -0.25
    scatter = NORMAL_95 * _jackknife(slopes[:rows], (fun * robust)[:rows], sizes, slopes[rows:])
    told = sum(2 if _told_by_end(segment) else 1 for segment in data)
    covariance = _covariance(slopes[:rows], _lack(fun[:rows], told), slopes[rows:], heavy)
    half = np.where(_ended(found.x, low, high), math.nan, NORMAL_95 * np.sqrt(np.diag(covariance)))
    evidence = {u.name: ScalarEvidence(float(value - by), float(value + by), repeatability=float(again))
                for u, value, by, again in zip(_UNKNOWNS, found.x, half, scatter, strict=True) if u.name != END_LAG}
    known = [i for i, u in enumerate(_UNKNOWNS) if u.name != END_LAG and np.isfinite(half[i])]
    together = correlation_of([_UNKNOWNS[i].name for i in known],
                                         covariance[np.ix_(known, known)])
    to = max(float(segment.start.max()) for segment in data)
    return dataclasses.replace(_with(guess, found.x), identified_to=to, correlation=together), evidence


def homed(segment: Segment, calibration: Calibration, offsets: Rest) -> tuple[float, float]:
    """Return friction and stretch, as factors, that homing would find in a pull and release of the identification."""
    plain = dataclasses.replace(calibration, homed_friction=1.0, homed_softness=1.0)
    work = adapt(plain, segment.period_s, segment.position, segment.start, segment.knee, offsets.start_offset)
    while True:
        try:
            next(work)
        except StopIteration as done:
            return float(done.value.friction), float(done.value.softness)


def _with(guess: Calibration, point: Array) -> Calibration:
    values: dict[str, Any] = {u.name: float(value) for u, value in zip(_UNKNOWNS, point, strict=True)
                              if u.name != END_LAG}
    return dataclasses.replace(guess, **values)


def _averaged(segment: Segment, offsets: Rest) -> Segment:
    """Return points of about `POINT_M` of rope travel, at least one control cycle, each a mean, without the offsets."""
    travel = float(np.median(np.abs(np.diff(segment.target)))) or POINT_M
    points = int(np.clip(round(POINT_M / travel), 1, 25))
    columns = [smoothed(column, points) for column in segment[2:7]]
    return Segment(segment.kind, segment.period_s * points, columns[0], columns[1], columns[2],
                   columns[3] - offsets.start_offset, columns[4] - offsets.end_offset)


def _residual(calibration: Calibration, segment: Segment, stiff_n_m: float, end_lag_s: float) -> Array:
    """Return model minus measurement of END and rope position for the measured START, N; each segment has the same
    weight.

    While the knee swings under a constant START, END depends on the fabric's slip on a turning knee, which the model
    lumps: there only the position counts. The same holds on a bench without END, on which the loop of position over
    START determines friction.
    """
    period_s = segment.period_s
    law = inverse.law(calibration, period_s)
    start = lag_compensated(segment.start, period_s, calibration.start_lag) / calibration.start_gain
    end, position = inverse.end_from_start(law, segment.position, start, segment.knee)
    taut = (segment.start > TAUT_N) & _slid(segment)
    weight = WEIGHT / math.sqrt(max(1, int(np.count_nonzero(taut))))
    moved = stiff_n_m * (position - segment.position)[taut]
    if not _told_by_end(segment):
        return np.asarray(weight * moved)
    return weight * np.concatenate([(end - lag_compensated(segment.end, period_s, end_lag_s))[taut], moved])


def _told_by_end(segment: Segment) -> bool:
    return segment.kind != "swing" and not bool(np.isnan(segment.end).all())


def _slid(segment: Segment) -> Any:
    """Return a mask of the samples with known slip directions of rope and fabric: from slack at once, from tension
    after `SLID_M` of rope."""
    if segment.start[0] <= 2.0 * TAUT_N:
        return True
    return np.cumsum(np.abs(np.diff(segment.position, prepend=segment.position[0]))) > SLID_M


def _place(name: str) -> int:
    return next(i for i, unknown in enumerate(_UNKNOWNS) if unknown.name == name)


def _ended(found: Array, low: Array, high: Array) -> Any:
    """Return the unknowns whose estimate is at a non-zero limit of the search."""
    near = 1e-4 * (high - low)
    return ((found <= low + near) & (low != 0.0)) | (found >= high - near)


def _lack(residuals: Array, told: int) -> float:
    """Return the standard deviation, in the unit of the residuals, of a segment's systematic error in END or in
    position.

    The residual after the fit is model error and not noise: it is correlated along a motion, so END and position of
    each segment count as one number each; `told` is their count. Never below `BELIEVED_N`, which the priors were
    weighed against.
    """
    return max(WEIGHT * BELIEVED_N, math.sqrt(float(np.sum(residuals**2)) / told))


def _covariance(slopes: Array, lack: float, prior: Array, believed: float) -> Array:
    """Return the covariance of the unknowns for a systematic error `lack` a segment and `believed` a prior.

    Each row of `prior` is one prior.

    The covariance is H⁻¹·(lack²·JᵀJ + believed²·PᵀP)·H⁻¹ with H = JᵀJ + PᵀP. A repeated systematic error would hide
    from a jackknife, and a dominant prior would have no variance in it; neither happens here.
    """
    scale = np.sqrt((slopes**2).sum(axis=0) + (prior**2).sum(axis=0) + 1e-300)
    told, doubted = slopes / scale, prior / scale
    inverted = np.linalg.inv(told.T @ told + doubted.T @ doubted + 1e-9 * np.eye(len(scale)))
    between = lack**2 * told.T @ told + believed**2 * doubted.T @ doubted
    return np.asarray(inverted @ between @ inverted / np.outer(scale, scale))


def _jackknife(slopes: Array, residuals: Array, sizes: Sequence[int], prior: Array) -> Array:
    """Return the standard errors of the unknowns when one segment at a time is left out; `prior`: rows that always
    stay."""
    scale = np.sqrt(np.maximum((slopes**2).sum(axis=0), 1e-300))
    scaled, kept, edges = slopes / scale, prior / scale, np.cumsum([0, *sizes])
    whole = scaled.T @ scaled + kept.T @ kept
    shifts = []
    for first, last in itertools.pairwise(edges):
        part = scaled[first:last]
        left = whole - part.T @ part + 1e-9 * np.eye(len(whole))
        shifts.append(np.linalg.solve(left, part.T @ residuals[first:last]))
    count = len(shifts)
    spread = np.array(shifts) - np.mean(shifts, axis=0)
    return np.asarray(np.sqrt((count - 1) / count * (spread**2).sum(axis=0)) / scale)


def _line(laps: Sequence[tuple[Array, Array]], degree: int) -> LineFit:
    def fitted(chosen: Sequence[tuple[Array, Array]]) -> Array:
        over, values = (np.concatenate(columns) for columns in zip(*chosen, strict=True))
        return np.polyfit(over, values, degree)

    coefficients = fitted(laps)
    values = np.concatenate([lap[1] for lap in laps])
    left = values - np.polyval(coefficients, np.concatenate([lap[0] for lap in laps]))
    return LineFit(tuple(coefficients.tolist()), float(1.0 - np.var(left) / np.var(values)),
                   tuple(half_width(laps, fitted).tolist()))


def _of(segments: Sequence[Segment], kind: str) -> list[Segment]:
    found = [segment for segment in segments if segment.kind == kind]
    if not found:
        raise InputError(f"identification: no {kind} experiment among those recorded; run identify {kind} or all.")
    return found
