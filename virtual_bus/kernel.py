"""One heap of events in integer nanoseconds.

The rule of this file: everything that happens on the virtual bus happens in a callback run from this
heap, in the order (time, priority, serial number), in the thread of whoever waits.
"""

import sys
from collections.abc import Callable, Container, Iterable, Sized
from heapq import heapify, heappop, heappush
from typing import Final

NEVER: Final = sys.maxsize
"""A time that never comes (292 years)."""

TICK: Final = 0
"""Plant, drives and converters: before any device acts at an instant, it has measured."""
END: Final = 1
"""Priority of the end of a frame or of an error frame: all stations receive."""
TIMER: Final = 2
"""Priority of devices' timers and of the host's periodic messages."""
START: Final = 3
"""Priority of an arbitration: after every frame that becomes ready at the same instant."""


class Kernel:
    """The event heap and its clock, which starts at 0."""

    __slots__ = ("_heap", "_serial", "now_ns")

    def __init__(self) -> None:
        self.now_ns = 0
        self._serial = 0
        self._heap: list[tuple[int, int, int, Callable[[], None]]] = []

    def at(self, time_ns: int, priority: int, callback: Callable[[], None]) -> None:
        """Have `callback` run at `time_ns`; it cannot be cancelled: one that is no longer needed returns at once.

        Raises `ValueError` for a time in the past.
        """
        if time_ns < self.now_ns:
            raise ValueError(f"an event at {time_ns} ns is in the past of {self.now_ns} ns")
        serial = self._serial
        self._serial = serial + 1
        heappush(self._heap, (time_ns, priority, serial, callback))

    def run(self, until_ns: int, filled: Sized = ()) -> None:
        """Run every event up to and including `until_ns`, or only until `filled` holds something.

        Afterwards `now_ns` is the time of the event that filled it, else `until_ns`; with `NEVER` and an
        empty heap it stays where it is.
        """
        heap = self._heap
        while heap and heap[0][0] <= until_ns:
            self.now_ns, _, _, callback = heappop(heap)
            callback()
            if filled:
                return
        if until_ns != NEVER:
            self.now_ns = max(self.now_ns, until_ns)

    def withdraw(self, owners: Container[int]) -> None:
        """Take every event off the heap whose callback is a method of one of `owners`, by their `id`."""
        self._heap[:] = [event for event in self._heap if id(getattr(event[3], "__self__", None)) not in owners]
        heapify(self._heap)

    def events(self) -> Iterable[tuple[int, int, int, Callable[[], None]]]:
        """Return the entries of the heap, in no order: (time, priority, serial number, callback)."""
        return self._heap

    def next_ns(self) -> int:
        """Time of the next event, `NEVER` if the heap is empty."""
        return self._heap[0][0] if self._heap else NEVER
