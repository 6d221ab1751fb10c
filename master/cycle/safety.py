"""Conditions that stop the bench, and the reaction to each: one table.

A condition names the fault, the table its reaction. No reaction holds the rope against the knee: while START is
trusted it is unwound. The servo's torque goes off at once if signals contradict each other, END is above its limit, a
motion is not the commanded one or another master commands.
"""

from collections.abc import Sequence
from enum import Enum
from types import MappingProxyType
from typing import Final

from eds.bench.bench_network import MONITOR
from eds.declaration import PathNodes
from master.cycle.inputs import END, KNEE, SERVO, START


class Condition(Enum):
    """Reason of a stop."""

    START_LIMIT = "START tension above its limit"
    END_LIMIT = "END tension above its limit"
    NODE_LOST = "heartbeat lost"
    LEFT = "node left OPERATIONAL"
    EMERGENCY = "emergency message"
    BOOTED = "restarted by itself"
    NOT_ENABLED = "drive left OPERATION ENABLED"
    STALE = "inputs too old"
    IMPLAUSIBLE = "signal implausible"
    OFF_TARGET = "motion not as commanded"
    OUT_OF_LIMITS = "motion outside its limits"
    FOREIGN = "foreign command on the bus"
    SYNC_LOST = "SYNC missing"
    BUS_LOST = "bus failed"
    RECORDING = "recording failed"
    CONTROLLER = "controller failed"
    INTERRUPTED = "interrupted"
    REFUSED = "refused"
    FAILED = "program failed"


class Reaction(Enum):
    """First action of a safe stop; the drives are disabled at its end in every case."""

    UNWIND = "pay the rope out to below 2 N, then quick stop"
    RELEASE = "servo torque off, the rope goes slack"
    RELEASE_BOTH = "torque off at both drives, the knee is not held by a drive or an angle that is not trusted"
    ABANDON = "nothing can be sent: the drives react by 0x6007"


class StopError(Exception):
    """A condition was met; `node_id` is the node it names, 0 for none."""

    def __init__(self, condition: Condition, text: str, node_id: int = 0) -> None:
        super().__init__(f"{condition.value}: {text}" if text else condition.value)
        self.condition = condition
        self.detail = text
        self.node_id = node_id


_UNWIND, _RELEASE = Reaction.UNWIND, Reaction.RELEASE
NOBODY: Final = -1
"""Number of a condition that names no device."""
_BY_PLACE: Final = {SERVO: _RELEASE, KNEE: Reaction.RELEASE_BOTH, START: _RELEASE, END: _UNWIND, NOBODY: _UNWIND}
"""Reaction by the device that a condition names as faulty. Without START no signal shows when the rope is slack;
without the servo nothing can unwind it; a faulty knee drive can neither brake nor hold by its own angle."""
_OTHERWISE: Final = {
    # START is above its limit but believed: it shows when the rope is slack
    (Condition.START_LIMIT, START): _UNWIND,
    (Condition.END_LIMIT, END): _RELEASE,
    (Condition.IMPLAUSIBLE, END): _RELEASE,
    # no sensor is named, so none is trusted to unwind by
    (Condition.IMPLAUSIBLE, NOBODY): _RELEASE,
    # somebody else sends: what the servo does with targets is not ours alone
    (Condition.FOREIGN, NOBODY): _RELEASE,
    # targets are taken over at SYNC: without it none unwinds
    (Condition.SYNC_LOST, NOBODY): _RELEASE,
    (Condition.BUS_LOST, NOBODY): Reaction.ABANDON,
}
REACTIONS: Final = MappingProxyType(
    {(condition, place): _OTHERWISE.get((condition, place), reaction)
     for condition in Condition for place, reaction in _BY_PLACE.items()})
"""Reaction by condition and place of the named device."""


def place_of(node_id: int, paths: Sequence[PathNodes]) -> int | None:
    """Return the place that a node has in its force path, `NOBODY` for node 0, None for a node of no path."""
    if not node_id:
        return NOBODY
    return next((path.index(node_id) for path in paths if node_id in path), None)


def reaction_to(stop: StopError, paths: Sequence[PathNodes]) -> Reaction:
    """Return the reaction of the table; an unknown node unwinds, and the safety monitor's torque off is not opposed."""
    if stop.node_id == MONITOR:
        return Reaction.RELEASE_BOTH
    place = place_of(stop.node_id, paths)
    return _UNWIND if place is None else REACTIONS[stop.condition, place]
