"""CiA 402: the power drive system's state machine, as one table for master, drives, tests and docs.

`TRANSITIONS` alone holds which state follows which; all behaviour is derived from it.
"""

from collections import deque
from enum import Enum, IntEnum, IntFlag
from types import MappingProxyType
from typing import Final, NamedTuple


class State(Enum):
    """PDS states with the (mask, value) of the statusword that shows each (CiA 402-2, table 29)."""

    NOT_READY_TO_SWITCH_ON = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP_ACTIVE = (0x6F, 0x07)
    FAULT_REACTION_ACTIVE = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)

    @property
    def title(self) -> str:
        """Name of the state as the profile writes it."""
        return self.name.replace("_", " ").capitalize()


class DriveEvent(Enum):
    """Event of the state machine: a command of the controlword, or an event inside the drive."""

    INITIALISED = "initialised"
    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    ENABLE_OPERATION = "enable operation"
    DISABLE_OPERATION = "disable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"
    QUICK_STOP_DONE = "quick stop done, 0x605A 0 to 4"
    FAULT_DETECTED = "fault detected"
    FAULT_REACTION_DONE = "fault reaction done"


class Command(NamedTuple):
    """A command: the controlword shows it if `word & mask == value`; a master sends `word` for it."""

    mask: int
    value: int
    word: int


COMMANDS: Final = MappingProxyType({
    DriveEvent.DISABLE_VOLTAGE: Command(0x82, 0x00, 0x0000),
    DriveEvent.QUICK_STOP: Command(0x86, 0x02, 0x0002),
    DriveEvent.SHUTDOWN: Command(0x87, 0x06, 0x0006),
    DriveEvent.SWITCH_ON: Command(0x8F, 0x07, 0x0007),
    DriveEvent.ENABLE_OPERATION: Command(0x8F, 0x0F, 0x000F),
    DriveEvent.FAULT_RESET: Command(0x80, 0x80, 0x0080),
})
"""Controlword commands (CiA 402-2, table 27). Switch on and disable operation are one word; fault reset acts on
the rising edge of bit 7 only, and while bit 7 is set no other command is seen."""


class Transition(NamedTuple):
    """One row of the state machine, by its number in the profile."""

    number: int
    sources: tuple[State | None, ...]
    events: tuple[DriveEvent, ...]
    target: State
    text: str


_S = State
_E = DriveEvent
TRANSITIONS: Final = (
    Transition(0, (None,), (_E.INITIALISED,), _S.NOT_READY_TO_SWITCH_ON, "power on or reset: self-test"),
    Transition(1, (_S.NOT_READY_TO_SWITCH_ON,), (_E.INITIALISED,), _S.SWITCH_ON_DISABLED, "communication is up"),
    Transition(2, (_S.SWITCH_ON_DISABLED,), (_E.SHUTDOWN,), _S.READY_TO_SWITCH_ON, "none"),
    Transition(3, (_S.READY_TO_SWITCH_ON,), (_E.SWITCH_ON, _E.ENABLE_OPERATION), _S.SWITCHED_ON, "high level power on"),
    Transition(4, (_S.SWITCHED_ON,), (_E.ENABLE_OPERATION,), _S.OPERATION_ENABLED, "drive function on"),
    Transition(5, (_S.OPERATION_ENABLED,), (_E.DISABLE_OPERATION,), _S.SWITCHED_ON, "by 0x605C, drive function off"),
    Transition(6, (_S.SWITCHED_ON,), (_E.SHUTDOWN,), _S.READY_TO_SWITCH_ON, "high level power off"),
    Transition(7, (_S.READY_TO_SWITCH_ON,), (_E.DISABLE_VOLTAGE, _E.QUICK_STOP), _S.SWITCH_ON_DISABLED, "none"),
    Transition(8, (_S.OPERATION_ENABLED,), (_E.SHUTDOWN,), _S.READY_TO_SWITCH_ON, "by 0x605B, power off"),
    Transition(9, (_S.OPERATION_ENABLED,), (_E.DISABLE_VOLTAGE,), _S.SWITCH_ON_DISABLED, "power off at once"),
    Transition(10, (_S.SWITCHED_ON,), (_E.DISABLE_VOLTAGE, _E.QUICK_STOP), _S.SWITCH_ON_DISABLED, "power off"),
    Transition(11, (_S.OPERATION_ENABLED,), (_E.QUICK_STOP,), _S.QUICK_STOP_ACTIVE, "by 0x605A"),
    Transition(12, (_S.QUICK_STOP_ACTIVE,), (_E.DISABLE_VOLTAGE, _E.QUICK_STOP_DONE), _S.SWITCH_ON_DISABLED, "off"),
    Transition(13, tuple(s for s in _S if s not in (_S.FAULT, _S.FAULT_REACTION_ACTIVE)), (_E.FAULT_DETECTED,),
               _S.FAULT_REACTION_ACTIVE, "by 0x605E"),
    Transition(14, (_S.FAULT_REACTION_ACTIVE,), (_E.FAULT_REACTION_DONE,), _S.FAULT, "drive function off, power off"),
    Transition(15, (_S.FAULT,), (_E.FAULT_RESET,), _S.SWITCH_ON_DISABLED, "no fault is present any more"),
    Transition(16, (_S.QUICK_STOP_ACTIVE,), (_E.ENABLE_OPERATION,), _S.OPERATION_ENABLED, "0x605A 5 to 8 only"),
)
"""Transitions of the CiA 402 state machine (CiA 402-2, figure 4 and table 26). `None` is the state before power-on; a
master uses a row's first event.
"""

