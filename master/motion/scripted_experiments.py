"""The experiments that separate effects, as the bench runs them: motions as data, under the catalogue's names.

The rule of this file: an experiment is a table; each lap of it is numbered like a gait cycle, so that whoever looks
at it later can leave whole laps out.  What needs hands is refused with what they are to do.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import can

from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import CycleAnnotations
from master.cycle.log import CycleSink
from master.cycle.run_safely import run_safely
from master.motion import gait
from master.motion.experiment_run import ExperimentSetup, Planned, Result, result_of
from master.motion.home import home, reached_n
from master.motion.scripted_motions import Dither, Hold, Knee, Motion, MotionContext, Pull, Release, Swing, Wind
from master.network.link import Link
from parameters import InputError
from physics.effects.separating_experiments import EXPERIMENTS

MM: Final = 1e-3
KNEE: Final = math.radians(-30.0)
LOW, MIDDLE, HIGH = (math.radians(angle) for angle in (-10.0, -30.0, -60.0))
SLOW, CREEP, EASY, BRISK = 0.002, 0.010, 0.030, 0.080
"""Rope speeds, m/s, beside the paper's 0.06 (4.1)."""
ROUND: Final = 1.25 * 2.0 * math.pi * 0.020
SLACK_M: Final = 4 * MM
SETTLE_S: Final = 0.5


class ScriptPart(NamedTuple):
    """What is done first, then `laps` times the same."""

    first: Sequence[Motion]
    lap: Sequence[Motion]
    laps: int


class ScriptedWalk(NamedTuple):
    """The gait of the configuration, after a rest."""

    rest_s: float = 0.0
    cycles: int | None = None


def _at(angle: float, low_n: float, high_n: float, laps: int) -> ScriptPart:
    return ScriptPart((Knee(angle), Pull(low_n)), (Pull(high_n), Release(low_n)), laps)


SCRIPTS: Final[Mapping[str, Sequence[ScriptPart | ScriptedWalk]]] = {
    "locked_angles": [_at(angle, 10.0, 50.0, 4) for angle in (LOW, MIDDLE, HIGH)],
    "two_peaks": [
        ScriptPart((Knee(KNEE),), (Pull(20.0), Release(5.0)), 5),
        ScriptPart((), (Pull(60.0), Release(5.0)), 5),
    ],
    "two_speeds": [
        ScriptPart((Knee(KNEE),), (Pull(40.0, CREEP), Release(5.0, CREEP)), 4),
        ScriptPart((), (Pull(40.0, BRISK), Release(5.0, BRISK)), 8),
    ],
    "dither": [
        ScriptPart((Knee(KNEE), Pull(30.0), Hold(SETTLE_S)),
                   (Dither(0.1 * MM, 40.0, 1.0), Wind(-1.0 * MM, CREEP), Wind(1.0 * MM, CREEP)), 5),
        ScriptPart((), (Hold(1.0), Wind(-1.0 * MM, CREEP), Wind(1.0 * MM, CREEP)), 5),
    ],
    "amplitude_sweep": [
        ScriptPart((Knee(KNEE), Pull(30.0), Hold(SETTLE_S)) if amplitude == 0.1 else (),
                   (Wind(-amplitude * MM, SLOW), Wind(amplitude * MM, SLOW)), 3)
        for amplitude in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    ],
    "rest_repeat": [ScriptedWalk(cycles=10), ScriptedWalk(rest_s=60.0, cycles=10)],
    "hold_return": [ScriptPart((Knee(KNEE),), (Pull(40.0), Hold(20.0), Release(5.0), Hold(20.0)), 3)],
    "unload": [ScriptPart((Knee(KNEE),), (Release(beyond_m=10.0 * MM, speed_m_s=EASY), Pull(20.0, EASY)), 6)],
    "locked_motor": [
        ScriptPart((Knee(KNEE), Pull(20.0), Hold(SETTLE_S)) if degrees == 1.0 else (),
                   (Swing(math.radians(degrees), 2.0),), 3)
        for degrees in (1.0, 2.0, 5.0)
    ],
    "full_turns": [
        ScriptPart((Knee(LOW), Release(beyond_m=SLACK_M)), (Wind(-ROUND, 0.1), Wind(ROUND, 0.1)), 2),
        *(ScriptPart((Knee(angle),), (Pull(20.0), Release(5.0)), 3) for angle in (LOW, MIDDLE, HIGH)),
    ],
    "slack_swing": [
        ScriptPart((Knee(math.radians(-37.5)), Release(beyond_m=SLACK_M)),
                   (Swing(math.radians(32.5), 3.0, rope_follows=True),), 5)],
    "step": [ScriptPart((Knee(KNEE), Pull(30.0), Hold(SETTLE_S)),
                        (Wind(-1.0 * MM, 1.0), Hold(0.4), Wind(1.0 * MM, 1.0), Hold(0.4)), 8)],
    "bus_log": [ScriptedWalk()],
    "three_speeds": [
        ScriptPart((Knee(HIGH), Release(beyond_m=10.0 * MM)) if speed == 0.01 else (),
                   (Wind(-30.0 * MM, speed), Wind(30.0 * MM, speed)), 3)
        for speed in (0.01, 0.03, 0.1)
    ],
}
"""By name of the catalogue: what is done, part by part."""

