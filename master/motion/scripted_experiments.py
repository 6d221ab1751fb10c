"""The experiments that separate effects, run on the bench by their scripts in
`physics.effects.separating_experiments`.

Each lap of an experiment is numbered like a gait cycle, so that a diagnosis can hold out complete laps.
"""

from __future__ import annotations

import dataclasses

import can

from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import CycleAnnotations
from master.cycle.log import CycleSink
from master.cycle.run_safely import run_safely
from master.motion import gait
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment, Result, result_of
from master.motion.home import home, reached_n
from master.motion.scripted_motions import MotionContext, do
from master.network.link import Link
from parameters import InputError
from physics.effects.experiment_motions import Hold, Pull, Release, ScriptedWalk, ScriptPart
from physics.effects.separating_experiments import EXPERIMENTS, SCRIPTED, SLACK_M


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
    """One script on one bench, with its tables made; raises `InputError` where it cannot be run."""

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
