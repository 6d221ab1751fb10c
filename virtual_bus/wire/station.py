"""One CAN controller on the wire: its transmit queue, acceptance filter and error counters.

Fault confinement is ISO 11898-1, 12.1.4: the counters determine the state, and only the wire counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Final, Protocol

from eds.cia301 import Frame

TEC_STEP: Final = 8
PASSIVE_ABOVE: Final = 127
BUS_OFF_ABOVE: Final = 255
EXTENDED: Final = 1 << 31
"""Marks an identifier of the extended format among acceptance filters and routes."""


class Confinement(Enum):
    """The three states of fault confinement."""

    ACTIVE = "error active"
    PASSIVE = "error passive"
    BUS_OFF = "bus-off"


class ErrorKind(Enum):
    """Cause of a frame's early end."""

    BIT = "bit error"
    CRC = "CRC error"
    ACKNOWLEDGE = "no acknowledge"


Waiting = tuple[int, int, "Station", Frame, object]
"""A frame that waits: (arbitration key, serial number, station, frame, origin); compares as arbitration does."""
Deliver = Callable[[Frame, int], None]


class Medium(Protocol):
    """Protocol of the medium that joins stations: `wire.Wire`, or `serve.Outside`."""

    def attach(self, station: Station) -> None:
        """Join a station."""

    def detach(self, station: Station) -> list[Waiting]:
        """Remove a station from the wire; return the frames of its queue."""

    def flush(self, station: Station) -> None:
        """Discard the frames that wait in a station."""

    def reroute(self) -> None:
        """Clear the cached routes from COB-IDs to stations."""

    def submit(self, station: Station, frame: Frame, ready_ns: int, origin: object = None) -> bool:
        """Queue a frame."""


class Station:
    """A controller with a finite transmit queue.

    `fifo` selects which of its frames takes part in arbitration: the oldest (one mailbox behind a driver's queue, as
    SocketCAN has it) or the one of the smallest identifier (a mailbox each, as devices have it). `filters` are the
    base-format identifiers it accepts, `None` accepts all; a `listen_only` station acknowledges nothing. `restart_ns`
    passes after bus-off before it begins to count the recessive bits of its recovery.
    """

    def __init__(
        self,
        name: str,
        deliver: Deliver,
        *,
        node: int | None = None,
        filters: frozenset[int] | None = None,
        limit: int = 32,
        fifo: bool = False,
        restart_ns: int = 0,
        listen_only: bool = False,
    ) -> None:
        self.name = name
        self.node = node
        self.deliver = deliver
        self.filters = filters
        self.limit = limit
        self.fifo = fifo
        self.restart_ns = restart_ns
        self.listen_only = listen_only
        self.hears_itself = type(self).sent is not Station.sent
        self.deaf_to: frozenset[int] | None = frozenset()
        self.wire: Medium | None = None
        self.routes: dict[int, tuple[Deliver, ...]] = {}
        self.backlog: deque[Waiting] = deque()
        self.waiting = 0
        self.contending = 0
        self.lost = 0
        self.resume_ns = 0
        self.tec = 0
        self.rec = 0
        self.state = Confinement.ACTIVE

    def __repr__(self) -> str:
        return f"Station({self.name!r}, {self.state.value}, tec={self.tec}, rec={self.rec})"

    def submit(self, frame: Frame, ready_ns: int, origin: object = None) -> bool:
        """Queue `frame` to take part in arbitration from `ready_ns`; False and counted in `lost` where it cannot."""
        if self.wire is None:
            self.lost += 1
            return False
        return self.wire.submit(self, frame, ready_ns, origin)

    def accepts(self, route: int) -> bool:
        """Return whether the filter accepts an identifier (`EXTENDED` set for the extended format)."""
        if self.deaf_to is None or route in self.deaf_to:
            return False
        return self.filters is None or route in self.filters

    def sent(self, frame: Frame, origin: object, now_ns: int) -> None:
        """Process the acknowledged transmission of the station's own frame."""

    def errs(self, kind: ErrorKind, sending: bool, now_ns: int) -> None:
        """Process the end of an error frame, in a frame that the station was `sending` or receiving."""

    def confined(self, previous: Confinement, now_ns: int) -> None:
        """Process a change of the fault confinement state from `previous`."""

    def powered(self, on: bool, now_ns: int) -> None:
        """Process a change of the power supply."""

    def reset_counters(self) -> None:
        """Reset the error counters to error active, as at power-on and after bus-off (ISO 11898-1, 12.1.4.4)."""
        self.tec = self.rec = self.resume_ns = 0
        self.state = Confinement.ACTIVE

    def count_success(self, sending: bool) -> None:
        """Count an error-free frame in the transmit or receive error counter."""
        if sending:
            self.tec = max(self.tec - 1, 0)
        elif self.rec > PASSIVE_ABOVE:
            self.rec = PASSIVE_ABOVE
        else:
            self.rec = max(self.rec - 1, 0)

    def count_error(self, kind: ErrorKind, sending: bool) -> None:
        """Count an error frame; a passive transmitter without an acknowledge counts no further."""
        if not sending:
            self.rec = min(self.rec + 1, PASSIVE_ABOVE + 1)
        elif kind is not ErrorKind.ACKNOWLEDGE or self.state is not Confinement.PASSIVE:
            self.tec += TEC_STEP

    def confinement(self) -> Confinement:
        """Return the state that follows from the counters."""
        if self.tec > BUS_OFF_ABOVE:
            return Confinement.BUS_OFF
        return Confinement.PASSIVE if max(self.tec, self.rec) > PASSIVE_ABOVE else Confinement.ACTIVE
