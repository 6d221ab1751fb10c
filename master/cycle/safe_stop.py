"""The safe stop: the reaction of `safety`'s table, carried out to its end.

The drives end disabled whatever happens on the way, nothing here holds a taut rope or winds it in, and a failure
during the stop makes it shorter, never longer. The tension during unwinding is the greatest of START, END and the
estimate from the servo's force. A faulty sensor therefore cannot keep the rope taut, or pull it.
"""

import math

from eds.cia402 import State, state_of
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import END, SERVO, START, Inputs
from master.cycle.safety import Reaction, StopError, reaction_to
from master.cycle.shared_exchange import Answer, Running, Work, together
from master.network.bringup import BringUpError, leave
from master.network.link import LinkError

_START_BIT = 1 << START
_SERVO_BIT = 1 << SERVO
_END_BIT = 1 << END
DISABLE_NS, SLACK_NS = 120_000_000, 100_000_000
"""Longest waits for disabled drives, and before for a slack rope and a leg at rest, ns: the sum is below 250 ms."""
GRACE_NS = 50_000_000
"""Time after which `let_go` repeats its controlwords, ns: on a bus that fails the first ones may be lost."""
SLACK_N = 5.0
AT_REST_RAD_S = 0.2
"""Speed of a held knee from which on it is let go, rad/s: a leg coasts by less than 1 degree from there."""
RISE, RISE_N = 1.03, 0.5
"""Allowed rise of a reading above the greatest one at the stop's beginning: noise, and less than 5 %."""
PROGRESS = 0.95
"""Largest share of the tension that may remain after each span of `Limits.progress_ms` of unwinding."""


def safe_stop(exchange: Running, stop: StopError) -> None:
    """React to `stop` by the table; at the end drives are disabled, SYNC stopped, the nodes PRE-OPERATIONAL.

    Every force path reacts, whichever one the stop names.
    """
    # a finding during the stop would replace the first cause and begin the stop anew
    for guard in exchange.guards:
        guard.active = False
    exchange.log.quiet = True
    reaction = reaction_to(stop, exchange.wire.paths)
    exchange.log.event(exchange.link.clock(), "safety", "master", f"{stop}: {reaction.value}.")
    try:
        # a knee that is named is let go: its brake and its hold would use the feedback that may have failed (decision
        # 43)
        free = {path.path.knee for path in exchange.paths if reaction is Reaction.RELEASE_BOTH
                and stop.node_id in path.path}
        # torque off needs no signal, so it is also what follows where unwinding cannot be done
        if reaction is not Reaction.UNWIND or not _unwind(exchange):
            for path in exchange.paths:
                drives.release(path, knee_too=path.path.knee in free)
        together(exchange, [_settling(path, path.path.knee not in free) for path in exchange.paths])
        _finish(exchange)
    except (StopError, BringUpError, LinkError) as error:
        exchange.log.event(exchange.link.clock(), "safety", "master", f"the stop was cut short: {error}.")
        # the cycle itself has failed: single frames let the drives go, else their own watchdogs do (0x6007)
        let_go(exchange)


def _greatest(exchange: Exchange, inputs: Inputs) -> float:
    """Return the rope's tension, N, the greatest of all signals present."""
    # the greatest of all: a sensor that reads too low cannot end the unwinding while another one shows tension
    start = 0.0 if inputs.missing & _START_BIT else inputs.start_n
    end = 0.0 if inputs.missing & _END_BIT or math.isnan(inputs.end_n) else inputs.end_n
    hidden = 0.0 if inputs.missing & (_SERVO_BIT | _START_BIT) else exchange.plausibility.hidden_n()
    return max(start + hidden, end)


def _unwind(exchange: Running) -> bool:
    """Unwind every rope until no signal shows tension, then quick stop; return False if that cannot be done."""
    if not all(together(exchange, [_unwinding(path) for path in exchange.paths])):
        return False
    for path in exchange.paths:
        drives.quick_stop(path)
    return True


