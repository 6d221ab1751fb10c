"""The two drives' state machines, commanded from inside the running cycle.

The rule of this file: which controlword comes next is read from CiA 402's table; targets follow the actual
positions until a drive is enabled, so that enabling moves nothing.
"""

import struct

from eds.cia402 import Control, HomingMethod, Mode, State, Status, next_controlword, state_of
from eds.dictionary import key
from master.cycle.exchange import Exchange
from master.cycle.inputs import KNEE, SERVO, Inputs
from master.cycle.shared_exchange import Answer, Running, Work, together
from master.network.acknowledge import RELEASE
from master.network.bringup import BringUpError
from master.network.sdo import SdoError

PATIENCE_NS = 2_000_000_000
RESEND_NS = 20_000_000
"""Time after which a controlword without effect is sent again, ns: sent once, by event, it may have been lost."""
_ERROR_CODE, _MODE, _MODE_SHOWN, _HOME_OFFSET, _HOMING_METHOD = 0x603F, 0x6060, 0x6061, 0x607C, 0x6098
_OPERATE = 0x000F


def enable(exchange: Running) -> None:
    """Bring every drive to OPERATION ENABLED at its position; raises `BringUpError` with drive and error code."""
    for path in exchange.paths:
        _drive_to(path, (State.OPERATION_ENABLED, State.OPERATION_ENABLED))
        path.plausibility.restart()
    # only now: until the last path is enabled, a drive that is off is no fault
    for path in exchange.paths:
        path.guard.enabled = (SERVO, KNEE)


def enable_alone(exchange: Exchange, node_id: int) -> Inputs:
    """Bring one drive to OPERATION ENABLED, the other one to SWITCH ON DISABLED."""
    exchange.guard.enabled = ()
    goals = [State.OPERATION_ENABLED if node == node_id else State.SWITCH_ON_DISABLED for node in exchange.path[:2]]
    _drive_to(exchange, (goals[0], goals[1]))
    exchange.plausibility.restart()
    exchange.guard.enabled = (exchange.path.index(node_id),)
    return exchange.inputs


def disable(exchange: Running, patience_ns: int = PATIENCE_NS) -> None:
    """Take every drive to SWITCH ON DISABLED, those of all force paths in the same cycles.

    Raises `BringUpError` where a drive does not follow, after all others have had their patience.
    """
    for guard in exchange.guards:
        guard.enabled = ()
    off = (State.SWITCH_ON_DISABLED, State.SWITCH_ON_DISABLED)
    reached = together(exchange, [_driving(path, off, patience_ns) for path in exchange.paths])
    for path, there in zip(exchange.paths, reached, strict=True):
        if not there:
            raise BringUpError(_not_there(path, path.inputs, off))


def _drive_to(exchange: Exchange, goals: tuple[State, State]) -> None:
    """Take the drives of one path to their goals; raises `BringUpError` where one does not follow."""
    if not together(exchange, [_driving(exchange, goals, PATIENCE_NS)])[0]:
        raise BringUpError(_not_there(exchange, exchange.inputs, goals))


def _driving(exchange: Exchange, goals: tuple[State, State], patience_ns: int) -> Work[bool]:
    """Walk the drives along CiA 402's table, resending a word that has no effect for a while; return whether they
    arrived."""
    inputs = exchange.inputs
    deadline = inputs.sync_ns + patience_ns
    sent, resend_ns = (-1, -1), 0
    while True:
        states = _states(exchange, inputs)
        if states[0] is goals[0] and (states[1] is goals[1] or not exchange.knee_driven):
            return True
        if inputs.sync_ns >= deadline:
            return False
        words = _word(states[0], goals[0], sent[0]), _word(states[1], goals[1], sent[1])
        if words != sent or inputs.sync_ns >= resend_ns:
            exchange.command(*words)
            sent, resend_ns = words, inputs.sync_ns + RESEND_NS
        yield Answer(*_where(exchange, states))
        inputs = exchange.inputs


def _states(exchange: Exchange, inputs: Inputs) -> tuple[State | None, State | None]:
    """Return the CiA 402 states of servo and knee drive; None without a statusword of this SYNC or without a knee
    drive."""
    servo = None if inputs.missing & 1 else state_of(inputs.servo_status)
    return servo, None if inputs.missing & 2 or not exchange.knee_driven else state_of(inputs.knee_status)


def _word(state: State | None, goal: State, sent: int) -> int:
    """Return the next controlword: zero before a fault reset, which acts on an edge; the last one while the state is
    unknown."""
    if state is None:
        return max(sent, 0)
    word = next_controlword(state, goal)
    return 0 if word & Control.FAULT_RESET and (sent == -1 or sent & Control.FAULT_RESET) else word


