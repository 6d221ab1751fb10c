"""Bounds against a servo stage that conducts by itself: `python -m benchmarks.shorted_stage [--page]`.

A step of the torque to τ stretches the rope, without friction, to a tension of 2 τ/r − F: r is the radius of the drum,
F the tension before the step.  The first table has this bound and the simulated tension for each torque that a current
limit or a slip clutch permits, the second the simulated tension for each time until STO removes 4 N·m.  `--page` writes
the tables into docs/safety.md and docs/safety_monitor.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmarks.frame import DOCS, put
from tests.faults.argument import STAGE
from tests.faults.judge import END_LIMIT_N, OVER, START_LIMIT_N
from tests.faults.plants import DRUM_M
from tests.faults.stage import Row, Scene, Told, trial

TORQUES_NM: Final = (1.2, 1.4, 1.6, 2.0, 2.4, 4.0)
OFF_MS: Final = (5.0, 6.0, 7.0, 8.0)
"""Times from the fault until STO takes the torque, ms."""


def conducting(torque_nm: float, for_ms: float = math.inf) -> Row:
    """Return the row of a stage that gives this torque towards the rope for a time, whatever the drive asks for."""
    def act(scene: Scene) -> None:
        off_ns = scene.now_ns + for_ms * 1e6
        scene.plant.stage = lambda now_ns, _servo, knee: (torque_nm, knee) if now_ns <= off_ns else (0.0, 0.0)

    return Row(f"{torque_nm:g}, {for_ms:g}", act, (), ("ramp", "peak", "idle"), unstoppable="the stage conducts",
               action=STAGE)


def reached(told: Sequence[Told], row: Row) -> tuple[float, float]:
    """Return the greatest true tension at START and at END after the fault, N, of a row's moments."""
    after = [one.true[one.true[:, 0] > one.fault_ns] for one in told if one.name == row.name]
    start, end = (max(float(true[:, column].max()) for true in after) for column in (1, 2))
    return start, end


def tables() -> tuple[list[str], list[str]]:
    """Run the rows and return the lines of the table by torque and of that by the time until STO acts."""
    rows = {torque: conducting(torque) for torque in TORQUES_NM}
    stopped = {off: conducting(TORQUES_NM[-1], off) for off in OFF_MS}
    told, twin = trial([*rows.values(), *stopped.values()], 1)
    lines = ["| torque left (N·m) | standing rope τ/r (N) | 2 τ/r − F at the peak (N) | simulated START / END (N) "
             f"| within {OVER * START_LIMIT_N:.0f} / {OVER * END_LIMIT_N:.0f} N |", "|---|---|---|---|---|"]
    for torque, row in rows.items():
        at_peak = next(one for one in told if one.name == row.name and one.moment == "peak")
        tension = float(np.interp(at_peak.fault_ns, twin.true[:, 0], twin.true[:, 1]))
        start, end = reached(told, row)
        kept = start <= OVER * START_LIMIT_N and end <= OVER * END_LIMIT_N
        lines.append(f"| {torque:g} | {torque / DRUM_M:.0f} | {2.0 * torque / DRUM_M - tension:.0f} "
                     f"| {start:.0f} / {end:.0f} | {'yes' if kept else 'no'} |")
    off = ["| torque of 4 N·m off after (ms) | START / END (N) |", "|---|---|"]
    off += [f"| {after:g} | {start:.0f} / {end:.0f} |" for after, row in stopped.items()
            for start, end in [reached(told, row)]]
    return lines, off


def main() -> int:
    """Calculate, simulate and print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--page", action="store_true")
    given = asked.parse_args()
    by_torque, by_time = map("\n".join, tables())
    print(f"{by_torque}\n\n{by_time}")
    if given.page:
        put(DOCS / "safety.md", "conducting stage", by_torque)
        put(DOCS / "safety_monitor.md", "sto", by_time)
    return 0


if __name__ == "__main__":
    sys.exit(main())
