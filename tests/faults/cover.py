"""The covering sample: every fault at every moment, with controller, period, bench and motion rotating by a fixed rule.

The whole product is faults × 20 moments × 5 controllers × 3 periods × 5 benches, and the other motions on every bench.
The sample has every sudden fault at every moment once; `whole=True` gives the product. Names, and slow faults, are
judged in the rows' own gaits.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from eds.declaration import SHAPES
from tests.faults import argument
from tests.faults.stage import OF_GAIT, OF_MOTION, Row, Walk

CONTROLLERS, PERIODS = ("paper", "extended", "none", "friction", "impedance"), (1.1, 2.0, 3.0)
GAITS = tuple(Walk(period_s, controller, 1, shape=SHAPES[(place + 2 * other) % len(SHAPES)])
              for place, controller in enumerate(CONTROLLERS) for other, period_s in enumerate(PERIODS))
"""Gaits of the sample: every controller with every period, every bench with three controllers and every period."""
EVERY_GAIT = tuple(Walk(period_s, controller, 1, shape=shape)
                   for controller in CONTROLLERS for period_s in PERIODS for shape in SHAPES)
MOTIONS = tuple(Walk(motion=motion, shape=shape, moments=OF_MOTION[:count]) for motion, shape, count in (
    ("home", "bench", 5), ("home", "bench_start_only", 5), ("jog", "bench", 6), ("jog", "bench_start_only", 6),
    ("identify", "bench", 9), ("identify", "bench_two_legs", 10)))
"""Other motions, with the moments before their end; `home` and `jog` run one force path with a driven knee."""
ON_ONE_BENCH = (argument.FOREIGN, argument.TARGETS, argument.ALTERED, argument.OTHER_BENCH)
"""Actions whose rows name frames of the paper's bench."""
DRAGGED = "a leg that falls pulls the antagonist's rope off a drum without torque, which drags"
UNSEEN = "without END no signal shows what changes between START and the limb"
STANDS = ("an encoder that stands still is right as long as the leg is to stand still; a leg that its drive then moves "
          "shows by the path alone, and falls from there once it is let go")
STEP = 7
"""Step of the rotation from fault to fault: without a common divisor with the number of gaits."""


def applies(row: Row, walk: Walk) -> bool:
    """Return whether a bench and a motion have what a row breaks."""
    if walk.shape != "bench" and row.action in ON_ONE_BENCH:
        return False
    if walk.shape == "bench_start_only" and "END" in row.name:
        return False
    if walk.shape == "bench_no_knee_drive" and "knee" in row.name:
        return False
    return not row.gradual


def sample(rows: Sequence[Row], *, whole: bool = False, motions: bool = True) -> dict[Walk, list[Row]]:
    """Return by walk the rows that begin in it, each with the moments at which it does; names are not judged.

    A gait that a row does not apply to is passed over for the next one of the rotation.
    """
    found: dict[Walk, list[Row]] = {}
    for place, row in enumerate(row for row in rows if row.moments != ("start",)):
        kinds = [(EVERY_GAIT if whole else GAITS, OF_GAIT)] + [(MOTIONS, OF_MOTION)] * motions
        for walks, moments in kinds:
            fit = [walk for walk in walks if applies(row, walk)]
            turns: dict[Walk, list[str]] = {}
            for number, moment in enumerate(moments if fit else ()):
                for walk in fit if whole else [fit[(STEP * place + number) % len(fit)]]:
                    if not walk.moments or moment in walk.moments:
                        turns.setdefault(walk, []).append(moment)
            for walk, at in turns.items():
                errors = tuple(name for name in row.named if name.startswith("program failed"))
                mine = replace(row, moments=tuple(at), walks=(walk,), named=errors, quiet=True)
                found.setdefault(walk, []).append(excused(mine, walk))
    return found


def excused(row: Row, walk: Walk) -> Row:
    """Return the row with the physical reasons for which it cannot keep every bound on this bench or in this motion."""
    if walk.shape == "bench_antagonists":
        measures = (*row.excused, "slack_ms") if row.excused or not row.unstoppable else ()
        row = replace(row, unstoppable="; ".join(filter(None, (row.unstoppable, DRAGGED))), excused=measures)
    if walk.shape == "bench_start_only" and row.action is argument.PATH:
        row = replace(row, beyond=UNSEEN)
    if walk.motion in ("home", "identify") and row.name == "knee encoder frozen":
        row = replace(row, unstoppable=STANDS, excused=("off_deg", "over_deg_s"))
    return row


def thinned(sampled: dict[Walk, list[Row]], every: int) -> dict[Walk, list[Row]]:
    """Return one run in `every`, another one for each fault."""
    found: dict[Walk, list[Row]] = {}
    number = 0
    for walk, rows in sampled.items():
        for row in rows:
            at = []
            for moment in row.moments:
                number += 1
                if not number % every:
                    at.append(moment)
            if at:
                found.setdefault(walk, []).append(replace(row, moments=tuple(at)))
    return found


def matching(sampled: dict[Walk, list[Row]], names: str, walks: str) -> dict[Walk, list[Row]]:
    """Return the runs whose fault and whose walk match."""
    return {walk: mine for walk, rows in sampled.items() if re.search(walks, str(walk))
            and (mine := [row for row in rows if re.search(names, row.name)])}
