"""Two short gait trials that end an identification: START and END under the motion that a controller will run.

Their peaks and cadences are others than those that a controller is judged at, below and above them.  Only START
against END by motion and load is kept of them (`discrepancy_fit`), and no force over time.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import can

from eds.bench.bench_network import Network
from eds.declaration import EXTENDS, MIRROR_RAD
from estimation.transfer.calibration_fit import Segment
from master.control.gait_table import samples_of
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.log import CycleSink
from master.cycle.run_safely import run_safely
from master.cycle.shared_exchange import Running
from master.motion import gait
from master.motion.experiment_run import ExperimentSetup, PreparedExperiment
from master.motion.paths_run import rest
from master.network.link import Link
from master.own_limits import counted
from master.settings import Gait, Homing, Limits
from physics import inverse
from physics.calibration import Calibration
from physics.reference import Reference, paper_reference

GAITS: Final = ((36.0, 1.6), (62.0, 1.2))
"""Peak, N, and period, s, of each trial: below and above 40…60 N, and about as fast as 60 N at 1.1 s."""
CYCLES: Final = 2
"""Gait cycles of each trial. The repetition check would compare a third with the second, and learning changes it."""
WITHIN: Final = 0.9
"""Share of a limit, and of the turning point of (10), that a trial stays within."""
Record = Callable[[Any, str, Callable[[], object]], Segment]


class _RecordedGait(PreparedExperiment):
    """A gait trial of a force path whose gait is recorded as a segment, with what homing found of friction and stretch.
    """

    def __init__(self, experiment: ExperimentSetup, record: Record) -> None:
        super().__init__(experiment)
        self._record = record
        self.segments: list[Segment] = []
        self._found: tuple[float, ...] = ()

    def home(self, exchange: Exchange) -> None:
        """Home; an event keeps friction and stretch, as factors of the calibration's."""
        super().home(exchange)
        if self.homed is None:
            return
        known, day = self.calibration, self.homed.day
        self._found = known.homed_friction * day.friction, known.homed_softness * day.softness
        exchange.log.event(exchange.inputs.sync_ns, "identify", exchange.name,
                           "homed {!r} {!r}".format(*self._found))

    def walk(self, exchange: gait.Cycle, before: int = 0) -> None:
        """Run the gait and keep its columns."""
        walked = self._record(exchange, "gait", lambda: super(_RecordedGait, self).walk(exchange, before))
        self.segments.append(walked._replace(homed=self._found))


def run(
    link: Link, tap: can.BusABC | None, recorder: CycleSink | None, network: Network, limits: Limits, homing: Homing,
    calibrations: Mapping[str, Calibration], record: Record, top_share: float,
) -> Iterator[tuple[str | None, dict[str, list[Segment]]]]:
    """Run the trials by the `extended` controller, on each force path in turn, the others slack.

    Yields after each trial why it stopped, and its segments by path.  `calibrations`: by path; `top_share`: share of
    START's limit that no trial is to need.
    """
    bench = network.bench
    for peak_n, period_s in GAITS:
        planned = {}
        for path in bench.force_paths:
            own, calibration = counted(limits, bench, path), calibrations[path.name]
            reference = _reachable(calibration, peak_n, _slowed(period_s, own), network.rate_hz,
                                   top_share * own.start_n)
            if path.acts == EXTENDS:
                reference = reference.mirrored(MIRROR_RAD, 1.0)
            planned[path.name] = _RecordedGait(ExperimentSetup(
                reference, network=replace(network, bench=bench.path(path.name)), limits=own, homing=homing,
                calibration=calibration, gait=Gait(peak_n=reference.peak_n, period_s=reference.period_s, cycles=CYCLES,
                                                   controller="extended")), record)
        outcome = run_safely(link, tap, recorder, network, limits, partial(_perform, tuple(planned.values())))
        yield outcome.reason, {name: one.segments for name, one in planned.items()}


def _perform(planned: Sequence[_RecordedGait], exchange: Running) -> None:
    """Enable every drive, slacken every rope, and walk each force path in turn."""
    paths = list(zip(planned, exchange.paths, strict=True))
    drives.enable(exchange)
    for _, path in paths if len(paths) > 1 else ():
        rest(path, planned[0].homing)
    for one, path in paths:
        path.own = len(one.kind.columns)
        one.warn(path)
        one.home(path)
        gait.approach(path, one.table, one.first, one.experiment.homing, one.calibration.rope_per_knee)
        one.watch(path)
        one.walk(path)
        if len(paths) > 1:
            rest(path, one.homing)


def _slowed(period_s: float, limits: Limits) -> float:
    """Return the period, s, or the shortest one that moves the knee within its limit, in steps of 0.1 s."""
    paper = paper_reference(1.0, 1.0)
    fastest = max(abs(paper.knee_velocity(i / 400)) for i in range(400))
    while fastest / period_s > WITHIN * limits.knee_rad_s:
        period_s = round(period_s + 0.1, 1)
    return period_s


def _reachable(
    calibration: Calibration, peak_n: float, period_s: float, rate_hz: int, top_start_n: float
) -> Reference:
    """Return the paper's reference with the peak, N, or a lower one that the bench's limits permit."""
    peak_n = min(peak_n, WITHIN * calibration.limit_n)
    law = inverse.law(calibration, 1.0 / rate_hz)
    while True:
        reference = paper_reference(peak_n, period_s)
        knee, desired = gait.sampled(reference, samples_of(period_s, rate_hz))
        most = float(inverse.path(law, desired, knee).start.max())
        if most <= top_start_n:
            return reference
        peak_n *= min(0.98, top_start_n / most)


