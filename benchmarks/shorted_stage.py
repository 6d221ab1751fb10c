"""Hardware bound against a servo stage that conducts by itself: `python -m benchmarks.shorted_stage [--page]`.

A step of torque into the rope ends, without friction, at 2 τ/r − F: drum and rotor bring once more what the standing
rope would bear beyond the tension F that it had.  Printed beside what the matrix's plant reaches, for each torque that
a current limit or a slip clutch leaves.  `--page` writes the table into docs/safety.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.frame import put
from tests.faults.argument import STAGE
from tests.faults.judge import END_LIMIT_N, OVER, START_LIMIT_N
from tests.faults.plants import DRUM_M
from tests.faults.stage import Row, Scene, trial

TORQUES_NM: Final = (1.2, 1.4, 1.6, 2.0, 2.4, 4.0)
PAGE: Final = Path(__file__).parents[1] / "docs" / "safety.md"


def conducting(torque_nm: float) -> Row:
    """The row of a stage that gives this torque towards the rope, whatever the drive asks for."""
    def stage(_now_ns: int, _servo: float, knee: float) -> tuple[float, float]:
        return torque_nm, knee

    def act(scene: Scene) -> None:
        scene.plant.stage = stage

    return Row(f"{torque_nm:g}", act, (), ("ramp", "peak", "idle"), unstoppable="the stage conducts", action=STAGE)


def table() -> list[str]:
    """Run the rows and return the table's lines."""
    told, twin = trial([conducting(torque) for torque in TORQUES_NM], 1)
    lines = ["| torque left (N·m) | standing rope τ/r (N) | 2 τ/r − F at the peak (N) | simulated START / END (N) "
             f"| within {OVER * START_LIMIT_N:.0f} / {OVER * END_LIMIT_N:.0f} N |", "|---|---|---|---|---|"]
    for torque in TORQUES_NM:
        mine = [one for one in told if one.name == f"{torque:g}"]
        after = [one.true[one.true[:, 0] > one.fault_ns] for one in mine]
        at_peak = next(one for one in mine if one.moment == "peak")
        tension = float(np.interp(at_peak.fault_ns, twin.true[:, 0], twin.true[:, 1]))
        start, end = (max(float(true[:, column].max()) for true in after) for column in (1, 2))
        kept = start <= OVER * START_LIMIT_N and end <= OVER * END_LIMIT_N
        lines.append(f"| {torque:g} | {torque / DRUM_M:.0f} | {2.0 * torque / DRUM_M - tension:.0f} "
                     f"| {start:.0f} / {end:.0f} | {'yes' if kept else 'no'} |")
    return lines


def main() -> int:
    """Calculate, simulate and print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--page", action="store_true")
    given = asked.parse_args()
    text = "\n".join(table())
    print(text)
    if given.page:
        put(PAGE, "conducting stage", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
