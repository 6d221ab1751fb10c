"""Waiting in bus time: what `CanBus.virtual_time` puts in place of the clocks and waits of one thread.

The rule of this file: only the thread that entered is concerned, and a wait runs the bus instead of blocking. The
functions of `time`, `threading.Condition.wait` (under `Queue.get` and `Event.wait` too), the waits of asyncio's loops
and `can.Notifier` are replaced while the context is open; names imported from them before (`from time import sleep`)
are not.
"""

from __future__ import annotations

import asyncio
import math
import queue
import selectors
import threading
import time
from collections.abc import Callable, Iterable, Sequence, Sized
from typing import Any, Final

import can
import canopen

from virtual_bus.bus import BowdenBus
from virtual_bus.kernel import NEVER, Kernel

STUCK_READS: Final = 1_000_000
"""Clock readings in a row without a wait after which a loop is taken to be endless."""

_real_wait = threading.Condition.wait
_real_init = canopen.Network.__init__
_real_notifier = can.Notifier
_SELECTORS: Final[dict[Any, Any]] = {
    kind: kind.select for kind in (getattr(selectors, name, None) for name in (
        "EpollSelector", "KqueueSelector", "SelectSelector")) if kind is not None}
"""The waits of asyncio's loops, by kind of selector."""
_CLOCKS: Final = ("time", "monotonic", "perf_counter")
_REAL: Final = {name: getattr(time, name) for name in (*_CLOCKS, *(f"{name}_ns" for name in _CLOCKS), "sleep")}


def waiting_ns(seconds: float) -> int:
    """Return a wait in whole nanoseconds, rounded up: a wait of any length lets time pass, or loops on it never end."""
    return max(0, math.ceil(seconds * 1e9))


class VirtualTime:
    """Context in which Python's clocks and waits are those of a virtual bus's `kernel`; for one bus at a time."""

    current: VirtualTime | None = None

    def __init__(self, kernel: Kernel, channel: str) -> None:
        self.kernel, self._channel = kernel, channel
        self._thread = threading.get_ident()
        self._notifiers: list[TurnNotifier] = []
        self._networks: list[Any] = []
        self._tasks: set[Any] = set()
        self._readings, self._read_at_ns = 0, -1

    # ---- entering and leaving ----

    def __enter__(self) -> None:
        if VirtualTime.current is not None:
            raise RuntimeError("virtual_time() of another bus is in force; leave it first")
        VirtualTime.current = self
        for name in _CLOCKS:
            setattr(time, name, self._clock(_REAL[name], lambda: self.read_ns() / 1e9))
            setattr(time, f"{name}_ns", self._clock(_REAL[f"{name}_ns"], self.read_ns))
        time.sleep = self._sleep  # type: ignore[assignment]
        for module, name in ((queue, "time"), (threading, "_time")):
            setattr(module, name, time.monotonic)
        threading.Condition.wait = _wait  # type: ignore[assignment]
        for kind in _SELECTORS:
            kind.select = _select
        can.Notifier = _notifier  # type: ignore[assignment,misc]
        canopen.Network.__init__ = _init  # type: ignore[assignment,method-assign]

    def __exit__(self, *_exc: object) -> None:
        for name, function in _REAL.items():
            setattr(time, name, function)
        for module, name in ((queue, "time"), (threading, "_time")):
            setattr(module, name, _REAL["monotonic"])
        threading.Condition.wait = _real_wait  # type: ignore[method-assign]
        for kind, select in _SELECTORS.items():
            kind.select = select
        can.Notifier = _real_notifier  # type: ignore[misc]
        canopen.Network.__init__ = _real_init  # type: ignore[method-assign]
        VirtualTime.current = None

    @property
    def mine(self) -> bool:
        """True in the thread that entered virtual time."""
        return threading.get_ident() == self._thread

    # ---- clocks ----

    def read_ns(self) -> int:
        """Return bus time, ns; `RuntimeError` for a loop that reads it and never waits."""
        now_ns = self.kernel.now_ns
        self._readings = self._readings + 1 if now_ns == self._read_at_ns else 0
        self._read_at_ns = now_ns
        if self._readings > STUCK_READS:
            self._readings = 0
            raise RuntimeError(f"the clock was read {STUCK_READS} times at {now_ns} ns and nothing waited; in virtual "
                               "time only waiting lets time pass")
        return now_ns

    def _clock(self, real: Callable[[], Any], virtual: Callable[[], Any]) -> Callable[[], Any]:
        return lambda: virtual() if self.mine else real()

    def _sleep(self, seconds: float) -> None:
        if not self.mine:
            _REAL["sleep"](seconds)
            return
        if seconds < 0:
            raise ValueError("sleep length must be non-negative")
        self.turn(self.kernel.now_ns + waiting_ns(seconds), lambda: False)

    # ---- waiting ----

    def turn(self, until_ns: int, done: Callable[[], bool]) -> None:
        """Run the bus and hand out its messages up to `until_ns` or until `done()`."""
        while not done():
            if not self._hand_out():
                if self.kernel.now_ns >= until_ns:
                    return
                self._advance(until_ns, done)

    def turn_once(self, until_ns: int, done: Callable[[], bool]) -> None:
        """Run the bus up to `until_ns`, to the first message that is handed out, or until `done()`."""
        while not done() and not self._hand_out() and self.kernel.now_ns < until_ns:
            self._advance(until_ns, done)

    def _advance(self, until_ns: int, done: Callable[[], bool]) -> None:
        """Run the bus up to `until_ns`, to the first message that waits, or until `done()`."""
        kernel = self.kernel
        if until_ns == NEVER and kernel.next_ns() == NEVER:
            raise RuntimeError(f"{self._channel}: a wait without time-out can never end, for nothing more will "
                               "happen on the bus")
        over = Over(done, [bus._queue for bus, _ in self._served()])
        kernel.run(until_ns if until_ns != NEVER else kernel.next_ns(), over)

    def _served(self) -> Iterable[tuple[BowdenBus, Sequence[Any]]]:
        """Return the buses somebody listens to, each with its listeners."""
        for notifier in self._notifiers:
            for bus in notifier.buses:
                yield bus, notifier.listeners
        for network in self._networks:
            if network.notifier is None and isinstance(network.bus, BowdenBus):
                yield network.bus, network.listeners

    def _hand_out(self) -> bool:
        """Pass the oldest message to its listeners; return False if no message waits."""
        waiting = [(bus._queue[0].time_ns, place) for place, (bus, _) in enumerate(self._served()) if bus._queue]
        if not waiting:
            return False
        bus, listeners = list(self._served())[min(waiting)[1]]
        message = bus._queue.popleft()
        for listener in list(listeners):
            answer = listener(message)
            if asyncio.iscoroutine(answer):
                task = asyncio.ensure_future(answer, loop=asyncio.get_running_loop())
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        return True