def _where(exchange: Exchange, states: tuple[State | None, State | None]) -> tuple[float, float]:
    """Return the targets that move nothing: actual positions for drives that are off, the last targets for those that
    hold."""
    inputs, (servo, knee) = exchange.inputs, exchange.targets
    if states[0] is not State.OPERATION_ENABLED and not inputs.missing & 1:
        servo = inputs.servo_position_m
    if exchange.knee_driven and states[1] is not State.OPERATION_ENABLED and not inputs.missing & 2:
        knee = inputs.knee_angle_rad
    return servo, knee


def _not_there(exchange: Exchange, inputs: Inputs, goals: tuple[State, State]) -> str:
    texts, remedies = [], []
    words = (inputs.servo_status, inputs.knee_status)
    for node, word, state, goal in zip(exchange.path[:2], words, _states(exchange, inputs), goals, strict=True):
        if state is goal or node not in exchange.wire.drives:
            continue
        name = exchange.wire.nodes[node].name
        if inputs.missing & 1 << exchange.path.index(node):
            texts.append(f"{name} says nothing, so that its state is not known")
            continue
        texts.append(f"{name} is in {state.title if state else 'no known state'} "
                     f"(0x603F = {_error_code(exchange, node)}), not in {goal.title}")
        if word & Status.STO_ACTIVE and key(RELEASE) in exchange.wire.nodes[node].dictionary.entries:
            remedies.append(f"free {name}'s emergency stop (STO) and say: bowden acknowledge")
    remedy = ", ".join(remedies) or "clear its cause"
    return f"{' and '.join(texts)}; {remedy}, and start again."


def _error_code(exchange: Exchange, node: int) -> str:
    try:
        return f"0x{int.from_bytes(exchange.link.sdo_read(node, _ERROR_CODE), 'little'):04X}"
    except SdoError as error:
        return str(error)


def quick_stop(exchange: Exchange) -> None:
    """Quick stop for the servo (0x605A = 2 by its set-up; CiA 402, transition 11); the knee drive holds its target."""
    exchange.command(0x0002, _OPERATE)


def release(exchange: Exchange, knee_too: bool = False) -> None:
    """Take the servo's torque off at once; the knee drive holds its target, unless its torque is taken, too."""
    # disable voltage (CiA 402, transition 9) needs no feedback, which a ramp would brake by
    exchange.command(0x0000, 0x0000 if knee_too else _OPERATE)


def set_home(exchange: Exchange, position_um: int) -> Inputs:
    """Set the servo's position to `position_um` where it stands, by homing method 37; the rope must be slack.

    Raises `BringUpError` where the drive does not report homing attained.
    """
    link, servo, before_m = exchange.link, exchange.path.servo, exchange.inputs.servo_position_m
    exchange.rehoming = True
    link.sdo_write(servo, _HOME_OFFSET, 0, struct.pack("<i", position_um))
    link.sdo_write(servo, _HOMING_METHOD, 0, struct.pack("<b", HomingMethod.CURRENT_POSITION_37))
    _set_mode(exchange, Mode.HOMING)
    exchange.command(_OPERATE | Control.HOMING_START, _OPERATE)
    deadline = exchange.inputs.sync_ns + PATIENCE_NS
    while not exchange.inputs.servo_status & Status.HOMING_ATTAINED:
        exchange.hold()
        if exchange.inputs.sync_ns >= deadline or exchange.inputs.servo_status & Status.HOMING_ERROR:
            raise BringUpError(f"{exchange.wire.nodes[servo].name} did not attain home "
                          f"(statusword 0x{exchange.inputs.servo_status:04X}).")
    # targets by the new count before positions are followed again: the old ones were a step of the whole shift
    inputs = exchange.hold()
    exchange.advance(inputs.servo_position_m, exchange.targets[1])
    exchange.command(_OPERATE, _OPERATE)
    _set_mode(exchange, Mode.CSP)
    exchange.rehomed(exchange.inputs.servo_position_m - before_m)
    return exchange.inputs


def _set_mode(exchange: Exchange, mode: Mode) -> None:
    link, servo = exchange.link, exchange.path.servo
    link.sdo_write(servo, _MODE, 0, bytes([mode]))
    deadline = exchange.inputs.sync_ns + PATIENCE_NS
    while link.sdo_read(servo, _MODE_SHOWN) != bytes([mode]):
        if exchange.inputs.sync_ns >= deadline:
            raise BringUpError(f"{exchange.wire.nodes[servo].name} does not show mode {mode.name} (0x6061).")
