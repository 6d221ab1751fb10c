"""Arbitration queues: the frames that wait on one wire.

The rule of this file: a frame first becomes ready, then contends; of those that contend the smallest arbitration key
wins, and frames of equal key from one station keep their order.
"""

from heapq import heapify, heappop, heappush

from eds.cia301 import Frame
from virtual_bus.kernel import NEVER
from virtual_bus.wire.bits import arbitration
from virtual_bus.wire.station import Station, Waiting


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