class Over:
    """Buffer that `Kernel.run` reads: true once a wait is over or a message waits for its listeners."""

    def __init__(self, done: Callable[[], bool], queues: Sequence[Sized]) -> None:
        self._done, self._queues = done, queues

    def __len__(self) -> int:
        return any(self._queues) or self._done()


class TurnNotifier:
    """`can.Notifier` in virtual time: messages reach its listeners while the thread waits."""

    exception: Exception | None = None

    def __init__(self, bus: Any, listeners: Sequence[Any], timeout: float = 1.0, loop: Any = None) -> None:
        self.buses = list(bus) if isinstance(bus, list | tuple) else [bus]
        self.bus, self.listeners, self.timeout = bus, list(listeners), timeout
        assert VirtualTime.current is not None
        self._time = VirtualTime.current
        self._time._notifiers.append(self)

    @property
    def stopped(self) -> bool:
        """True once the notifier has stopped passing messages on."""
        return self not in self._time._notifiers

    def stop(self, timeout: float = 5.0) -> None:
        """Pass no more messages on and stop the listeners."""
        if self.stopped:
            return
        self._time._notifiers.remove(self)
        for listener in self.listeners:
            if hasattr(listener, "stop"):
                listener.stop()

    def add_listener(self, listener: Any) -> None:
        """Add a listener."""
        self.listeners.append(listener)

    def remove_listener(self, listener: Any) -> None:
        """Remove a listener."""
        self.listeners.remove(listener)

    def add_bus(self, bus: Any) -> None:
        """Receive from a further bus."""
        self.buses.append(bus)

    def __enter__(self) -> TurnNotifier:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.stop()


def _notifier(bus: Any, *given: Any, **options: Any) -> Any:
    """Make a notifier without a thread for a virtual bus, and python-can's own for any other."""
    current = VirtualTime.current
    first = bus[0] if isinstance(bus, list | tuple) else bus
    if current is None or not current.mine or not isinstance(first, BowdenBus):
        return _real_notifier(bus, *given, **options)
    return TurnNotifier(bus, *given, **options)


def _init(network: Any, *given: Any, **options: Any) -> None:
    """Make a `canopen.Network`, and hand it messages while this thread waits, `connect()` or not."""
    _real_init(network, *given, **options)
    current = VirtualTime.current
    if current is not None and current.mine:
        current._networks.append(network)


def _select(selector: Any, timeout: float | None = None) -> Any:
    """Wait in an asyncio loop as its selector does, but run the bus in place of blocking."""
    current, loop = VirtualTime.current, asyncio._get_running_loop()
    real = next(select for kind, select in _SELECTORS.items() if isinstance(selector, kind))
    if current is None or not current.mine or loop is None or getattr(loop, "_selector", None) is not selector:
        return real(selector, timeout)
    ready = real(selector, 0)
    if not ready and (timeout is None or timeout > 0):
        until_ns = NEVER if timeout is None else current.kernel.now_ns + waiting_ns(timeout)
        current.turn_once(until_ns, lambda: bool(loop._ready))  # type: ignore[attr-defined]
    return ready


def _starts_a_thread(condition: Any) -> bool:
    """Return whether this is the wait of `Thread.start`, which ends in wall time."""
    return any(thread._started._cond is condition for thread in list(threading._limbo))  # type: ignore[attr-defined]


def _wait(condition: Any, timeout: float | None = None) -> bool:
    """Wait for a condition as `threading.Condition.wait` does, but run the bus in place of blocking."""
    current = VirtualTime.current
    if current is None or not current.mine or _starts_a_thread(condition):
        return _real_wait(condition, timeout)
    if not condition._is_owned():
        raise RuntimeError("cannot wait on un-acquired lock")
    waiter = threading.Lock()
    waiter.acquire()
    condition._waiters.append(waiter)
    saved = condition._release_save()
    until_ns = NEVER if timeout is None else current.kernel.now_ns + waiting_ns(timeout)
    try:
        current.turn(until_ns, lambda: not waiter.locked())
    finally:
        condition._acquire_restore(saved)
        if waiter.locked() and waiter in condition._waiters:
            condition._waiters.remove(waiter)
    return not waiter.locked()
