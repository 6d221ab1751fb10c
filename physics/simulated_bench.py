"""Simulated bench of estimated parameters: parameters of its plant, and readings of its sensors."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from physics import memory_laws
from physics.laws import Array
from physics.parameters import ESTIMATED, PARAMETERS
from physics.path_parameters import STRETCH_BEND, STRETCH_LINEAR
from physics.plant import PlantParameters
from physics.plant.imposed import Tensions

Values = Mapping[str, float]

PLANT: Final = "plant."
NAMED: Final[Mapping[str, str]] = {
    name: p.plant.removeprefix(PLANT) for name, p in ESTIMATED.items()
    if p.plant.startswith(PLANT)
    and p.plant.removeprefix(PLANT) in {f.name for f in dataclasses.fields(PlantParameters)}}
"""Estimated parameter → field of `PlantParameters` of the same quantity."""
ELSEWHERE: Final = frozenset({"slack", "rope_zero", "knee_backlash", "drum_radius"})
"""Parameters of `NAMED` that are not copied to the plant: the zeros, the backlash and the drum are handled apart."""


@dataclass(frozen=True)
class SimulatedTensions:
    """START and END tension, N, as the simulated sensors read them, shape (samples,)."""

    tension_start_n: Array
    tension_end_n: Array


def plant_of(values: Values, seconds: float) -> PlantParameters:
    """Return the plant parameters for values of the estimated parameters; `seconds`: length of the trial.

    Friction drift is stated per length of the trial, at least 1 s.
    """
    share = min(max(values["cable_share"], 0.01), 0.8) * STRETCH_LINEAR
    sheath = min(PARAMETERS["sheath_compliance"].nominal, share)
    preload, scale = values["home_preload"], values["stiffness_scale"]
    homed = (STRETCH_LINEAR / scale - STRETCH_LINEAR) * preload + STRETCH_BEND * preload**2 * (
        (1.0 + values["stiffness_shape"]) / scale - 1.0)
    taken = {field: values[name] for name, field in NAMED.items() if name not in ELSEWHERE}
    return dataclasses.replace(
        PlantParameters(), **taken, fabric_presliding_m=values["presliding"] * values["fabric_presliding_ratio"],
        lead_compliance=max(share - 0.5 * sheath, 0.25 * share), sheath_compliance=sheath,
        encoder_zero_m=values["rope_zero"] + values["slack"] - homed, friction_drift_s=max(seconds, 1.0))


def readings(time: Array, true: Tensions, values: Values) -> SimulatedTensions:
    """Return the readings, N, of sensors with parameters `values` for true tensions at the times `time`, s."""
    start, end = true
    progress = (time - time[0]) / float(time[-1] - time[0])
    if values["end_filter"] > 0.0:
        end = memory_laws.lag(end, time, np.arange(time.size) == 0, values["end_filter"])
    skew, lag = values["timestamp_skew"], values["end_delay"]
    return SimulatedTensions(
        values["start_gain"] * np.interp(time - skew, time, start) + values["start_offset"]
        + values["start_drift"] * progress,
        values["end_gain"] * np.interp(time - skew - lag, time, end) + values["end_offset"]
        + values["end_drift"] * progress)
