"""Where the processor time of a master's cycle on the kernel's CAN goes, counted in instructions of the guest.

The rule of this file: a function is charged with the time of its own thread while it is the innermost one of those
watched; what watching itself costs is measured on functions that do nothing, and taken off.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from master.control.packaged import PaperController
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.log import Log
from master.cycle.reception import Reception
from master.motion import gait
from master.network import kernel_frames
from master.network.kernel_cycles import KernelCycles
from trial.record import Recorder

clock = time.thread_time_ns
KERNEL, LINK, EXCHANGE, SAFETY, GAIT, ROW, RECORDER = (
    "compiled call: targets sent, one wait, two reads, all in the kernel; rows and inputs of what came",
    "around it", "exchange: values of the inputs, what a cycle missed", "checks of range, step, limits, heartbeats",
    "gait and controller", "the row of 34 columns", "row and frames into the recorder's memory")
STAGES: Final = (KERNEL, LINK, EXCHANGE, SAFETY, GAIT, ROW, RECORDER)
WRITER: Final = "the recorder's thread: messages made of rows, compressed, written"
WHOLE: Final = "the whole, without being watched"
WATCHED: Final[tuple[tuple[Any, str, str], ...]] = (
    (kernel_frames, "cycle", KERNEL), (KernelCycles, "run", LINK), (Exchange, "advance", EXCHANGE),
    (Reception, "takes_all", SAFETY), (Guard, "check", SAFETY), (gait, "run", GAIT), (PaperController, "step", GAIT),
    (Exchange, "row_of", ROW), (Log, "take", RECORDER), (Log, "row", RECORDER), (Recorder, "event", RECORDER),
)
"""Functions of a cycle and the stage that each is charged to, with what it calls that is not watched."""
REHEARSED: Final = 2000


class Watch:
    """Processor time of the calling thread by stage: `spent` has ns, what watching costs taken off."""

    def __init__(self) -> None:
        self._spent: dict[str, int] = {}
        self._calls: dict[tuple[str, str], int] = {}
        self._within = [""]
        self._asked = False
        self._last = clock()

    def watched(self, function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        """Wrap a function so that the time in it is the stage's."""
        spent, calls, within = self._spent, self._calls, self._within

        def call(*given: Any, **named: Any) -> Any:
            around = within[-1]
            spent[around] = spent.get(around, 0) + clock() - self._last
            calls[around, stage] = calls.get((around, stage), 0) + 1
            within.append(stage)
            self._last = clock()
            try:
                return function(*given, **named)
            finally:
                spent[stage] = spent.get(stage, 0) + clock() - self._last
                within.pop()
                self._last = clock()

        return call

    def restarted(self) -> float:
        """Reset the times at the first call, so that start-up is not counted; return 0."""
        if not self._asked:
            self._asked = True
            self._spent.clear()
            self._calls.clear()
        return 0.0

    @property
    def cycles(self) -> int:
        """Control cycles up to now."""
        return sum(count for (_, stage), count in self._calls.items() if stage == EXCHANGE)

    def spent_ns(self, around_ns: float, inside_ns: float) -> dict[str, float]:
        """Time by stage without what a watched call costs the stage around it and its own."""
        told: dict[str, float] = {stage: self._spent.get(stage, 0) for stage in STAGES}
        for (around, stage), count in self._calls.items():
            told[stage] -= count * inside_ns
            if around in told:
                told[around] -= count * around_ns
        return told


def costs_ns() -> tuple[float, float]:
    """What watching a call costs the stage around it and its own."""
    watch = Watch()
    inner = watch.watched(lambda: None, LINK)

    def loop(function: Callable[[], None]) -> None:
        for _ in range(REHEARSED):
            function()

    watch.watched(loop, EXCHANGE)(inner)
    watched = watch.spent_ns(0.0, 0.0)
    watch = Watch()
    watch.watched(loop, EXCHANGE)(lambda: None)
    plain = watch.spent_ns(0.0, 0.0)[EXCHANGE]
    return (watched[EXCHANGE] - plain) / REHEARSED, watched[LINK] / REHEARSED


@contextmanager
def watching() -> Iterator[Watch]:
    """Watch the functions of `WATCHED` meanwhile."""
    watch = Watch()
    before = [(holder, name, getattr(holder, name)) for holder, name, _ in WATCHED]
    for holder, name, stage in WATCHED:
        setattr(holder, name, watch.watched(getattr(holder, name), stage))
    try:
        yield watch
    finally:
        for holder, name, function in before:
            setattr(holder, name, function)
