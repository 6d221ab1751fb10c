"""The virtual bus as a python-can interface: `can.Bus(interface="bowden", channel=…)`.

The rule of this file: time passes only while somebody waits in `recv`, and then as far as the next
message or the time-out; nothing here reads a clock, sleeps or starts a thread.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NoReturn

import can
from can.typechecking import AutoDetectedConfig, CanFilters

from eds.bench.complete_cycle import CompleteCycle
from eds.cia301 import Frame
from parameters import InputError, extras
from virtual_bus.bench import Bench
from virtual_bus.bus_options import options
from virtual_bus.kernel import NEVER
from virtual_bus.wire.host import BowdenMessage, Room, Socket, frame_of
from virtual_bus.wire.periodic import Modifier, PeriodicTask
from virtual_bus.wire.station import Confinement

if TYPE_CHECKING:
    from virtual_bus.compiled.compiled_cycles import Steady
    from virtual_bus.compiled.cycle_arrays import CycleRequest

STATES: Final = {
    Confinement.ACTIVE: can.BusState.ACTIVE,
    Confinement.PASSIVE: can.BusState.PASSIVE,
    Confinement.BUS_OFF: can.BusState.ERROR,
}


def _built(given: dict[str, Any], channel: str) -> Bench:
    """Return a bench with the packaged devices and a plant; its modules are compiled, and so are imported here."""
    try:
        from virtual_bus.build import build
    except ModuleNotFoundError as error:
        raise extras.refusal(error) from None
    return build(options(given, f"channel {channel}"), channel)


def _steady(bench: Bench) -> Steady | None:
    """Return the compiled cycles of a bench; None if the bench cannot run them."""
    from virtual_bus.compiled.compiled_cycles import Steady, possible

    return Steady(bench) if possible(bench) else None


class OpenBench:
    """A bench and the number of buses that are open on it; the lock permits their use from several threads."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.users = 0
        self.lock = threading.RLock()
        self.turnstile = threading.RLock()
        self.steady = None if bench.machine is None else _steady(bench)

    def settle(self) -> None:
        """Write the arrays' state back to the bench's objects, before any access to them."""
        if self.steady is not None and self.steady.warm:
            with self.lock:
                self.steady.leave()


LONG_S: Final = 0.1  # a wait so long, s, leaves the bus to other threads in between

_OPEN: dict[str, OpenBench] = {}


class SteadyCycles:
    """Complete cycles of one master, equal to a sequence of `send` and `recv` to the nanosecond."""

    def __init__(self, steady: Steady, asked: CycleRequest, lock: threading.RLock) -> None:
        self._steady, self._asked, self._lock = steady, asked, lock

    def run(self, data: bytes, beat_ns: int, after_ns: int) -> CompleteCycle | bool:
        """Send the targets `data` and the heartbeat at `beat_ns`, and run to the last input of a SYNC after `after_ns`.

        False, and no change, if the cycle may contain anything else.
        """
        with self._lock:
            return self._steady.cycle(self._asked, data, beat_ns, after_ns) or False