STEP: Final = MappingProxyType({(s, e): t for t in TRANSITIONS for s in t.sources for e in t.events})
"""(state, event) → the row that it takes; no entry: the event does nothing in that state."""


def command_of(controlword: int, previous: int, state: State) -> DriveEvent | None:
    """Read the command that a controlword gives in a state; `previous` is the word before it, for the reset's edge.

    0x0007 is "switch on" except in OPERATION ENABLED, where it is "disable operation".
    """
    if controlword & 0x80:
        return None if previous & 0x80 else DriveEvent.FAULT_RESET
    for event, command in COMMANDS.items():
        if controlword & command.mask == command.value:
            disable = event is DriveEvent.SWITCH_ON and state is State.OPERATION_ENABLED
            return DriveEvent.DISABLE_OPERATION if disable else event
    return None


def _states_by_word() -> tuple[State | None, ...]:
    def shown(word: int) -> State | None:
        return next((s for s in State if word & s.value[0] == s.value[1]), None)

    return tuple(shown(word) for word in range(128))


_BY_WORD: Final = _states_by_word()


def state_of(statusword: int) -> State | None:
    """Read the state from a statusword (0x6041); None where its bits show no state of the profile."""
    return _BY_WORD[statusword & 0x7F]


_HOLD: Final = MappingProxyType({
    State.SWITCH_ON_DISABLED: 0x0000,
    State.READY_TO_SWITCH_ON: 0x0006,
    State.SWITCHED_ON: 0x0007,
    State.OPERATION_ENABLED: 0x000F,
    State.QUICK_STOP_ACTIVE: 0x0002,
})


def _word(event: DriveEvent) -> int | None:
    command = COMMANDS.get(DriveEvent.SWITCH_ON if event is DriveEvent.DISABLE_OPERATION else event)
    return None if command is None else command.word


def _routes(goal: State) -> dict[State, int]:
    """First controlword of the shortest way to `goal` by commands, for each state (16 left out: it is optional)."""
    words, queue = {goal: _HOLD[goal]}, deque([goal])
    while queue:
        target = queue.popleft()
        for row in TRANSITIONS:
            word = _word(row.events[0])
            if row.target is not target or word is None or row.number == 16:
                continue
            for source in row.sources:
                if source is not None and source not in words:
                    words[source] = word
                    queue.append(source)
    return words


_NEXT: Final = MappingProxyType({goal: MappingProxyType(_routes(goal)) for goal in _HOLD})


def next_controlword(state: State, goal: State) -> int:
    """Return the controlword that moves a drive from `state` one row nearer to `goal`, or holds it there.

    In a state that the drive ends without a command (NOT READY, FAULT REACTION ACTIVE), or without a way to the goal,
    it is 0x0000. Out of FAULT it is 0x0080: send 0x0000 before it, for the drive acts on the edge. `goal` is a state
    that can be commanded: SWITCH ON DISABLED … OPERATION ENABLED, QUICK STOP ACTIVE (KeyError otherwise).
    """
    return _NEXT[goal].get(state, 0x0000)


