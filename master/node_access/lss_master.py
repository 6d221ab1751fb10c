"""LSS master (CiA 305): finds devices by their identity, and gives them node id and bit timing.

Waiting is receiving. `canopen.lss` is not used here, but as a test's counterpart. It sleeps on the wall clock 0.2 s
after each number of an identity, and waits 0.5 s for each bit that no slave confirms.
"""

from contextlib import suppress
from typing import Final

from eds.cia305 import BIT_RATES, FASTSCAN_RESET, LSS_REQUEST, LSS_RESPONSE, LssAddress, LssCommand
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access.remote_node import BOOT_NS, SENT_NS, NodeAccess
from parameters import InputError

ANSWER_NS: Final = 100_000_000
"""Time-out of an LSS answer; CiA 305 states none. Too short: a slow slave's yes counts as no. Every 1 bit of an
identity takes this long in a fastscan.
"""
SETTLE_NS: Final = 10_000_000
"""Time for further slaves' answers to one question, which must not count for the next."""
_REFUSALS: Final = {
    LssCommand.CONFIGURE_NODE_ID: "the node id is out of range",
    LssCommand.CONFIGURE_BIT_TIMING: "this bit rate is not supported",
    LssCommand.STORE: "it cannot store node id and bit rate",
}


_HIDDEN: Final = "further devices cannot be found beside it; give it a node id, then scan again."
_MANY_ANSWERS: Final = "a device answers what it should not; scan with fewer devices on the bus."


class LssRefusalError(Exception):
    """A device refused an LSS request or did not answer; the text gives request and reason."""


