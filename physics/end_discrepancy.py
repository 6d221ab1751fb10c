"""Discrepancy START → END of one bench: error of the calibrated force-transfer model, with its uncertainty.

ln(estimated END / measured END) is a Bayesian linear model of a few features of the controller's own simulated state:
load, knee angle, pre-sliding states of rope and fabric (their direction history) and how slowly both slide.
`bowden identify all` fits it to gait trials with END (`estimation.transfer.discrepancy_fit`); the controller
evaluates it from its simulated state, so that END stays out of the loop.
"""

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from parameters import InputError
from physics.laws import Array
from physics.path_laws import LOAD_N, presliding

TABLE: Final = "discrepancy"
"""Table of a bench model's file."""
SCALES: Final = (0.25, 0.5, 2.0, 4.0)
"""Pre-sliding travels of the further slip states, by that of the calibration: shorter and longer memories of reversals.

Real friction along a rope turns over with many travels at once; the lumped model has one for the rope, one for fabric.
"""
FEATURES: Final = ("level", "load", "sheath", "sheath_load", "fabric", "fabric_load", "fabric_knee", "sheath_slow",
                   "fabric_slow", *(f"sheath_travel_{scale:g}" for scale in SCALES),
                   *(f"fabric_travel_{scale:g}" for scale in SCALES))
"""Features in the order of mean and covariance; `features` computes them."""
COUNT: Final = len(FEATURES)
Slips = tuple[float, ...]
UNTURNED: Final[Slips] = (0.0,) * (2 * len(SCALES))
"""Further slip states before the first motion, sheath before fabric."""
LEAST_TRAVEL_M: Final = 5e-5
KNEE_RAD: Final = 0.45
"""Knee flexion at which `fabric_knee` is 0: about the one at the peak of the desired force."""
BEYOND: Final = 0.15
"""Width of the transition beyond a range of the gait trials, as a share of the range: the discrepancy falls to zero in
it."""


class EndDiscrepancy(NamedTuple):
    """Posterior of the discrepancy: mean and covariance of the features' coefficients, and the ranges of the gait
    trials.

    `force_n`: END, N; `flexion_rad`: |knee angle|; `speed_m_s`: the fabric's largest speed on the rope's side. `prior`
    and `residual`: standard deviations of the coefficients before the fit and of its residual.
    """

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    force_n: tuple[float, float]
    flexion_rad: tuple[float, float]
    speed_m_s: float
    prior: float
    residual: float

    def packed(self, period_s: float, rope_travel: float, fabric_travel: float) -> Array:
        """Return the array that `evaluate` reads, for control cycles of `period_s`; pre-sliding travels, m."""
        return np.array([*self.mean, *(cell for row in self.covariance for cell in row), *self.force_n,
                         *self.flexion_rad, self.speed_m_s * period_s, rope_travel, fabric_travel, self.prior,
                         self.residual])


@njit(cache=True)
def turned(slips: Any, moved: float, on_knee: float, rope_travel: float, fabric_travel: float) -> Any:
    """Return the eight pre-sliding states `slips` after travels of `moved` in the sheath and `on_knee`, m."""
    rope, fabric = max(rope_travel, LEAST_TRAVEL_M), max(fabric_travel, LEAST_TRAVEL_M)
    return (presliding(slips[0], moved, SCALES[0] * rope), presliding(slips[1], moved, SCALES[1] * rope),
            presliding(slips[2], moved, SCALES[2] * rope), presliding(slips[3], moved, SCALES[3] * rope),
            presliding(slips[4], on_knee, SCALES[0] * fabric), presliding(slips[5], on_knee, SCALES[1] * fabric),
            presliding(slips[6], on_knee, SCALES[2] * fabric), presliding(slips[7], on_knee, SCALES[3] * fabric))


@njit(cache=True)
def features(force: float, knee: float, sheath: float, fabric: float, sheath_slow: float, fabric_slow: float,
             slips: Any) -> Any:
    """Return the features of one control cycle: END force, N, knee, rad, slip states −1…1, slownesses 0…1."""
    load = force / LOAD_N - 1.0
    return (1.0, load, sheath, sheath * load, fabric, fabric * load, fabric * (abs(knee) - KNEE_RAD),
            sheath * sheath_slow, fabric * fabric_slow,
            slips[0] - sheath, slips[1] - sheath, slips[2] - sheath, slips[3] - sheath,
            slips[4] - fabric, slips[5] - fabric, slips[6] - fabric, slips[7] - fabric)


