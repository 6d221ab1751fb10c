"""A CiA 402 drive behind any EDS: profile position, velocity and torque, homing, CSP, CSV and CST, in raw counts.

It has no mechanics: an axis follows its command within its profile's velocity and acceleration. Positions are in
position units, velocities in position units per second, torques in ‰ of the rated torque; objects that the EDS lacks
have the defaults below. `nodes.Drive` has control loops, units and mechanics, and needs the EDS of this project.
"""

import math
from typing import Final

from eds.cia301 import Abort, Emcy, NmtState
from eds.cia402 import STEP, AbortConnection, Control, DriveEvent, Mode, State, Status, Stop, command_of
from eds.datatype import Value
from eds.dictionary import key
from nodes.core.application import Application, ProfileHost

STEP_NS: Final = 1_000_000
"""Time step of a motion: shorter than the SYNC period of most masters."""
VELOCITY: Final = 10_000.0
"""Position units per second where the EDS has no profile or homing velocity, or 0."""
ACCELERATION: Final = 100_000.0
"""Position units per second² where the EDS has no profile acceleration, or 0."""
SETTLING_S: Final = 0.1
"""Time constant with which the speed of an axis follows its torque, in the torque modes."""
HOMING_NS: Final = 100_000_000
"""Duration of a homing run, ns; methods 35 and 37 take the present position at once."""
MODES: Final = frozenset({Mode.NONE, Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY, Mode.PROFILE_TORQUE, Mode.HOMING,
                          Mode.CSP, Mode.CSV, Mode.CST})
CONTROLWORD, MODE = key(0x6040), key(0x6060)
TARGETS: Final = frozenset({key(0x607A), key(0x60FF), key(0x6071)})
"""Targets of position, velocity and torque."""
_NEW_SET_POINT, _IMMEDIATE, _RELATIVE = 1 << 4, 1 << 5, 1 << 6
"""Bits of the controlword in profile position mode (CiA 402-2): new set-point, change set immediately, relative."""
_SPEED_ZERO = _ACKNOWLEDGED = Status.FOLLOWS_COMMAND
_RAMP: Final = int(Stop.QUICK_STOP_RAMP)
"""Quick stop option if the EDS has no 0x605A."""
_HOLDS: Final = int(Stop.SLOW_DOWN_RAMP_HOLD)
"""Least value of 0x605A that stays in QUICK STOP ACTIVE."""
_CYCLIC: Final = (Mode.CSP, Mode.CSV, Mode.CST)
_UNPOWERED: Final = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.FAULT)
"""States in which the statusword does not show "voltage enabled"."""


