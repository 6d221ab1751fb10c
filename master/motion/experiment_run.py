"""One experiment from a silent bus to disabled drives: bring-up, home, gait, return, safe end.

The rule of this file: everything that can be computed or refused is, before the first frame is sent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any

import can
import numpy as np

from eds.bench.bench_network import Network
from estimation.transfer.homing_fit import HomingFit
from master import settings
from master.control import controller, gait_phase
from master.control.controller import Conditions, Controller, ControllerInput, RecordedTargets, Repeated
from master.control.effect_correction import Effects, calibrated, correction, homed_stretch
from master.control.extended import TARGET_CYCLES
from master.control.gait_table import GaitTable, samples_of, tabulate
from master.control.stability import derated
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.log import CycleSink
from master.cycle.repetition import Repetition
from master.cycle.run_safely import Outcome, run_safely
from master.cycle.shared_exchange import Work
from master.motion import gait, moves
from master.motion.home import HomingResult, home, reached_n, within
from master.network.link import Link
from parameters import InputError
from physics import inverse
from physics.calibration import Calibration, nominal, refuse_beyond_validity, said_of
from physics.reference import Reference
from physics.stride_walk import Stride, StrideWalk, Variation, walk
from physics.terms import Term
from trial.signals import Signal

KNEE_SAMPLES = 400
"""Points of a gait cycle at which a knee motion is compared with the limits."""


@dataclass(frozen=True)
class ExperimentSetup:
    """An experiment to run: declared sections, a reference and a calibration; `dry_run` never enables a drive.

    `motion`, if given, is the knee's true motion: the controller still expects `reference`. `known`: effects beyond
    the calibration that the controller compensates, name → values; `terms`: modulated constants beyond it.
    `strides`: what `walk` plays in random order; the reference's knee is their mean.
    `targets`: of the recorded trial whose motion is repeated in place of the controller's.
    """

    reference: Reference
    network: Network = field(default_factory=Network)
    gait: settings.Gait = field(default_factory=settings.Gait)
    impedance: settings.Impedance = field(default_factory=settings.Impedance)
    limits: settings.Limits = field(default_factory=settings.Limits)
    homing: settings.Homing = field(default_factory=settings.Homing)
    calibration: Calibration = field(default_factory=nominal)
    dry_run: bool = False
    motion: Reference | None = None
    known: Effects = field(default_factory=dict)
    terms: tuple[Term, ...] = ()
    walk: settings.Walk = field(default_factory=settings.Walk)
    strides: tuple[Stride, ...] = ()
    record: settings.Record = field(default_factory=settings.Record)
    targets: RecordedTargets | None = None


@dataclass(frozen=True)
class Result:
    """Outcome: "completed", or "stopped" with the reason; counts over every control cycle; the bus's time.

    `day` is the homing fit: with the trial's inputs it makes every step of the controller again. `warning` names
    departures of the run from the request. `signal` is the number of the signal that requested the end, 0 for none: a
    command line ends with 128 + that.
    """

    outcome: str
    stop_reason: str | None
    missed_cycles: int
    stale_inputs: int
    duration_s: float
    friction_half_width_m: float | None
    day: HomingFit | None = None
    warning: str | None = None
    signal: int = 0

    @property
    def was_homed(self) -> bool:
        """Whether homing succeeded, after which the experiment itself begins."""
        return self.day is not None


def run(link: Link, tap: can.BusABC | None, recorder: CycleSink | None, experiment: ExperimentSetup) -> Result:
    """Run an experiment on the bus of `link`; the recorder hears the bus through `tap`.

    Raises `InputError` before anything is sent where the experiment cannot be run at all; whatever happens on the
    bus ends in a `Result`.
    """
    return PreparedExperiment(experiment).run(link, tap, recorder)


def result_of(outcome: Outcome, trial: PreparedExperiment) -> Result:
    """Return the outcome of a planned experiment."""
    return Result(
        outcome="completed" if outcome.reason is None else "stopped",
        stop_reason=outcome.reason,
        missed_cycles=outcome.missed_cycles,
        stale_inputs=outcome.stale_inputs,
        duration_s=outcome.duration_s,
        friction_half_width_m=trial.homed.half_width_m if trial.homed else None,
        day=trial.homed.day if trial.homed else None,
        warning=trial.warning,
        signal=outcome.signal,
    )


def refuse_beyond_limits(experiment: ExperimentSetup) -> None:
    """Raise `InputError` for a knee motion that the limits would stop."""
    limits = experiment.limits
    for reference in filter(None, (experiment.reference, experiment.motion)):
        angles = [reference.at(i / KNEE_SAMPLES).knee_angle_rad for i in range(KNEE_SAMPLES + 1)]
        if not limits.knee_low_rad <= min(angles) <= max(angles) <= limits.knee_high_rad:
            raise InputError(
                f"the knee would move from {math.degrees(min(angles)):.1f} to {math.degrees(max(angles)):.1f} degrees; "
                f"limits.knee_low_rad and knee_high_rad allow {math.degrees(limits.knee_low_rad):.1f} to "
                f"{math.degrees(limits.knee_high_rad):.1f}; give another curve, or limits that bench and limb bear.")
        fastest = max(abs(b - a) for a, b in pairwise(angles)) * KNEE_SAMPLES / reference.period_s
        if fastest > limits.knee_rad_s:
            raise InputError(
                f"the knee would move at up to {fastest:.1f} rad/s; limits.knee_rad_s allows {limits.knee_rad_s:g}; "
                f"give a period of at least {reference.period_s * fastest / limits.knee_rad_s:.2f} s.")


def drawn_walk(experiment: ExperimentSetup, table: GaitTable, first: int, rest: int) -> StrideWalk | None:
    """Return the drawn walk of an experiment of several strides, None of one that repeats.

    `first`, `rest`: the samples of run-in and run-out.  Raises `InputError` for what cannot be walked.
    """
    chosen = experiment.walk
    if not chosen.strides:
        if chosen.stumbles or chosen.stops or chosen.sits:
            raise InputError("stumbles, stops and sits are drawn among recorded strides; say how many with --strides.")
        return None
    if not experiment.strides:
        raise InputError("--strides: the knee's motion has no recorded strides; give them with --knee FILE.")
    made = walk(experiment.strides, Variation(
        chosen.strides, chosen.seed, chosen.period_share, chosen.amplitude_share, chosen.stumbles, chosen.stops,
        chosen.sits), np.array(table.knee), table.period_s, first, rest, 2 + experiment.gait.soft_start)
    limits, low, high = experiment.limits, float(made.knee_rad.min()), float(made.knee_rad.max())
    fastest = float(np.abs(np.diff(made.knee_rad)).max()) / table.period_s
    if not (limits.knee_low_rad <= low <= high <= limits.knee_high_rad and fastest <= limits.knee_rad_s):
        raise InputError(
            f"the drawn strides move the knee from {math.degrees(low):.1f} to {math.degrees(high):.1f} degrees at up "
            f"to {fastest:.1f} rad/s; limits allow {math.degrees(limits.knee_low_rad):.1f} to "
            f"{math.degrees(limits.knee_high_rad):.1f} degrees and {limits.knee_rad_s:g} rad/s; lower "
            "walk.amplitude_share or walk.period_share.")
    return made


class PreparedExperiment:
    """Experiment with every table computed before SYNC starts; `homed` is the result of homing, set during the run.

    Computations that would take longer than a control cycle allows are done here.
    """

    def __init__(self, experiment: ExperimentSetup) -> None:
        chosen, rate_hz = experiment.gait, experiment.network.rate_hz
        calibration, rest = calibrated(experiment.calibration, experiment.known)
        self.kind = controller.find(chosen.controller, where="gait")
        self.own = controller.own_parameters(self.kind, chosen.tuning, where=f"controller {chosen.controller}")
        refuse_beyond_validity(calibration, experiment.reference.peak_n)
        refuse_beyond_limits(experiment)
        samples = samples_of(experiment.reference.period_s, rate_hz)
        knee, desired = gait.sampled(experiment.reference, samples)
        by_knee = gait.sampled_by_knee(experiment.reference.surface, samples)
        if by_knee is not None and not getattr(self.kind, "follows_knee", False):
            raise InputError(f"controller {chosen.controller}: follows no desired force that depends on the knee "
                             "angle, as that of --desired does; say --controller extended.")
        most = desired if by_knee is None else by_knee.force_n.max(axis=1)
        start_n = float(inverse.path(inverse.law(calibration, 1.0 / rate_hz), most, knee).start.max())
        self.start_n = start_n
        self.homing, calibration = within(experiment.homing, calibration, experiment.reference.peak_n)
        self.experiment, self.calibration = experiment, calibration
        slack_m = chosen.idle_slack_m * self.kind.slack_share
        self.table = tabulate(calibration, knee, desired, 1.0 / rate_hz, slack_m, by_knee)
        self.rising = [tabulate(
            calibration, knee, desired * (i + 1) / (chosen.soft_start + 1), 1.0 / rate_hz, slack_m,
            by_knee and by_knee._replace(force_n=by_knee.force_n * (i + 1) / (chosen.soft_start + 1)))
            for i in range(chosen.soft_start)]
        self.idle = gait.idle_table(self.table, calibration)
        self.first = gait.run_in_sample(self.table)
        self.rest = gait.resting_sample(self.idle, samples // 20, samples // 2)
        self.strides = drawn_walk(experiment, self.table, self.first, self.rest)
        self.phase = gait_phase.configure(knee, 1.0 / rate_hz, experiment.walk.departure_rad) if (
            experiment.walk.felt) else None
        self.stretched = partial(homed_stretch, calibration, rest) if rest else None
        self.undone = {id(table): correction(
            calibration, table, rest, experiment.terms, adapts=self.kind.uses_homing_fit)
                       for table in (self.table, self.idle, *self.rising)}
        steps = (1 + chosen.soft_start + chosen.cycles) * samples + self.rest - self.first
        if experiment.targets is not None and len(experiment.targets.rope_m) != steps:
            raise InputError(f"the motion to repeat has {len(experiment.targets.rope_m)} control cycles, its gait "
                             f"{steps}; give a trial that was completed.")
        self.homed: HomingResult | None = None
        self.impedance, slowed = derated(
            calibration, experiment.impedance, 1.0 / rate_hz, experiment.reference.peak_n)
        self.warning = " ".join([*([slowed] if slowed else []), *said_of(calibration, start_n)]) or None
        inverse.prepare()
        self._rehearse()

    @property
    def own_signals(self) -> tuple[Signal, ...]:
        """Return the controller's own columns of the trial, and those of strides that differ."""
        return controller.signals(self.kind, self.experiment.walk.differs)

    @property
    def pulls(self) -> str:
        """Return a sentence with the largest forces of the experiment."""
        if self.experiment.dry_run:
            return "The drives stay off: nothing is pulled."
        return (f"Pulls START to at most {reached_n(self.homing.top_n):.0f} N while homing, then to about "
                f"{self.start_n:.0f} N, END to {self.experiment.reference.peak_n:g} N.")

    def run(self, link: Link, tap: can.BusABC | None, recorder: CycleSink | None) -> Result:
        """Run the experiment on the bus of `link`."""
        experiment = self.experiment
        return result_of(
            run_safely(link, tap, recorder, experiment.network, experiment.limits, self.perform), self)

    def _rehearse(self) -> None:
        """Step the controller once, so that compilation and refusals happen before a frame is sent."""
        name = self.experiment.gait.controller
        try:
            rehearsed = self.control(self.table)
            (servo, knee), _, trace = rehearsed.step(ControllerInput(0, 0.0, 0.0, 0.0, 0.0), rehearsed.initial())
            float(servo), float(knee), [float(value) for value in trace.numbers]
        except InputError:
            raise
        except gait.ENDS_A_STEP as error:
            raise InputError(f"controller {name}: {gait.raised(error)} when it was tried before the trial; "
                             "mend it.") from error

    @property
    def begin(self) -> int:
        """Number of the first sample of the trial: run-in, and before it the soft start, or a stride in which the phase
        is found."""
        return self.first - (1 + len(self.rising) + self.experiment.walk.differs) * self.table.samples

    def control(self, table: GaitTable) -> Controller[Any]:
        """Return the chosen controller for a gait table, with the homing fit of the session."""
        day = self.homed.day if self.homed else HomingFit()
        conditions = Conditions(self.impedance, day, self.own, self.experiment.walk.migration)
        made = controller.with_effects(self.kind, self.calibration, table, conditions, self.undone[id(table)])
        targets = self.experiment.targets
        return made if targets is None else Repeated(made, targets, self.begin)

    def perform(self, exchange: Exchange) -> None:
        """Enable, home and walk; with `dry_run` only the walk, on drives that are off."""
        experiment, table = self.experiment, self.table
        self.warn(exchange)
        if not experiment.dry_run:
            drives.enable(exchange)
            self.home(exchange)
            gait.approach(exchange, table, self.first, experiment.homing, self.calibration.rope_per_knee)
        elif not exchange.knee_driven:
            moves.follow_joint(exchange, table.knee[self.first], 0.0, experiment.homing.knee_rad_s)
        self.watch(exchange)
        self.walk(exchange)

    def warn(self, exchange: Exchange) -> None:
        """Record each difference between the requested and the run experiment."""
        if self.warning is not None:
            exchange.log.event(exchange.inputs.sync_ns, "warning", exchange.name, self.warning)

    def home(self, exchange: Exchange) -> None:
        """Home the servo; its drives are enabled."""
        undone = self.undone[id(self.table)]
        self.homed = home(exchange, self.calibration, self.homing, self.experiment.gait.idle_slack_m,
                          1.0 if undone is None else undone.home_gain, self.stretched)

    def watch(self, exchange: Exchange) -> None:
        """Start the comparison of the coming gait with the desired force and with its own first cycles."""
        wanted = self.experiment.reference
        exchange.guard.repetition = Repetition(wanted.peak_n, self.table.period_s, wanted.period_s,
                                               with_rope=exchange.knee_driven,
                                               migration_m=self.experiment.walk.migration[0])
        if self.experiment.walk.differs:
            exchange.plausibility.expect_strides()

    def walk(self, exchange: gait.Cycle, before: int = 0) -> None:
        """Run in, start softly, run the gait and run out; `before` cycles came earlier."""
        gait.run(exchange, self.steps(exchange, before))

    def steps(self, exchange: gait.Cycle, before: int = 0) -> Work[None]:
        """Yield every step that the controller makes in a trial.

        `before` cycles were walked.  Cycles of the soft start are numbered −1, as the run-in is.
        """
        samples, strides = self.table.samples, self.strides
        last = self.experiment.gait.cycles * samples if strides is None else strides.samples
        begin = self.begin

        def number(sample: int) -> float:
            if strides is not None:
                return strides.at(sample)[2]
            return float(before + sample // samples) if 0 <= sample < last else -1.0

        if self.phase is not None:  # the run-out keeps the zero that was followed
            yield from self._walked(exchange, self.table, begin, last + self.rest, number, last)
            return
        for i, table in enumerate(self.rising, 1 - len(self.rising)):
            yield from self._walked(exchange, table, begin, i * samples, number)
            begin = i * samples
        yield from self._walked(exchange, self.table, begin, last, number)
        end = -(-last // samples) * samples  # the run-out begins with a gait cycle
        yield from self._walked(exchange, self.idle, end, end + self.rest, lambda sample: -1.0, late=end - last)

    def _walked(
        self, exchange: gait.Cycle, table: GaitTable, first: int, last: int, number: Callable[[int], float],
        until: float = math.inf, *, late: int = 0,
    ) -> Work[None]:
        """Yield the steps of a controller over a gait table; `late`: how many samples the knee is behind them."""
        name = self.experiment.gait.controller
        with gait.naming(name):
            control = self.control(table)
        yield from gait.steps(
            exchange, control, table, first, last, number, self._led(late), name=name, own=len(self.kind.columns),
            felt=self.phase, true_percent=self._true_percent(late), until=until,
            rising=len(self.rising))

    def _true_percent(self, late: int) -> Callable[[int], float] | None:
        """Return the true phase, %, by sample, of strides that differ or are felt; None of one that repeats."""
        strides, samples = self.strides, self.table.samples
        if strides is not None:
            return lambda sample: strides.at(sample - late)[1]
        return None if self.phase is None else lambda sample: 100.0 * (sample % samples) / samples

    def _led(self, late: int) -> Callable[[int], float] | None:
        """Return the knee's target by sample if its motion departs from the reference, eased in and out; None
        otherwise."""
        motion, table, strides = self.experiment.motion, self.table, self.strides
        if strides is not None:
            return lambda sample: strides.at(sample - late + TARGET_CYCLES)[0]
        if self.phase is not None:
            return lambda sample: table.knee[(sample + TARGET_CYCLES) % table.samples]
        if motion is None:
            return None
        per_sample, end = table.period_s / motion.period_s, self.experiment.gait.cycles * table.samples + self.rest

        def knee_at(sample: int) -> float:
            share = moves.smooth(max(0.0, min(1.0, 1.0 + sample / (0.1 * table.samples), (end - sample) / self.rest)))
            own = table.knee[sample % table.samples]
            return own + share * (motion.knee_angle(sample * per_sample) - own)

        return knee_at
