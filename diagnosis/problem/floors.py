"""Reference RMSE of each prediction equation that is assumed without reference trials.

Each value exceeds twice the root mean square residual of simulated benches of many structures in the reference
condition (`python -m tests.hidden.run --floors` prints it). Without reference trials, systematic error of the submodels
is therefore never named an effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

FLOORS: Final[Mapping[str, float]] = {
    "friction": 0.25, "elasticity": 0.40, "kinematics": 0.006, "servo": 5e-5, "drive_force": 0.5, "knee": 5e-4}
CORRELATION_LENGTH: Final[Mapping[str, float]] = dict.fromkeys(FLOORS, 5.0)
"""Samples at the working rate per effective sample."""
LEAST_CORRELATION_LENGTH: Final = 4.0
MOST_CORRELATION_LENGTH: Final = 30.0
"""Upper limit of the samples per effective sample: 0.25 s at the highest working rate. A residual that lasts longer is
an offset of one trial, not its noise."""
LEAST_FLOOR: Final[Mapping[str, float]] = {
    "friction": 0.02, "elasticity": 0.02, "kinematics": 2e-4, "servo": 1e-5, "drive_force": 0.05, "knee": 1e-4}
"""Lower limit of an equation's reference RMSE, in its unit: the resolution of the converter."""
