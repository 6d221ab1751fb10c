"""How far each relation may be from holding on healthy data, before any healthy trial is seen.

The rule of this file: every figure is more than twice what healthy plants of many structures leave in the root mean
square (`python -m tests.hidden.run --floors` prints that), so that without a healthy trial nothing is named on the
laws' own accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

FLOORS: Final[Mapping[str, float]] = {
    "friction": 0.25, "elasticity": 0.40, "kinematics": 0.006, "servo": 5e-5, "drive_force": 0.5, "knee": 5e-4}
CORRELATION_LENGTH: Final[Mapping[str, float]] = dict.fromkeys(FLOORS, 5.0)
"""Samples at the working rate that count as one."""
LEAST_CORRELATION_LENGTH: Final = 4.0
MOST_CORRELATION_LENGTH: Final = 30.0
"""A quarter of a second at the highest working rate: what lasts longer is an offset of one trial, not its noise."""
LEAST_FLOOR: Final[Mapping[str, float]] = {
    "friction": 0.02, "elasticity": 0.02, "kinematics": 2e-4, "servo": 1e-5, "drive_force": 0.05, "knee": 1e-4}
"""Below this a relation holds exactly, and its floor is the converter's."""
