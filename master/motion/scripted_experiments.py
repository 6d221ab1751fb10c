"""The experiments that separate effects, run on the bench by their scripts in
`physics.effects.separating_experiments`: each kind of motion, and each script.

A motion starts from the last targets, is led at its stated speed, and never reads END. Each lap of an experiment is
numbered like a gait cycle, so that a diagnosis can hold out complete laps.
"""

import dataclasses
import math
from typing import Final, NamedTuple, assert_never

import can

from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import CycleAnnotations
from master.cycle.log import CycleSink
from master.cycle.run_safely import run_safely
from master.motion import gait, moves
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment, Result, result_of
from master.motion.home import home, reached_n, swing_to
from master.network.link import Link
from master.settings import Homing
from parameters import InputError
from physics.calibration import Calibration
from physics.effects.separating_experiments import (
    EXPERIMENTS,
    SCRIPTED,
    SLACK_M,
    Dither,
    Hold,
    Knee,
    Motion,
    Pull,
    Release,
    ScriptedWalk,
    ScriptPart,
    Swing,
    Wind,
)

REACH_M: Final = 0.12
"""Rope, m, within which a pull must tighten and a release must slacken."""


class MotionContext(NamedTuple):
    """Properties of the bench that motions need."""

    calibration: Calibration
    homing: Homing


def do(motion: Motion, exchange: Exchange, bench: MotionContext) -> None:
    """Do one motion from the last targets on; raises `BringUpError` if the rope does not tighten or go slack."""
    match motion:
        case Pull():
            moves.reel(exchange, motion.speed_m_s, lambda inputs: inputs.start_n > motion.start_n, REACH_M,
                       "the rope does not tighten")
        case Release():
            moves.reel(exchange, -motion.speed_m_s, lambda inputs: inputs.start_n < motion.start_n, REACH_M,
                       "the rope does not go slack")
            _wind(exchange, -motion.beyond_m, motion.speed_m_s)
        case Wind():
            _wind(exchange, motion.length_m, motion.speed_m_s)
        case Hold():
            moves.settle(exchange, motion.seconds)
        case Dither():
            _dither(exchange, motion)
        case Knee():
            swing_to(exchange, motion.angle_rad, bench.calibration, bench.homing)
        case Swing():
            _swing(exchange, motion, bench.calibration.rope_per_knee if motion.rope_follows else 0.0)
        case _:
            assert_never(motion)


def _wind(exchange: Exchange, length_m: float, speed_m_s: float) -> None:
    servo, knee = exchange.targets
    steps = math.ceil(abs(length_m) / speed_m_s / _period_s(exchange))
    for step in range(1, steps + 1):
        exchange.advance(servo + length_m * step / steps, knee)


def _dither(exchange: Exchange, motion: Dither) -> None:
    servo, knee = exchange.targets
    turn = 2.0 * math.pi * motion.frequency_hz * _period_s(exchange)
    whole_s = round(motion.seconds * motion.frequency_hz) / motion.frequency_hz
    for step in range(1, round(whole_s / _period_s(exchange))):
        exchange.advance(servo + motion.amplitude_m * math.sin(turn * step), knee)
    exchange.advance(servo, knee)


def _swing(exchange: Exchange, motion: Swing, rope_by_knee: float) -> None:
    """Swing the knee a sine from its middle to its middle; `rope_by_knee`, m/rad, 0: the rope is held."""
    servo, knee = exchange.targets
    steps = round(motion.seconds / _period_s(exchange))
    for step in range(1, steps + 1):
        angle = motion.amplitude_rad * math.sin(2.0 * math.pi * step / steps)
        exchange.advance(servo + rope_by_knee * angle, knee + angle)


def _period_s(exchange: Exchange) -> float:
    return exchange.wire.period_ns * 1e-9


