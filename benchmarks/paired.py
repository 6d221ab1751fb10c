"""Two pieces of work compared fairly on a busy machine: two processes that pass a token.

The rule of this file: only one of the two runs at a time, in short turns, and each turn counts that process's own
processor time; what else runs on the machine then strikes neighbouring turns alike, and their ratio stays.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

Turn = Callable[[], None]
"""To be called by a piece of work at the end of each turn; returns when the next one begins."""
Work = Callable[[Turn], None]
"""Sets itself up, then works turn after turn until `turn()` raises `DoneError`."""


class DoneError(BaseException):
    """Enough turns were measured; no trial ends safely for it."""


class Compared(NamedTuple):
    """Processor time of one unit of work, µs: median of own and peer; quartiles of peer / own, turn by turn."""

    own_us: float
    peer_us: float
    ratio: tuple[float, float, float]

    def row(self, name: str, peer: str) -> tuple[str, str, str, str, str]:
        """Return the cells of a table: what, own time, peer, its time, ratio with quartiles."""
        low, middle, high = self.ratio
        own = f"{self.own_us:.{1 if self.own_us >= 1.0 else 2}f}"
        return name, own, peer, f"{self.peer_us:.1f}", f"{middle:.1f} ({low:.1f} … {high:.1f})"


def compare(own: Work, peer: Work, *, units: int, turns: int, warm: int = 5) -> Compared:
    """Run both in processes of their own, `turns` turns each of `units` units, the first `warm` not counted."""
    spent = np.array(_alternate((own, peer), turns + warm))[:, warm:] / units * 1e-3
    low, middle, high = np.quantile(spent[1] / spent[0], (0.25, 0.5, 0.75))
    return Compared(*(float(np.median(each)) for each in spent), (float(low), float(middle), float(high)))


def _alternate(works: tuple[Work, Work], turns: int) -> list[list[int]]:
    context = multiprocessing.get_context("fork")
    ends = [context.Pipe() for _ in works]
    processes = [context.Process(target=_serve, args=(work, theirs, turns)) for work, (_, theirs) in
                 zip(works, ends, strict=True)]
    for process in processes:
        process.start()
    for ours, _ in ends:
        ours.recv()
    spent: list[list[int]] = [[], []]
    for _ in range(turns):
        for place, (ours, _) in enumerate(ends):
            ours.send(None)
            spent[place].append(ours.recv())
    for process in processes:
        process.join()
    return spent


def _serve(work: Work, pipe: Any, turns: int) -> None:
    left, began = turns, -1

    def turn() -> None:
        nonlocal left, began
        now = time.process_time_ns()
        pipe.send(None if began < 0 else now - began)
        if began >= 0:
            left -= 1
        if not left:
            raise DoneError
        pipe.recv()
        began = time.process_time_ns()

    with suppress(DoneError):
        work(turn)
    os._exit(0)
