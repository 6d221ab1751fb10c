"""Parameters of the many-segment simulation from the constants of the two-node force path; its plant, its readings.

Each conversion follows from equating the two models where both are exact: friction exponents by tension and knee angle,
stretch between 10 and 60 N, displacement of the anchor between 0 and 70° of flexion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from physics.forward.force_path import KNEE_RAD, STRETCH_M
from physics.forward.path_constants import LOAD_PER_STEP, PRESLIDING
from physics.laws import MILLI, STIFFNESS_A_MM_N2, STIFFNESS_B_MM_N, Array
from physics.parameters import ESTIMATED, PARAMETERS, healthy
from physics.path_laws import lag
from physics.plant import PlantParameters
from physics.plant.components import KNEE_AT_FIT

if TYPE_CHECKING:  # it loads SciPy
    from physics.plant.imposed import Tensions

Values = Mapping[str, float]

STRETCH_LINEAR: Final = STIFFNESS_B_MM_N * MILLI
STRETCH_BEND: Final = STIFFNESS_A_MM_N2 * MILLI
TENSIONS_N: Final = np.linspace(10.0, 60.0, 11)
"""Tensions at which the two stretch equations are equated: those of a gait cycle's loading."""
ANGLES_RAD: Final = np.linspace(-1.2, 0.0, 13)
"""Knee angles at which the two displacements of the anchor are equated."""
DIRECT: Final = (
    "viscous", "stribeck_speed", "stribeck_memory", "creep_compliance", "creep_time", "start_gain", "end_gain",
    "start_offset", "end_offset", "drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset", "drive_asymmetry",
    "drive_viscous_asymmetry", "demand_gain")
"""Constants of the path that the simulation has, too."""
_FIELDS: Final = {f"plant.{field.name}" for field in dataclasses.fields(PlantParameters)}
NAMED: Final[Mapping[str, str]] = {
    name: p.plant.removeprefix("plant.") for name, p in ESTIMATED.items()
    if p.plant in _FIELDS and name not in {"slack", "rope_zero", "knee_backlash", "drum_radius"}}
"""Estimated parameter → field of `PlantParameters` that takes it; zeros, backlash and drum are handled apart."""


def simulation_values(path: Values) -> dict[str, float]:
    """Return every parameter that the simulation reads, SI, from constants of the path by name.

    Each value lies within the bounds of its row of the parameter table.
    """
    given = healthy() | {name: path[name] for name in DIRECT} | _friction(path)
    given |= stretch_of(path) | _anchor(path)
    given |= {"home_preload": 0.0, "timestamp_skew": path["start_lag"],
              "end_delay": path["end_lag"] - path["start_lag"], "drive_presliding": PRESLIDING * path["drive_travel"]}
    return {name: min(max(value, p.low), p.high) for name, value in given.items()
            for p in (ESTIMATED[name],)}


def _friction(path: Values) -> dict[str, float]:
    loaded = 1.0 + LOAD_PER_STEP * path["load"]
    bent, wrapped = 1.0 + KNEE_RAD * path["bend"], 1.0 + KNEE_RAD * path["wrap"]
    phi0 = PARAMETERS["phi0"].nominal
    return {
        "mu1": path["cable"] * loaded * bent / PARAMETERS["theta1"].nominal, "cable_bend": path["bend"] / bent,
        "load_slope": path["load"] / loaded, "mu2": path["fabric"] * loaded * wrapped / phi0,
        "fabric_wrap": phi0 * path["wrap"] / max(wrapped, 0.02),
        "stribeck_ratio": 1.0 + 0.5 * (path["breakaway"] + path["fabric_breakaway"]),
        "presliding": PRESLIDING * path["cable_travel"],
        "fabric_presliding_ratio": path["fabric_travel"] / path["cable_travel"]}


def stretch_m(path: Values, tension_n: Array | float) -> Array:
    """Return the stretch of a path, m, at each tension, N, with half of its slow creep."""
    strain = np.linspace(0.0, 4.0, 4001)
    tension = path["stiffness"] * strain * (1.0 + strain * (path["curve2"] + strain * path["curve3"]))
    delayed = path["prompt"] + 0.5 * path["slow"]
    return np.asarray(STRETCH_M * np.interp(tension_n, tension, strain)
                      + (path["cable_compliance"] + delayed) * tension_n)


def stretch_of(path: Values) -> dict[str, float]:
    """Fit the simulation's stretch parameters to the stretch of a path at 10 to 60 N; return them by name."""
    stretch = stretch_m(path, TENSIONS_N)
    linear, bend = np.linalg.lstsq(np.stack([TENSIONS_N, TENSIONS_N**2], axis=1), stretch, rcond=None)[0]
    scale = STRETCH_LINEAR / max(float(linear), 1e-6)
    return {"stiffness_scale": scale, "stiffness_shape": float(bend) * scale / STRETCH_BEND - 1.0,
            "cable_share": path["cable_compliance"] * scale / STRETCH_LINEAR}


def _anchor(path: Values) -> dict[str, float]:
    on = ANGLES_RAD - KNEE_RAD
    moved = path["arm"] * on + path["arm2"] * on**2 + path["arm3"] * on**3
    design = np.stack([np.ones(on.size), ANGLES_RAD - KNEE_AT_FIT, ANGLES_RAD**2 - KNEE_AT_FIT**2], axis=1)
    zero, arm, quadratic = np.linalg.lstsq(design, moved, rcond=None)[0]
    return {"rope_zero": path["zero"] + float(zero), "rope_per_knee": float(arm),
            "rope_per_knee_quadratic": float(quadratic)}


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
    taken = {field: values[name] for name, field in NAMED.items()}
    return dataclasses.replace(
        PlantParameters(), **taken, fabric_presliding_m=values["presliding"] * values["fabric_presliding_ratio"],
        lead_compliance=max(share - 0.5 * sheath, 0.25 * share), sheath_compliance=sheath,
        encoder_zero_m=values["rope_zero"] + values["slack"] - homed, friction_drift_s=max(seconds, 1.0))


def readings(time: Array, true: Tensions, values: Values) -> SimulatedTensions:
    """Return the readings, N, of sensors with parameters `values` for true tensions at the times `time`, s."""
    start, end = true
    progress = (time - time[0]) / float(time[-1] - time[0])
    if values["end_filter"] > 0.0:
        end = lag(end, time, np.arange(time.size) == 0, values["end_filter"])
    skew, delay = values["timestamp_skew"], values["end_delay"]
    return SimulatedTensions(
        values["start_gain"] * np.interp(time - skew, time, start) + values["start_offset"]
        + values["start_drift"] * progress,
        values["end_gain"] * np.interp(time - skew - delay, time, end) + values["end_offset"]
        + values["end_drift"] * progress)
