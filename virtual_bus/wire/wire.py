"""The wire: arbitration, bit times, acknowledge, error frames, fault confinement (ISO 11898-1).

One frame at a time. A frame starts when the wire is idle and something is ready, lasts its exact bits, and is received
by everyone in the same nanosecond, at its end. Of the frames that contend, the smallest arbitration key wins; frames of
equal key from one station keep their order.
"""

from heapq import heapify, heappop, heappush
from typing import Protocol

from eds.cia301 import Frame
from virtual_bus.kernel import END, NEVER, START, TIMER, Kernel
from virtual_bus.wire.bits import (
    BITRATES,
    ERROR_FRAME_BITS,
    INTERMISSION_BITS,
    RECOVERY_BITS,
    SUSPEND_BITS,
    arbitration,
    first_difference,
    frame_bits,
)
from virtual_bus.wire.station import EXTENDED, Confinement, Deliver, ErrorKind, Station, Waiting


class Contention:
    """The queues of all stations of one wire as two heaps: future frames, and frames that contend now."""

    __slots__ = ("_coming", "_serial", "contending")

    def __init__(self) -> None:
        self._coming: list[tuple[int, int, Waiting]] = []
        self.contending: list[Waiting] = []
        self._serial = 0

    def add(self, station: Station, frame: Frame, ready_ns: int, origin: object) -> None:
        """Add `frame` to the arbitration from `ready_ns` on."""
        serial = self._serial
        self._serial = serial + 1
        station.waiting += 1
        heappush(self._coming, (ready_ns, serial, (arbitration(frame), serial, station, frame, origin)))

    def take(self, now_ns: int) -> Waiting | None:
        """Remove and return the winner of an arbitration at `now_ns`, `None` where nobody may send."""
        coming, contending = self._coming, self.contending
        while coming and coming[0][0] <= now_ns:
            entry = heappop(coming)[2]
            station = entry[2]
            if station.fifo and station.contending:
                station.backlog.append(entry)
            else:
                station.contending += 1
                heappush(contending, entry)
        if not contending:
            return None
        if contending[0][2].resume_ns <= now_ns:
            return heappop(contending)
        free = [entry for entry in contending if entry[2].resume_ns <= now_ns]
        if free:
            contending.remove(min(free))
            heapify(contending)
        return min(free, default=None)

    def rivals(self, winner: Waiting, now_ns: int) -> list[Waiting]:
        """Remove and return the frames of other stations that are equal to the winner's in arbitration."""
        contending = self.contending
        first: dict[Station, Waiting] = {winner[2]: winner}
        for entry in sorted(contending):
            if entry[0] == winner[0] and entry[2].resume_ns <= now_ns:
                first.setdefault(entry[2], entry)
        del first[winner[2]]
        for entry in first.values():
            contending.remove(entry)
        heapify(contending)
        return list(first.values())

    def again(self, entry: Waiting) -> None:
        """Add a frame to the arbitration again after an error frame."""
        heappush(self.contending, entry)

    def follow(self, station: Station) -> None:
        """Move the station's next waiting frame into the arbitration, after one of its frames was sent."""
        if station.backlog:
            self.again(station.backlog.popleft())
        else:
            station.contending -= 1

    def next_ns(self, idle_ns: int) -> int:
        """Return the time of the next arbitration, ns, not before `idle_ns`; `NEVER` if no frame waits."""
        ready = self._coming[0][0] if self._coming else NEVER
        if self.contending:
            if self.contending[0][2].resume_ns <= idle_ns:
                return idle_ns
            ready = min(ready, min(entry[2].resume_ns for entry in self.contending))
        return ready if ready > idle_ns else idle_ns

    def withdraw(self, station: Station) -> list[Waiting]:
        """Remove the station's queue; return its frames in their order."""
        entries = [entry for entry in self.contending if entry[2] is station]
        entries += [*station.backlog, *(entry for _, _, entry in self._coming if entry[2] is station)]
        self._coming = [coming for coming in self._coming if coming[2][2] is not station]
        self.contending = [entry for entry in self.contending if entry[2] is not station]
        heapify(self._coming)
        heapify(self.contending)
        station.backlog.clear()
        station.waiting = station.contending = 0
        return sorted(entries, key=lambda entry: entry[1])


TO_ACKNOWLEDGE_BITS = -8
"""Bits from the end of a frame back to the end of its acknowledge slot, where a missing acknowledge is flagged."""
TO_CRC_ERROR_BITS = -7
"""Bits from the end of a frame back to the end of its acknowledge delimiter, where a CRC error is flagged."""


