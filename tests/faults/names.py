"""What a stop's sentence names, without what was measured: a row of the matrix lists the names that are right for it.

`name_of` leaves the condition, the suspects and an emergency's code; that must be one of the row's names to the letter.
"""

from __future__ import annotations

import re
from typing import Final

_FIGURE: Final = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?(?= (?:N|mm|ms|cycles|degrees|bytes)\b)")
_MEASURED: Final = re.compile(
    r" \(.*|(?<!that) (?:is|are|missed|says|repeats|reports|twice|by [a-z]+ targets|by #) .*"
    r"|, (?:for|statusword|its|which|mapped) .*")
"""Where a part of a sentence turns to what was seen."""
NODES: Final = ("knee", "servo", "start", "end")


def name_of(said: str) -> str:
    """Return the name in a sentence, figures with a unit as #."""
    first, *more = [_MEASURED.sub("", part).rstrip(".") for part in _FIGURE.sub("#", said).split(": ")]
    if not more:
        return first
    if first == "emergency message":
        return f"{first}: {more[0]}: {more[1].partition(',')[0]}"
    return ": ".join([first, *more[:2 if first == "refused" else 1]])


def old(node: str) -> str:
    """Name of inputs that are too old."""
    return f"inputs too old: {node}"


def emergency(node: str, code: int) -> str:
    """Name of an emergency message."""
    return f"emergency message: {node}: 0x{code:04X}"


def foreign(what: str) -> str:
    """Name of a foreign command."""
    return f"foreign command on the bus: {what}"


def implausible(suspects: str) -> str:
    """Name of signals that contradict each other."""
    return f"signal implausible: {suspects}"


START_ALONE: Final = implausible("START")
START_OR_PATH: Final = implausible("START, or a path that is jammed")
END_OR_ROPE: Final = implausible("END, or a rope that slipped or snapped")
BETWEEN: Final = implausible("START or END, or a path between them that is jammed")
TORQUE_OR_START: Final = implausible("the servo's torque, or START with its path")
GEOMETRY: Final = implausible(
    "servo position, knee angle, a rope that slipped or snapped, or the calibration's rope_per_knee")
DESIRED: Final = implausible("START, END, friction, an encoder, the calibration or the controller")
PARTED: Final = implausible("START, END, or friction between them")
ALIKE: Final = implausible(
    "START and END alike, servo encoder, knee encoder, a rope or sheath that slipped, or the controller")
SERVO_OFF: Final = "motion not as commanded: servo position"
KNEE_OFF: Final = "motion not as commanded: knee angle"
