"""A CiA 402 drive behind a CANopen device: its objects and their rules, its latch, its drive tick.

This module joins the device core to the state machine and the modes; it decides nothing itself.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from eds.cia301 import Abort, Emcy, NmtState
from eds.cia402 import DriveEvent, Mode, State, Stop
from eds.datatype import Value
from eds.dictionary import key
from nodes.core.application import ProfileHost
from nodes.drives import axis_law as law
from nodes.drives.axis import Axis
from nodes.drives.modes import MODE_DISPLAY, TARGET_POSITION, ModesOfOperation, Phase
from nodes.drives.state_machine import ERROR_CODE, RELEASE

CONTROLWORD, STATUSWORD, MODE = key(0x6040), key(0x6041), key(0x6060)
TARGET_VELOCITY, TARGET_TORQUE = key(0x60FF), key(0x6071)
POSITION_OFFSET, VELOCITY_OFFSET, TORQUE_OFFSET = key(0x60B0), key(0x60B1), key(0x60B2)
POSITION, VELOCITY, TORQUE, INCREMENTS = key(0x6064), key(0x606C), key(0x6077), key(0x6063)
POSITION_DEMAND, VELOCITY_DEMAND, TORQUE_DEMAND = key(0x6062), key(0x606B), key(0x6074)
CURRENT, FOLLOWING, EFFORT = key(0x6078), key(0x60F4), key(0x60FA)
_FIRST_PROFILE_KEY: Final = key(0x2000)
FAULTS: Final = MappingProxyType({
    law.LOST_TRACK: Emcy.FOLLOWING_ERROR, law.DISAGREE: Emcy.POSITION_SENSOR, law.RUNAWAY: Emcy.COMMUTATION})
"""Events of a drive tick that are faults, each with its error code."""
RELEASE_SIGNATURE: Final = 0x736C6572
"""Signature "rels", written to 0x2020: the operator's release."""

_MODES: Final = frozenset(int(mode) for mode in Mode)
_STOPS: Final = frozenset(int(stop) for stop in Stop)
_POLARITY: Final = 0xC0
"""Bits of 0x607E in use: position and velocity, which here are turned together."""


