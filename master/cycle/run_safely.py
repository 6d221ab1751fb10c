"""Whatever is done on a bench is done between a bring-up and a safe end.

The rule of this file: whatever happens, the drives end disabled, SYNC stops, and the outcome says why.
"""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import can

from eds import bus_load
from eds.bench import Network, Wire, wire
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.log import Log, Sink
from master.cycle.safe_stop import let_go, safe_stop
from master.cycle.safety import Condition, StopError
from master.cycle.stop_request import requested
from master.network import bringup
from master.network.link import Link, LinkError
from master.network.sdo import SdoError
from master.settings import Limits

ESTABLISHED, PATIENCE = 20, 400
"""Cycles in a row that show the exchange to run, and after how many it is taken as it is."""


@dataclass(frozen=True)
class Outcome:
    """How it ended: `reason` is None where it completed; counts over every control cycle; the bus's time, s."""

    reason: str | None
    missed_cycles: int
    stale_inputs: int
    duration_s: float


def run_safely(
    link: Link, tap: can.BusABC | None, recorder: Sink | None, network: Network, limits: Limits,
    perform: Callable[[Exchange], None],
) -> Outcome:
    """Bring the bench up, run `perform` inside the cycle, end safely; the recorder hears the bus through `tap`.

    Raises `InputError` for a network that cannot keep its deadline; what happens on the bus ends in the outcome.
    """
    described = wire(network)
    budget_ns = bus_load.refuse(described).deadline_ns - bus_load.frame_bits(0) * bus_load.bit_ns(described)
    log = Log(tap, recorder, described.targets.cob_id)
    with interruption() as interrupted, collector_frozen():
        guard = Guard(link, described, log, limits, network.heartbeat_timeout_ms * 1_000_000, interrupted)
        exchange = Exchange(link, described, log, guard, budget_ns)
        started_ns = link.clock()
        stop = _prepare(exchange, described)
        if stop is None:
            stop = _attempt(exchange, described, perform)
        log.quiet = True
        log.tell_lost(link.clock())
    reason = None if stop is None else str(stop)
    duration_s = (link.clock() - started_ns) * 1e-9
    return Outcome(reason, exchange.missed_cycles, exchange.stale_inputs, duration_s)


def _prepare(exchange: Exchange, described: Wire) -> StopError | None:
    """Bring the nodes up; where that fails no drive was enabled, and the bench of another master is let be."""
    link = exchange.link
    try:
        bringup.bring_up(link, described, exchange.log)
        link.emergencies.clear()
    except bringup.RivalError as error:
        return StopError(Condition.REFUSED, str(error))
    except (bringup.RefusedError, SdoError, StopError) as error:
        with contextlib.suppress(LinkError):
            bringup.leave(link)
        return error if isinstance(error, StopError) else StopError(Condition.REFUSED, str(error))
    except LinkError as error:
        return StopError(Condition.BUS_LOST, str(error))
    return None


def _attempt(exchange: Exchange, described: Wire, perform: Callable[[Exchange], None]) -> StopError | None:
    """Run the cycle with `perform` in it, and stop safely whatever ends it; what the table does not know goes on."""
    try:
        _cycle(exchange, described, perform)
        return None
    except StopError as error:
        stop = error
    except (bringup.RefusedError, SdoError) as error:
        stop = StopError(Condition.REFUSED, str(error))
    except LinkError as error:
        stop = StopError(Condition.BUS_LOST, str(error))
    except BaseException:
        let_go(exchange)
        raise
    safe_stop(exchange, stop)
    return stop


def _cycle(exchange: Exchange, described: Wire, perform: Callable[[Exchange], None]) -> None:
    link = exchange.link
    link.sync_start(described.period_ns)
    exchange.begin()
    _establish(exchange)
    perform(exchange)
    drives.disable(exchange)
    exchange.end()
    link.sync_stop()
    bringup.leave(link)


def _establish(exchange: Exchange) -> None:
    """Hold, drives off, until the cycle has been whole `ESTABLISHED` times in a row; misses count from here on."""
    whole = 0
    for _ in range(PATIENCE):
        missed = exchange.missed_cycles
        exchange.hold()
        whole = whole + 1 if exchange.missed_cycles == missed else 0
        if whole == ESTABLISHED:
            break
    exchange.missed_cycles = exchange.stale_inputs = 0


@contextmanager
def interruption() -> Iterator[Callable[[], bool]]:
    """Ctrl-C as a question asked every few cycles, so that it never tears one; a second one interrupts at once.

    A request by another thread (`stop_request`) counts as the first Ctrl-C, in whatever thread the run is.
    """
    pressed = False
    if threading.current_thread() is not threading.main_thread():
        yield lambda: bool(requested())
        return

    def press(number: int, frame: object) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    before = signal.signal(signal.SIGINT, press)
    try:
        yield lambda: pressed or bool(requested())
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def collector_frozen() -> Iterator[None]:
    """No garbage collection in the cycle: everything made so far is left alone until the end."""
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()
