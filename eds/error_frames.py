"""Error frames of the kernel's CAN in words: class of error, state and error counters of the controller.

The bits are those of linux/can/error.h. The class is in the identifier; byte 1 holds the controller's state, byte 2 the
protocol violation, byte 3 its place, bytes 6 and 7 the transmit and receive error counters (ISO 11898-1, 12.1.4).
"""

from typing import Final, NamedTuple

TX_TIMEOUT: Final = 0x001
ARBITRATION_LOST: Final = 0x002
CONTROLLER: Final = 0x004
PROTOCOL: Final = 0x008
NO_ACKNOWLEDGE: Final = 0x020
BUS_OFF: Final = 0x040
BUS_ERROR: Final = 0x080
RESTARTED: Final = 0x100
COUNTERS: Final = 0x200
"""Classes of an error frame; `COUNTERS` marks that bytes 6 and 7 hold the counters."""
ACTIVE_STATE: Final = 0x40
PASSIVE_STATE: Final = 0x30
"""Bits of byte 1: error active again; error passive in receiving (10h) and transmitting (20h)."""
WARNING_STATE: Final = 0x0C
TRANSMITTING: Final = 0x80
"""Bit of byte 2: the error was in a frame that this controller sent."""
CRC_SEQUENCE: Final = 0x08
"""Byte 3: place of the error in the frame."""
_CLASSES: Final = {TX_TIMEOUT: "transmit time-out", ARBITRATION_LOST: "arbitration lost", 0x010: "transceiver error",
                   NO_ACKNOWLEDGE: "no acknowledge", RESTARTED: "controller restarted"}
_OVERFLOWS: Final = {0x01: "receive overflow", 0x02: "transmit overflow"}
_VIOLATIONS: Final = {0x01: "bit error", 0x02: "form error", 0x04: "stuff error", 0x08: "bit error, 0 not sent",
                      0x10: "bit error, 1 not sent", 0x20: "overload"}
_PLACES: Final = {0x03: "start of frame", CRC_SEQUENCE: "CRC", 0x18: "CRC delimiter", 0x19: "acknowledge slot",
                  0x1B: "acknowledge delimiter", 0x1A: "end of frame", 0x12: "intermission", 0x0A: "data",
                  0x0B: "data length"}


class ErrorReport(NamedTuple):
    """Content of one error frame: `state` ("" if it reports none), errors in words, counters (None if not reported)."""

    state: str
    errors: tuple[str, ...]
    counters: tuple[int, int] | None

    def __str__(self) -> str:
        words = ", ".join((*((self.state,) if self.state else ()), *self.errors)) or "error"
        if self.counters is None:
            return words
        return f"{words}; transmit error counter {self.counters[0]}, receive error counter {self.counters[1]}"


def decode(can_id: int, data: bytes) -> ErrorReport:
    """Return the content of an error frame: its identifier without the flag of error frames, and its 8 bytes."""
    data = data.ljust(8, b"\0")
    errors = [text for bit, text in _CLASSES.items() if can_id & bit]
    if can_id & CONTROLLER:
        errors += [text for bit, text in _OVERFLOWS.items() if data[1] & bit]
    if can_id & PROTOCOL:
        place = f" in {_PLACES[data[3]]}" if data[3] in _PLACES else ""
        way = " while sending" if data[2] & TRANSMITTING else ""
        violations = [text for bit, text in _VIOLATIONS.items() if data[2] & bit] or ["protocol error"]
        errors += [f"{text}{place}{way}" for text in violations]
    elif can_id & BUS_ERROR and not errors:
        errors.append("bus error")
    known = can_id & COUNTERS or data[6] or data[7]
    return ErrorReport(_state(can_id, data[1]), tuple(errors), (data[6], data[7]) if known else None)


def _state(can_id: int, bits: int) -> str:
    """Return the controller's state as `ip -details link` names it, "" if the frame reports none."""
    if can_id & BUS_OFF:
        return "BUS-OFF"
    if not can_id & (CONTROLLER | RESTARTED):
        return ""
    for mask, name in ((PASSIVE_STATE, "ERROR-PASSIVE"), (WARNING_STATE, "ERROR-WARNING"),
                       (ACTIVE_STATE, "ERROR-ACTIVE")):
        if bits & mask:
            return name
    return "ERROR-ACTIVE" if can_id & RESTARTED else ""
