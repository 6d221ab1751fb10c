"""Experiment of several force paths: each planned as one of a single path, all run in the same control cycles.

The paths home one after the other, the others slack; then their gaits run together. A path with a separate joint runs
half a gait cycle behind the path before it, as the legs of a walker do; an antagonist runs with the rope that flexes
its joint. An experiment of the catalogue runs on one path after the other, the others slack.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import can

from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.log import CycleSink
from master.cycle.run_safely import run_safely
from master.cycle.shared_exchange import Answer, Running, Work, together
from master.motion import gait, moves
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment, Result, result_of
from master.motion.scripted_experiments import Scripted
from master.network.link import Link
from master.settings import Homing

RESTING_M: Final = 0.015
"""Rope, m, that a resting path unwinds beyond slack, while the other path of its joint moves the joint. The lever of
a leg departs from the packaged one by up to a tenth, 5 mm over a gait's flexion, and slack of 10 mm stays."""


@dataclass(frozen=True)
class PathsResult(Result):
    """Outcome of an experiment of several paths; `homed`: the results of homing, by path."""

    homed: Mapping[str, Mapping[str, object]] = field(default_factory=dict)

    @property
    def was_homed(self) -> bool:
        """Whether homing of a path succeeded."""
        return bool(self.homed)


def rest(exchange: Exchange, homing: Homing) -> None:
    """Slacken a rope by `RESTING_M`, so that its joint can move."""
    moves.reel(exchange, -homing.rope_m_s, lambda inputs: inputs.start_n < 1.0, homing.reach_m,
               "the rope does not go slack; release it by hand or tare START")
    servo, knee = exchange.targets
    moves.move(exchange, servo - RESTING_M, knee, homing.rope_m_s, homing.knee_rad_s)


class PlannedPaths:
    """An experiment of several paths with its tables made; `planned` has that of each path of the bench of `network`.

    `script`: the experiment of the catalogue that each path runs in place of the gait; "" for the gait.
    """

    def __init__(self, setups: Mapping[str, ExperimentSetup], whole: ExperimentSetup, script: str = "") -> None:
        self.scripts = {name: Scripted(setup, script) for name, setup in setups.items()} if script else {}
        self.planned = {name: self.scripts[name].planned if script else PreparedExperiment(setup)
                        for name, setup in setups.items()}
        self.experiment, self._whole = next(iter(setups.values())), whole
        bench = whole.network.bench
        leads: dict[str, PreparedExperiment] = {}
        for path in bench.force_paths:
            lead = leads.setdefault(path.joint, self.planned[path.name])
            self.planned[path.name].first, self.planned[path.name].rest = lead.first, lead.rest
        self._place = {path.name: list(leads).index(path.joint) for path in bench.force_paths}

    @property
    def pulls(self) -> str:
        """Return a sentence with the largest forces of the experiment."""
        return " ".join(f"{name}: {planned.pulls}" for name, planned in (self.scripts or self.planned).items())

    def run(self, link: Link, tap: can.BusABC | None, recorder: CycleSink | None) -> PathsResult:
        """Run the experiment on the bus of `link`."""
        outcome = run_safely(link, tap, recorder, self._whole.network, self._whole.limits, self.perform)
        first = next(iter(self.planned.values()))
        warning = " ".join(f"{name}: {planned.warning}" for name, planned in self.planned.items() if planned.warning)
        found = {name: {"friction_half_width_m": planned.homed.half_width_m, "day": planned.homed.day}
                 for name, planned in self.planned.items() if planned.homed is not None}
        whole = dataclasses.asdict(result_of(outcome, first))
        whole |= {"day": None, "friction_half_width_m": None, "warning": warning or None}
        return PathsResult(**whole, homed=found)

    def perform(self, exchange: Running) -> None:
        """Enable every drive, home the paths one after the other, and walk them together, or each by its script.

        A dry run only walks, on drives that are off.
        """
        paths = dict(zip(self.planned, exchange.paths, strict=True))
        for name, path in paths.items():
            path.own = len(self.planned[name].kind.columns)
            self.planned[name].warn(path)
        if not self.experiment.dry_run:
            self._prepare(exchange, paths)
        if self.scripts:
            return
        for name, path in paths.items():
            self.planned[name].watch(path)
        together(exchange, [self._steps(name, path) for name, path in paths.items()])

    def _prepare(self, exchange: Running, paths: Mapping[str, Exchange]) -> None:
        """Enable, slacken every rope, and home each path; scripts run after the homing of their path."""
        drives.enable(exchange)
        for name, path in paths.items():
            rest(path, self.planned[name].homing)
        for name, path in paths.items():
            if self.scripts:
                self.scripts[name].work(path)
            else:
                self.planned[name].home(path)
            rest(path, self.planned[name].homing)
        for name, path in paths.items() if not self.scripts else ():
            planned = self.planned[name]
            gait.approach(path, planned.table, planned.first, planned.experiment.homing,
                          planned.calibration.rope_per_knee)

    def _steps(self, name: str, path: Exchange) -> Work[None]:
        """Yield the steps of one path, half a gait cycle behind those of the joint before it."""
        planned = self.planned[name]
        for _ in range(self._place[name] * (planned.table.samples // 2)):
            yield Answer(*path.targets)
        yield from planned.steps(path)