class GenericDrive(Application):
    """An ideal axis with the CiA 402 state machine; `fault` makes it report an error."""

    def __init__(self) -> None:
        self.state: State | None = None
        self.mode = Mode.NONE
        self.position = self.velocity = 0.0
        self.torque = 0
        self._goal: float | None = None
        """Position that profile position moves to; None while no set-point is in effect."""
        self._next: float | None = None
        self._word = 0
        self._homed_ns: int | None = None
        self._homed = False
        self._limited = False
        self._at_ns = 0
        self._error = 0

    def attach(self, device: ProfileHost) -> None:
        """Listen to controlword and mode."""
        super().attach(device)
        self.watched, self.unstored = TARGETS | {CONTROLWORD, MODE}, TARGETS | {CONTROLWORD}

    def check_write(self, key: int, value: Value) -> int:
        """Refuse a mode that the drive does not have."""
        if key != MODE:
            return 0
        supported = self.number(0x6502)
        known = value in MODES and (not supported or value == 0 or Mode(int(value)).supported_bit & supported)
        return 0 if known else Abort.INVALID_VALUE

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Process a command, a mode, or a set-point."""
        self._advance(now_ns)
        if key == CONTROLWORD:
            self._control(int(value), now_ns)
        elif key == MODE:
            self._select(Mode(int(value)) if value in MODES else self.mode)
        self._show(now_ns)

    def reset(self, now_ns: int) -> None:
        """Initialise: state SWITCH ON DISABLED; the position survives."""
        self.state, self._word, self._error, self._at_ns = None, 0, 0, now_ns
        self._stop_at_once()
        self._select(Mode(self.number(0x6060)) if self.number(0x6060) in MODES else Mode.NONE)
        for _ in range(2):
            self._fire(DriveEvent.INITIALISED)
        self._show(now_ns)

    def nmt_changed(self, state: NmtState, now_ns: int) -> None:
        """React to NMT state STOPPED as to a lost connection: 0x6007 selects the reaction of an enabled drive."""
        if state is NmtState.STOPPED:
            self.communication_lost(Emcy.GENERIC, now_ns)

    def communication_lost(self, reason: Emcy, now_ns: int) -> None:
        """React to a lost connection: fault, disable voltage, quick stop or nothing, as 0x6007 selects."""
        self._advance(now_ns)
        reaction = self.number(0x6007)
        if self.state is State.OPERATION_ENABLED:
            if reaction == AbortConnection.FAULT:
                self.fault(reason, now_ns)
            elif reaction == AbortConnection.DISABLE_VOLTAGE:
                self._fire(DriveEvent.DISABLE_VOLTAGE)
            elif reaction == AbortConnection.QUICK_STOP:
                self._fire(DriveEvent.QUICK_STOP)
        self._show(now_ns)

    def fault(self, code: int, now_ns: int) -> None:
        """Report an error code by EMCY and 0x603F, and go to FAULT; a fault reset ends it."""
        self._error = int(code)
        self.device.emergency(self._error, 0x21)
        self._fire(DriveEvent.FAULT_DETECTED)
        self._fire(DriveEvent.FAULT_REACTION_DONE)
        self._show(now_ns)

    def latch(self, now_ns: int) -> None:
        """Bring the axis and its objects up to date."""
        self._advance(now_ns)
        self._show(now_ns)

    refresh = poll = latch

    def next_ns(self) -> int | None:
        """Return the time of the next step of a motion; None at rest."""
        return self._at_ns + STEP_NS if self._busy else None

    # ---- commands ----

    def _control(self, word: int, now_ns: int) -> None:
        previous, self._word = self._word, word
        event = command_of(word, previous, self.state) if self.state is not None else None
        if event is not None:
            self._fire(event)
        rising = word & ~previous
        if self.state is not State.OPERATION_ENABLED:
            return
        if self.mode is Mode.PROFILE_POSITION and rising & _NEW_SET_POINT:
            self._take_set_point(word)
        elif self.mode is Mode.HOMING and rising & Control.HOMING_START:
            self._homed = False
            at_once = self.number(0x6098) in (35, 37)
            self._homed_ns = now_ns + (0 if at_once else HOMING_NS)
        elif self.mode is Mode.HOMING and not word & Control.HOMING_START and not self._homed:
            self._homed_ns = None

    def _fire(self, event: DriveEvent) -> None:
        row = None if self.state is None and event is not DriveEvent.INITIALISED else STEP.get((self.state, event))
        option = self.number(0x605A, missing=_RAMP)
        if row is None or (row.number == 16 and option < _HOLDS):
            return
        self.state = row.target
        if self.state is State.QUICK_STOP_ACTIVE:
            self._goal = self._next = None
            if option == Stop.DISABLE:
                self._fire(DriveEvent.QUICK_STOP_DONE)
        elif self.state is not State.OPERATION_ENABLED:
            self._stop_at_once()
        if event is DriveEvent.FAULT_RESET and self._error:
            self.device.recover(self._error)
            self._error = 0

    def _select(self, mode: Mode) -> None:
        if mode is not self.mode:
            self._stop_at_once()
        self.mode = mode

    def _take_set_point(self, word: int) -> None:
        start = self._next if self._next is not None else self._goal if self._goal is not None else self.position
        target = self.number(0x607A) + (start if word & _RELATIVE else 0.0)
        if self._goal is None or word & _IMMEDIATE:
            self._goal, self._next = target, None
        elif self._next is None:
            self._next = target

    def _stop_at_once(self) -> None:
        self.velocity, self.torque = 0.0, 0
        self._goal = self._next = self._homed_ns = None

    # ---- motion ----

    @property
    def _busy(self) -> bool:
        """True while the axis moves, or something is still to be reached."""
        waiting = self.state is State.QUICK_STOP_ACTIVE and self.number(0x605A, missing=_RAMP) < _HOLDS
        commanded = self.state is State.OPERATION_ENABLED and self._wanted_velocity() != self.velocity
        homing = self._homed_ns is not None and not self._homed
        return bool(self.velocity) or self._goal is not None or waiting or commanded or homing

    def _advance(self, now_ns: int) -> None:
        """Move the axis up to `now_ns`, in steps of at most `STEP_NS`."""
        while self._busy and self._at_ns < now_ns:
            step_ns = min(STEP_NS, now_ns - self._at_ns)
            self._at_ns += step_ns
            self._move(step_ns * 1e-9)
        self._at_ns = max(self._at_ns, now_ns)
        if self._homed_ns is not None and not self._homed and self._homed_ns <= now_ns:
            self._homed, self.position = True, float(self.number(0x607C))
        if self.mode is Mode.CSP and self._follows:
            self.position = self._within(self.number(0x607A) + self.number(0x60B0))
        if self.state is State.QUICK_STOP_ACTIVE and not self.velocity and self.number(0x605A, missing=_RAMP) < _HOLDS:
            self._fire(DriveEvent.QUICK_STOP_DONE)

    @property
    def _follows(self) -> bool:
        """True if set-points of the mode act: enabled, and not halted."""
        return self.state is State.OPERATION_ENABLED and not self._word & Control.HALT

    def _move(self, step_s: float) -> None:
        wanted = self._wanted_velocity()
        if self.mode is Mode.CSV and self._follows:
            self.velocity = wanted
        elif self.mode in (Mode.CST, Mode.PROFILE_TORQUE) and self._follows:
            self.velocity += (wanted - self.velocity) * min(1.0, step_s / SETTLING_S)
            if abs(wanted - self.velocity) < 0.5:
                self.velocity = wanted
        else:
            rate = self._acceleration(abs(wanted) < abs(self.velocity)) * step_s
            self.velocity += max(-rate, min(rate, wanted - self.velocity))
        before, self.position = self.position, self._within(self.position + self.velocity * step_s)
        if self._limited:
            self.velocity = 0.0
        if self._goal is not None and (self._goal - before) * (self._goal - self.position) <= 0.0:
            self.position, self._goal, self._next = self._goal, self._next, None
            if self._goal is None:
                self.velocity = 0.0

    def _wanted_velocity(self) -> float:
        """Return the velocity that the mode asks for now."""
        if not self._follows:
            return 0.0
        if self.mode is Mode.PROFILE_POSITION and self._goal is not None:
            way = self._goal - self.position  # v² = 2·a·s: the speed from which the axis can still stop at its goal
            braking = math.sqrt(2.0 * self._acceleration(True) * abs(way))
            return math.copysign(min(float(self.number(0x6081)) or VELOCITY, max(braking, 1.0)), way)
        if self.mode in (Mode.PROFILE_VELOCITY, Mode.CSV):
            return float(self.number(0x60FF) + (self.number(0x60B1) if self.mode is Mode.CSV else 0))
        if self.mode in (Mode.CST, Mode.PROFILE_TORQUE):
            return self._torque() * 1e-3 * (float(self.number(0x607F)) or VELOCITY)
        return 0.0

    def _torque(self) -> int:
        return self.number(0x6071) + (self.number(0x60B2) if self.mode is Mode.CST else 0)

    def _acceleration(self, braking: bool) -> float:
        if self.state is State.QUICK_STOP_ACTIVE and self.number(0x6085):
            return float(self.number(0x6085))
        return float((braking and self.number(0x6084)) or self.number(0x6083)) or ACCELERATION

    def _within(self, position: float) -> float:
        low, high = self.number(0x607D, 1), self.number(0x607D, 2)
        bounded = max(low, min(high, position)) if low < high else position
        self._limited = bounded != position
        return bounded

    # ---- objects ----

    def _put(self, index: int, value: float) -> None:
        entry = self.device.objects.entries.get(key(index))
        if entry is not None and entry.data_type.integer:
            self.values[entry.key] = max(entry.data_type.low, min(entry.data_type.high, round(value)))

    def _show(self, now_ns: int) -> None:
        """Write position, velocity, torque, mode, error and statusword into their objects."""
        follows = self._follows and self.mode in (Mode.CST, Mode.PROFILE_TORQUE)
        self.torque = self._torque() if follows else 0
        for value, *indices in (
            (self.position, 0x6062, 0x6063, 0x6064), (self.velocity, 0x606B, 0x606C), (self.torque, 0x6074, 0x6077),
            (self.mode, 0x6061), (self._error, 0x603F), (self._statusword(), 0x6041),
        ):
            for index in indices:
                self._put(index, value)

    def _statusword(self) -> int:
        state = self.state or State.NOT_READY_TO_SWITCH_ON
        word = state.value[1] | Status.REMOTE
        if state not in _UNPOWERED:
            word |= Status.VOLTAGE_ENABLED
        if self._limited:
            word |= Status.INTERNAL_LIMIT
        if self._word & Control.HALT:
            return word | (Status.TARGET_REACHED if not self.velocity else 0)
        if self.mode is Mode.HOMING:
            return word | (Status.HOMING_ATTAINED | Status.TARGET_REACHED if self._homed else 0)
        if self.mode is Mode.PROFILE_POSITION:
            taken = self._word & _NEW_SET_POINT or self._next is not None
            return word | (Status.TARGET_REACHED if self._goal is None else 0) | (_ACKNOWLEDGED if taken else 0)
        if self.mode is Mode.PROFILE_VELOCITY:
            reached = self.velocity == self._wanted_velocity()
            return word | (Status.TARGET_REACHED if reached else 0) | (_SPEED_ZERO if not self.velocity else 0)
        if self.mode in _CYCLIC and self._follows:
            return word | Status.FOLLOWS_COMMAND
        return word
