"""Measured signals on one time base, and what the sensors and the knee really saw.

The rule of this file: what was measured is kept as it was; a sensor's error is undone by its law in one place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from physics import memory_laws as states
from physics.laws import Array
from physics.plant.leg import GRAVITY
from physics.relations.recorded_reads import Memory

Values = Mapping[str, float]

T = TypeVar("T")

MEMORIES: Final = 12


class Fine(NamedTuple):
    """The rope's motion at the trial's own rate, and how what is made of it comes to the working rate."""

    rope_m: Array
    rope_m_s: Array
    fresh: NDArray[np.bool_]
    thinned: Callable[[Array], Array]


@dataclass
class Signals:
    """What was measured: arrays by signal name with the derivatives that laws read.

    `fresh`: where a memory starts again; `progress`: 0…1 over the trial; `fine`: the rope's motion as it was sampled,
    for laws that turn over between two of these samples.
    """

    columns: Mapping[str, Array]
    fresh: NDArray[np.bool_]
    progress: Array
    fine: Fine | None = None
    _memory: Memory = field(default_factory=lambda: Memory(MEMORIES), repr=False)

    def has(self, *names: str) -> bool:
        return all(name in self.columns for name in names)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def remember(self, law: Callable[[Signals, Values], T], p: Values) -> T:
        """Return `law(self, p)`, made once for the values that it reads: most parameters leave most laws alone."""
        return self._memory.recall(law, p, lambda read: law(self, read))

    def later(self, values: Array, seconds: float) -> Array:
        """Return `values` as they are `seconds` later."""
        if seconds == 0.0:
            return values
        time = self["time_s"]
        return np.interp(time + seconds, time, values)


def end_tension(signals: Signals, p: Values) -> Array:
    """Return END tension, N, with its sensor's gain, offset, drift, mass, filter and delay undone."""
    return signals.remember(_end_tension, p)


def _end_tension(signals: Signals, p: Values) -> Array:
    end = signals["tension_end_n"]
    if p["end_filter"] > 0.0:
        end = end + p["end_filter"] * signals["end_rate"]
    end = signals.later(end, p["end_delay"]) - p["end_offset"] - p["end_drift"] * signals.progress
    if p["end_mass"] > 0.0 and signals.has("knee_angle_rad"):
        swing = GRAVITY * np.cos(signals["knee_angle_rad"]) + p["end_mass_arm"] * signals["knee_acceleration"]
        end = end - p["end_mass"] * swing
    return np.asarray(end / p["end_gain"])


def start_tension(signals: Signals, p: Values) -> Array:
    """Return START tension, N, with its sensor's gain, offset and drift undone."""
    shifted = signals["tension_start_n"] - p["start_offset"] - p["start_drift"] * signals.progress
    return np.asarray(shifted / p["start_gain"])


def start_reading(signals: Signals, p: Values, tension: Array) -> Array:
    """Return what the START sensor says, N, of a true `tension`."""
    return np.asarray(p["start_gain"] * tension + p["start_offset"] + p["start_drift"] * signals.progress)


def leg_angle(signals: Signals, p: Values) -> Array:
    """Return the leg's own angle, rad: the knee drive's behind a dead band."""
    if p["knee_backlash"] <= 0.0:
        return signals["knee_angle_rad"]
    return signals.remember(_played, p)


def _played(signals: Signals, p: Values) -> Array:
    return np.asarray(states.play(signals["knee_angle_rad"], signals.fresh, p["knee_backlash"]))