class Drive(ModesOfOperation):
    """A drive axis; frames command it, `tick` runs its loops, `emergency_stop` is its wired input (STO).

    The encoder is absolute: home survives an NMT reset. The actual torque is the demand, for the current loop does not
    report back.
    """

    def attach(self, device: ProfileHost) -> None:
        """Read the units; listen to every writable object of the profile."""
        super().attach(device)
        self.axis = Axis(device.objects.dictionary)
        entries = device.objects.entries
        self.watched = frozenset(k for k, e in entries.items() if k >= _FIRST_PROFILE_KEY and e.writable)
        self.unstored = frozenset({CONTROLWORD, RELEASE, TARGET_POSITION, TARGET_VELOCITY, TARGET_TORQUE})
        self._writers: dict[int, Callable[[int, int], None]] = {
            CONTROLWORD: self.control, MODE: self.select, RELEASE: lambda _value, now: self.release(now),
            TARGET_POSITION: self.to_position, POSITION_OFFSET: self.to_position,
            TARGET_VELOCITY: self.to_velocity, TARGET_TORQUE: self.to_torque,
            VELOCITY_OFFSET: lambda value, _now: self.axis.offset_velocity(value),
            TORQUE_OFFSET: lambda value, _now: self.axis.offset_torque(value),
        }

    def check_write(self, key: int, value: Value) -> int:
        """Return the abort code of the object's own rule, 0 for an accepted value."""
        rule = RULES.get(key)
        return rule(self, int(value)) if rule is not None else 0

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Process a written command or set-point; every other object is a setting."""
        writer = self._writers.get(key)
        if writer is None:
            self.configure()
            return
        writer(int(value), now_ns)
        self.poll(now_ns)

    def latch(self, now_ns: int) -> None:
        """Copy position, velocity, torque, errors and statusword into the objects."""
        law.counts(self.axis.s, self.axis.g, self.axis.out)
        self.show_latched()

    refresh = latch

    def show_latched(self) -> None:
        """Copy position, velocity and torque in counts into their objects."""
        values = self.values
        (values[POSITION], values[VELOCITY], torque, values[POSITION_DEMAND], values[VELOCITY_DEMAND],
         values[FOLLOWING], values[EFFORT], values[INCREMENTS], flags) = self.axis.out.tolist()
        values[TORQUE] = values[TORQUE_DEMAND] = values[CURRENT] = torque
        values[STATUSWORD] = self.base | self.mode_bits(flags)

    def reset(self, now_ns: int) -> None:
        """Reset (row 0): only the home position and a wired emergency stop are kept."""
        self.switch_off(now_ns)
        self._errors.clear()
        if self.phase is not Phase.ATTAINED:
            self.phase = Phase.IDLE
        self._word, self.state = 0, None
        self.values[ERROR_CODE], self.values[RELEASE] = 0, int(self.awaits_release)
        mode = self.number(0x6060)
        self.mode, self.values[MODE_DISPLAY] = Mode(mode), mode
        self.configure()
        self.fire(DriveEvent.INITIALISED, now_ns)

    def nmt_changed(self, state: NmtState, now_ns: int) -> None:
        """React to an NMT state: initialised in PRE-OPERATIONAL (row 1), stopped as 0x6007 selects on leaving
        OPERATIONAL.
        """
        before, self._nmt = self._nmt, state
        left = before is NmtState.OPERATIONAL and self.axis.on
        if left or state in (NmtState.STOPPED, NmtState.INITIALISING):
            self.disconnected(Emcy.GENERIC, now_ns, announce=True)
        elif state is NmtState.PRE_OPERATIONAL and self.state is State.NOT_READY_TO_SWITCH_ON:
            self.fire(DriveEvent.INITIALISED, now_ns)
            if self.emergency_stopped:
                self.emergency_stop(True, now_ns)

    _nmt = NmtState.INITIALISING

    def communication_lost(self, reason: Emcy, now_ns: int) -> None:
        """React to a lost heartbeat, RPDO or bus as 0x6007 selects."""
        self.disconnected(reason, now_ns)

    def poll(self, now_ns: int) -> None:
        """Latch the changes of a drive tick; end a hold whose time is over."""
        if self.hold_ends_ns is not None:
            self.end_hold(now_ns)
        if self.changed:
            self.changed = False
            self.latch(now_ns)

    def next_ns(self) -> int | None:
        """Return the time of the next action: at once after a tick that changed something, else the end of a hold."""
        return self.device.now_ns if self.changed else self.hold_ends_ns

    def tick(self, now_ns: int, position: float, velocity: float) -> float:
        """Return the torque demand, N·m at the output, for position and velocity in SI at the axis; 0 when off."""
        axis = self.axis
        torque: float = law.step(axis.s, axis.g, now_ns, position, velocity)
        return self._notice(now_ns) if axis.state[law.EVENTS] else torque

    # ---- what a steady cycle needs ----

    steady_sources = MappingProxyType({
        POSITION: 0, VELOCITY: 1, TORQUE: 2, TORQUE_DEMAND: 2, CURRENT: 2, POSITION_DEMAND: 3, VELOCITY_DEMAND: 4,
        FOLLOWING: 5, EFFORT: 6, INCREMENTS: 7, STATUSWORD: 8})
    """Objects that a TPDO may carry, each with its place among `law.counts`; in that of the flags, the statusword."""

    @property
    def steady(self) -> bool:
        """True if a tick changes process values only."""
        return not self.changed and self.hold_ends_ns is None and not self.axis.state[law.EVENTS]

    def steady_words(self) -> list[int]:
        """Return the statusword for each of the axis' flags (`law.IS_…`, 0 … 15), as the state machine is now."""
        return [self.base | self.mode_bits(flags) for flags in range(16)]

    def _notice(self, now_ns: int) -> float:
        """Process the events of a tick; return the torque after them."""
        state = self.axis.state
        events, state[law.EVENTS] = int(state[law.EVENTS]), 0.0
        self.device.now_ns = now_ns
        for event, code in FAULTS.items():
            if events & event:
                self.fault(code, now_ns)
        if events & law.STOPPED:
            self.rested(now_ns)
        if events & law.TIGHT:
            self.homed(now_ns)
        if events & law.NOT_TIGHT:
            self.not_homed(now_ns)
        self.changed = True
        return float(state[law.TORQUE])


class KneeDrive(Drive):
    """The drive that moves the knee; angles in rad of the knee (flexion negative), torques in N·m at the knee.

    Its 1:20 reducer is in the objects 0x6091 and 0x6092, in thousandths of a degree of the knee, not in code.
    """


def _mode(drive: Drive, value: int) -> int:
    supported = drive.number(0x6502)
    known = value in _MODES and (value == Mode.NONE or supported & Mode(value).supported_bit)
    return 0 if known else Abort.INVALID_VALUE


def _method(drive: Drive, value: int) -> int:
    listed = {drive.number(0x60E3, sub) for sub in range(1, drive.number(0x60E3) + 1)}
    if value not in listed:
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.seeking else 0


def _polarity(drive: Drive, value: int) -> int:
    if value not in (0, _POLARITY):
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.state is State.OPERATION_ENABLED else 0


def _release(drive: Drive, value: int) -> int:
    if value != RELEASE_SIGNATURE:
        return Abort.INVALID_VALUE
    return Abort.DEVICE_STATE if drive.emergency_stopped else 0


RULES: Final[Mapping[int, Callable[[Drive, int], int]]] = MappingProxyType({
    key(0x2020): _release,
    key(0x605A): lambda _drive, value: 0 if value in _STOPS else Abort.INVALID_VALUE,
    key(0x6060): _mode,
    key(0x607D, 1): lambda drive, value: Abort.MAX_BELOW_MIN if value > drive.number(0x607D, 2) else 0,
    key(0x607D, 2): lambda drive, value: Abort.MAX_BELOW_MIN if value < drive.number(0x607D, 1) else 0,
    key(0x607E): _polarity,
    key(0x6098): _method,
})
"""Rules of objects beyond their limits in the EDS, by key: (drive, value) → 0 or an SDO abort code."""