def checked(name: str, *, where: str) -> str:
    """Return `name` if a bench can run it by itself, else raise `InputError` with what to do."""
    if name not in EXPERIMENTS:
        raise InputError(f"{where} {name}: not in the catalogue; expected one of {', '.join(SCRIPTED)}.")
    needed = EXPERIMENTS[name]
    if not needed.script:
        raise InputError(f"{where} {name} needs an operator: {needed.by_hand} ({needed.motion}); {needed.around}.")
    return name


def laps(name: str, cycles: int) -> int:
    """Return how many laps an experiment numbers; `cycles` are the configuration's gait cycles."""
    parts = EXPERIMENTS[name].script
    return sum(part.laps if isinstance(part, ScriptPart) else part.cycles or cycles for part in parts)


def run(link: Link, tap: can.BusABC | None, recorder: CycleSink | None, experiment: ExperimentSetup,
        name: str) -> Result:
    """Run the experiment `name` on the bus of `link`, on the bench that `experiment` describes."""
    return Scripted(experiment, name).run(link, tap, recorder)


class Scripted:
    """Scripted experiment `name` prepared for a bench, with its tables; raises `InputError` if it cannot be run."""

    def __init__(self, experiment: ExperimentSetup, name: str) -> None:
        checked(name, where="experiment")
        self.script = EXPERIMENTS[name].script
        cycles = next((part.cycles for part in self.script if isinstance(part, ScriptedWalk) and part.cycles), None)
        if cycles is not None:
            experiment = dataclasses.replace(experiment, gait=dataclasses.replace(experiment.gait, cycles=cycles))
        self.name, self.planned, self.count = name, PreparedExperiment(experiment), 0
        self.pull_n = max((motion.start_n for part in self.script if isinstance(part, ScriptPart)
                           for motion in (*part.first, *part.lap) if isinstance(motion, Pull)), default=0.0)

    @property
    def pulls(self) -> str:
        """Return a sentence with the largest forces of the experiment."""
        planned = self.planned
        walks = any(isinstance(part, ScriptedWalk) for part in self.script)
        return (f"Pulls START to at most {reached_n(planned.homing.top_n):.0f} N while homing, then to about "
                f"{max(self.pull_n, planned.start_n if walks else 0.0):.0f} N.")

    def run(self, link: Link, tap: can.BusABC | None, recorder: CycleSink | None) -> Result:
        """Run the experiment on the bus of `link`."""
        experiment = self.planned.experiment
        outcome = run_safely(link, tap, recorder, experiment.network, experiment.limits, self.perform)
        return result_of(outcome, self.planned)

    def perform(self, exchange: Exchange) -> None:
        """Enable the drives, home, and run every part."""
        drives.enable(exchange)
        self.work(exchange)

    def work(self, exchange: Exchange) -> None:
        """Home, and run every part, on drives that are enabled."""
        planned = self.planned
        bench = MotionContext(planned.calibration, planned.homing)
        planned.homed = home(exchange, planned.calibration, planned.homing, SLACK_M)
        for part in self.script:
            if isinstance(part, ScriptedWalk):
                self._walk(exchange, part)
            else:
                self._part(exchange, bench, part)
        do(Release(beyond_m=SLACK_M), exchange, bench)

    def _part(self, exchange: Exchange, bench: MotionContext, part: ScriptPart) -> None:
        for motion in part.first:
            do(motion, exchange, bench)
        for _lap in range(part.laps):
            exchange.annotations = CycleAnnotations(cycle=float(self.count))
            for motion in part.lap:
                do(motion, exchange, bench)
            self.count += 1
        exchange.annotations = CycleAnnotations()

    def _walk(self, exchange: Exchange, walk: ScriptedWalk) -> None:
        planned = self.planned
        do(Hold(walk.rest_s), exchange, MotionContext(planned.calibration, planned.experiment.homing))
        gait.approach(exchange, planned.table, gait.run_in_sample(planned.table), planned.experiment.homing,
                      planned.calibration.rope_per_knee)
        planned.watch(exchange)
        planned.walk(exchange, self.count)
        self.count += planned.experiment.gait.cycles
