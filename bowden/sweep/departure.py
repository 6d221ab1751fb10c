"""A knee that departs from the reference: in angle, and in tempo.

Only the knee's motion departs; the desired force and its time remain the reference's.
"""

from dataclasses import dataclass

import numpy as np

from parameters import parameter
from physics.closure import CYCLE_POINTS
from physics.reference import Reference


@dataclass(frozen=True)
class Departure:
    """Departure of the knee from its reference; the defaults are no departure."""

    angle_rad: float = parameter(
        0.0, "rad", "amplitude of a sine, once a gait cycle, on top of the reference", low=-0.3, high=0.3,
        source="assumed: people do not walk a table")
    tempo: float = parameter(
        1.0, "", "gait cycles of the knee to one of the reference", low=0.5, high=2.0,
        source="assumed: people do not walk to a clock")


def motion(reference: Reference, departure: Departure) -> Reference | None:
    """Return the knee's motion in place of `reference`; None without a departure."""
    if departure == Departure():
        return None
    phase = np.linspace(0.0, 1.0, CYCLE_POINTS + 1)
    turn = 2.0 * np.pi * phase
    angle = np.array([reference.knee_angle(at) for at in phase]) + departure.angle_rad * np.sin(turn)
    velocity = np.array([reference.knee_velocity(at) for at in phase])
    slope = (velocity * reference.period_s + 2.0 * np.pi * departure.angle_rad * np.cos(turn)) / 100.0
    return Reference(reference.period_s / departure.tempo, (angle, slope), (np.zeros_like(phase),) * 3)