class BowdenBus(can.BusABC):
    """One socket on a simulated bench; buses on the same `channel` share the bench, the first one's options make it.

    `given` are the options of `options.Options`; `bench` gives a bench made elsewhere instead. `single_handle`,
    which python-can's own tools pass to every interface, changes nothing. Raises `parameters.InputError` for an
    option that cannot be used, `fd=True` among them: the bench is classical CAN.

    Several threads may use one bus: while one waits in `recv`, others send; a `recv` without time-out lets bus time
    pass in steps, between which a `send` of another thread goes out.
    """

    def __init__(
        self,
        channel: str = "bench",
        can_filters: CanFilters | None = None,
        *,
        bench: Bench | None = None,
        receive_own_messages: bool = False,
        rx_queue: int = 65_536,
        single_handle: bool = False,
        fd: bool = False,
        **given: Any,
    ) -> None:
        if fd:
            raise InputError(f"channel {channel}: fd = true, but the bench is classical CAN; leave fd out.")
        self._key = str(channel)
        shared = _OPEN.get(self._key)
        if shared is None:
            shared = _OPEN[self._key] = OpenBench(bench or _built(given, self._key))
        self._shared = shared
        shared.settle()
        shared.users += 1
        self._lock = shared.lock
        self._settle, self._steady = shared.settle, shared.steady
        self._kernel = shared.bench.kernel
        self._host = shared.bench.host
        self._turnaround_ns = shared.bench.master_turnaround_ns
        self._socket = Socket(own=bool(receive_own_messages), limit=int(rx_queue))
        self._queue = self._socket.queue
        self._host.sockets.append(self._socket)
        self.channel_info = f"bowden bench on {self._key}"
        super().__init__(channel=self._key, can_filters=can_filters)

    @property
    def bench(self) -> Bench:
        """The simulated bench, advanced to the present time."""
        self._settle()
        return self._shared.bench

    def cycles(
        self, tap: can.BusABC | None, targets: tuple[int, int], inputs: Sequence[tuple[int, int]], period_ns: int,
        budget_ns: int, heartbeat: tuple[int, int, int],
    ) -> SteadyCycles | None:
        """Offer complete cycles to a master: see `SteadyCycles`; None where this bench has none.

        `tap` is the bus on which everything is recorded; `targets` and `inputs` are identifiers and sizes of the frame
        that the master sends in each and of those that it then waits for, within `budget_ns` of their SYNC; `heartbeat`
        is its own: identifier, data, period in ns.
        """
        steady = self._steady
        if steady is None or not (tap is None or (isinstance(tap, BowdenBus) and tap._shared is self._shared)):
            return None
        from virtual_bus.compiled.cycle_arrays import CycleRequest, Heartbeat

        asked = CycleRequest(self._socket, None if tap is None else tap._socket, *targets,
                             tuple([each for each, _ in inputs]),
                             budget_ns, Heartbeat(*heartbeat))
        return SteadyCycles(steady, asked, self._lock)

    @property
    def complete_cycles(self) -> int:
        """Number of control cycles of this bench that ran compiled so far; see `cycles`."""
        self._settle()
        return 0 if self._steady is None else self._steady.cycles

    def time_ns(self) -> int:
        """Return the bus's own time: ns since the bench was switched on."""
        return self._kernel.now_ns

    @property
    def lost(self) -> int:
        """Number of messages lost because the receive queue was full."""
        return self._socket.lost

    @property
    def state(self) -> can.BusState:
        """Fault confinement of the computer's controller."""
        return STATES[self._host.state]

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("the error counters say the state")

    def recv(self, timeout: float | None = None) -> BowdenMessage | None:
        """Return the next message, letting bus time pass up to `timeout` s; 0 returns only a message already
        received.

        Raises `can.CanOperationError` if no message can ever come.
        """
        steady = self._steady
        if steady is not None and steady.warm:
            self._settle()
        queue = self._queue
        if queue:
            return queue.popleft()
        if self._is_shutdown:
            self._refuse()
        if timeout is not None and timeout <= 0:
            return None
        kernel = self._kernel
        if timeout is None or timeout > LONG_S:
            self._wait_long(NEVER if timeout is None else kernel.now_ns + round(timeout * 1e9))
        else:
            with self._lock:
                if not queue:
                    kernel.run(kernel.now_ns + round(timeout * 1e9), queue)
        if queue:
            return queue.popleft()
        if timeout is None:
            raise can.CanOperationError(f"{self.channel_info}: nothing will ever happen; give a time-out")
        return None

    def _wait_long(self, until_ns: int) -> None:
        """Let bus time pass event by event up to `until_ns`, with the lock free for other threads in between."""
        queue, kernel, shared = self._queue, self._kernel, self._shared
        while not queue and not self._is_shutdown:
            with shared.turnstile:  # a thread that sends stands here while it waits for the lock
                pass
            with self._lock:
                due_ns = kernel.next_ns()
                if queue or (due_ns == NEVER and until_ns == NEVER):
                    return
                kernel.run(min(due_ns, until_ns), queue)
                if due_ns > until_ns:
                    return

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message, ready after the stated turnaround; `timeout` waits for room in the queue.

        Raises `can.CanOperationError` with ENOBUFS if the queue stays full, ENETDOWN at bus-off.
        """
        if self._is_shutdown:
            self._refuse()
        frame = frame_of(msg)
        with self._shared.turnstile, self._lock:
            self._settle()
            host, kernel = self._host, self._kernel
            if host.waiting >= host.limit and timeout:
                kernel.run(kernel.now_ns + round(timeout * 1e9), Room(host))
            self._submit(frame, kernel.now_ns + self._turnaround_ns, self._socket)

    def _submit(self, frame: Frame, ready_ns: int, origin: Socket | None) -> None:
        if self._host.submit(frame, ready_ns, origin):
            return
        code = errno.ENETDOWN if self._host.state is Confinement.BUS_OFF or self._host.wire is None else errno.ENOBUFS
        raise can.CanOperationError(f"{self.channel_info}: {errno.errorcode[code]}", code)

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Modifier | None = None,
    ) -> PeriodicTask:
        task = PeriodicTask(self._kernel, self._send_now, msgs, period, duration, modifier_callback, self._settle)
        if autostart:
            task.start()
        return task

    def _send_now(self, message: can.Message) -> None:
        self._host.submit(frame_of(message), self._kernel.now_ns)

    def flush_tx_buffer(self) -> None:
        """Discard frames in the computer's transmit queue."""
        self._settle()
        with self._lock:
            if self._host.wire is not None:
                self._host.wire.flush(self._host)

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._settle()
        self._socket.filters = list(filters) if filters else None
        self._host.rematch()

    def shutdown(self) -> None:
        """Close this socket; the bench is removed with its last socket."""
        if self._is_shutdown:
            return
        self._settle()
        super().shutdown()
        with self._lock:
            self._host.sockets.remove(self._socket)
            self._host.rematch()
            self._shared.users -= 1
            if not self._shared.users:
                _OPEN.pop(self._key, None)
                self._shared.bench.close()

    def _refuse(self) -> NoReturn:
        raise can.CanOperationError(f"{self.channel_info} is shut down")

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "bowden", "channel": channel} for channel in [*_OPEN, "bench"]]
