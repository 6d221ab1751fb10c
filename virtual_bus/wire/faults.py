"""Faults of the wire and of a node's wiring: declaration (kind, time, frames or node concerned), and their effects.

A fault is a row of `Fault`, effective from `start_s` to before `stop_s` of bus time; random faults are drawn from the
bench's seed and the row's place in the list. A fault of a whole station (cut, deaf, without supply, babbling) acts at
its two instants only and costs the wire's hot path nothing.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eds.cia301 import Frame
from parameters import InputError, checked, from_table, parameter, read_toml
from virtual_bus.kernel import NEVER, TIMER, Kernel
from virtual_bus.wire.station import Confinement, ErrorKind, Medium, Station, Waiting
from virtual_bus.wire.wire import Wire

KINDS: Mapping[str, str] = {
    "drop": "the frame is sent and acknowledged, and reaches nobody",
    "delay": "the frame is ready delay_us later",
    "duplicate": "the frame is sent twice",
    "corrupt": "one bit of the payload is flipped and the CRC agrees with it",
    "shorten": "the payload ends after size bytes",
    "disturb": "an error frame ends the frame; its transmitter tries again",
    "late_sync": "SYNC is ready delay_us later",
    "babble": "a station sends cob_id with size bytes of 55h every period_us, without pause where that is 0",
    "cut": "the node's bus line is open: it hears nobody, nobody acknowledges it",
    "deaf": "the node receives nothing, or nothing with cob_id, but acknowledges",
    "power_off": "the node has no supply; it boots when it comes back",
    "broken_wire": "a wire of the sensor's bridge is broken, and its converter says so",
    "overload": "the sensor's converter is at the end of its range",
    "emergency_stop": "the drive's emergency-stop input (STO) is active; it stays off until 0x2020 releases it",
}
OF_A_SENSOR = frozenset({"broken_wire", "overload"})
OF_A_DRIVE = frozenset({"emergency_stop"})
OF_A_NODE = frozenset({"cut", "deaf", "power_off"}) | OF_A_SENSOR | OF_A_DRIVE
OF_A_FRAME = frozenset({"drop", "duplicate", "corrupt", "shorten", "disturb"})
OF_TIME = frozenset({"delay", "late_sync"})
ANY = -1
COPY = object()
"""Origin that marks the second transmission of a duplicated frame."""


@dataclass(frozen=True)
class Fault:
    """One declared fault; `cob_id` and `node` (of the transmitter, or the one concerned) narrow it down."""

    kind: str = parameter("drop", "", "what happens; one of " + ", ".join(KINDS), source="ISO 11898-1")
    start_s: float = parameter(0.0, "s", "bus time when it begins", low=0.0, high=1e9, source="test plan")
    stop_s: float = parameter(1e9, "s", "bus time when it is over", low=0.0, high=1e9, source="test plan")
    cob_id: int = parameter(ANY, "", "COB-ID it concerns, -1 for all", low=-1, high=0x7FF, source="CiA 301")
    node: int = parameter(ANY, "", "node it concerns, -1 for all", low=-1, high=127, source="CiA 301")
    probability: float = parameter(1.0, "", "chance for each frame", low=0.0, high=1.0, source="test plan")
    delay_us: float = parameter(500.0, "µs", "delay", low=0.0, high=1e9, source="test plan")
    size: int = parameter(0, "byte", "payload left by shorten, payload of babble", low=0, high=8, source="CiA 301")
    period_us: float = parameter(0.0, "µs", "period of babble", low=0.0, high=1e9, source="test plan")

    @property
    def start_ns(self) -> int:
        """Bus time of the fault's first nanosecond."""
        return round(self.start_s * 1e9)

    @property
    def stop_ns(self) -> int:
        """Bus time of the first nanosecond after the fault."""
        return round(self.stop_s * 1e9) if math.isfinite(self.stop_s) else NEVER

    def concerns(self, station: Station, frame: Frame, now_ns: int) -> bool:
        """Return whether the fault applies to this frame of `station`."""
        cob_id = 0x080 if self.kind == "late_sync" else self.cob_id
        return (
            self.start_ns <= now_ns < self.stop_ns
            and (cob_id in (ANY, frame.can_id))
            and (self.node in (ANY, station.node))
        )


