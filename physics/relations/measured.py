"""Measured signals on one time base, corrected to the true inputs of sensors and knee.

Measurements are kept unchanged; the error model of a sensor is inverted in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from physics import memory_laws as states
from physics.laws import Array
from physics.plant.leg import GRAVITY
from physics.relations.recorded_reads import Memory

Values = Mapping[str, float]

T = TypeVar("T")

REMEMBERED: Final = 4
"""Results of each part of a law that are kept: a slope's, and those of the point that it is taken at."""


class Fine(NamedTuple):
    """The rope's motion at the trial's own rate, and the decimation of results to the working rate."""

    rope_m: Array
    rope_m_s: Array
    fresh: NDArray[np.bool_]
    thinned: Callable[[Array], Array]


@dataclass
class Signals:
    """Measured signals: arrays by signal name with the derivatives that the equations need.

    `fresh`: samples at which a memory starts again; `progress`: 0…1 over the trial; `fine`: the rope's motion at its
    own rate, for equations that reverse between two of these samples.
    """

    columns: Mapping[str, Array]
    fresh: NDArray[np.bool_]
    progress: Array
    fine: Fine | None = None
    _memory: Memory = field(default_factory=lambda: Memory(REMEMBERED), repr=False)

    def has(self, *names: str) -> bool:
        return self.columns.keys() >= set(names)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def remember(self, law: Callable[..., T], *given: Any) -> T:
        """Return `law(self, *given)`, computed once per argument: most parameters do not affect most equations."""
        return self._memory.recall(law, given, lambda: law(self, *given))

    def later(self, values: Array, seconds: float) -> Array:
        """Return `values` as they are `seconds` later."""
        time = self["time_s"]
        return values if seconds == 0.0 else np.interp(time + seconds, time, values)

    def column_later(self, name: str, seconds: float) -> Array:
        """Return a column as it is `seconds` later."""
        return self._memory.recall(name, (seconds,), lambda: self.later(self[name], seconds))

    @cached_property
    def step_s(self) -> float:
        """Time from one sample to the next, s."""
        return float(np.median(np.diff(self["time_s"])))


def end_tension(signals: Signals, p: Values) -> Array:
    """Return END tension, N, with its sensor's gain, offset, drift, mass, filter and delay undone."""
    mass = p["end_mass"] if signals.has("knee_angle_rad") else 0.0
    return signals.remember(_end_tension, p["end_filter"], p["end_delay"], p["end_offset"], p["end_drift"], mass,
                            p["end_mass_arm"] if mass > 0.0 else 0.0, p["end_gain"])


def _end_tension(signals: Signals, lag: float, delay: float, offset: float, drift: float, mass: float, arm: float,
                 gain: float) -> Array:
    end = signals.column_later("tension_end_n", delay)
    if lag > 0.0:
        end = end + lag * signals.column_later("end_rate", delay)
    end = end - offset - drift * signals.progress
    if mass > 0.0:
        end = end - mass * (GRAVITY * np.cos(signals["knee_angle_rad"]) + arm * signals["knee_acceleration"])
    return np.asarray(end / gain)


def start_tension(signals: Signals, p: Values) -> Array:
    """Return START tension, N, with its sensor's gain, offset and drift undone."""
    return signals.remember(_start_tension, p["start_gain"], p["start_offset"], p["start_drift"])


def _start_tension(signals: Signals, gain: float, offset: float, drift: float) -> Array:
    return np.asarray((signals["tension_start_n"] - offset - drift * signals.progress) / gain)


def leg_angle(signals: Signals, p: Values) -> Array:
    """Return the leg's own angle, rad: the knee drive's behind a dead band."""
    if p["knee_backlash"] <= 0.0:
        return signals["knee_angle_rad"]
    return signals.remember(_played, p["knee_backlash"])


def _played(signals: Signals, width: float) -> Array:
    return np.asarray(states.play(signals["knee_angle_rad"], signals.fresh, width))