@njit(cache=True)
def _outside(value: float, low: float, high: float) -> float:
    """Return 1 within a range of the gait trials, 0 from `BEYOND` of it outside, linear between."""
    away = max(low - value, value - high, 0.0)
    return max(0.0, 1.0 - away / (BEYOND * (high - low) + 1e-12))


@njit(cache=True)
def evaluate(packed: Any, slips: Any, force: float, knee: float, before: Any, after: Any, sheath_slow: float,
             fabric_slow: float) -> Any:
    """Return (discrepancy of ln(START/END), its standard deviation, further slip states) in one control cycle.

    `before` and `after`: the model's memory, an `inverse.Slip`, around this control cycle.  The posterior mean m is
    shrunk by its standard deviation σ to m·m²/(m² + σ²) and falls to zero outside of the ranges that the gait trials
    saw, where σ rises to that of the prior.  The standard deviation returned contains the residual of the fit.
    """
    ranges = packed[COUNT * (COUNT + 1):]
    moved = 0.0 if math.isnan(before[2]) else after[2] - before[2]
    on_knee = 0.0 if math.isnan(before[3]) else after[3] - before[3]
    slips = turned(slips, moved, on_knee, ranges[5], ranges[6])
    at = features(force, knee, after[0], after[1], sheath_slow, fabric_slow, slips)
    mean, variance, length = 0.0, 0.0, 0.0
    for i in range(COUNT):
        length += at[i] * at[i]
        mean += packed[i] * at[i]
        row = 0.0
        for j in range(COUNT):
            row += packed[COUNT * (1 + i) + j] * at[j]
        variance += at[i] * row
    inside = (_outside(force, ranges[0], ranges[1]) * _outside(abs(knee), ranges[2], ranges[3])
              * _outside(abs(moved), 0.0, ranges[4]))
    square = mean * mean
    shrunk = mean * square / (square + variance) if square > 0.0 else 0.0
    known = inside * inside
    variance = known * max(variance, 0.0) + (1.0 - known) * ranges[7] ** 2 * length + ranges[8] ** 2
    return inside * shrunk, math.sqrt(variance), slips


def rows(known: EndDiscrepancy | None) -> list[str]:
    """Return the lines of `[discrepancy]` in a bench model's file; `stated` reads them back."""
    if known is None:
        return []
    names = ", ".join(f'"{name}"' for name in FEATURES)
    cells = [f"{key} = {_text(getattr(known, key))}" for key in EndDiscrepancy._fields]
    return ["", f"[{TABLE}]  # ln(estimated END / measured END) of the gait trials, by features; SI",
            f"features = [{names}]", *cells]


def _text(value: Any) -> str:
    return f"[{', '.join(map(_text, value))}]" if isinstance(value, tuple) else repr(float(value))


def stated(tables: Mapping[str, Any], where: str) -> EndDiscrepancy | None:
    """Return the discrepancy that a file's tables state, None where they state none.  Raises `InputError`."""
    table = tables.get(TABLE)
    if table is None:
        return None
    again = "run bowden identify again"
    if not isinstance(table, Mapping) or tuple(table.get("features", ())) != FEATURES:
        raise InputError(f"{where}: [{TABLE}] features are not {', '.join(FEATURES)}; {again}.")
    shapes: dict[str, tuple[int, ...]] = {
        "mean": (COUNT,), "covariance": (COUNT, COUNT), "force_n": (2,), "flexion_rad": (2,), "speed_m_s": (),
        "prior": (), "residual": ()}
    found: dict[str, Any] = {}
    for key, shape in shapes.items():
        value = _numbers(table.get(key), shape)
        if value is None:
            raise InputError(f"{where}: [{TABLE}] {key} = {table.get(key)!r}, expected "
                             f"{' × '.join(map(str, shape)) or 'one'} finite numbers; {again}.")
        found[key] = value
    if np.linalg.eigvalsh(np.array(found["covariance"])).min() < -1e-9:
        raise InputError(f"{where}: [{TABLE}] covariance has a negative eigenvalue, expected none; {again}.")
    return EndDiscrepancy(**found)


def _numbers(value: Any, shape: tuple[int, ...]) -> Any:
    """Return nested tuples of floats of a shape, None for anything else."""
    if not shape:
        number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        return float(value) if number else None
    if not isinstance(value, list) or len(value) != shape[0]:
        return None
    parts = tuple(_numbers(each, shape[1:]) for each in value)
    return None if None in parts else parts
