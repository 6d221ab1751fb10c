"""An LSS slave with the habits of CANopenNode: in configuration it says yes to every fastscan, whatever is asked.

Written from its observed answers on a bus; it also keeps the numbers of a selection in any order.
"""

from __future__ import annotations

from bowden.testing import CanBus
from eds.cia301 import Frame
from eds.cia305 import FASTSCAN_RESET, LSS_REQUEST, LSS_RESPONSE, UNCONFIGURED, LssAddress, LssCommand
from virtual_bus.wire.station import Station


class EagerLssSlave(Station):
    """A device without a node id on a `CanBus`; `node_id` is what LSS gave it."""

    def __init__(self, bus: CanBus, identity: LssAddress, *, inquiries: LssAddress | None = None) -> None:
        super().__init__("eager", self.heard, filters=frozenset({LSS_REQUEST}))
        self.identity, self.inquired = identity, inquiries or identity
        self.node_id = UNCONFIGURED
        self.configuring = False
        self._selection = [0, 0, 0, 0]
        self._part = 0
        bus.wire.attach(self)

    def heard(self, frame: Frame, now_ns: int) -> None:
        command, number = frame.data[0], int.from_bytes(frame.data[1:5], "little")
        if command == LssCommand.SWITCH_GLOBAL:
            if not frame.data[1] and self.configuring and self.node_id != UNCONFIGURED:
                self.submit(Frame(0x700 + self.node_id, b"\0"), now_ns)
            self.configuring = bool(frame.data[1])
        elif self.configuring:
            self._configure(command, frame.data, now_ns)
        elif LssCommand.SELECT_VENDOR <= command <= LssCommand.SELECT_SERIAL:
            self._selection[command - LssCommand.SELECT_VENDOR] = number
            if command == LssCommand.SELECT_SERIAL and tuple(self._selection) == self.identity:
                self.configuring = True
                self._answer(now_ns, LssCommand.SELECTED)
        elif command == LssCommand.FASTSCAN and self.node_id == UNCONFIGURED:
            self._fastscan(number, *frame.data[5:8], now_ns)

    def _fastscan(self, number: int, bit: int, part: int, following: int, now_ns: int) -> None:
        if bit == FASTSCAN_RESET:
            self._part = 0
        elif part != self._part or (self.identity[part] ^ number) >> bit:
            return
        else:
            self._part = following
            self.configuring = bit == 0 and following < part
        self._answer(now_ns, LssCommand.IDENTIFIED)

    def _configure(self, command: int, data: bytes, now_ns: int) -> None:
        if command == LssCommand.FASTSCAN:
            self._answer(now_ns, LssCommand.IDENTIFIED)
        elif command == LssCommand.CONFIGURE_NODE_ID:
            self.node_id = data[1]
            self._answer(now_ns, command)
        elif LssCommand.INQUIRE_VENDOR <= command <= LssCommand.INQUIRE_SERIAL:
            number = self.inquired[command - LssCommand.INQUIRE_VENDOR]
            self._answer(now_ns, command, *number.to_bytes(4, "little"))
        elif command == LssCommand.INQUIRE_NODE_ID:
            self._answer(now_ns, command, self.node_id)

    def _answer(self, now_ns: int, command: int, *data: int) -> None:
        self.submit(Frame(LSS_RESPONSE, bytes((command, *data)).ljust(8, b"\0")), now_ns)
