"""Node guarding (CiA 301, 7.2.8.3.2.1): the master asks a node's NMT state by a remote frame.

Older drives have no heartbeat and nothing else. A node answers a remote frame 700h + node id with its state and a bit
that toggles from answer to answer.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import can

from eds.cia301 import HEARTBEAT_BASE
from master.network.link import Link

ANSWER_NS: Final = 100_000_000
"""Time for the answer to a remote frame: many times the turnaround of a slow node, less than a usual guard time."""
_STATE: Final = 0x7F


class GuardAnswer(NamedTuple):
    """Answer to one remote frame: NMT state byte, toggle bit (0 or 1)."""

    state: int
    toggle: int


def guard(link: Link, node_id: int, answer_ns: int = ANSWER_NS) -> GuardAnswer | None:
    """Ask a node's state by a remote frame; None without an answer in time. The answer counts as a heartbeat, too."""
    can_id = HEARTBEAT_BASE + node_id
    link.wait(0)
    if not link.try_send(can.Message(arbitration_id=can_id, is_remote_frame=True, dlc=1, is_extended_id=False)):
        return None
    deadline = link.clock() + answer_ns
    while (message := link.receive(deadline)) is not None:
        if message.arbitration_id == can_id and message.dlc:
            return GuardAnswer(message.data[0] & _STATE, message.data[0] >> 7)
    return None


class NodeGuard:
    """Guarding of one node: `poll` asks it every `period_ns`; `life` missed answers are a loss.

    `state` is the last state byte, None before the first answer; `lost` is True from a loss to the next answer.
    `asked` and `unanswered` count remote frames; `asked_ns` is the time of the last one.
    """

    def __init__(self, link: Link, node_id: int, period_ns: int, life: int = 3) -> None:
        self.link, self.node_id, self.period_ns, self.life = link, node_id, period_ns, life
        self.state: int | None = None
        self.lost = False
        self.asked = self.unanswered = self.asked_ns = 0
        self._missed = 0
        self._toggle: int | None = None
        self._due_ns = link.clock()

    def poll(self) -> str | None:
        """Wait for the next guard time and ask; return in words what is wrong or has changed, None where nothing."""
        if (wait_ns := self._due_ns - self.link.clock()) > 0:
            self.link.wait(wait_ns)
        self._due_ns += self.period_ns
        self.asked, self.asked_ns = self.asked + 1, self.link.clock()
        answer = guard(self.link, self.node_id, min(self.period_ns, ANSWER_NS))
        if answer is None:
            self._missed, self.unanswered = self._missed + 1, self.unanswered + 1
            if self._missed != self.life:
                return None
            self.lost, self._toggle = True, None
            return f"lost: {self.life} remote frames without an answer"
        repeated = answer.toggle == self._toggle
        changed, self.state = answer.state != self.state, answer.state
        self._toggle, self._missed, self.lost = answer.toggle, 0, False
        if repeated:
            return "the toggle bit did not change: the node booted, or another master guards it, too"
        return "state" if changed else None
