"""The safe stop: what `safety`'s table decided, carried out to its end.

The rule of this file: the drives end disabled whatever happens on the way, nothing here holds a taut rope,
and a failure during the stop makes it shorter, never longer.
"""

from __future__ import annotations

from eds.bench import SERVO, START
from eds.cia402 import State, state_of
from master.cycle import drives
from master.cycle.exchange import ORDER, Exchange
from master.cycle.safety import Reaction, StopError, reaction_to
from master.network.bringup import RefusedError, leave
from master.network.link import LinkError

_START_BIT = 1 << ORDER.index(START)
_SERVO_BIT = 1 << ORDER.index(SERVO)
QUICK_STOP_NS = 500_000_000
GRACE_NS = 100_000_000


def safe_stop(exchange: Exchange, stop: StopError) -> None:
    """React to `stop` by the table and leave the drives disabled, SYNC stopped, the nodes PRE-OPERATIONAL."""
    exchange.guard.active = False
    exchange.log.quiet = True
    reaction = reaction_to(stop)
    exchange.log.event(exchange.link.clock(), "safety", "master", f"{stop}: {reaction.value}.")
    try:
        if reaction is not Reaction.UNWIND or not _unwind(exchange):
            drives.release(exchange)
        _finish(exchange)
    except (StopError, RefusedError, LinkError) as error:
        exchange.log.event(exchange.link.clock(), "safety", "master", f"the stop was cut short: {error}.")
        let_go(exchange)


def _unwind(exchange: Exchange) -> bool:
    """Pay the rope out until START is below its limit, then quick stop; False where that cannot be done."""
    limits, inputs = exchange.guard.limits, exchange.inputs
    servo, knee = exchange.targets
    servo = min(servo, inputs.servo_position_m)
    step = limits.unwind_m_s * exchange.wire.period_ns * 1e-9
    deadline = inputs.sync_ns + round(limits.unwind_s * 1e9)
    late = 0
    while inputs.start_n >= limits.unwound_n or inputs.missing & _START_BIT:
        late = late + 1 if inputs.missing & (_START_BIT | _SERVO_BIT) else 0
        enabled = state_of(inputs.servo_status) is State.OPERATION_ENABLED
        if inputs.sync_ns >= deadline or late >= limits.stale_cycles or not enabled:
            return False
        servo -= step
        inputs = exchange.advance(servo, knee)
    drives.quick_stop(exchange)
    _await_stopped(exchange)
    return True


def _await_stopped(exchange: Exchange) -> None:
    """Wait until the servo has stopped and left OPERATION ENABLED by itself (0x605A = 2)."""
    deadline = exchange.inputs.sync_ns + QUICK_STOP_NS
    while exchange.inputs.sync_ns < deadline:
        if state_of(exchange.hold().servo_status) not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            return


def _finish(exchange: Exchange) -> None:
    drives.disable(exchange)
    exchange.end()
    exchange.link.sync_stop()
    leave(exchange.link)


def let_go(exchange: Exchange) -> None:
    """Without a cycle: voltage off by the event-driven controlwords, as long as the bus takes them."""
    link = exchange.link
    link.pump = link.receive
    try:
        exchange.command(0x0000, 0x0000)
        link.wait(GRACE_NS)
        exchange.command(0x0000, 0x0000)
        leave(link)
        link.sync_stop()
    except (LinkError, OSError):
        return
