"""Hours of simulated trials in one process, memory and handles watched: `python -m tests.fuzz.soak [--hours 8]`.

Each piece is a whole trial, recorded to a file and closed; printed are the simulated hours, the process's resident
memory, its open handles and its live objects after each, and at the end whether they grew after the first tenth.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import time
from pathlib import Path


def resident_mb() -> float:
    """Resident memory, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def piece(path: Path, number: int, cycles: int) -> float:
    """Run one trial; returns its simulated seconds."""
    from master import settings
    from master.motion import experiment_run
    from master.network.link import Link
    from physics.reference import paper_reference
    from trial.record import Recorder
    from virtual_bus.bus import BowdenBus

    channel = f"soak-{number}"
    bus = BowdenBus(channel, serial=number % 7, day=number % 5, seed=number)
    tap = BowdenBus(channel)
    recorder = Recorder(path, metadata={}, attachments={}, threaded=False, overwrite=True)
    asked = experiment_run.ExperimentSetup(paper_reference(40.0, 2.0), gait=settings.Gait(
        peak_n=40.0, period_s=2.0, cycles=cycles, controller="paper"))
    result = experiment_run.run(Link(bus, bus.time_ns), tap, recorder, asked)
    recorder.close({})
    tap.shutdown()
    bus.shutdown()
    if result.stop_reason is not None:
        raise SystemExit(f"piece {number}: {result.stop_reason}")
    return result.duration_s


def main() -> int:
    """Soak and print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--hours", type=float, default=8.0)
    asked.add_argument("--cycles", type=int, default=300)
    given = asked.parse_args()
    simulated, number, began = 0.0, 0, time.monotonic()
    memory: list[float] = []
    handles: list[int] = []
    with tempfile.TemporaryDirectory() as folder:
        while simulated < 3600.0 * given.hours:
            simulated += piece(Path(folder) / "soak.mcap", number, given.cycles)
            number += 1
            gc.collect()
            memory.append(resident_mb())
            handles.append(len(os.listdir("/proc/self/fd")))
            print(f"{simulated / 3600.0:6.2f} h simulated, {time.monotonic() - began:6.0f} s, {memory[-1]:7.1f} MB, "
                  f"{handles[-1]} handles, {len(gc.get_objects())} objects", flush=True)
    early = max(1, len(memory) // 10)
    grown = max(memory[early:], default=memory[-1]) - memory[early - 1]
    print(f"{number} trials, {simulated / 3600.0:.2f} h: memory {grown:+.1f} MB and handles "
          f"{max(handles[early:], default=handles[-1]) - handles[early - 1]:+d} after the first tenth")
    return int(grown > 20.0 or max(handles[early:], default=0) > handles[early - 1])


if __name__ == "__main__":
    sys.exit(main())
