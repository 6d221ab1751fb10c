"""Parameters of the many-segment simulation from the constants of the two-node force path.

Each conversion follows from equating the two models where both are exact: friction exponents by tension and knee angle,
stretch between 10 and 60 N, displacement of the anchor between 0 and 70° of flexion.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from physics.force_path import KNEE_RAD, STRETCH_M
from physics.laws import MILLI, STIFFNESS_A_MM_N2, STIFFNESS_B_MM_N
from physics.parameters import ESTIMATED, PARAMETERS, healthy
from physics.path_constants import LOAD_PER_STEP, PRESLIDING
from physics.plant.leg import KNEE_AT_FIT

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


def stretch_of(path: Values) -> dict[str, float]:
    """Return the simulation's stretch parameters that have the path's stretch between 10 and 60 N."""
    strain = np.linspace(0.0, 4.0, 4001)
    tension = path["stiffness"] * strain * (1.0 + strain * (path["curve2"] + strain * path["curve3"]))
    delayed = path["prompt"] + 0.5 * path["slow"]
    stretch = STRETCH_M * np.interp(TENSIONS_N, tension, strain) + (path["cable_compliance"] + delayed) * TENSIONS_N
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