BY_HAND: Final[Mapping[str, str]] = {
    "known_bend": "run two_peaks before and after, in two trials",
    "swapped_sensors": "run two_peaks before and after, in two trials",
    "dead_weight": "record with --dry-run while it hangs, and again without it",
    "log_current": "record them beside a trial at the shortest period and the highest peak",
}
"""What needs hands: what to run around their work."""


def names() -> tuple[str, ...]:
    """Return the experiments that a bench runs by itself, in the catalogue's order."""
    return tuple(name for name in EXPERIMENTS if name in SCRIPTS)


def checked(name: str, *, where: str) -> str:
    """Return `name` if a bench can run it by itself, else raise `InputError` with what to do."""
    if name in BY_HAND:
        needed = EXPERIMENTS[name]
        raise InputError(f"{where} {name} needs an operator: {needed.by_hand} ({needed.motion}); {BY_HAND[name]}.")
    if name not in SCRIPTS:
        raise InputError(f"{where} {name}: not in the catalogue; expected one of {', '.join(names())}.")
    return name


def laps(name: str, cycles: int) -> int:
    """Return how many laps an experiment numbers; `cycles` are the configuration's gait cycles."""
    return sum(part.laps if isinstance(part, ScriptPart) else part.cycles or cycles for part in SCRIPTS[name])


def run(link: Link, tap: can.BusABC | None, recorder: CycleSink | None, experiment: ExperimentSetup,
        name: str) -> Result:
    """Run the experiment `name` on the bus of `link`, on the bench that `experiment` describes."""
    return Scripted(experiment, name).run(link, tap, recorder)


class Scripted:
    """One script on one bench, with its tables made; raises `InputError` where it cannot be run."""

    def __init__(self, experiment: ExperimentSetup, name: str) -> None:
        checked(name, where="experiment")
        cycles = next((part.cycles for part in SCRIPTS[name] if isinstance(part, ScriptedWalk) and part.cycles), None)
        if cycles is not None:
            experiment = dataclasses.replace(experiment, gait=dataclasses.replace(experiment.gait, cycles=cycles))
        self.name, self.planned, self.count = name, Planned(experiment), 0
        self.pull_n = max((motion.start_n for part in SCRIPTS[name] if isinstance(part, ScriptPart)
                           for motion in (*part.first, *part.lap) if isinstance(motion, Pull)), default=0.0)

    @property
    def pulls(self) -> str:
        """The largest forces that it will pull, as a sentence."""
        planned = self.planned
        walks = any(isinstance(part, ScriptedWalk) for part in SCRIPTS[self.name])
        return (f"Pulls START to at most {reached_n(planned.homing):.0f} N while homing, then to about "
                f"{max(self.pull_n, planned.start_n if walks else 0.0):.0f} N.")

    def run(self, link: Link, tap: can.BusABC | None, recorder: CycleSink | None) -> Result:
        """Run it on the bus of `link`."""
        experiment = self.planned.experiment
        outcome = run_safely(link, tap, recorder, experiment.network, experiment.limits, self.perform)
        return result_of(outcome, self.planned)

    def perform(self, exchange: Exchange) -> None:
        """Enable, home, and run every part."""
        planned = self.planned
        bench = MotionContext(planned.calibration, planned.homing)
        drives.enable(exchange)
        planned.homed = home(exchange, planned.calibration, planned.homing, SLACK_M)
        for part in SCRIPTS[self.name]:
            if isinstance(part, ScriptedWalk):
                self._walk(exchange, part)
            else:
                self._part(exchange, bench, part)
        Release(beyond_m=SLACK_M).run(exchange, bench)

    def _part(self, exchange: Exchange, bench: MotionContext, part: ScriptPart) -> None:
        for motion in part.first:
            motion.run(exchange, bench)
        for _lap in range(part.laps):
            exchange.annotations = CycleAnnotations(cycle=float(self.count))
            for motion in part.lap:
                motion.run(exchange, bench)
            self.count += 1
        exchange.annotations = CycleAnnotations()

    def _walk(self, exchange: Exchange, walk: ScriptedWalk) -> None:
        planned = self.planned
        Hold(walk.rest_s).run(exchange, MotionContext(planned.calibration, planned.experiment.homing))
        gait.approach(exchange, planned.table, gait.run_in_sample(planned.table), planned.experiment.homing,
                      planned.calibration.swing_k)
        planned.watch(exchange)
        planned.walk(exchange, self.count)
        self.count += planned.experiment.gait.cycles