class LssMaster:
    """The LSS requests of a master on a link; `answer_ns` is how long an answer is awaited.

    `scan_note` is the reason for which the last scan ended early, None for a complete one.
    """

    def __init__(self, link: Link, answer_ns: int = ANSWER_NS) -> None:
        self.link = link
        self.scan_note: str | None = None
        self._answer_ns = answer_ns

    # ---- who is configured ----

    def configure_all(self, on: bool) -> None:
        """Switch all slaves to configuration, or back to waiting, where an assigned node boots."""
        self._send(LssCommand.SWITCH_GLOBAL, int(on))

    def select(self, address: LssAddress) -> bool:
        """Switch the slave of this address to configuration; False where none confirms it."""
        for part, number in enumerate(address[:3]):
            self._send(LssCommand.SELECT_VENDOR + part, *number.to_bytes(4, "little"))
        return self._ask(LssCommand.SELECT_SERIAL, *address.serial.to_bytes(4, "little"),
                         expected=LssCommand.SELECTED) is not None

    def fastscan(self) -> LssAddress | None:
        """Find one unconfigured slave and switch it to configuration; None if no slave answers.

        Of several the one with the lowest numbers is found; a slave in configuration is not found again.
        """
        if not self._scanned(0, FASTSCAN_RESET, 0, 0):
            return None
        numbers = [0] * 4
        for part in range(4):
            for bit in reversed(range(32)):
                if not self._scanned(numbers[part], bit, part, part):
                    numbers[part] |= 1 << bit
            if not self._scanned(numbers[part], 0, part, (part + 1) % 4):
                raise LssRefusalError("a device stopped answering the fastscan")
        return LssAddress(*numbers)

    def scan(self) -> list[LssAddress]:
        """Find all unconfigured slaves; they stay unconfigured.

        Each identity is then confirmed by the inquiries 5Ah to 5Dh of the slave that it selects. An identity that comes
        again, that no slave confirms, or a slave that answers every fastscan while it is in configuration makes the
        list incomplete; `scan_note` is then the reason.
        """
        found: list[LssAddress] = []
        self.scan_note = None
        try:
            while self.scan_note is None and (address := self.fastscan()) is not None:
                if address in found:
                    self.scan_note = f"the identity {address} came twice: {_MANY_ANSWERS}"
                    break
                found.append(address)
                if self._answers_always(address):
                    self.scan_note = f"{address} answers every fastscan while it is in configuration: {_HIDDEN}"
        finally:
            self.leave()
        return [address for address in found if self._confirmed(address)]

    def _confirmed(self, address: LssAddress) -> bool:
        """Return whether the slave selected by an identity reports it; alone, since several answers collide."""
        try:
            if self.select(address) and self._inquired() == address:
                return True
        finally:
            self.leave()
        self.scan_note = f"the identity {address} is confirmed by no device: {_MANY_ANSWERS}"
        return False

    def _inquired(self) -> LssAddress | None:
        """Return the identity of the slave in configuration; None where a number is not answered."""
        answers = [self._ask(LssCommand.INQUIRE_VENDOR + part) for part in range(4)]
        if any(answer is None for answer in answers):
            return None
        return LssAddress(*(int.from_bytes(answer[1:5], "little") for answer in answers if answer is not None))

    def _answers_always(self, address: LssAddress) -> bool:
        """Return whether a slave confirms a wrong vendor id too: such a fastscan cannot find identities."""
        self._scanned(0, FASTSCAN_RESET, 0, 0)
        return self._scanned(address.vendor ^ 0xFFFFFFFF, 0, 0, 0)

    def choose(self, node_id: int | None = None, address: LssAddress | None = None) -> LssAddress:
        """Switch one slave to configuration: that of `address`, of a node id, or the only unconfigured one.

        Raises `InputError` where it is not there, or where several are unconfigured.
        """
        if node_id is not None:
            address = self._address_of(node_id)
        if address is not None:
            if not self.select(address):
                raise InputError(f"no device of identity {address} answers LSS; give another (bowden lss scan).")
            return address
        found = self.scan()
        if not found and self.scan_note is not None:
            raise LssRefusalError(self.scan_note.rstrip("."))
        if len(found) != 1:
            several = f"{len(found)} devices are unconfigured ({', '.join(map(str, found))}); give one by --identity"
            raise InputError(f"{several}." if found else
                             "no unconfigured device answers LSS; give a configured one by --node or --identity.")
        return self.choose(address=found[0])

    def _address_of(self, node_id: int) -> LssAddress:
        try:
            found = NodeAccess(self.link, node_id).identity()
        except SdoError as error:
            raise InputError(f"{error}; give the id of a node, or its --identity.") from None
        return LssAddress(*(found.get(name, 0) for name in LssAddress._fields))

    # ---- what it gets: the slave in configuration ----

    def node_id(self) -> int | None:
        """Return the node id of the slave in configuration, 255 for none yet; None where no slave answers."""
        answer = self._ask(LssCommand.INQUIRE_NODE_ID)
        return None if answer is None else answer[1]

    def configure_node_id(self, node_id: int) -> None:
        """Set the selected device's node id, effective after the switch to waiting or an NMT reset."""
        self._configure(LssCommand.CONFIGURE_NODE_ID, node_id)

    def configure_bitrate(self, bitrate: int) -> None:
        """Set the selected device's bit rate by CiA 305's table, effective after `activate` or a power cycle."""
        index = next((index for index, rate in BIT_RATES.items() if rate == bitrate), None)
        if index is None:
            raise InputError(f"bit rate {bitrate} is none of CiA 305's table; give one of "
                             f"{', '.join(map(str, BIT_RATES.values()))}.")
        self._configure(LssCommand.CONFIGURE_BIT_TIMING, 0, index)

    def activate(self, delay_ms: int) -> None:
        """Let all slaves in configuration switch to their bit rate after a delay, and be silent for another."""
        self._send(LssCommand.ACTIVATE_BIT_TIMING, *delay_ms.to_bytes(2, "little"))

    def store(self) -> None:
        """Make the selected device store node id and bit rate in non-volatile memory."""
        self._configure(LssCommand.STORE)

    def booted(self, node_id: int) -> bool:
        """Switch all slaves to waiting; return whether the boot-up of `node_id` follows within 3 s."""
        self.link.beats.pop(node_id, None)
        self.configure_all(False)
        deadline = self.link.clock() + BOOT_NS
        while node_id not in self.link.beats and self.link.receive(deadline) is not None:
            pass
        return node_id in self.link.beats

    def leave(self) -> None:
        """Switch all slaves to waiting, before the bus is closed."""
        self.configure_all(False)
        self.link.wait(SENT_NS)

    def _configure(self, command: LssCommand, *data: int) -> None:
        answer = self._ask(command, *data)
        if answer is None:
            raise LssRefusalError(f"LSS {command.text}: no answer")
        if answer[1]:
            own = f" (its own code {answer[2]})" if answer[1] == 255 else f" (code {answer[1]})"
            raise LssRefusalError(f"LSS {command.text}: {_REFUSALS[command]}{own}")

    def _scanned(self, number: int, bit: int, part: int, following: int) -> bool:
        answer = self._ask(LssCommand.FASTSCAN, *number.to_bytes(4, "little"), bit, part, following,
                           expected=LssCommand.IDENTIFIED)
        if answer is not None:
            self.link.wait(SETTLE_NS)
        return answer is not None

    def _send(self, command: int, *data: int) -> None:
        self.link.send(LSS_REQUEST, bytes((command, *data)).ljust(8, b"\0"))

    def _ask(self, command: int, *data: int, expected: int | None = None) -> bytes | None:
        """Send a request and return the answer to it; None where none comes in time."""
        self.link.wait(0)
        self._send(command, *data)
        deadline = self.link.clock() + self._answer_ns
        while (message := self.link.receive(deadline)) is not None:
            if message.arbitration_id == LSS_RESPONSE and len(message.data) == 8 \
                    and message.data[0] == (command if expected is None else expected):
                return bytes(message.data)
        return None


def refuse_taken(link: Link, node_id: int) -> None:
    """Raise `InputError` where a node id cannot be given: out of range, or a node answers to it."""
    if not 1 <= node_id <= 127:
        raise InputError(f"node id {node_id}: is outside 1 … 127; give a free one, as bowden node scan shows.")
    taken = node_id in link.beats
    with suppress(SdoError):
        taken = bool(link.sdo_read(node_id, 0x1000)) or taken
    if taken:
        raise InputError(f"node id {node_id}: a node has it already (bowden node info {node_id}); give a free one.")


def address_of(text: str) -> LssAddress:
    """Return the address that `VENDOR:PRODUCT:REVISION:SERIAL`, hexadecimal, states; `InputError` for other text."""
    try:
        numbers = [int(part, 16) for part in text.split(":")]
        if len(numbers) != len(LssAddress._fields) or not all(0 <= number < 1 << 32 for number in numbers):
            raise ValueError
    except ValueError:
        raise InputError(f"--identity {text}: expected VENDOR:PRODUCT:REVISION:SERIAL in hexadecimal; copy a line of "
                         "bowden lss scan.") from None
    return LssAddress(*numbers)
