"""Frame of every motion on a bench: bring-up, the motion, a safe end.

Whatever happens, the drives end disabled, SYNC stops, and the outcome has the reason.
"""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import can

from eds.bench import bus_load
from eds.bench.bench_network import Network, WireLayout, wire
from eds.declaration import ForcePath
from master.cycle import drives, plausibility, repetition
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.log import CycleSink, Log
from master.cycle.safe_stop import let_go, safe_stop
from master.cycle.safety import Condition, StopError
from master.cycle.shared_exchange import Running, SharedExchange
from master.network import bringup
from master.network.bus_watch import BusWatch
from master.network.drive_limits import drive_limits
from master.network.host_computer import collector_frozen
from master.network.link import Link, LinkError
from master.network.sdo import SdoError
from master.own_limits import counted
from master.settings import Limits
from parameters import InputError

ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
                      if hasattr(signal, name))
"""Operating-system signals that end a run by the safe stop."""
ESTABLISHED, PATIENCE = 20, 400
"""Complete cycles in a row after which the exchange counts as established; largest number of cycles to wait for them.
"""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run: `reason` (None if completed); counts over every control cycle; the bus's time, s.

    `signal` is the number of the signal that requested the end, 0 for none; `condition` the name of the condition
    that stopped it.
    """

    reason: str | None
    missed_cycles: int
    stale_inputs: int
    duration_s: float
    signal: int = 0
    condition: str = ""


def run_safely(
    link: Link, tap: can.BusABC | None, recorder: CycleSink | None, network: Network, limits: Limits,
    perform: Callable[[Any], None],
) -> Outcome:
    """Bring the bench up, run `perform` inside the cycle, end safely; the recorder hears the bus through `tap`.

    `perform` gets the running cycle: an `Exchange`, or on a bench of several force paths a `SharedExchange`. `limits`
    are the bench's; every path is held to those that it has as its own.

    Raises `InputError` for a network that cannot keep its deadline; what happens on the bus ends in the outcome.
    """
    described = wire(network)
    budget_ns = bus_load.refuse(described).deadline_ns - bus_load.frame_bits(0) * bus_load.bit_ns(described)
    log = Log(tap, recorder, described.target_frames[-1].cob_id)
    # compiled here: in a cycle it would take seconds, in which the drives get no targets
    plausibility.prepare()
    repetition.prepare()
    with interruption() as interrupted, collector_frozen():
        def guard(of: WireLayout, path: ForcePath) -> Guard:
            return Guard(link, of, log, counted(limits, network.bench, path),
                         network.heartbeat_timeout_ms * 1_000_000, interrupted,
                         described.nodes.keys() - of.nodes.keys())

        exchange: Running = (Exchange(link, described, log, guard(described, network.bench.force_paths[0]), budget_ns)
                             if len(described.paths) == 1 else SharedExchange(link, described, log, guard, budget_ns))
        started_ns = link.clock()
        stop = _prepare(exchange, described, limits)
        if stop is None:
            stop = _attempt(exchange, described, perform)
        log.quiet = True
        _tell_strangers(link, log)
        log.tell_reception(link.clock())
        link.watch = None
    reason = None if stop is None else str(stop)
    duration_s = (link.clock() - started_ns) * 1e-9
    return Outcome(reason, exchange.missed_cycles, exchange.stale_inputs, duration_s, interrupted(),
                   "" if stop is None else stop.condition.name)


def _prepare(exchange: Running, described: WireLayout, limits: Limits) -> StopError | None:
    """Bring the nodes up. If that fails no drive was enabled; nothing is sent on the bus of another master."""
    link = exchange.link
    try:
        bringup.bring_up(link, described, exchange.log, drive_limits(described, limits))
        link.emergencies.clear()  # raised by resets and new parameters, before anything could move
        link.watch = BusWatch(described, link.returned)
    except bringup.RivalError as error:
        return StopError(Condition.REFUSED, str(error))
    except (bringup.BringUpError, SdoError, StopError) as error:
        with contextlib.suppress(LinkError):
            bringup.leave(link)
        return error if isinstance(error, StopError) else StopError(Condition.REFUSED, str(error))
    except LinkError as error:
        return StopError(Condition.BUS_LOST, str(error))
    return None


def _attempt(exchange: Running, described: WireLayout, perform: Callable[[Any], None]) -> StopError | None:
    """Run the cycle with `perform` in it, and stop safely at its end, also after an error of the program."""
    try:
        _cycle(exchange, described, perform)
        return None
    except StopError as error:
        stop = error
    except InputError:  # a plug-in behind a simulated bus: no bench to stop
        let_go(exchange)
        raise
    except (bringup.BringUpError, SdoError) as error:
        stop = StopError(Condition.REFUSED, str(error))
    except LinkError as error:
        stop = StopError(Condition.BUS_LOST, str(error))
    except Exception as error:
        stop = StopError(Condition.FAILED, _text_of(error))
    except BaseException:  # a second Ctrl-C: there is no time for a stop in cycles
        let_go(exchange)
        raise
    try:
        safe_stop(exchange, stop)
    except Exception as error:
        exchange.log.event(exchange.link.clock(), "safety", "master", f"the stop itself failed ({_text_of(error)}).")
        let_go(exchange)
    return stop


def _text_of(error: Exception) -> str:
    """Return a sentence about an unexpected error: its kind, its text, and where it was raised."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    where = "" if frame is None else f" ({Path(frame.tb_frame.f_code.co_filename).name}, line {frame.tb_lineno})"
    text = " ".join(str(error).split())[:300]
    return f"{type(error).__name__}: {text}{where}" if text else f"{type(error).__name__}{where}"


