"""Modes of operation: CSP, CSV, CST and homing over one axis; halt; the controlword and its mode's bits.

A set-point reaches the axis only while its mode is open, and a mode opens at a standstill: a target that stood in an
object before the drive was enabled moves nothing.
"""

import math
from enum import Enum
from typing import Final

from eds.cia301 import Emcy
from eds.cia402 import Control, HomingMethod, Mode, State, Status, Stop, command_of
from eds.dictionary import key
from nodes.drives import axis_law as law
from nodes.drives.axis_law import FOLLOWS, KEEPS, RpdoEffect
from nodes.drives.state_machine import StateMachine


class Phase(Enum):
    """Phase of a homing run."""

    IDLE = "not started, or interrupted"
    SEEKING = "in progress"
    ATTAINED = "completed"
    ERROR = "failed"


BITS: Final = {
    (Phase.IDLE, False): Status.TARGET_REACHED,
    (Phase.IDLE, True): Status(0),
    (Phase.SEEKING, False): Status(0),
    (Phase.SEEKING, True): Status(0),
    (Phase.ATTAINED, False): Status.HOMING_ATTAINED | Status.TARGET_REACHED,
    (Phase.ATTAINED, True): Status.HOMING_ATTAINED,
    (Phase.ERROR, False): Status.HOMING_ERROR | Status.TARGET_REACHED,
    (Phase.ERROR, True): Status.HOMING_ERROR,
}
"""(phase, the axis moves) → statusword bits 10, 12, 13 (CiA 402-2, homing mode)."""

AT_ONCE: Final = frozenset({HomingMethod.CURRENT_POSITION_35, HomingMethod.CURRENT_POSITION_37})
"""Methods that take the present position for home, without a motion and in any state."""


MODE_DISPLAY, TARGET_POSITION = key(0x6061), key(0x607A)
_ENABLED: Final = State.OPERATION_ENABLED
_MOVING: Final = (Mode.CSP, Mode.CSV, Mode.CST)
_EDGES: Final = Control.HOMING_START | Control.HALT


