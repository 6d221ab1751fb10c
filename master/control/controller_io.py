"""What goes into a controller and comes out of it, the same for all of them.

The rule of this file: `ControllerInput` has no END; a controller cannot use what it cannot see.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class ControllerInput(NamedTuple):
    """What a controller may know of one SYNC, all latched by it; where anything is older there is no step.

    `sample` counts control cycles from the start of gait cycle 0, negative in the run-in.
    """

    sample: int
    servo_position_m: float
    servo_force_n: float
    knee_angle_rad: float
    start_n: float


class Outputs(NamedTuple):
    """Targets of one control cycle: rope position and knee angle, in the homed frame."""

    servo_target_m: float
    knee_target_rad: float


class Trace(NamedTuple):
    """Why the targets are what they are; all but two are the signals of `trial.signals.TRACE`, in its order."""

    desired_force_n: float
    estimated_end_force_n: float
    feedforward_m: float
    impedance_dx_m: float
    friction_ratio: float
    rope_direction: float
    strain_direction: float
    estimated_end_half_n: float = math.nan
