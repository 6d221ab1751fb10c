"""NMT slave (CiA 301, 7.2.8 and 7.3.2): states, commands, boot-up, resets.

The rule of this file: the state changes only by `eds.cia301.NMT_TRANSITIONS`, by a boot-up, or by 0x1029.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from eds.cia301 import HEARTBEAT_BASE, NMT_TRANSITIONS, Frame, NmtCommand, NmtState
from eds.cia305 import UNCONFIGURED

if TYPE_CHECKING:
    from nodes.core.device import Device

_COMMANDS: Final = frozenset(int(command) for command in NmtCommand)

ERROR_BEHAVIOUR: Final = 0x102901
"""0x1029:01, the effect of a communication error on the NMT state (CiA 301, 7.5.2.32)."""

ON_ERROR: Final = {
    (NmtState.OPERATIONAL, 0): NmtState.PRE_OPERATIONAL,
    (NmtState.OPERATIONAL, 2): NmtState.STOPPED,
    (NmtState.PRE_OPERATIONAL, 2): NmtState.STOPPED,
}
"""(state, 0x1029:01) → state after a communication error; every other pair changes nothing."""


class Nmt:
    """One device's NMT slave."""

    __slots__ = ("_device", "state")

    def __init__(self, device: Device) -> None:
        self._device = device
        self.state = NmtState.INITIALISING

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey a command for this node or for all; anything else is not for us."""
        if len(data) != 2 or data[1] not in (0, self._device.node_id) or data[0] not in _COMMANDS:
            return
        command = NmtCommand(data[0])
        target = NMT_TRANSITIONS[self.state, command]
        if target is NmtState.INITIALISING:
            self.initialise(command is NmtCommand.RESET_NODE, now_ns)
        elif target is not self.state:
            self.enter(target, now_ns)

    def initialise(self, whole_node: bool, now_ns: int) -> None:
        """Restore power-on values (all, or 0x1000–0x1FFF), send the boot-up, enter PRE-OPERATIONAL.

        A node without a node id stays in INITIALISING, where only LSS reaches it (CiA 305).
        """
        device = self._device
        device.outbox.clear()
        self.enter(NmtState.INITIALISING, now_ns)
        device.restart(whole_node, now_ns)
        if device.node_id == UNCONFIGURED:
            return
        device.outbox.append(Frame(HEARTBEAT_BASE + device.node_id, b"\x00"))
        self.enter(NmtState.PRE_OPERATIONAL, now_ns)

    def enter(self, state: NmtState, now_ns: int) -> None:
        """Change the state and report it to every part that acts on it."""
        self.state = state
        self._device.state_entered(state, now_ns)

    def communication_error(self, now_ns: int) -> None:
        """Change to the state that 0x1029:01 selects after a lost heartbeat or a bus-off."""
        target = ON_ERROR.get((self.state, self._device.objects.number(ERROR_BEHAVIOUR)))
        if target is not None:
            self.enter(target, now_ns)