def _unwinding(exchange: Exchange) -> Work[bool]:
    """Unwind one rope until no signal shows tension; return False if that cannot be done."""
    limits, inputs = exchange.guard.limits, exchange.inputs
    servo, knee = exchange.targets
    # from the rope's own place if the target is ahead of it: nothing in a stop winds in
    servo = min(servo, inputs.servo_position_m)
    step = limits.unwind_m_s * exchange.wire.period_ns * 1e-9
    began, late = inputs.sync_ns, 0
    first = last = _greatest(exchange, inputs)
    judged = began + round(limits.progress_ms * 1e6)
    while (tension := _greatest(exchange, inputs)) >= limits.unwound_n or inputs.missing & _START_BIT:
        late = late + 1 if inputs.missing & (_START_BIT | _SERVO_BIT) else 0
        enabled = state_of(inputs.servo_status) is State.OPERATION_ENABLED
        if inputs.sync_ns - began >= limits.unwind_s * 1e9 or late >= limits.stale_cycles or not enabled:
            return _not_unwound(exchange, "the servo cannot unwind")
        # a tension that rises while rope is paid out contradicts servo or sensor: neither is used any further
        if tension > RISE * first + RISE_N:
            return _not_unwound(exchange, f"tension rose from {first:.1f} to {tension:.1f} N while unwinding")
        if inputs.sync_ns >= judged:
            if tension > PROGRESS * last:
                return _not_unwound(exchange, f"tension stays at {tension:.1f} N while unwinding")
            judged, last = judged + round(limits.progress_ms * 1e6), tension
        servo -= step
        yield Answer(servo, knee)
        inputs = exchange.inputs
        exchange.plausibility.follow(exchange.targets, inputs)
    return True


def _not_unwound(exchange: Exchange, why: str) -> bool:
    exchange.log.event(exchange.link.clock(), "safety", "master", f"{why}: torque off.")
    return False


def _settling(exchange: Exchange, held: bool) -> Work[None]:
    """Wait until the servo is off, the rope slack and a `held` knee at rest: let go in mid-swing, it would coast on.

    A stage that does not let go needs the operator's hand.
    """
    inputs, knee = exchange.inputs, math.nan
    deadline, still = inputs.sync_ns + SLACK_NS, AT_REST_RAD_S * exchange.wire.period_ns * 1e-9
    while (taut := inputs.start_n >= SLACK_N or inputs.end_n >= SLACK_N) or _powered(inputs) or (
            held and exchange.knee_driven and not abs(inputs.knee_angle_rad - knee) < still):
        if inputs.sync_ns >= deadline:
            if taut:
                exchange.log.event(exchange.link.clock(), "safety", "master",
                                   f"{_readings(inputs)} with the servo's torque off: press the emergency stop (STO).")
            return
        knee = inputs.knee_angle_rad
        yield Answer(*exchange.targets)
        inputs = exchange.inputs


def _powered(inputs: Inputs) -> bool:
    """Return whether the servo reports torque; it ends a quick stop by itself (0x605A = 2)."""
    return not inputs.missing & _SERVO_BIT and state_of(inputs.servo_status) in (
        State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)


def _readings(inputs: Inputs) -> str:
    end = "" if math.isnan(inputs.end_n) else f" and END {inputs.end_n:.1f} N"
    return f"START says {inputs.start_n:.1f} N{end}"


def _finish(exchange: Running) -> None:
    drives.disable(exchange, DISABLE_NS)
    exchange.end()
    exchange.link.sync_stop()
    leave(exchange.link)


def let_go(exchange: Running) -> None:
    """Disable the voltage by event-driven controlwords, without control cycles, as long as the bus accepts them."""
    link = exchange.link
    link.pump = link.receive
    try:
        _voltage_off(exchange)
        link.wait(GRACE_NS)
        _voltage_off(exchange)
        leave(link)
        link.sync_stop()
    except (LinkError, OSError):
        return


def _voltage_off(exchange: Running) -> None:
    for path in exchange.paths:
        path.command(0x0000, 0x0000)