class FrameFaults(Protocol):
    """Protocol of faults on frames; see `faults.py`."""

    def ready(self, station: Station, frame: Frame, ready_ns: int) -> int:
        """Return the time from which on the frame takes part in arbitration."""

    def heard(self, entry: Waiting, now_ns: int) -> Frame | ErrorKind | None:
        """Return the frame that receivers get, `None` where none does, or the error that ends it."""

    def quiet_until(self, now_ns: int) -> int:
        """Return the time up to which no frame is affected."""


class Wire:
    """A bus at `bitrate` bit/s, one of `bits.BITRATES`."""

    def __init__(self, kernel: Kernel, bitrate: int, judge: FrameFaults | None = None) -> None:
        if bitrate not in BITRATES:
            raise ValueError(f"bit rate {bitrate} is none of {BITRATES}")
        self.retime(bitrate)
        self.stations: list[Station] = []
        self.frames = 0
        self.errors = 0
        self.busy_bits = 0
        self._kernel = kernel
        self._judge = judge
        self._queue = Contention()
        self._senders: list[Waiting] = []
        self._heard: Frame | None = None
        self._error = ErrorKind.BIT
        self._busy = False
        self._start_ns = NEVER
        self.idle_ns = 0
        """Bus time, ns, from which on a frame may start."""
        self._participants = 0
        self._hurt = False

    def retime(self, bitrate: int) -> None:
        """Change the bit rate from the next frame on."""
        self.bit_ns = 1_000_000_000 // bitrate
        self._gap_ns = INTERMISSION_BITS * self.bit_ns

    # -- who is on it ------------------------------------------------------------------------------

    def attach(self, station: Station) -> None:
        """Join a station to the wire; it receives the next frame that ends."""
        station.wire = self
        self.stations.append(station)
        self._hurt = self._hurt or station.tec + station.rec > 0
        self.reroute()

    def detach(self, station: Station) -> list[Waiting]:
        """Take a station off the wire, out of a frame it is sending too; returns what waited in it."""
        waiting = [entry for entry in self._senders if entry[2] is station] + self._queue.withdraw(station)
        self._senders = [entry for entry in self._senders if entry[2] is not station]
        self.stations.remove(station)
        station.wire = None
        self.reroute()
        return waiting

    def reroute(self) -> None:
        """Clear the routes; call it when a station's filter, deafness or confinement has changed."""
        self._participants = sum(
            station.state is not Confinement.BUS_OFF and not station.listen_only for station in self.stations
        )
        for station in self.stations:
            station.routes.clear()

    def _route(self, sender: Station, route: int) -> tuple[Deliver, ...]:
        sender.routes[route] = receivers = tuple(
            station.deliver
            for station in self.stations
            if station is not sender and station.state is not Confinement.BUS_OFF and station.accepts(route)
        )
        return receivers

    # -- what a steady cycle needs ----

    @property
    def steady(self) -> bool:
        """True if the wire is idle, no frame waits, and no station has counted an error."""
        queue = self._queue
        return not (self._busy or self._hurt or queue.contending or queue.next_ns(0) != NEVER)

    def quiet_until(self, now_ns: int) -> int:
        """Return the time up to which no fault affects a frame: at most `NEVER`, not after `now_ns` during a fault."""
        return NEVER if self._judge is None else self._judge.quiet_until(now_ns)

    def carried(self, frames: int, busy_bits: int, idle_ns: int) -> None:
        """Add the frames and bits of a compiled cycle; set the time from which on a frame may start."""
        self.frames, self.busy_bits, self.idle_ns = frames, busy_bits, idle_ns

    # -- sending -----------------------------------------------------------------------------------

    def submit(self, station: Station, frame: Frame, ready_ns: int, origin: object = None) -> bool:
        """Queue a frame that takes part in arbitration from `ready_ns`; False where the queue is full or bus-off."""
        if station.waiting >= station.limit or station.state is Confinement.BUS_OFF:
            station.lost += 1
            return False
        if self._judge is not None:
            ready_ns = self._judge.ready(station, frame, ready_ns)
        self._queue.add(station, frame, ready_ns, origin)
        if ready_ns < self._start_ns and not self._busy:
            self._plan(ready_ns)
        return True

    def flush(self, station: Station) -> None:
        """Discard the waiting frames of a station, except the frame on the wire."""
        station.lost += len(self._queue.withdraw(station))
        station.waiting = station.contending = sum(entry[2] is station for entry in self._senders)

    def _plan(self, ready_ns: int) -> None:
        start_ns = ready_ns if ready_ns > self.idle_ns else self.idle_ns
        if start_ns < self._start_ns:
            self._start_ns = start_ns
            self._kernel.at(start_ns, START, self._start)

    def _start(self) -> None:
        now_ns = self._kernel.now_ns
        if now_ns != self._start_ns:
            return  # an earlier start took its place
        self._start_ns = NEVER
        entry = self._queue.take(now_ns)
        if entry is None:
            self._plan_next()
            return
        self._busy = True
        self._senders = [entry]
        contending = self._queue.contending
        if contending and contending[0][0] == entry[0]:
            self._senders += self._queue.rivals(entry, now_ns)
        frame = entry[3]
        bits = frame_bits(frame)
        if self._judge is None and self._participants > len(self._senders) == 1:
            self._heard = frame
            self.busy_bits += bits + INTERMISSION_BITS
            self._kernel.at(now_ns + bits * self.bit_ns, END, self._end)
        else:
            self._examine(entry, bits, now_ns)

    def _examine(self, entry: Waiting, bits: int, now_ns: int) -> None:
        frame = entry[3]
        clashes = [first_difference(frame, rival[3]) for rival in self._senders[1:] if rival[3] != frame]
        heard = frame if self._judge is None else self._judge.heard(entry, now_ns)
        if clashes:
            self._last(min(clashes) + ERROR_FRAME_BITS, error=ErrorKind.BIT)
        elif self._participants <= len(self._senders):
            self._last(bits + TO_ACKNOWLEDGE_BITS + ERROR_FRAME_BITS, error=ErrorKind.ACKNOWLEDGE)
        elif isinstance(heard, ErrorKind):
            self._last(bits + TO_CRC_ERROR_BITS + ERROR_FRAME_BITS, error=heard)
        else:
            self._heard = heard
            self._last(bits if heard is None or heard is frame else frame_bits(heard), error=None)

    def _last(self, bits: int, error: ErrorKind | None) -> None:
        self.busy_bits += bits + INTERMISSION_BITS
        self._error = error or self._error
        end_ns = self._kernel.now_ns + bits * self.bit_ns
        self._kernel.at(end_ns, END, self._end if error is None else self._fail)

    # -- what becomes of a frame -------------------------------------------------------------------

    def _end(self) -> None:
        now_ns = self._kernel.now_ns
        senders, heard = self._senders, self._heard
        self._senders = []
        self._busy = False
        self.idle_ns = now_ns + self._gap_ns
        self.frames += 1
        if self._hurt:
            self._count(None, senders, now_ns)
        for _, _, station, frame, origin in senders:
            station.waiting -= 1
            self._queue.follow(station)
            if station.hears_itself:
                station.sent(frame, origin, now_ns)
        if heard is not None and senders:
            route = heard.can_id | EXTENDED if heard.extended else heard.can_id
            receivers = senders[0][2].routes.get(route)
            if receivers is None:
                receivers = self._route(senders[0][2], route)
            if len(senders) > 1:
                receivers = tuple(each for each in receivers if each not in [sender[2].deliver for sender in senders])
            for deliver in receivers:
                deliver(heard, now_ns)
        self._plan_next()

    def _fail(self) -> None:
        now_ns = self._kernel.now_ns
        senders = self._senders
        self._senders = []
        self._busy = False
        self.idle_ns = now_ns + self._gap_ns
        self.errors += 1
        for entry in senders:
            self._queue.again(entry)
        self._count(self._error, senders, now_ns)
        sending = {entry[2] for entry in senders}
        for station in self.stations:
            station.errs(self._error, station in sending, now_ns)
        self._plan_next()

    def _plan_next(self) -> None:
        start_ns = self._queue.next_ns(self.idle_ns)
        if start_ns < self._start_ns:
            self._start_ns = start_ns
            self._kernel.at(start_ns, START, self._start)

    # -- fault confinement -------------------------------------------------------------------------

    def _count(self, error: ErrorKind | None, senders: list[Waiting], now_ns: int) -> None:
        sending = {entry[2] for entry in senders}
        for station in list(self.stations):
            if station.state is Confinement.BUS_OFF or station.listen_only:
                continue
            if error is None:
                station.count_success(station in sending)
            else:
                station.count_error(error, station in sending)
            self._confine(station, now_ns)
            if station in sending and station.state is Confinement.PASSIVE:
                station.resume_ns = self.idle_ns + SUSPEND_BITS * self.bit_ns
        self._hurt = any(station.tec or station.rec for station in self.stations)

    def _confine(self, station: Station, now_ns: int) -> None:
        state, previous = station.confinement(), station.state
        if state is previous:
            return
        station.state = state
        if state is Confinement.BUS_OFF:
            self.flush(station)
            free_ns = now_ns + station.restart_ns + RECOVERY_BITS * self.bit_ns
            self._kernel.at(free_ns, TIMER, lambda: recover(station, free_ns))
        self.reroute()
        station.confined(previous, now_ns)


def recover(station: Station, now_ns: int) -> None:
    """End bus-off, unless a loss of supply did already."""
    if station.state is not Confinement.BUS_OFF:
        return
    station.reset_counters()
    if station.wire is not None:
        station.wire.reroute()
    station.confined(Confinement.BUS_OFF, now_ns)
