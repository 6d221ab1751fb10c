"""CiA 301: the CAN frame, and the numbers and tables that every node and every master agree on.

The rule of this file: codes and tables only, each with the clause's own name; behaviour is built from
them elsewhere.
"""

from __future__ import annotations

from enum import Enum, IntEnum, IntFlag
from types import MappingProxyType
from typing import Final, NamedTuple


class Frame(NamedTuple):
    """One classical CAN frame, as devices and the wire exchange it; python-can's `Message` is met at buses alone.

    `dlc` is given only if the frame is remote or malformed, so that it differs from `len(data)`.
    """

    can_id: int
    data: bytes = b""
    remote: bool = False
    extended: bool = False
    error: bool = False
    dlc: int | None = None


class NmtState(IntEnum):
    """NMT states, by the byte that a heartbeat carries (CiA 301, 7.2.8.3.2.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT command specifiers, first byte of COB-ID 0 (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


class Service(Enum):
    """Communication objects that the NMT state lets through or holds back."""

    NMT = "NMT"
    ERROR_CONTROL = "heartbeat"
    SYNC = "SYNC"
    EMCY = "EMCY"
    SDO = "SDO"
    PDO = "PDO"
    LSS = "LSS"


_STATES: Final = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL, NmtState.STOPPED)
_TARGETS: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.INITIALISING,
    NmtCommand.RESET_COMMUNICATION: NmtState.INITIALISING,
}

NMT_TRANSITIONS: Final = MappingProxyType({(s, c): t for s in _STATES for c, t in _TARGETS.items()})
"""(state, command) → state (CiA 301, figure 48); INITIALISING passes to PRE-OPERATIONAL without a command, with a
boot-up."""

SERVICES: Final = MappingProxyType({
    NmtState.INITIALISING: frozenset({Service.LSS}),
    NmtState.PRE_OPERATIONAL: frozenset(Service) - {Service.PDO},
    NmtState.OPERATIONAL: frozenset(Service),
    NmtState.STOPPED: frozenset({Service.NMT, Service.ERROR_CONTROL, Service.LSS}),
})
"""Services that a node provides in each state (CiA 301, table 37); LSS in all of them (CiA 305)."""

NMT_COB_ID: Final = 0x000
SYNC_COB_ID: Final = 0x080
EMCY_BASE: Final = 0x080
TPDO_BASE: Final = 0x180
RPDO_BASE: Final = 0x200
SDO_RESPONSE_BASE: Final = 0x580
SDO_REQUEST_BASE: Final = 0x600
HEARTBEAT_BASE: Final = 0x700

COB_ID_INVALID: Final = 1 << 31
"""PDO and EMCY COB-ID entries: the object does not exist."""
COB_ID_NO_RTR: Final = 1 << 30
"""TPDO COB-ID entries: no remote request allowed. In 0x1005 the same bit marks the device as the SYNC producer."""
COB_ID_EXTENDED: Final = 1 << 29

SYNC_MAX: Final = 240
"""Transmission types 1 … 240: with every n-th SYNC."""
EVENT_MANUFACTURER: Final = 254
EVENT_PROFILE: Final = 255

SIGNATURE_SAVE: Final = 0x65766173
"""Signature "save", written to 0x1010."""
SIGNATURE_LOAD: Final = 0x64616F6C
"""Signature "load", written to 0x1011."""
SIGNATURE_ZERO: Final = 0x6F72657A
"""Signature "zero", written to 0x6125 (CiA 404)."""


RESTRICTED: Final = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))
"""Identifiers that no configurable object may take (CiA 301, table 41)."""


def restricted(can_id: int) -> bool:
    """Return whether CiA 301 keeps `can_id` from SYNC, EMCY and PDOs."""
    return any(low <= can_id <= high for low, high in RESTRICTED)


def pdo_type_allowed(transmission_type: int) -> bool:
    """Return whether 0x140x:02 or 0x180x:02 may hold the value here: 0, 1 … 240, 254, 255; no remote-only 252, 253."""
    return 0 <= transmission_type <= SYNC_MAX or transmission_type in (EVENT_MANUFACTURER, EVENT_PROFILE)


class Abort(IntEnum):
    """SDO abort codes (CiA 301, table 22)."""

    text: str

    def __new__(cls, code: int, text: str) -> Abort:
        member = int.__new__(cls, code)
        member._value_ = code
        member.text = text
        return member

    TOGGLE = 0x05030000, "toggle bit not alternated"
    TIMEOUT = 0x05040000, "SDO protocol timed out"
    COMMAND = 0x05040001, "command specifier not valid or unknown"
    BLOCK_SIZE = 0x05040002, "invalid block size"
    SEQUENCE = 0x05040003, "invalid sequence number"
    CRC = 0x05040004, "CRC error"
    MEMORY = 0x05040005, "out of memory"
    ACCESS = 0x06010000, "unsupported access to an object"
    WRITE_ONLY = 0x06010001, "attempt to read a write-only object"
    READ_ONLY = 0x06010002, "attempt to write a read-only object"
    NO_OBJECT = 0x06020000, "object does not exist in the object dictionary"
    NOT_MAPPABLE = 0x06040041, "object cannot be mapped to the PDO"
    PDO_LENGTH = 0x06040042, "number and length of the mapped objects would exceed the PDO length"
    INCOMPATIBLE = 0x06040043, "general parameter incompatibility"
    INTERNAL_INCOMPATIBLE = 0x06040047, "general internal incompatibility in the device"
    HARDWARE = 0x06060000, "access failed due to a hardware error"
    LENGTH = 0x06070010, "data type does not match, length of service parameter does not match"
    TOO_LONG = 0x06070012, "data type does not match, length of service parameter too high"
    TOO_SHORT = 0x06070013, "data type does not match, length of service parameter too low"
    NO_SUBINDEX = 0x06090011, "sub-index does not exist"
    INVALID_VALUE = 0x06090030, "invalid value for parameter"
    TOO_HIGH = 0x06090031, "value of parameter written too high"
    TOO_LOW = 0x06090032, "value of parameter written too low"
    MAX_BELOW_MIN = 0x06090036, "maximum value is less than minimum value"
    NO_RESOURCE = 0x060A0023, "resource not available: SDO connection"
    GENERAL = 0x08000000, "general error"
    NOT_STORED = 0x08000020, "data cannot be transferred or stored to the application"
    LOCAL_CONTROL = 0x08000021, "data cannot be transferred or stored because of local control"
    DEVICE_STATE = 0x08000022, "data cannot be transferred or stored because of the present device state"
    NO_DICTIONARY = 0x08000023, "object dictionary dynamic generation failed or no object dictionary present"
    NO_DATA = 0x08000024, "no data available"


class ErrorRegister(IntFlag):
    """Bits of 0x1001 (CiA 301, table 48)."""

    GENERIC = 1
    CURRENT = 2
    VOLTAGE = 4
    TEMPERATURE = 8
    COMMUNICATION = 16
    PROFILE = 32
    MANUFACTURER = 128


class Emcy(IntEnum):
    """EMCY error codes in use here (CiA 301 table 26, CiA 402-2, CiA 404); 0xFFxx are the manufacturer's."""

    text: str
    register: ErrorRegister

    def __new__(cls, code: int, register: int, text: str) -> Emcy:
        member = int.__new__(cls, code)
        member._value_ = code
        member.register = ErrorRegister(register)
        member.text = text
        return member

    NO_ERROR = 0x0000, 0, "error reset or no error"
    GENERIC = 0x1000, 0x01, "generic error"
    OVERCURRENT = 0x2310, 0x03, "continuous over-current at the device output"
    MAINS_UNDERVOLTAGE = 0x3220, 0x05, "DC link under-voltage"
    OVERTEMPERATURE = 0x4310, 0x09, "excess temperature of the drive"
    SENSOR_BROKEN = 0x5030, 0x21, "sensor fault: broken wire"
    STO = 0x5441, 0x21, "emergency-stop input (STO) active"
    SOFTWARE = 0x6010, 0x01, "software reset (watchdog)"
    DATA_SET = 0x6320, 0x21, "parameter error"
    MOTOR_BLOCKED = 0x7121, 0x21, "motor blocked"
    COMMUTATION = 0x7122, 0x21, "motor error or commutation malfunction"
    POSITION_SENSOR = 0x7305, 0x21, "incremental sensor fault"
    CAN_OVERRUN = 0x8110, 0x11, "CAN overrun, objects lost"
    CAN_PASSIVE = 0x8120, 0x11, "CAN in error-passive mode"
    HEARTBEAT = 0x8130, 0x11, "life guard or heartbeat error"
    BUS_OFF_RECOVERED = 0x8140, 0x11, "recovered from bus-off"
    COB_ID_COLLISION = 0x8150, 0x11, "CAN-ID collision"
    PDO_TOO_SHORT = 0x8210, 0x11, "PDO not processed due to length error"
    PDO_TOO_LONG = 0x8220, 0x11, "PDO length exceeded"
    SYNC_LENGTH = 0x8240, 0x11, "unexpected SYNC data length"
    RPDO_TIMEOUT = 0x8250, 0x11, "RPDO time-out"
    FOLLOWING_ERROR = 0x8611, 0x21, "following error"
    HOMING = 0x8613, 0x21, "homing error"
    POSITION_LIMIT = 0x8612, 0x21, "reference limit: software position limit passed"
    OVER_RANGE = 0xF001, 0x21, "process value outside the sensor's span"
    TENSION_LIMIT = 0xFF01, 0x81, "rope tension above its limit"
    MONITOR_START = 0xFF11, 0x81, "safety monitor: START beyond its bound"
    MONITOR_END = 0xFF12, 0x81, "safety monitor: END beyond its bound"
    MONITOR_FORCE_RATE = 0xFF13, 0x81, "safety monitor: a tension rises faster than its bound"
    MONITOR_ANGLE = 0xFF14, 0x81, "safety monitor: knee angle beyond its bounds, or about to be"
    MONITOR_SPEED = 0xFF15, 0x81, "safety monitor: knee faster than its bound"
    MONITOR_HEARTBEAT = 0xFF16, 0x81, "safety monitor: heartbeat of the master or a drive missing"
    MONITOR_TRIAL_TIME = 0xFF17, 0x81, "safety monitor: trial longer than its bound"
    MONITOR_OWN = 0xFF18, 0x81, "safety monitor: its own steps came late"
    MONITOR_ROPE = 0xFF19, 0x81, "safety monitor: the rope winds in faster than its bound, or is about to"

