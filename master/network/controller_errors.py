"""State and errors of the CAN controller from its error frames, as events of the trial."""

from collections import Counter, deque
from typing import NamedTuple

import can

from eds import error_frames
from master.network.bus_watch import stamp_ns


class ControllerEvent(NamedTuple):
    """A change of the controller's state, or the first error of its kind: its time and its words."""

    time_ns: int
    text: str


class ControllerErrors:
    """Error frames of one link: their number, the controller's last reported state, the events not logged yet.

    Every change of state is an event with the error counters; an error is an event once of each kind, and counted.
    """

    def __init__(self) -> None:
        self.count = 0
        self.state = ""
        self.events: deque[ControllerEvent] = deque()
        self._kinds: Counter[str] = Counter()

    def hear(self, message: can.Message) -> bool:
        """Process an error frame; return whether it reports bus-off."""
        self.count += 1
        report = error_frames.decode(message.arbitration_id, bytes(message.data))
        kind = ", ".join(report.errors)
        if (report.state and report.state != self.state) or (kind and kind not in self._kinds):
            self.events.append(ControllerEvent(stamp_ns(message), f"CAN controller: {report}"))
        self.state = report.state or self.state
        self._kinds.update([kind] if kind else [])
        return report.state == "BUS-OFF"

    def summary(self) -> list[str]:
        """Return the number of errors of each kind that came more than once, the most frequent first."""
        return [f"CAN controller: {kind}, {count} times" for kind, count in self._kinds.most_common() if count > 1]