def _tell_strangers(link: Link, log: Log) -> None:
    """Log the total number of foreign frames and controller errors of each kind that was logged once."""
    log.controller(link.controller)
    for sentence in (*(link.watch.summary() if link.watch is not None else ()), *link.controller.summary()):
        log.event(link.clock(), "bus", "master", f"{sentence}.")


def _cycle(exchange: Running, described: WireLayout, perform: Callable[[Any], None]) -> None:
    link = exchange.link
    link.sync_start(described.period_ns)
    exchange.begin()
    _establish(exchange)
    perform(exchange)
    drives.disable(exchange)  # SYNC goes on until then: with it come the statuswords that show it
    exchange.end()
    link.sync_stop()
    bringup.leave(link)


def _establish(exchange: Running) -> None:
    """Run cycles with the drives off until `ESTABLISHED` cycles in a row were complete; misses count from here on."""
    whole = 0
    for guard in exchange.guards:
        guard.beginning = True
    for _ in range(PATIENCE):
        missed = exchange.missed_cycles
        exchange.hold()
        whole = whole + 1 if exchange.missed_cycles == missed else 0
        if whole == ESTABLISHED:
            break
    for guard in exchange.guards:
        guard.beginning = False
    exchange.forget_misses()


_requested = threading.Event()


@contextmanager
def stop_button() -> Iterator[Callable[[], None]]:
    """Yield a function by which any thread of this process may request the safe stop of the run in this context."""
    _requested.clear()
    try:
        yield _requested.set
    finally:
        _requested.clear()


@contextmanager
def interruption() -> Iterator[Callable[[], int]]:
    """Poll Ctrl-C and similar signals between cycles, so that no cycle is cut short.

    The yielded function returns the number of the first signal of `ENDING`, 0 before any; a second Ctrl-C interrupts
    at once. A request by another thread (`stop_button`) counts as the first Ctrl-C, in whatever thread the run is. A
    signal that this process ignores (nohup) stays ignored.
    """
    asked = 0

    def requested() -> int:
        return asked or (int(signal.SIGINT) if _requested.is_set() else 0)

    if threading.current_thread() is not threading.main_thread():
        yield requested
        return

    def press(number: int, frame: object) -> None:
        nonlocal asked
        if asked and number == signal.SIGINT:
            raise KeyboardInterrupt
        asked = asked or number

    before = {number: signal.getsignal(number) for number in ENDING}
    taken = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    for number in taken:
        signal.signal(number, press)
    try:
        yield requested
    finally:
        for number in taken:
            signal.signal(number, before[number])
