"""True signals that no device measures, from the plant's array: one row of the truth file.

One function serves requests by name and rows in bulk. As in `plant.step`, the sources' digest is a constant of the
compiled function.
"""

from __future__ import annotations

from typing import Any, Final

from numba import njit

from physics.plant import step
from physics.plant.state_layout import CABLE_NODES, FABRIC_NODES, NODES, SLOT

NAMES: Final = (
    "true_start_n", "true_cable_end_n", "true_end_n", "true_knee_angle_rad", "true_knee_velocity_rad_s",
    "true_knee_motor_rad", "true_servo_position_m", "true_servo_velocity_m_s", "true_current_a", "true_supply_v",
    "true_cable_slip", "true_fabric_slip", "true_creep_m",
)


def _compile(sources: int) -> Any:
    @njit(cache=True)
    def truth_row(m: Any, row: Any) -> None:
        _ = sources
        cable = fabric = 0.0
        for i in range(CABLE_NODES):
            cable += m[SLOT.s + 1 + i]
        for i in range(FABRIC_NODES):
            fabric += m[SLOT.s + CABLE_NODES + 1 + i]
        row[0], row[1], row[2] = m[SLOT.tension], m[SLOT.tension + CABLE_NODES], m[SLOT.tension + NODES]
        row[3], row[4], row[5] = m[SLOT.leg_q], m[SLOT.leg_w], m[SLOT.motor_q]
        row[6], row[7] = m[SLOT.servo_x] + m[SLOT.encoder_zero_m], m[SLOT.servo_v]
        row[8], row[9] = m[SLOT.current], m[SLOT.bus_v]
        row[10], row[11], row[12] = cable / CABLE_NODES, fabric / FABRIC_NODES, m[SLOT.creep]

    return truth_row


truth_row: Final[Any] = _compile(step.digest())
"""truth_row(memory, row): write the values of `NAMES` into `row`."""
