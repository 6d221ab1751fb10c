"""Experiments that separate effects which one gait trial confuses: their motions, and one entry each.

A motion starts from the last targets and is led at a stated speed. An entry has the experiment's words, the script by
which `master.motion.scripted_experiments` runs it on a bench, and the waypoints by which
`diagnosis.evidence.experiment_prediction` simulates its observation. `bowden trial --experiment` takes the names of the
entries that have a script.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

SLACK_N: Final = 1.0
"""START tension, N, below which the rope counts as slack."""


@dataclass(frozen=True)
class Pull:
    """Wind the rope until START is above `start_n`."""

    start_n: float
    speed_m_s: float = 0.06


@dataclass(frozen=True)
class Release:
    """Pay the rope out until START is below `start_n`, then `beyond_m` more."""

    start_n: float = SLACK_N
    speed_m_s: float = 0.06
    beyond_m: float = 0.0


@dataclass(frozen=True)
class Wind:
    """Wind a length of rope at constant speed, at any tension; a negative length is unwound."""

    length_m: float
    speed_m_s: float


@dataclass(frozen=True)
class Hold:
    """Hold both axes."""

    seconds: float


@dataclass(frozen=True)
class Dither:
    """Hold the rope with a sine of `amplitude_m` on it, in whole sines."""

    amplitude_m: float
    frequency_hz: float
    seconds: float


@dataclass(frozen=True)
class Knee:
    """Slacken the rope, then bring the knee to an angle, the rope led along; it stays locked there."""

    angle_rad: float


@dataclass(frozen=True)
class Swing:
    """Swing the knee once about where it is, a sine; the rope follows, or is held."""

    amplitude_rad: float
    seconds: float
    rope_follows: bool = False


Motion = Pull | Release | Wind | Hold | Dither | Knee | Swing


class ScriptPart(NamedTuple):
    """Motions that are done first, then `laps` times the same ones; each lap is numbered like a gait cycle."""

    first: Sequence[Motion]
    lap: Sequence[Motion]
    laps: int


class ScriptedWalk(NamedTuple):
    """The gait after a rest, s; `cycles` None: the number in the configuration."""

    rest_s: float = 0.0
    cycles: int | None = None


class Waypoint(NamedTuple):
    """Point of a quasi-static motion: time since the last one, s, END tension, N, and knee angle, degrees, there."""

    seconds: float
    end_n: float
    knee_deg: float


def laps(seconds: float, tensions: Sequence[float], knee_deg: float, count: int = 2) -> list[Waypoint]:
    """Return `count` rounds through tensions at a locked knee, each reached in `seconds`."""
    return [Waypoint(seconds, tension, knee_deg) for _ in range(count) for tension in tensions]


def gaits(count: int) -> list[Waypoint]:
    """Return gait cycles of 2 s and 40 N."""
    return [Waypoint(*point) for _ in range(count) for point in (
        (0.5, 5.0, -5.0), (0.3, 40.0, -15.0), (0.4, 6.0, -40.0), (0.4, 5.0, -60.0), (0.4, 5.0, -10.0))]


MM: Final = 1e-3
MIDDLE: Final = math.radians(-30.0)
ANGLES: Final = tuple(math.radians(angle) for angle in (-10.0, -30.0, -60.0))
"""Knee angles, rad, at which the knee is locked."""
SLOW, CREEP, EASY, BRISK = 0.002, 0.010, 0.030, 0.080
"""Rope speeds, m/s, beside the paper's 0.06 (4.1)."""
ROUND: Final = 1.25 * 2.0 * math.pi * 0.020
"""Rope length, m, of 1¼ turns of the drum."""
SLACK_M: Final = 4 * MM
"""Rope, m, that is paid out beyond slack."""
SETTLE_S: Final = 0.5
REST_N: Final = 0.5
"""END tension, N, of a slack rope among waypoints."""


@dataclass(frozen=True)
class SeparatingExperiment:
    """One experiment: `motion` for the bench and `reads` for the eye, in words.

    `by_hand`: work that an engineer does by hand, "" for none; `around`: the motion of the bench around such work.
    `script`: parts that a bench runs by itself, empty if it needs hands. `waypoints`: its motion as the diagnosis
    simulates it; without waypoints no observation is predicted.  `elsewhere`: motion and reads on a rig of another
    kind.
    """

    name: str
    motion: str
    reads: str
    by_hand: str = ""
    around: str = ""
    script: Sequence[ScriptPart | ScriptedWalk] = ()
    waypoints: Sequence[Waypoint] = ()
    elsewhere: tuple[str, str] | None = None

    def told(self, of_rig: bool) -> tuple[str, str]:
        """Return what to record and what to look at, on the bench or on a rig of another kind."""
        if of_rig and self.elsewhere is not None:
            return self.elsewhere
        return f"{self.motion}{f'; {self.by_hand}' if self.by_hand else ''}", self.reads


_STROKES: Final = (
    "the same strokes at three loads and at three speeds",
    "half of what the two directions are apart: what grows with the load, what with the speed, and what is left at "
    "small ones")