class Control(IntFlag):
    """Bits of the controlword 0x6040; bits 4 to 6 and 9 belong to the mode."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    QUICK_STOP = 1 << 2
    """Quick stop, active low: 0 requests it."""
    ENABLE_OPERATION = 1 << 3
    HOMING_START = 1 << 4
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Status(IntFlag):
    """Bits of the statusword 0x6041; bits 12 and 13 belong to the mode."""

    READY_TO_SWITCH_ON = 1 << 0
    SWITCHED_ON = 1 << 1
    OPERATION_ENABLED = 1 << 2
    FAULT = 1 << 3
    VOLTAGE_ENABLED = 1 << 4
    QUICK_STOP = 1 << 5
    SWITCH_ON_DISABLED = 1 << 6
    WARNING = 1 << 7
    STO_ACTIVE = 1 << 8
    """Manufacturer's bit: the emergency-stop input is active, or the operator's release is outstanding."""
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    FOLLOWS_COMMAND = 1 << 12
    """Statusword bit 12 in CSP, CSV and CST: the drive follows the command value."""
    HOMING_ATTAINED = 1 << 12
    FOLLOWING_ERROR = 1 << 13
    """Statusword bit 13 in CSP: following error."""
    HOMING_ERROR = 1 << 13


_SHOWN: Final = (Status.WARNING, Status.REMOTE, Status.TARGET_REACHED, Status.INTERNAL_LIMIT)
"""Bits of the statusword with one meaning in every mode, beside those of the state."""


def statusword_text(word: int) -> str:
    """Return a statusword in words: the state, and the bits whose meaning does not depend on the mode."""
    state = state_of(word)
    bits = [bit.name.lower().replace("_", " ") for bit in _SHOWN if word & bit and bit.name]
    return ", ".join(["no state of CiA 402" if state is None else state.title, *bits])


def controlword_text(word: int) -> str:
    """Return the command of a controlword in words."""
    event = DriveEvent.FAULT_RESET if word & Control.FAULT_RESET else next(
        (event for event, command in COMMANDS.items() if word & command.mask == command.value), None)
    return ("no command" if event is None else event.value) + (", halt" if word & Control.HALT else "")


class Mode(IntEnum):
    """Modes of operation, 0x6060 and 0x6061."""

    NONE = 0
    PROFILE_POSITION = 1
    VELOCITY = 2
    PROFILE_VELOCITY = 3
    PROFILE_TORQUE = 4
    HOMING = 6
    INTERPOLATED_POSITION = 7
    CSP = 8
    CSV = 9
    CST = 10

    @property
    def supported_bit(self) -> int:
        """Bit of this mode in 0x6502, supported drive modes."""
        return 1 << (self - 1) if self else 0


class HomingMethod(IntEnum):
    """Values of 0x6098 in use here; negative ones are the manufacturer's."""

    PRELOAD_TENSION = -1
    """Homing by preload: wind in slowly until START's tension holds 0x2010; that position is home."""
    CURRENT_POSITION_35 = 35
    CURRENT_POSITION_37 = 37


class Stop(IntEnum):
    """Values of 0x605A (quick stop) that the drives here support; 0x605B to 0x605E support the first three."""

    DISABLE = 0
    SLOW_DOWN_RAMP = 1
    QUICK_STOP_RAMP = 2
    SLOW_DOWN_RAMP_HOLD = 5
    QUICK_STOP_RAMP_HOLD = 6


class AbortConnection(IntEnum):
    """Values of 0x6007: the drive's reaction to a lost connection."""

    NO_ACTION = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


class Input(IntFlag):
    """Bits of the digital inputs 0x60FD."""

    NEGATIVE_LIMIT = 1 << 0
    POSITIVE_LIMIT = 1 << 1
    HOME = 1 << 2
    INTERLOCK = 1 << 3
    """The emergency-stop input (STO) is active."""
    RELEASE_OUTSTANDING = 1 << 16
    """STO was active; 0x2020 awaits the operator's release."""


def mode_text(number: int) -> str:
    """Return a mode of operation in words."""
    return next((one.name.replace("_", " ").lower() if len(one.name) > 3 else one.name for one in Mode
                 if one == number), f"mode {number}")


WORDS: Final = MappingProxyType({
    0x6040: controlword_text, 0x6041: statusword_text, 0x6060: mode_text, 0x6061: mode_text,
})
"""Objects of CiA 402 whose values are words, by index of the first axis; further axes are 0x800 apart."""


def text_of(index: int, value: object) -> str:
    """Return the words for a value of controlword, statusword or mode, of any axis; empty for other objects."""
    words = WORDS.get(0x6000 + (index - 0x6000) % 0x800) if 0x6000 <= index < 0xA000 else None
    return "" if words is None or not isinstance(value, int) else words(value)
