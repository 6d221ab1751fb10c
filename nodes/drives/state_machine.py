"""The CiA 402 state machine of `eds.cia402.TRANSITIONS`, with the actions of its rows on the axis.

The state changes only in `_take`, by a row of the table; further conditions and actions of a row are in `GUARDS` and
`ACTIONS`, by the row's number.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from eds.cia301 import Emcy
from eds.cia402 import STEP, AbortConnection, DriveEvent, Input, State, Status, Stop, Transition
from eds.dictionary import key
from nodes.core.application import Application
from nodes.drives.axis import Axis

ERROR_CODE, RELEASE, INPUTS = key(0x603F), key(0x2020), key(0x60FD)
HOLD_TIME, MS_NS = 0x2018, 1_000_000
POWERED: Final = (
    State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
_OPTION: Final = MappingProxyType({5: 0x605C, 8: 0x605B})
"""Rows that brake first if their option code is 1: 0x605C disable operation, 0x605B shutdown (CiA 402-2)."""
_HOLDING: Final = (Stop.SLOW_DOWN_RAMP_HOLD, Stop.QUICK_STOP_RAMP_HOLD)
_SLOWLY: Final = (Stop.SLOW_DOWN_RAMP, Stop.SLOW_DOWN_RAMP_HOLD)


class StateMachine(Application):
    """The power drive system's state, its faults and its stops; `begin` and `cease` are the drive function's."""

    axis: Axis

    def __init__(self) -> None:
        self.state: State | None = None
        self.emergency_stopped = False
        self.awaits_release = False
        self.changed = False
        """True after a drive tick that changed a value of event-driven PDOs."""
        self.base = 0
        """Statusword without the bits of mode and motion."""
        self._leaving: Transition | None = None
        self._at_rest: Callable[[int], None] | None = None
        self._errors: list[Emcy] = []
        self.hold_ends_ns: int | None = None
        """Time, ns, at which a holding stop ends by itself after the connection was lost (0x2018); None otherwise."""

    # ---- the drive function: what a mode of operation adds ----

    def begin(self, now_ns: int) -> None:
        """Start the drive function."""

    def cease(self) -> None:
        """End the drive function, or let a stop replace it."""

    def ready(self) -> bool:
        """Return whether row 4 may turn the drive function on: no release outstanding, and its master is alive."""
        return not self.awaits_release and self.device.consumer.all_live()

    def cured(self) -> bool:
        """Return whether no cause of a fault is present."""
        return not self.awaits_release

    def warned(self) -> bool:
        """Return whether the warning bit of the statusword is set."""
        return False

    # ---- rows ----

    def command(self, event: DriveEvent, now_ns: int) -> None:
        """Act on a command of the controlword; "enable operation" goes on from row 3 to row 4 and cancels a pending
        exit."""
        if event is DriveEvent.ENABLE_OPERATION:
            if self._leaving is not None:
                self._leaving = self._at_rest = None
                self.begin(now_ns)
            elif self.state is State.READY_TO_SWITCH_ON:
                self.fire(event, now_ns)
        self.fire(event, now_ns)

    def fire(self, event: DriveEvent, now_ns: int) -> None:
        """Take the row of the table for `event` in this state, if its guard permits; its option code may brake first.
        """
        row = STEP.get((self.state, event))
        if row is None or (row.number in GUARDS and not GUARDS[row.number].holds(self)):
            return
        option = _OPTION.get(row.number)
        if option is None or not self.number(option) or not self.axis.on:
            self._take(row, now_ns)
        elif self._leaving is not row:
            self._leaving = row
            self.brake(Stop.SLOW_DOWN_RAMP, lambda now: self._take(row, now))

    def _take(self, row: Transition, now_ns: int) -> None:
        self.state, self._leaving = row.target, None
        if self.state is not State.QUICK_STOP_ACTIVE:
            self.hold_ends_ns = None
        self.show()
        action = ACTIONS.get(row.number)
        if action is not None:
            action(self, now_ns)

    def show(self) -> None:
        """Update the base of the statusword and the digital inputs."""
        state = self.state or State.NOT_READY_TO_SWITCH_ON
        word = state.value[1] | Status.REMOTE
        if not self.emergency_stopped:
            word |= Status.VOLTAGE_ENABLED
        if self.awaits_release:
            word |= Status.STO_ACTIVE
        if self.warned():
            word |= Status.WARNING
        self.base = int(word)
        self.values[INPUTS] = self._inputs()
        self.changed = True

    def _inputs(self) -> int:
        active = Input.INTERLOCK if self.emergency_stopped else Input(0)
        return int(active | Input.RELEASE_OUTSTANDING if self.awaits_release else active)

    def switch_off(self, now_ns: int) -> None:
        """Switch the torque off at once."""
        self._at_rest = None
        self.cease()
        self.axis.off()

    def brake(self, ramp: int, at_rest: Callable[[int], None]) -> None:
        """Brake by 0x6084 or 0x6085; `at_rest` is called once the axis stands."""
        self.cease()
        self.axis.brake(self.number(0x6084 if ramp in _SLOWLY else 0x6085))
        self._at_rest = at_rest

    def rested(self, now_ns: int) -> None:
        """Process the end of a stop: the axis is at rest."""
        at_rest, self._at_rest = self._at_rest, None
        if at_rest is not None:
            at_rest(now_ns)

    def _start(self, now_ns: int) -> None:
        self._at_rest = None
        self.begin(now_ns)

    def _quick_stop(self, now_ns: int) -> None:
        option = self.number(0x605A)
        if option == Stop.DISABLE:
            self._quick_stopped(now_ns)
        else:
            self.brake(option, self._quick_stopped)

    def _quick_stopped(self, now_ns: int) -> None:
        if self.number(0x605A) in _HOLDING:
            self.axis.hold()
        else:
            self.fire(DriveEvent.QUICK_STOP_DONE, now_ns)

    def end_hold(self, now_ns: int) -> None:
        """End the hold once the time allowed for it after a lost connection is over."""
        if self.hold_ends_ns is not None and now_ns >= self.hold_ends_ns:
            self.hold_ends_ns = None
            self.fire(DriveEvent.QUICK_STOP_DONE, now_ns)

    def _react(self, now_ns: int) -> None:
        option = self.number(0x605E)
        if option == Stop.DISABLE or self.emergency_stopped or not self.axis.on:
            self._reacted(now_ns)
        else:
            self.brake(option, self._reacted)

    def _reacted(self, now_ns: int) -> None:
        self.fire(DriveEvent.FAULT_REACTION_DONE, now_ns)

    def _forget_faults(self, now_ns: int) -> None:
        for code in self._errors:
            self.device.recover(code)
        self._errors.clear()
        self.values[ERROR_CODE] = 0

    # ---- faults ----

    def fault(self, code: Emcy, now_ns: int, announce: bool = True) -> None:
        """Process a fault (row 13); `announce` False: the core has already sent the EMCY."""
        self.values[ERROR_CODE] = int(code)
        if announce:
            self._errors.append(code)
            self.device.emergency(code, code.register)
        self.fire(DriveEvent.FAULT_DETECTED, now_ns)

    def disconnected(self, reason: Emcy, now_ns: int, announce: bool = False) -> None:
        """React to a lost connection as 0x6007 selects."""
        action = self.number(0x6007)
        if self.state not in POWERED:
            return
        if action == AbortConnection.FAULT:
            self.fault(reason, now_ns, announce)
        elif action == AbortConnection.DISABLE_VOLTAGE:
            self.fire(DriveEvent.DISABLE_VOLTAGE, now_ns)
        elif action == AbortConnection.QUICK_STOP:
            self.fire(DriveEvent.QUICK_STOP, now_ns)
        hold_ms = self.number(HOLD_TIME)
        if hold_ms and self.hold_ends_ns is None and self.state is State.QUICK_STOP_ACTIVE:
            self.hold_ends_ns = now_ns + hold_ms * MS_NS

    def emergency_stop(self, active: bool, now_ns: int) -> None:
        """Set the wired emergency-stop input (STO): the torque ends at once, until the operator's release."""
        self.device.now_ns = now_ns
        self.emergency_stopped = active
        if active:
            self.awaits_release = True
            self.values[RELEASE] = 1
            self.switch_off(now_ns)
            if self.state in POWERED:
                self.fault(Emcy.STO, now_ns)
            else:
                self.device.emergency(Emcy.STO, Emcy.STO.register)
                self._reacted(now_ns)
        self.show()

    def release(self, now_ns: int) -> None:
        """Process the operator's release after an emergency stop; 0x2020 is refused while the input is active."""
        self.awaits_release = False
        self.values[RELEASE] = 0
        self.device.recover(Emcy.STO)
        self.show()


