"""LSS slave (CiA 305): node id and bit timing from a master that has the device's identity, or finds it by fastscan.

A new node id is in force after the next NMT reset, a new bit timing after its activation or the next power-on; only
stored values outlast a power cycle.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from eds.cia301 import Frame, Service
from eds.cia305 import BIT_RATES, FASTSCAN_RESET, LSS_REQUEST, LSS_RESPONSE, UNCONFIGURED, LssAddress, LssCommand
from eds.dictionary import key
from nodes.core.parts import FAR_NS, MS, Handler, Part
from parameters import InputError
from parameters.files import write_whole

if TYPE_CHECKING:
    from nodes.core.device import Device

_ADDRESS: Final = tuple(key(0x1018, sub) for sub in range(1, 5))
_SELECT: Final = LssCommand.SELECT_VENDOR
_IDENTIFY: Final = LssCommand.IDENTIFY_VENDOR
_INQUIRE: Final = LssCommand.INQUIRE_VENDOR
_OUT_OF_RANGE, _NOT_STORED = 1, 2


class LssSlave(Part):
    """Answers the LSS master; `pending` is the node id that the next NMT reset puts in force.

    `bitrate` is the bit rate in force, bit/s: None for that of the bus, until LSS sets one. `muted` while a bit
    timing is being switched. With a path, stored values outlast a power cycle.
    """

    service = Service.LSS

    def __init__(self, device: Device, path: Path | None) -> None:
        self._device = device
        self._path = None if path is None else path.with_name(path.name + ".lss")
        self._stored: tuple[int, int | None] = device.node_id, None
        self.pending = device.node_id
        self.bitrate: int | None = None
        self._pending_rate: int | None = None
        self._configuring = False
        self._selected = self._identified = 0
        self._scanned = 0
        self._switch_ns = self._speak_ns = FAR_NS
        self._delay_ns = 0

    def load(self) -> None:
        """Read the stored values at power-on; a file that cannot be read counts as absent."""
        if self._path is not None and self._path.exists():
            try:
                found = json.loads(self._path.read_text(encoding="utf-8"))
                node_id, rate = int(found["node_id"]), found["bitrate"]
            except (OSError, ValueError, KeyError, TypeError):
                return
            if _valid(node_id) and (rate is None or rate in BIT_RATES.values()):
                self._stored = node_id, rate
        self.recall()
        self.bitrate = self._pending_rate = self._stored[1]
        self._switch_ns = self._speak_ns = FAR_NS
        self._configuring = False

    def recall(self) -> None:
        """Take the stored node id as the next one, as a node reset does."""
        self.pending = self._stored[0]

    @property
    def muted(self) -> bool:
        """Return whether nothing may be sent: the bit timing was switched and other devices are still switching."""
        return self._speak_ns != FAR_NS

    def handlers(self) -> Iterator[tuple[int, Handler]]:
        """Yield COB-ID and handler of the LSS master's frames."""
        yield LSS_REQUEST, self.receive

    def receive(self, data: bytes, now_ns: int) -> None:
        """Obey a request; one of another length, or not meant for this state, changes nothing."""
        if len(data) != 8:
            return
        command = data[0]
        if command == LssCommand.SWITCH_GLOBAL:
            self._switch(data[1] == 1, now_ns)
        elif _SELECT <= command <= LssCommand.SELECT_SERIAL:
            self._select(command - _SELECT, _number(data))
        elif _IDENTIFY <= command <= LssCommand.IDENTIFY_SERIAL_HIGH:
            self._identify(command - _IDENTIFY, _number(data))
        elif command == LssCommand.IDENTIFY_UNCONFIGURED:
            if self._unconfigured:
                self._answer(LssCommand.UNCONFIGURED_SLAVE)
        elif command == LssCommand.FASTSCAN:
            self._fastscan(*struct.unpack("<xIBBB", data))
        elif self._configuring:
            self._configure(data, now_ns)

    def poll(self, now_ns: int) -> int:
        """Switch the bit timing after the switch delay, and transmit again one delay later."""
        if self._switch_ns <= now_ns:
            self._speak_ns, self._switch_ns = self._switch_ns + self._delay_ns, FAR_NS
            self.bitrate = self._pending_rate
        if self._speak_ns <= now_ns:
            self._speak_ns = FAR_NS
        return min(self._switch_ns, self._speak_ns)

    @property
    def _unconfigured(self) -> bool:
        return self.pending == UNCONFIGURED and self._device.node_id == UNCONFIGURED

    @property
    def _address(self) -> LssAddress:
        return LssAddress(*(self._device.objects.number(at) for at in _ADDRESS))

    def _switch(self, configuring: bool, now_ns: int) -> None:
        self._configuring = configuring
        self._selected = self._identified = 0
        # CiA 305: a device without a node id boots with its first one as it leaves configuration
        if not configuring and self._device.node_id == UNCONFIGURED and self.pending != UNCONFIGURED:
            self._device.nmt.initialise(False, now_ns)

    def _select(self, part: int, value: int) -> None:
        """Count the parts of the address that match in their order; the fourth leads into configuration."""
        if self._configuring or value != self._address[part] or self._selected != part:
            self._selected = 0
            return
        self._selected = part + 1
        if self._selected == len(_ADDRESS):
            self._selected, self._configuring = 0, True
            self._answer(LssCommand.SELECTED)

    def _identify(self, part: int, value: int) -> None:
        """Check one field of an LSS identity: vendor, product, lowest and highest revision and serial, in order."""
        vendor, product, revision, serial = self._address
        holds = (value == vendor, value == product, value <= revision, value >= revision,
                 value <= serial, value >= serial)[part]
        self._identified = part + 1 if holds and self._identified == part else 0
        if self._identified == 6:
            self._identified = 0
            self._answer(LssCommand.IDENTIFIED)

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> None:
        """Answer if the address agrees in all bits from `bit` up; agreement in the last one selects this slave."""
        if self._configuring or not self._unconfigured:
            return
        if bit == FASTSCAN_RESET:
            self._scanned = 0
            self._answer(LssCommand.IDENTIFIED)
        elif part == self._scanned < len(_ADDRESS) and bit < 32 and (number ^ self._address[part]) >> bit == 0:
            self._scanned = following
            if bit == 0 and following < part:
                self._configuring = True
            self._answer(LssCommand.IDENTIFIED)

    def _configure(self, data: bytes, now_ns: int) -> None:
        command, first, second = data[:3]
        if command == LssCommand.CONFIGURE_NODE_ID:
            if _valid(first):
                self.pending = first
            self._answer(command, 0 if _valid(first) else _OUT_OF_RANGE)
        elif command == LssCommand.CONFIGURE_BIT_TIMING:
            known = first == 0 and second in BIT_RATES
            if known:
                self._pending_rate = BIT_RATES[second]
            self._answer(command, 0 if known else _OUT_OF_RANGE)
        elif command == LssCommand.ACTIVATE_BIT_TIMING:
            self._delay_ns = int.from_bytes(data[1:3], "little") * MS
            self._switch_ns = now_ns + self._delay_ns
            self._device.wake(self._switch_ns)
        elif command == LssCommand.STORE:
            self._answer(command, self._store())
        elif _INQUIRE <= command < LssCommand.INQUIRE_NODE_ID:
            self._answer(command, *self._address[command - _INQUIRE].to_bytes(4, "little"))
        elif command == LssCommand.INQUIRE_NODE_ID:
            self._answer(command, self._device.node_id)

    def _store(self) -> int:
        """Store node id and bit timing; return the error code of the answer."""
        if self._path is not None:
            try:
                write_whole(self._path, json.dumps({"node_id": self.pending, "bitrate": self._pending_rate}) + "\n",
                            overwrite=True)
            except InputError:
                return _NOT_STORED
        self._stored = self.pending, self._pending_rate
        return 0

    def _answer(self, command: int, *data: int) -> None:
        self._device.outbox.append(Frame(LSS_RESPONSE, bytes((command, *data)).ljust(8, b"\0")))


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")


def _valid(node_id: int) -> bool:
    return 1 <= node_id <= 127 or node_id == UNCONFIGURED