class ModesOfOperation(StateMachine):
    """Drive function by mode of operation, while the drive is on."""

    def __init__(self) -> None:
        super().__init__()
        self.mode = Mode.NONE
        self.phase = Phase.IDLE
        self._word = 0
        self._open = Mode.NONE
        """The cyclic mode whose set-points are in effect."""
        self._halted = False
        self._stepped = False
        """True if the last target was refused because its step is too large."""

    @property
    def seeking(self) -> bool:
        """True while homing runs."""
        return self.phase is Phase.SEEKING

    @property
    def _at_will(self) -> bool:
        """True if the drive function is on and neither a stop nor a halt is active."""
        return self.state is _ENABLED and self._at_rest is None and not self._halted

    # ---- the controlword ----

    def control(self, word: int, now_ns: int) -> None:
        """Process 0x6040: the command first, then the bits of the mode."""
        previous, self._word = self._word, word
        event = command_of(word, previous, self.state) if self.state is not None else None
        if event is not None:
            self.command(event, now_ns)
        if (word ^ previous) & _EDGES:
            self._edges(word, word & ~previous, now_ns)
        self.changed = True

    def _edges(self, word: int, rising: int, now_ns: int) -> None:
        if self.state is _ENABLED and self._leaving is None:
            if word & Control.HALT and not self._halted:
                self._halt()
            elif self._halted and not word & Control.HALT:
                self.begin(now_ns)
        if self.mode is not Mode.HOMING:
            return
        if rising & Control.HOMING_START:
            self._home(now_ns)
        elif self.seeking and not word & Control.HOMING_START:
            self.brake(Stop.SLOW_DOWN_RAMP, self._hold)

    def _halt(self) -> None:
        self.brake(self.number(0x605D), self._hold)
        self._halted = True

    def _hold(self, now_ns: int) -> None:
        self.axis.hold()

    # ---- modes ----

    def select(self, value: int, now_ns: int) -> None:
        """Act on 0x6060; a motion of the old mode is braked, the new one begins at rest."""
        if value == self.mode:
            return
        self.mode = Mode(value)
        if self.state is _ENABLED and self._leaving is None and not self._halted:
            self.brake(Stop.SLOW_DOWN_RAMP, self.begin)  # 0x6061 shows the new mode when it opens, at rest
        else:
            self.values[MODE_DISPLAY] = value

    def begin(self, now_ns: int) -> None:
        """Open the mode and show it in 0x6061: hold where the axis is until its first set-point comes."""
        self._halted = False
        self.values[MODE_DISPLAY] = int(self.mode)
        if self._stepped:
            self._stepped = False
            self.device.recover(Emcy.POSITION_LIMIT)
        if self._word & Control.HALT:
            self._halt()
            return
        self._open = self.mode if self.mode in _MOVING else Mode.NONE
        if self._open is Mode.CSV:
            self.axis.speed()
        elif self._open is Mode.CST:
            self.axis.push()
        else:
            self.axis.hold()

    def cease(self) -> None:
        """Close the mode; homing that was under way is interrupted."""
        self._open = Mode.NONE
        self._halted = False
        if self.seeking:
            self.phase = Phase.IDLE

    @property
    def _commanded(self) -> bool:
        """Return whether every master that 0x1016 names is alive: set-points are ignored otherwise."""
        return self.device.consumer.all_live()

    def to_position(self, _value: int, _now_ns: int) -> None:
        """Apply a write to 0x607A, with the offset 0x60B0; a step beyond 0x2017 is refused with EMCY 8612h, the last
        target holds."""
        if self._open is not Mode.CSP or not self._commanded:
            return
        target, limit = self.number(0x607A) + self.number(0x60B0), self.number(0x2017)
        if limit and abs(self.axis.step_to(target)) > limit:
            if not self._stepped:
                self._stepped = True
                self.device.emergency(Emcy.POSITION_LIMIT, Emcy.POSITION_LIMIT.register)
            return
        if self._stepped:
            self._stepped = False
            self.device.recover(Emcy.POSITION_LIMIT)
        self.axis.target_position(target)

    def rpdo_effect(self, at: int) -> RpdoEffect | None:
        """Return the effect of the object `at` of an RPDO on the axis in the present mode; None if an event may follow.
        """
        if at != TARGET_POSITION:
            return None
        if self._open is not Mode.CSP or not self._commanded:
            return RpdoEffect(KEEPS)
        if self._stepped or self.number(0x60B0):
            return None
        return RpdoEffect(FOLLOWS, self.axis.unit, self.axis.origin, self.number(0x2017) or math.inf)

    def to_velocity(self, value: int, _now_ns: int) -> None:
        """Apply a write to 0x60FF, target velocity."""
        if self._open is Mode.CSV and self._commanded:
            self.axis.target_velocity(value)

    def to_torque(self, value: int, _now_ns: int) -> None:
        """Apply a write to 0x6071, target torque."""
        if self._open is Mode.CST and self._commanded:
            self.axis.target_torque(value)

    # ---- homing ----

    def _home(self, now_ns: int) -> None:
        self.device.recover(Emcy.HOMING)
        method = self.number(0x6098)
        if method in AT_ONCE:
            self.homed(now_ns)
        elif method == HomingMethod.PRELOAD_TENSION and self._at_will:
            self.cease()
            self.axis.tighten()
            self.phase = Phase.SEEKING

    def homed(self, now_ns: int) -> None:
        """Complete homing: the present position becomes 0x607C."""
        if self.seeking:
            self.axis.hold()
        self.phase = Phase.ATTAINED
        self.axis.home(self.number(0x607C))
        self.configure()

    def not_homed(self, now_ns: int) -> None:
        """End a failed homing run: the axis stops and holds."""
        self.brake(Stop.SLOW_DOWN_RAMP, self._hold)
        self.phase = Phase.ERROR
        self.device.emergency(Emcy.HOMING, Emcy.HOMING.register)

    def configure(self) -> None:
        """Copy all settings from the objects to the axis."""
        self.axis.configure(self.values)

    # ---- the statusword ----

    def mode_bits(self, flags: int) -> int:
        """Return statusword bits 10 to 13 for the axis' flags."""
        bits = 0
        if self.mode is Mode.HOMING:
            bits = int(BITS[self.phase, bool(flags & law.IS_MOVING)])
        elif self._open is not Mode.NONE:
            if not flags & law.IS_YIELDING:
                bits = int(Status.FOLLOWS_COMMAND)
            if flags & law.IS_OFF_TRACK:
                bits |= Status.FOLLOWING_ERROR
        if flags & law.IS_LIMITED:
            bits |= Status.INTERNAL_LIMIT
        if self._halted and not flags & law.IS_MOVING:
            bits |= Status.TARGET_REACHED
        return bits
