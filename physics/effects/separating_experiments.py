"""The experiments that separate effects which one gait trial confuses.

The rule of this file: what is done and what is looked at, in words and under one name; who runs them reads the name.
`by_hand` says what no drive can do for the engineer.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple


class SeparatingExperiment(NamedTuple):
    """One experiment: `motion` for the bench, `reads` for the eye, `by_hand` where hands are needed ("" if not)."""

    name: str
    motion: str
    reads: str
    by_hand: str = ""


_TABLE: Final[tuple[tuple[str, ...], ...]] = (
    ("known_bend", "pull and release at a locked knee, before and after", "the friction loop's width against "
     "the change of bend: its slope is μ1 alone", "change the sheath's bend by a known angle in between"),
    ("locked_angles", "pull and release between 10 and 50 N at three locked knee angles, −10, −30 and −60°",
     "the loop's width against the knee angle: φ0, κ and κb part from μ2"),
    ("two_peaks", "pull and release to 20 N and to 60 N at a locked knee",
     "START over END at both loads: equal for pure capstan friction"),
    ("two_speeds", "pull and release to 40 N at 10 and at 80 mm/s, knee locked",
     "what grows with speed at one load is viscous; what grows with dT/dt alone is a delay"),
    ("dither", "hold 30 N with a 40 Hz, 0.1 mm dither on the rope, then without",
     "the peak after a reversal goes with dither if it is static friction"),
    ("amplitude_sweep", "rope reversals of 0.1, 0.2, 0.5, 1, 2 and 5 mm at 30 N, knee locked",
     "how the loop closes as the reversal shrinks: pre-sliding has no dead band"),
    ("rest_repeat", "ten gait cycles, a minute of rest, ten more",
     "heat recovers with rest, wear does not, a drifting zero shows at slack"),
    ("dead_weight", "hang a known weight on the END side, drives off", "both sensors against the weight",
     "hang the weight"),
    ("swapped_sensors", "pull and release to 40 N at a locked knee, before and after",
     "a wrong gain moves with its sensor, a wrong stiffness stays", "swap the two sensors"),
    ("hold_return", "hold the rope at 40 N for 20 s, return to 5 N, hold for 20 s",
     "creep relaxes and comes back; a slipped anchor does not come back"),
    ("unload", "pay out 10 mm beyond slack, then wind up to 20 N, knee locked",
     "where the tension begins: slack shifts the start, an offset shifts the level"),
    ("locked_motor", "hold the rope, swing the knee by ±1, ±2 and ±5° about −30°",
     "a dead band steps by the same angle at every reversal, pre-sliding does not"),
    ("full_turns",
     "wind the slack rope through a turn and a quarter of the drum, then three locked angles at 20 N",
     "what repeats with the drum is the drum's, what repeats with the knee is the moment arm's"),
    ("slack_swing", "swing the knee through its travel with the rope slack",
     "END moves with the angle and its acceleration at zero tension: the mass it carries"),
    ("step", "step the rope by 1 mm at 30 N, knee locked",
     "which signal answers late, and by a dead time or by a lag"),
    ("bus_log", "any trial", "ages, gaps and repeats in the frames themselves"),
    ("three_speeds", "wind the slack rope both ways at 10, 30 and 100 mm/s, with accelerations between",
     "force against speed, by direction, and against acceleration"),
    ("log_current", "the fastest trial of the plan", "motor current and supply voltage at their limits",
     "log current and voltage, which no PDO of the plan carries"),
)

EXPERIMENTS: Final[Mapping[str, SeparatingExperiment]] = {
    row[0]: SeparatingExperiment(*row) for row in _TABLE}