def _locked(angle: float, low_n: float, high_n: float, count: int) -> ScriptPart:
    """Return pulls and releases between two START tensions at a locked knee."""
    return ScriptPart((Knee(angle), Pull(low_n)), (Pull(high_n), Release(low_n)), count)


def _points(*rows: tuple[float, float, float]) -> list[Waypoint]:
    return [Waypoint(*row) for row in rows]


_TABLE: Final = (
    SeparatingExperiment(
        "known_bend", "pull and release at a locked knee, before and after",
        "the friction loop's width against the change of bend: its slope is μ1 alone",
        by_hand="change the sheath's bend by a known angle in between",
        around="run two_peaks before and after, in two trials",
        waypoints=laps(2.0, (40.0, 10.0), -30.0, 4), elsewhere=_STROKES),
    SeparatingExperiment(
        "locked_angles", "pull and release between 10 and 50 N at three locked knee angles, −10, −30 and −60°",
        "the loop's width against the knee angle: φ0, κ and κb part from μ2",
        script=[_locked(angle, 10.0, 50.0, 4) for angle in ANGLES],
        waypoints=[p for knee in (-10.0, -30.0, -60.0) for p in laps(2.0, (10.0, 50.0, 10.0), knee, 1)]),
    SeparatingExperiment(
        "two_peaks", "pull and release to 20 N and to 60 N at a locked knee",
        "START over END at both loads: equal for pure capstan friction",
        script=[ScriptPart((Knee(MIDDLE),), (Pull(20.0), Release(5.0)), 5),
                ScriptPart((), (Pull(60.0), Release(5.0)), 5)],
        waypoints=laps(2.0, (20.0, 5.0), -30.0) + laps(2.0, (60.0, 5.0), -30.0),
        elsewhere=_STROKES),
    SeparatingExperiment(
        "two_speeds", "pull and release to 40 N at 10 and at 80 mm/s, knee locked",
        "what grows with speed at one load is viscous; what grows with dT/dt alone is a delay",
        script=[ScriptPart((Knee(MIDDLE),), (Pull(40.0, CREEP), Release(5.0, CREEP)), 4),
                ScriptPart((), (Pull(40.0, BRISK), Release(5.0, BRISK)), 8)],
        waypoints=laps(4.0, (40.0, 5.0), -30.0) + laps(0.4, (40.0, 5.0), -30.0, 6),
        elsewhere=_STROKES),
    SeparatingExperiment(
        "dither", "hold 30 N with a 40 Hz, 0.1 mm dither on the rope, then without",
        "the peak after a reversal goes with dither if it is static friction",
        script=[ScriptPart((Knee(MIDDLE), Pull(30.0), Hold(SETTLE_S)),
                           (Dither(0.1 * MM, 40.0, 1.0), Wind(-1.0 * MM, CREEP), Wind(1.0 * MM, CREEP)), 5),
                ScriptPart((), (Hold(1.0), Wind(-1.0 * MM, CREEP), Wind(1.0 * MM, CREEP)), 5)],
        elsewhere=_STROKES),
    SeparatingExperiment(
        "amplitude_sweep", "rope reversals of 0.1, 0.2, 0.5, 1, 2 and 5 mm at 30 N, knee locked",
        "how the loop closes as the reversal shrinks: pre-sliding has no dead band",
        script=[ScriptPart((Knee(MIDDLE), Pull(30.0), Hold(SETTLE_S)) if amplitude == 0.1 else (),
                           (Wind(-amplitude * MM, SLOW), Wind(amplitude * MM, SLOW)), 3)
                for amplitude in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)],
        waypoints=[p for size in (0.5, 1.0, 2.0, 5.0, 10.0) for p in laps(1.0, (30.0 + size, 30.0 - size), -30.0)],
        elsewhere=("reversals of growing amplitude, from a hundredth of the stroke on",
                   "how the loop closes as the reversal shrinks: pre-sliding has no dead band")),
    SeparatingExperiment(
        "rest_repeat", "ten gait cycles, a minute of rest, ten more",
        "heat recovers with rest, wear does not, a drifting zero shows at slack",
        script=[ScriptedWalk(cycles=10), ScriptedWalk(rest_s=60.0, cycles=10)],
        waypoints=[*gaits(5), *_points((20.0, 5.0, -10.0)), *gaits(5)],
        elsewhere=("ten cycles, a minute of rest, ten more", "heat recovers with rest, wear does not")),
    SeparatingExperiment(
        "dead_weight", "hang a known weight on the END side, drives off", "both sensors against the weight",
        by_hand="hang the weight", around="record with --dry-run while it hangs, and again without it",
        waypoints=_points((1.0, 20.0, -30.0), (3.0, 20.0, -30.0), (1.0, 40.0, -30.0), (3.0, 40.0, -30.0)),
        elsewhere=("a known force or weight on the far side, the drive off", "both sensors against the known force")),
    SeparatingExperiment(
        "swapped_sensors", "pull and release to 40 N at a locked knee, before and after",
        "a wrong gain moves with its sensor, a wrong stiffness stays",
        by_hand="swap the two sensors", around="run two_peaks before and after, in two trials",
        waypoints=laps(2.0, (40.0, 5.0), -30.0, 4),
        elsewhere=("the same strokes before and after the two sensors are swapped",
                   "a wrong gain moves with its sensor, a wrong stiffness stays")),
    SeparatingExperiment(
        "hold_return", "hold the rope at 40 N for 20 s, return to 5 N, hold for 20 s",
        "creep relaxes and comes back; a slipped anchor does not come back",
        script=[ScriptPart((Knee(MIDDLE),), (Pull(40.0), Hold(20.0), Release(5.0), Hold(20.0)), 3)],
        waypoints=_points((2.0, 40.0, -30.0), (20.0, 40.0, -30.0), (2.0, 5.0, -30.0), (20.0, 5.0, -30.0))),
    SeparatingExperiment(
        "unload", "pay out 10 mm beyond slack, then wind up to 20 N, knee locked",
        "where the tension begins: slack shifts the start, an offset shifts the level",
        script=[ScriptPart((Knee(MIDDLE),), (Release(beyond_m=10.0 * MM, speed_m_s=EASY), Pull(20.0, EASY)), 6)],
        waypoints=laps(2.0, (20.0, REST_N, REST_N), -30.0, 3),
        elsewhere=("strokes down to no load and up again",
                   "where the force begins: slack shifts the start, an offset shifts the level")),
    SeparatingExperiment(
        "locked_motor", "hold the rope, swing the knee by ±1, ±2 and ±5° about −30°",
        "a dead band steps by the same angle at every reversal, pre-sliding does not",
        script=[ScriptPart((Knee(MIDDLE), Pull(20.0), Hold(SETTLE_S)) if degrees == 1.0 else (),
                           (Swing(math.radians(degrees), 2.0),), 3)
                for degrees in (1.0, 2.0, 5.0)],
        waypoints=[Waypoint(0.5, 20.0 + 4.0 * swing, -30.0 + swing)
                   for swing in (1, -1, 1, -1, 2, -2, 2, -2, 5, -5, 5, -5)]),
    SeparatingExperiment(
        "full_turns", "wind the slack rope through a turn and a quarter of the drum, then three locked angles at 20 N",
        "what repeats with the drum is the drum's, what repeats with the knee is the moment arm's",
        script=[ScriptPart((Knee(ANGLES[0]), Release(beyond_m=SLACK_M)), (Wind(-ROUND, 0.1), Wind(ROUND, 0.1)), 2),
                *(ScriptPart((Knee(angle),), (Pull(20.0), Release(5.0)), 3) for angle in ANGLES)]),
    SeparatingExperiment(
        "slack_swing", "swing the knee through its travel with the rope slack",
        "END moves with the angle and its acceleration at zero tension: the mass it carries",
        script=[ScriptPart((Knee(math.radians(-37.5)), Release(beyond_m=SLACK_M)),
                           (Swing(math.radians(32.5), 3.0, rope_follows=True),), 5)],
        waypoints=[Waypoint(0.4, REST_N, knee) for _ in range(6) for knee in (-60.0, -5.0)]),
    SeparatingExperiment(
        "step", "step the rope by 1 mm at 30 N, knee locked",
        "which signal answers late, and by a dead time or by a lag",
        script=[ScriptPart((Knee(MIDDLE), Pull(30.0), Hold(SETTLE_S)),
                           (Wind(-1.0 * MM, 1.0), Hold(0.4), Wind(1.0 * MM, 1.0), Hold(0.4)), 8)],
        waypoints=4 * _points((0.05, 35.0, -30.0), (1.0, 35.0, -30.0), (0.05, 30.0, -30.0), (1.0, 30.0, -30.0))),
    SeparatingExperiment(
        "bus_log", "any trial", "ages, gaps and repeats in the frames themselves", script=[ScriptedWalk()]),
    SeparatingExperiment(
        "three_speeds", "wind the slack rope both ways at 10, 30 and 100 mm/s, with accelerations between",
        "force against speed, by direction, and against acceleration",
        script=[ScriptPart((Knee(ANGLES[2]), Release(beyond_m=10.0 * MM)) if speed == 0.01 else (),
                           (Wind(-30.0 * MM, speed), Wind(30.0 * MM, speed)), 3)
                for speed in (0.01, 0.03, 0.1)],
        elsewhere=("the same strokes at three speeds, then with a known mass or force added",
                   "force against speed by direction, and against acceleration; the known mass gives the scale")),
    SeparatingExperiment(
        "log_current", "the fastest trial of the plan", "motor current and supply voltage at their limits",
        by_hand="log current and voltage, which no PDO of the plan carries",
        around="record them beside a trial at the shortest period and the highest peak"),
)

EXPERIMENTS: Final[Mapping[str, SeparatingExperiment]] = {one.name: one for one in _TABLE}
"""Every experiment, by name."""
SCRIPTED: Final = tuple(one.name for one in _TABLE if one.script)
"""Names of the experiments that a bench runs by itself, in the table's order."""
