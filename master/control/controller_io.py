"""Inputs and outputs of every controller.

`ControllerInput` has no END, so no controller can use it.
"""

import math
from typing import NamedTuple

NAN = math.nan


class ControllerInput(NamedTuple):
    """Inputs of a controller, all latched by one SYNC; the controller does not step unless all are there.

    `sample` counts control cycles from the start of gait cycle 0, negative in the run-in. Where the force follows a
    felt phase, `place` is the phase in samples of the gait table, fractional, `rate` its change in a control cycle, 0
    without a phase, and `share` says how much force is asked for (`gait_phase.follow`); on the clock `place` is None.
    """

    sample: int
    servo_position_m: float
    servo_force_n: float
    knee_angle_rad: float
    start_n: float
    place: float | None = None
    rate: float = 1.0
    share: float = 1.0

    def table_index(self, samples: int, ahead: int = 0) -> int:
        """Return the sample of a gait table of `samples` that is nearest, `ahead` control cycles later."""
        if self.place is None:
            return (self.sample + ahead) % samples
        return round(self.place + ahead * self.rate) % samples


class ControllerOutput(NamedTuple):
    """Targets of one control cycle: rope position and knee angle, in the homed frame."""

    servo_target_m: float
    knee_target_rad: float


class Trace(NamedTuple):
    """Intermediate values of a step; NaN where a controller has none.

    The first two and the six after them are signals of `/cycle`; `zero_m` is the shift of the rope's zero since homing
    that the controller follows; `own` are the values of the controller's own `columns`, in their order.
    """

    desired_force_n: float
    estimated_end_force_n: float = NAN
    feedforward_m: float = NAN
    impedance_dx_m: float = NAN
    friction_ratio: float = NAN
    rope_direction: float = NAN
    strain_direction: float = NAN
    estimated_end_half_n: float = NAN
    zero_m: float = 0.0
    own: tuple[float, ...] = ()

    @property
    def numbers(self) -> tuple[float, ...]:
        """Values of all columns; those of the controller's own columns come last."""
        return (*self[:-1], *self.own)


class Column(NamedTuple):
    """A trace column of a controller's own: its name in the trial, its SI unit ("1" for a pure number), its meaning."""

    name: str
    unit: str
    text: str = ""
