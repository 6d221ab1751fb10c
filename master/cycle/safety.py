"""What stops the bench, and how: one table.

The rule of this file: a condition names what went wrong, the table what is done about it.  No reaction
holds the rope against the knee: while START is trusted it is unwound; where signals contradict each other, END is above
its limit, a motion is not the commanded one or somebody else commands, the servo's torque goes off at once.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import Final

from eds.bench.bench_network import END, KNEE, SERVO, START


class Condition(Enum):
    """Why a trial stops."""

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
    """What a safe stop does first; the drives are disabled at its end in every case."""

    UNWIND = "pay the rope out to below 2 N, then quick stop"
    RELEASE = "servo torque off, the rope goes slack"
    RELEASE_BOTH = "torque off at both drives: the knee cannot be held by an angle that is not believed"
    ABANDON = "nothing can be sent: the drives react by 0x6007"


class StopError(Exception):
    """A condition was met; `node_id` is the node it names, 0 for none."""

    def __init__(self, condition: Condition, text: str, node_id: int = 0) -> None:
        super().__init__(f"{condition.value}: {text}" if text else condition.value)
        self.condition = condition
        self.detail = text
        self.node_id = node_id


_UNWIND, _RELEASE = Reaction.UNWIND, Reaction.RELEASE
_BY_NODE: Final = {SERVO: _RELEASE, KNEE: _RELEASE, START: _RELEASE, END: _UNWIND}
"""Without START nothing says when the rope is slack; without the servo nothing can unwind it; a knee that nobody holds
loads the rope faster than it is paid out."""

REACTIONS: Final = MappingProxyType({
    **{(Condition.NODE_LOST, node): reaction for node, reaction in _BY_NODE.items()},
    **{(Condition.LEFT, node): reaction for node, reaction in _BY_NODE.items()},
    **{(Condition.EMERGENCY, node): reaction for node, reaction in _BY_NODE.items()},
    **{(Condition.BOOTED, node): reaction for node, reaction in _BY_NODE.items()},
    **{(Condition.STALE, node): reaction for node, reaction in _BY_NODE.items()},
    **{(Condition.IMPLAUSIBLE, node): _RELEASE for node in (0, SERVO, START, END)},
    (Condition.OFF_TARGET, SERVO): _RELEASE,
    **{(condition, KNEE): Reaction.RELEASE_BOTH
       for condition in (Condition.IMPLAUSIBLE, Condition.OFF_TARGET, Condition.OUT_OF_LIMITS)},
    (Condition.FOREIGN, 0): _RELEASE,
    (Condition.NOT_ENABLED, SERVO): _RELEASE,
    (Condition.NOT_ENABLED, KNEE): _RELEASE,
    (Condition.START_LIMIT, START): _UNWIND,
    (Condition.END_LIMIT, END): _RELEASE,
    (Condition.SYNC_LOST, 0): _RELEASE,
    (Condition.BUS_LOST, 0): Reaction.ABANDON,
    (Condition.RECORDING, 0): _UNWIND,
    (Condition.CONTROLLER, 0): _UNWIND,
    (Condition.INTERRUPTED, 0): _UNWIND,
    (Condition.REFUSED, 0): _UNWIND,
    (Condition.FAILED, 0): _UNWIND,
})
"""(condition, node) → reaction.  A node that is not of the bench unwinds."""


def reaction_to(stop: StopError) -> Reaction:
    """The reaction of the table; an unknown node unwinds."""
    return REACTIONS.get((stop.condition, stop.node_id), _UNWIND)