def declared(given: str | Path | Iterable[Fault | Mapping[str, Any]]) -> tuple[Fault, ...]:
    """Read faults from a TOML file of `[[fault]]` tables, from mappings, or as they are; raises `InputError`."""
    if isinstance(given, str | Path):
        tables = read_toml(Path(given)).get("fault", [])
        if not isinstance(tables, list) or not tables:
            raise InputError(f"{given}: no [[fault]] table; add one, with kind, start_s and stop_s.")
        rows: list[Any] = tables
        name = str(given)
    else:
        rows, name = list(given), "faults"
    return tuple(_row(row, f"{name} [[fault]] {place}") for place, row in enumerate(rows, start=1))


def _row(row: Fault | Mapping[str, Any], where: str) -> Fault:
    fault = checked(row, where=where) if isinstance(row, Fault) else from_table(Fault, row, where=where)
    if fault.kind not in KINDS:
        raise InputError(f"{where}: kind = {fault.kind!r} is unknown; expected one of {', '.join(KINDS)}.")
    if fault.kind in OF_A_NODE and fault.node == ANY:
        raise InputError(f"{where}: {fault.kind} concerns one node; give node = 1 … 127.")
    if fault.kind == "babble" and fault.cob_id == ANY:
        raise InputError(f"{where}: babble sends one COB-ID; give cob_id = 0 … 0x7FF.")
    if fault.stop_s <= fault.start_s:
        raise InputError(f"{where}: stop_s = {fault.stop_s:g} is not after start_s = {fault.start_s:g}; mend one.")
    return fault


class InjectedFaults:
    """Applies the faults that concern single frames; see `wire.InjectedFaults`."""

    def __init__(self, faults: Sequence[Fault], seed: int) -> None:
        chances = [np.random.Generator(np.random.Philox([seed, place])) for place in range(len(faults))]
        rows = list(zip(faults, chances, strict=True))
        self._of_time = [row for row in rows if row[0].kind in OF_TIME]
        self._of_a_frame = [row for row in rows if row[0].kind in OF_A_FRAME]

    def ready(self, station: Station, frame: Frame, ready_ns: int) -> int:
        """Return when the frame takes part in arbitration: later by every delay that strikes it."""
        late_ns = ready_ns
        for fault, chance in self._of_time:
            if fault.concerns(station, frame, ready_ns) and _strikes(fault, chance):
                late_ns += round(fault.delay_us * 1e3)
        return late_ns

    def quiet_until(self, now_ns: int) -> int:
        """Return the begin of the next fault; `now_ns` during a fault."""
        quiet_ns = NEVER
        for fault, _ in (*self._of_time, *self._of_a_frame):
            if fault.stop_ns > now_ns:
                quiet_ns = min(quiet_ns, max(now_ns, fault.start_ns))
        return quiet_ns

    def heard(self, entry: Waiting, now_ns: int) -> Frame | ErrorKind | None:
        """Return the frame as receivers get it, `None` where none does, or the error that ends it."""
        _, _, station, frame, origin = entry
        heard: Frame | None = frame
        for fault, chance in self._of_a_frame:
            if heard is None or not fault.concerns(station, frame, now_ns) or not _strikes(fault, chance):
                continue
            if fault.kind == "disturb":
                return ErrorKind.CRC
            if fault.kind == "duplicate":
                if origin is not COPY:
                    station.submit(frame, now_ns, COPY)
            elif fault.kind == "drop":
                heard = None
            elif fault.kind == "shorten":
                heard = heard._replace(data=heard.data[: fault.size])
            else:
                heard = _flip(heard, chance)
        return heard


def _strikes(fault: Fault, chance: np.random.Generator) -> bool:
    return fault.probability >= 1.0 or bool(chance.random() < fault.probability)


def _flip(frame: Frame, chance: np.random.Generator) -> Frame:
    if not frame.data:
        return frame
    data = bytearray(frame.data)
    place = int(chance.integers(8 * len(data)))
    data[place >> 3] ^= 1 << (place & 7)
    return frame._replace(data=bytes(data))


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
