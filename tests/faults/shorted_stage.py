"""Tension by a servo stage that conducts by itself: `python -m tests.faults.shorted_stage`.

A step of the torque to τ stretches the rope, without friction, to a tension of 2 τ/r − F: r is the radius of the drum,
F the tension before the step.  The first table has this bound and the simulated tension for each torque that a current
limit or a slip clutch permits, the second the simulated tension for each time until STO removes 4 N·m.  The tables are
written into docs/safety.md and docs/safety_monitor.md.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from benchmarks.frame import DOCS, markdown, put
from tests.faults.argument import STAGE
from tests.faults.judge import END_LIMIT_N, OVER, START_LIMIT_N
from tests.faults.plants import DRUM_M
from tests.faults.stage import Row, Scene, trial

TORQUES_NM: Final = (1.2, 1.4, 1.6, 2.0, 2.4, 4.0)
OFF_MS: Final = (5.0, 6.0, 7.0, 8.0)
"""Times from the fault until STO takes the torque, ms."""


def conducting(torque_nm: float, for_ms: float = math.inf) -> Row:
    """Return the fault of a stage that gives this torque towards the rope for a time, whatever the drive demands."""
    def act(scene: Scene) -> None:
        off_ns = scene.now_ns + for_ms * 1e6
        scene.plant.stage = lambda now_ns, _servo, knee: (torque_nm, knee) if now_ns <= off_ns else (0.0, 0.0)

    return Row(f"{torque_nm:g}, {for_ms:g}", act, (), ("ramp", "peak", "idle"), unstoppable="the stage conducts",
               action=STAGE)


def main() -> None:
    """Run the faults, print the tables and write them into the pages."""
    faults = [(torque, math.inf, conducting(torque)) for torque in TORQUES_NM]
    faults += [(TORQUES_NM[-1], off, conducting(TORQUES_NM[-1], off)) for off in OFF_MS]
    moments, twin = trial([row for _, _, row in faults], 1)
    by_torque, by_time = [], []
    for torque, off, row in faults:
        mine = [one for one in moments if one.name == row.name]
        after = np.concatenate([one.true[one.true[:, 0] > one.fault_ns] for one in mine])
        start, end = float(after[:, 1].max()), float(after[:, 2].max())
        if off < math.inf:
            by_time.append((f"{off:g}", f"{start:.0f} / {end:.0f}"))
            continue
        peak_ns = next(one.fault_ns for one in mine if one.moment == "peak")
        tension = float(np.interp(peak_ns, twin.true[:, 0], twin.true[:, 1]))
        within = start <= OVER * START_LIMIT_N and end <= OVER * END_LIMIT_N
        by_torque.append((f"{torque:g}", f"{torque / DRUM_M:.0f}", f"{2.0 * torque / DRUM_M - tension:.0f}",
                          f"{start:.0f} / {end:.0f}", "yes" if within else "no"))
    for page, name, text in (
            ("safety.md", "conducting stage", markdown((
                "torque left (N·m)", "standing rope τ/r (N)", "2 τ/r − F at the peak (N)", "simulated START / END (N)",
                f"within {OVER * START_LIMIT_N:.0f} / {OVER * END_LIMIT_N:.0f} N"), by_torque)),
            ("safety_monitor.md", "sto", markdown(("torque of 4 N·m off after (ms)", "START / END (N)"), by_time))):
        print(text)
        put(DOCS / page, name, text)


if __name__ == "__main__":
    main()
