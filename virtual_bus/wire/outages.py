"""Faults of whole stations and of their wiring: cut, deaf, without supply, babbling; bridges, STO inputs.

Each acts at its two instants only and costs the wire's hot path nothing.
"""

from collections.abc import Callable, Iterable
from functools import partial

from eds.cia301 import Frame
from virtual_bus.kernel import NEVER, TIMER, Kernel
from virtual_bus.wire.faults import ANY, COPY, OF_A_DRIVE, OF_A_SENSOR, Fault
from virtual_bus.wire.station import Confinement, Medium, Station
from virtual_bus.wire.wire import Wire


def arrange(
    kernel: Kernel, medium: Callable[[], Medium], stations: Iterable[Station], faults: Iterable[Fault], bit_ns: int
) -> None:
    """Schedule the beginning and end of every fault of a station; `medium` joins the stations afterwards."""
    by_node = {station.node: station for station in stations if station.node is not None}
    for fault in faults:
        if fault.kind == "babble":
            begin, end = _babbler(kernel, medium, fault)
        elif fault.kind == "cut" and fault.node in by_node:
            begin, end = _cut(kernel, medium, by_node[fault.node], bit_ns)
        elif fault.kind in _EFFECTS and fault.node in by_node:
            begin, end = _EFFECTS[fault.kind](kernel, medium, by_node[fault.node], fault)
        else:
            continue
        _plan(kernel, fault, begin, end)


def wired(kernel: Kernel, faults: Iterable[Fault], inputs: Callable[[Fault, bool], None]) -> None:
    """Schedule the faults of the sensors' bridges and the drives' inputs; `inputs` is called at each beginning and end.
    """
    for fault in faults:
        if fault.kind in OF_A_SENSOR | OF_A_DRIVE:
            _plan(kernel, fault, partial(inputs, fault, True), partial(inputs, fault, False))


def _plan(kernel: Kernel, fault: Fault, begin: Callable[[], None], end: Callable[[], None]) -> None:
    kernel.at(fault.start_ns, TIMER, begin)
    if fault.stop_ns != NEVER:
        kernel.at(fault.stop_ns, TIMER, end)


Effect = tuple[Callable[[], None], Callable[[], None]]


def _move(station: Station, to: Medium, now_ns: int) -> None:
    waiting = station.wire.detach(station) if station.wire is not None else []
    to.attach(station)
    for _, _, _, frame, origin in waiting:
        to.submit(station, frame, now_ns, origin)


def _cut(kernel: Kernel, medium: Callable[[], Medium], station: Station, bit_ns: int) -> Effect:
    alone = Wire(kernel, 1_000_000_000 // bit_ns)
    return lambda: _move(station, alone, kernel.now_ns), lambda: _move(station, medium(), kernel.now_ns)


def _deaf(kernel: Kernel, medium: Callable[[], Medium], station: Station, fault: Fault) -> Effect:
    def hear(deaf_to: frozenset[int] | None) -> None:
        station.deaf_to = deaf_to
        medium().reroute()

    nothing = frozenset({fault.cob_id}) if fault.cob_id != ANY else None
    return lambda: hear(nothing), lambda: hear(frozenset())


def _power_off(kernel: Kernel, medium: Callable[[], Medium], station: Station, fault: Fault) -> Effect:
    def off() -> None:
        if station.wire is not None:
            station.lost += len(station.wire.detach(station))
        station.powered(False, kernel.now_ns)

    def on() -> None:
        station.reset_counters()
        medium().attach(station)
        station.powered(True, kernel.now_ns)

    return off, on


_EFFECTS = {"deaf": _deaf, "power_off": _power_off}


class _Babbler(Station):
    """A babbling station: it sends one frame without end."""

    def __init__(self, kernel: Kernel, fault: Fault) -> None:
        super().__init__("babbler", lambda frame, now_ns: None, filters=frozenset(), limit=2)
        self._kernel = kernel
        self._frame = Frame(fault.cob_id, b"\x55" * fault.size)
        self._period_ns = round(fault.period_us * 1e3)

    def speak(self) -> None:
        if self.wire is None:
            return
        self.submit(self._frame, self._kernel.now_ns)
        if self._period_ns:
            self._kernel.at(self._kernel.now_ns + self._period_ns, TIMER, self.speak)

    def sent(self, frame: Frame, origin: object, now_ns: int) -> None:
        if not self._period_ns and origin is not COPY:
            self.submit(self._frame, now_ns)

    def confined(self, previous: Confinement, now_ns: int) -> None:
        if not self._period_ns and not self.waiting:
            self.speak()


def _babbler(kernel: Kernel, medium: Callable[[], Medium], fault: Fault) -> Effect:
    station = _Babbler(kernel, fault)

    def begin() -> None:
        medium().attach(station)
        station.speak()

    def end() -> None:
        medium().detach(station)

    return begin, end
