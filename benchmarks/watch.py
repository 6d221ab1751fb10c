"""Cost of the watch: share of one core by gait cycle, and what it adds to a row of the trial.

    python -m benchmarks.watch TRIAL --healthy GOOD…
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import numpy as np

from bowden.watch.file_watch import FileWatch, WatchedBench
from bowden.watch.watch_process import TrialWatch
from trial import read
from trial.signals import SIGNALS

ROWS = 100_000


def main() -> None:
    """Print both costs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trial", type=Path)
    parser.add_argument("--healthy", type=Path, nargs="+", required=True)
    given = parser.parse_args()
    watch = FileWatch(given.trial, WatchedBench(tuple(given.healthy)))
    recorded = read.open(given.trial)
    inside = recorded.time_ns[recorded.columns["cycle"] >= 0.0]
    gait_s = 1e-9 * float(inside[-1] - inside[0])
    costs, began = [], time.process_time()
    for _ in watch.look(last=True):
        costs.append(time.process_time() - began)
        began = time.process_time()
    print(f"watch: {1e3 * np.mean(costs):.0f} ms a gait cycle of {gait_s / len(costs):.2f} s, "
          f"{100.0 * sum(costs) / gait_s:.1f} % of one core (goal 5 %); largest {1e3 * max(costs):.0f} ms")
    beside, alone = (min(_row_s(recorder) for _ in range(5)) for recorder in _recorders())
    print(f"trial: {1e6 * (beside - alone):.2f} µs more a row of /cycle")


class _Nothing:
    """A recorder that records nothing."""

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record nothing."""

    frame = frames = event = cycle


def _recorders() -> tuple[Any, Any]:
    here, _there = Pipe()
    _KEPT.append(_there)
    nothing = _Nothing()
    return TrialWatch(here, False, lambda: None).beside(nothing), nothing


_KEPT: list[Any] = []
"""Other ends of the pipes: a closed one would end the hearing."""


def _row_s(recorder: Any) -> float:
    values = [0.0] * len(SIGNALS)
    began = time.perf_counter()
    for k in range(ROWS):
        recorder.cycle(k, values)
    return (time.perf_counter() - began) / ROWS


if __name__ == "__main__":
    main()
