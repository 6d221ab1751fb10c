"""What the paper's formulas cost where they are used as printed, in N at END.

The rule of this file: statics, by the laws of `physics` along one gait cycle on the nominal bench; no simulation.
Each function gives the error of END (N) by desired force, when everything else is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from physics import laws
from physics.closure import CYCLE_POINTS
from physics.laws import Array
from physics.plant.bench_plant import NOMINAL
from physics.reference import paper_reference

PERIOD_S = 2.0


class Trajectory(NamedTuple):
    """One gait cycle: desired force (N), exponents and slip directions, sign of the rope's acceleration."""

    desired_n: Array
    cable: float
    fabric: Array
    rope: Array
    strain: Array
    rope_turned: Array


def course(peak_n: float) -> Trajectory:
    """Return the paper's gait cycle on the nominal bench."""
    reference = paper_reference(peak_n, PERIOD_S)
    wanted = [reference.at(i / CYCLE_POINTS) for i in range(CYCLE_POINTS)]
    desired = np.array([w.force_n for w in wanted])
    knee = np.array([w.knee_angle_rad for w in wanted])
    position = laws.rope_position(desired, knee)
    velocity = np.roll(position, -1) - np.roll(position, 1)
    return Trajectory(
        desired, NOMINAL.mu1 * NOMINAL.theta1_rad,
        NOMINAL.mu2 * (NOMINAL.wrap_rad + NOMINAL.fabric_wrap * np.abs(knee)), np.sign(velocity),
        np.sign(np.roll(desired, -1) - np.roll(desired, 1)), np.sign(np.roll(velocity, -1) - np.roll(velocity, 1)))


def at_end(start_n: Array, on: Trajectory) -> Array:
    """Return what END feels of START, N: (3) and (7)."""
    felt: Array = start_n * np.exp(-on.cable * on.rope - on.fabric * on.strain)
    return felt


def separate_losses(on: Trajectory) -> Array:
    """(4) and (8) added to the desired force one by one, instead of in series."""
    start = on.desired_n + laws.cable_loss(on.desired_n, on.cable, on.rope) + laws.fabric_loss(
        on.desired_n, on.fabric, on.strain)
    return at_end(start, on) - on.desired_n


def turned_by_acceleration(on: Trajectory) -> Array:
    """The cable's friction turned by the sign of v̇, as the text says, instead of v."""
    start = laws.series_input(on.desired_n, on.cable, on.rope_turned, on.fabric, on.strain)
    return at_end(start, on) - on.desired_n


def inverted_at_start(on: Trajectory) -> Array:
    """(10) inverted at the force that START needs, instead of END's; the rope before the friction stretches rightly."""
    start = laws.series_input(on.desired_n, on.cable, on.rope, on.fabric, on.strain)
    beyond = np.where(start < laws.STIFFNESS_TURNING_N, start, np.nan)
    excess = laws.stiffness_displacement(beyond) - laws.stiffness_displacement(on.desired_n)
    excess = excess - NOMINAL.lead_compliance * (start - on.desired_n)
    error: Array = excess / laws.stiffness_slope(on.desired_n)
    return np.where(on.desired_n > 0.0, error, 0.0)


def printed_sum(on: Trajectory) -> Array:
    """(10) + (11) in their printed zeros, instead of one zero at 13 % of gait and 20 N."""
    error: Array = zero_error_m() / laws.stiffness_slope(on.desired_n)
    return np.where(on.desired_n > 0.0, error, 0.0)


def zero_error_m() -> float:
    """Return by how much the zeros of (10) and (11) differ, m: what (11) gives at 13 % of gait, its 20 N included."""
    return float(laws.swing_displacement(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT)))


APPROXIMATIONS: dict[str, Callable[[Trajectory], Array]] = {
    "fL and fT added separately": separate_losses,
    "(10) inverted at START force": inverted_at_start,
    "friction turned by the sign of v̇": turned_by_acceleration,
    "(10) + (11) in their printed zeros": printed_sum,
}


class Cost(NamedTuple):
    """What an approximation costs over a gait cycle: root mean square and largest, N, and RMSE by the peak, %."""

    rms_n: float
    largest_n: float
    relative_percent: float


def cost(name: str, peak_n: float) -> Cost:
    """Return what one of `APPROXIMATIONS` costs at a peak."""
    error = APPROXIMATIONS[name](course(peak_n))
    rms = float(np.sqrt(np.mean(error**2)))
    return Cost(rms, float(np.max(np.abs(error))), 100.0 * rms / peak_n)