class TransitionGuard(NamedTuple):
    """Condition that a transition has beside its event: in words, and as a function of the machine."""

    text: str
    holds: Callable[[StateMachine], bool]


GUARDS: Final[Mapping[int, TransitionGuard]] = MappingProxyType({
    2: TransitionGuard("no emergency stop awaits its release", lambda machine: not machine.awaits_release),
    4: TransitionGuard("no emergency stop awaits its release; who 0x1016 names lives; START has a value (servo)",
                       lambda machine: machine.ready()),
    15: TransitionGuard("no cause is left: emergency stop released, rope below its trip level",
                        lambda machine: machine.cured()),
    16: TransitionGuard("0x605A is 5 or 6", lambda machine: machine.number(0x605A) in _HOLDING and machine.ready()),
})
"""Further conditions of the rows, by row number."""

ACTIONS: Final[Mapping[int, Callable[[StateMachine, int], None]]] = MappingProxyType({
    4: StateMachine._start,
    5: StateMachine.switch_off,
    8: StateMachine.switch_off,
    9: StateMachine.switch_off,
    11: StateMachine._quick_stop,
    12: StateMachine.switch_off,
    13: StateMachine._react,
    14: StateMachine.switch_off,
    15: StateMachine._forget_faults,
    16: StateMachine._start,
})
"""Action on the axis by row number; the other rows change the state only."""
