"""Homing (CiA 402 mode 6): controlword bit 4 starts it, statusword bits 10, 12 and 13 report it.

One table gives the three bits of each phase; a phase changes only here.
"""

from enum import Enum
from typing import Final

from eds.cia402 import HomingMethod, Status


class Phase(Enum):
    """Phase of a homing run."""

    IDLE = "not started, or interrupted"
    SEEKING = "in progress"
    ATTAINED = "completed"
    ERROR = "failed"


BITS: Final = {
    (Phase.IDLE, False): Status.TARGET_REACHED,
    (Phase.IDLE, True): Status(0),
    (Phase.SEEKING, False): Status(0),
    (Phase.SEEKING, True): Status(0),
    (Phase.ATTAINED, False): Status.HOMING_ATTAINED | Status.TARGET_REACHED,
    (Phase.ATTAINED, True): Status.HOMING_ATTAINED,
    (Phase.ERROR, False): Status.HOMING_ERROR | Status.TARGET_REACHED,
    (Phase.ERROR, True): Status.HOMING_ERROR,
}
"""(phase, the axis moves) → statusword bits 10, 12, 13 (CiA 402-2, homing mode)."""

AT_ONCE: Final = frozenset({HomingMethod.CURRENT_POSITION_35, HomingMethod.CURRENT_POSITION_37})
"""Methods that take the present position for home, without a motion and in any state."""


def bits(phase: Phase, moving: bool) -> int:
    """Return the statusword bits of a phase."""
    return int(BITS[phase, moving])
