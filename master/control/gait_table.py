"""The paper's compensations for one gait cycle, computed once, looked up every control cycle.

The rule of this file: everything that depends on the reference alone is a table by sample, built with
the laws of `physics` before the first control cycle; nothing here sees a measurement.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from parameters import InputError
from physics import laws
from physics.calibration import Calibration
from physics.laws import Array
from physics.reference import ForceSurface

ROPE_STILL_M_S = 1e-3
STRAIN_STILL_N_S = 2.0
RAMP_SHARE = 0.06


@dataclass(frozen=True)
class GaitTable:
    """One gait cycle by sample (`samples` control cycles of `period_s`): floats in SI, knee flexion negative.

    `stretch` is x1 of (10) at the desired END force; `loss` the addition at START by (4) + (8), `series_loss` that of
    the two in series; `slack` the rope unwound while no force is desired; directions are −1, 0, +1. `by_knee`: if the
    force depends on the knee angle, too, angles and the desired force at each by sample; `desired` follows `knee`.
    """

    samples: int
    period_s: float
    desired: tuple[float, ...]
    knee: tuple[float, ...]
    swing: tuple[float, ...]
    stretch: tuple[float, ...]
    loss: tuple[float, ...]
    series_loss: tuple[float, ...]
    rope_direction: tuple[float, ...]
    fabric_direction: tuple[float, ...]
    slack: tuple[float, ...]
    by_knee: tuple[tuple[float, ...], tuple[tuple[float, ...], ...]] | None = None

    def wanted(self, place: float, share: float = 1.0, knee_rad: float | None = None) -> tuple[float, float]:
        """Return desired force, N, and slack, m, at a place in the table, for the `share` of the force asked for.

        `share` 1 … 0: of the force; 0 … −1: how far the rope is paid out in its place. `knee_rad`: the knee angle, by
        which the force goes where it depends on one.
        """
        desired, slack = at(self.desired, place), at(self.slack, place)
        if self.by_knee is not None and knee_rad is not None:
            angles, forces = self.by_knee
            i = min(max(bisect_right(angles, knee_rad), 1), len(angles) - 1)
            u = min(max((knee_rad - angles[i - 1]) / (angles[i] - angles[i - 1]), 0.0), 1.0)
            desired = (1.0 - u) * at(forces[i - 1], place) + u * at(forces[i], place)
        if share == 1.0:
            return desired, slack
        return max(share, 0.0) * desired, slack + (max(self.slack) - slack) * max(-share, 0.0)


def at(column: Sequence[float], place: float) -> float:
    """Return a periodic column at a place in samples, 0 or more; between two samples on a straight line."""
    i = int(place)
    here = column[i % len(column)]
    return here if i == place else here + (place - i) * (column[(i + 1) % len(column)] - here)


def samples_of(gait_period_s: float, rate_hz: int) -> int:
    """Control cycles in one gait cycle; raises `InputError` unless that is a whole number of at least 20."""
    samples = round(gait_period_s * rate_hz)
    if samples < 20 or abs(samples - gait_period_s * rate_hz) > 1e-6 * samples:
        fitting = max(samples, 20) / rate_hz
        raise InputError(
            f"period = {gait_period_s:g} s is not a whole number of at least 20 control cycles at {rate_hz} Hz; "
            f"the nearest that is: {fitting:g} s."
        )
    return samples


def stretch(calibration: Calibration, force_n: Any) -> Any:
    """Return x1 of (10), m, with the calibration's coefficients; constant beyond the turning point of the parabola."""
    force = np.minimum(force_n, calibration.turning_point_n)
    return (calibration.stiffness_a * force + calibration.stiffness_b) * force + calibration.rope_zero


def slope(calibration: Calibration, force_n: Any) -> Any:
    """Return dx1/dF of (10), m/N, with the calibration's coefficients."""
    return 2.0 * calibration.stiffness_a * force_n + calibration.stiffness_b


def swing(calibration: Calibration, knee_rad: Any) -> Any:
    """Return k2·(θk − θk(13 %)), m: (11) in the encoder zero of (10)."""
    return calibration.rope_per_knee * (knee_rad - laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))


def fabric_exponent(calibration: Calibration, knee_rad: Any) -> Any:
    """Return μ2·φ of (7) with the wrap φ = φ0 + κ·|θk|."""
    return calibration.mu2 * (calibration.phi0 + calibration.fabric_wrap * np.abs(knee_rad))


def directions(speed: Array, still: float) -> Array:
    """Return the sign of a periodic speed, with hysteresis: it reverses once the opposite speed exceeds `still`; 0 if
    it never does."""
    sign = 0.0
    held = np.zeros_like(speed)
    for _lap in range(2):
        for i, value in enumerate(speed):
            if abs(value) > still:
                sign = math.copysign(1.0, value)
            held[i] = sign
    return held


def slack_share(desired: Array, ramp: int) -> Array:
    """Return the periodic share of the idle slack: 0 while a force is desired, 1 from `ramp` samples away, a quarter
    sine between.

    The rope comes taut with the speed that the following force requires, so the velocity has no step at the transition.
    """
    loaded = np.flatnonzero(desired > 0.0)
    if loaded.size == 0:
        return np.ones_like(desired)
    away = np.abs(np.arange(desired.size)[:, None] - loaded[None, :])
    distance = np.minimum(np.minimum(away, desired.size - away).min(axis=1) / max(ramp, 1), 1.0)
    return np.asarray(np.sin(0.5 * np.pi * distance), dtype=np.float64)


def tabulate(calibration: Calibration, knee: Array, desired: Array, period_s: float, slack_m: float,
             by_knee: ForceSurface | None = None) -> GaitTable:
    """Build the tables of one gait cycle from knee angle (rad) and desired END force (N) by sample.

    `by_knee`: the desired force by sample and knee angle; the rope is taut where any angle has a force.
    """
    stretched, swung = stretch(calibration, desired), swing(calibration, knee)
    rope = directions(_rate(stretched + swung, period_s), ROPE_STILL_M_S)
    strain = directions(_rate(desired, period_s), STRAIN_STILL_N_S)
    fabric = fabric_exponent(calibration, knee)
    cable = calibration.cable_exponent
    series = laws.series_input(desired, cable, rope, fabric, strain) - desired
    columns = {
        "desired": desired, "knee": knee, "swing": swung, "stretch": stretched, "series_loss": series,
        "loss": laws.cable_loss(desired, cable, rope) + laws.fabric_loss(desired, fabric, strain),
        "rope_direction": rope, "fabric_direction": strain,
        "slack": slack_m * slack_share(desired if by_knee is None else by_knee.force_n.max(axis=1),
                                       round(RAMP_SHARE * desired.size)),
    }
    forces = by_knee and (tuple(by_knee.knee_rad.tolist()), tuple(map(tuple, by_knee.force_n.T.tolist())))
    return GaitTable(desired.size, period_s, **{name: tuple(column.tolist()) for name, column in columns.items()},
                     by_knee=forces)


def _rate(column: Array, period_s: float) -> Array:
    return np.asarray((np.roll(column, -1) - np.roll(column, 1)) / (2.0 * period_s), dtype=np.float64)
