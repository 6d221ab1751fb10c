"""How far each relation is from holding on healthy data, before any healthy trial is seen.

The rule of this file: figures measured, not chosen: the root mean square over healthy plants of many structures
(tests/hidden, `python -m tests.hidden.run --floors`), with their like-bench scatter inside the bands.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

FLOORS: Final[Mapping[str, float]] = {
    "friction": 0.25, "elasticity": 0.40, "kinematics": 0.006, "servo": 5e-5, "drive_force": 0.5, "knee": 5e-4}
TIED: Final[Mapping[str, float]] = dict.fromkeys(FLOORS, 5.0)
"""Samples at the working rate that count as one."""
LEAST_TIED: Final = 4.0
LEAST_FLOOR: Final[Mapping[str, float]] = {
    "friction": 0.02, "elasticity": 0.02, "kinematics": 2e-4, "servo": 1e-5, "drive_force": 0.05, "knee": 1e-4}
"""Below this a relation holds exactly, and its floor is the converter's."""
