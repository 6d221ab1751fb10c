"""Unsafe control actions (STPA): what each leads to and what is required; rows of the matrix are its tests.

Every row belongs to one of them; docs/faults.md says by them what the rows did.
"""

from __future__ import annotations

from typing import Final, NamedTuple

TENSION: Final = "too much tension on limb, fabric, rope"
UNKNOWN: Final = "a rope that is pulled although the tension is not known"
KNEE: Final = "a knee moved beyond or faster than a limb bears"
HELD: Final = "a taut rope that holds while the knee moves"
ALONE: Final = "a motion that nobody supervises"
HAZARDS: Final = (TENSION, UNKNOWN, KNEE, HELD, ALONE)
"""Hazards, as docs/safety.md names them."""


class UnsafeAction(NamedTuple):
    """An unsafe control action: in words, the hazard that it leads to, and what is required against it."""

    words: str
    hazard: str
    required: str


LYING_TENSION = UnsafeAction("targets that answer a tension that is not there", TENSION,
                             "no tension is believed that the other signals contradict")
LYING_ROPE = UnsafeAction("targets that answer a rope position that is not there", TENSION,
                          "no position is believed that targets and stretch contradict")
LYING_KNEE = UnsafeAction("a knee led by an angle that is not there", KNEE,
                          "no angle is believed that targets, stretch and velocity contradict")
LYING_VELOCITY = UnsafeAction("torque by a velocity that is not there", TENSION,
                              "the drive compares velocity with position")
SLOW_LIE = UnsafeAction("targets that answer a sensor that departs slowly", TENSION,
                        "END against the desired force, and each gait cycle against the first two")
SLOW_KNEE = UnsafeAction("a knee led by an angle that departs slowly", KNEE,
                         "rope by tension in each gait cycle against the first two; velocity against position")
NO_INPUT = UnsafeAction("targets given without their inputs", UNKNOWN, "torque off, or unwound, where inputs are lost")
STAGE = UnsafeAction("torque at the servo that nobody asked for, or none", TENSION,
                     "torque off where motion is not as commanded; STO where the stage conducts")
KNEE_STAGE = UnsafeAction("torque at the knee that nobody asked for, or none", KNEE,
                          "torque off at both drives where the knee is not as commanded")
PATH = UnsafeAction("targets for a path that has changed", TENSION, "stretch and friction of the path are compared")
TARGETS = UnsafeAction("targets not given, late, twice or altered", HELD,
                       "drives let go without targets, refuse steps, and misses are counted")
FOREIGN = UnsafeAction("targets or commands from somebody else", ALONE,
                       "a foreign command that can move anything stops")
ALTERED = UnsafeAction("targets that answer a value altered on the way", TENSION,
                       "a value that cannot be is not taken, and its cycle holds the targets")
STOP = UnsafeAction("a stop asked for and given late or not at all", ALONE, "every end of the program is a safe stop")
OTHER_BENCH = UnsafeAction("power given on a bench that is not the one described", TENSION,
                           "homing compares the bench with its calibration before anything moves fast")
ACTIONS: Final = (LYING_TENSION, LYING_ROPE, LYING_KNEE, LYING_VELOCITY, SLOW_LIE, SLOW_KNEE, NO_INPUT, STAGE,
                  KNEE_STAGE, PATH, TARGETS, FOREIGN, ALTERED, STOP, OTHER_BENCH)
