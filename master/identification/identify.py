"""Identification experiments over the bus, those of the paper where the paper describes them.

This module only runs motions; `calibration_fit` and `discrepancy_fit` evaluate them.  The gait trials have other peaks
and cadences than those at which a controller is judged; only their discrepancy by motion and load is kept.

| kind | motion | result |
|---|---|---|
| rest | the rope slack, one second | offsets, noise |
| stiffness | knee at 13 % of gait, five pulls and releases, 20…60 N, 0.06 m/s (paper, 4.1) | (10) |
| swing | 20 N held at START, the knee swung slowly ten times (paper, 4.2) | (11) |
| ramp | pulls and releases from slack to the top and to 45 N at three knee angles, 0.015…0.12 m/s | friction, lags |
| pull | two pulls and releases to the top, 0.015 and 0.12 m/s, on a calibration that is there | END's lag |
| gait | two gait cycles at 36 N and 1.6 s and two at 62 N and 1.2 s, calibrated by the others | the discrepancy |

The ramps are an addition, since the paper gives no procedure for friction. Pulling and releasing slide rope and
fabric both ways, so START by END force is e^(±(μ1θ + μ2φ)). Three knee angles separate the part that grows with the
wrap from the rest. The reversal at the top, and at half the load, shows the pre-sliding. The top is the START force
for the highest desired force (END 62 N), as far as START's limit permits, so that a controller extrapolates nothing.
Most are at the paper's speed; a slower and a faster one separate breakaway, viscous friction and the sensors' lag.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import can
import numpy as np

from eds.bench.bench_network import Network, wire
from estimation.transfer import calibration_fit, discrepancy_fit
from estimation.transfer.calibration_fit import Segment
from estimation.transfer.jackknife import LineFit
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import Inputs, KeptCycle
from master.cycle.log import CycleSink
from master.cycle.run_safely import Outcome, run_safely
from master.cycle.shared_exchange import Running
from master.identification import gait_trials
from master.motion import moves
from master.motion.home import home, reached_n, swing_held, swing_to
from master.motion.paths_run import rest
from master.network.link import Link
from master.own_limits import by_path
from master.settings import Homing, Limits
from parameters import InputError
from physics import inverse, laws
from physics.calibration import Calibration, ScalarEvidence, nominal
from trial.read import Trial

KINDS = ("rest", "stiffness", "swing", "ramp")
PROCEDURES: Mapping[str, tuple[str, ...]] = {
    "sensors": ("rest",), "stiffness": ("rest", "stiffness"), "swing": ("rest", "swing"),
    "friction": ("rest", "stiffness", "ramp"), "gait": ("rest", "pull"), "all": KINDS,
}
HOMED = ("homed_friction", "homed_softness")
"""Scalars by which homing is relative to the session of the identification."""
WALKED = ("gait", "all")
"""Identification procedures that end with gait trials."""
LOW_N, HIGH_N, SPEED_M_S, PULLS = 20.0, 60.0, 0.06, 5
SLACK_N = 3.0
TOP_END_N, TOP_SHARE, HALF_N = 62.0, 0.7, 45.0
"""Highest tension of the ramps: N at END, or this share of START's limit; START, N, of the ramp that turns early."""
SLOW_M_S, FAST_M_S = 0.015, 0.12
RAMPS = ((True, SPEED_M_S), (True, SPEED_M_S), (False, SPEED_M_S), (True, SLOW_M_S), (True, FAST_M_S))
"""Each ramp: whether to the top or to half the load, and its speed."""
RAMP_KNEES_RAD = (math.radians(-6.0), float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT)), math.radians(-60.0))
SWINGS, SWING_S = 10, 4.0
SWING_FROM_RAD, SWING_TO_RAD = math.radians(-5.0), math.radians(-65.0)
HANGING_RAD = 0.0
"""Knee angle at which the leg stays by itself between the experiments and the gait trials, while the drives are off."""
REST_S, REACH_M, SLACK_M, SAME_KNEE_RAD = 1.0, 0.12, 4e-3, 0.05

COLUMNS = ("servo_target_m", "servo_position_m", "knee_angle_rad", "tension_start_n", "tension_end_n",
           "desired_force_n", "estimated_end_force_n")
"""Columns of the trial that a segment contains."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Identification:
    """Request of an identification: a procedure's name, the calibration to start from, and the bench.

    `guesses`: other calibrations to start from, by force path.
    """

    what: str = "all"
    guesses: Mapping[str, Calibration] = field(default_factory=dict)
    guess: Calibration = field(default_factory=nominal)
    network: Network = field(default_factory=Network)
    limits: Limits = field(default_factory=Limits)
    homing: Homing = field(default_factory=Homing)


def run(
    link: Link, tap: can.BusABC | None, recorder: CycleSink | None, identification: Identification,
    progress: Progress = lambda what, share: None,
) -> tuple[Outcome, dict[str, list[Segment]]]:
    """Run the experiments of a procedure on each force path in turn; return the outcome and the recorded segments.

    The segments are by path.
    """
    procedure(identification.what)
    inverse.prepare()
    bench = identification.network.bench
    names = [path.name for path in bench.force_paths]
    limits = by_path(identification.limits, bench)
    paths = {name: _Experiments(
        replace(identification, guess=identification.guesses.get(name, identification.guess), limits=limits[name]),
        functools.partial(_shared, progress, place / len(names), 1.0 / len(names)))
        for place, name in enumerate(names)}

    def perform(exchange: Running) -> None:
        several = len(names) > 1
        drives.enable(exchange)
        for path in exchange.paths if several else ():
            rest(path, identification.homing)
        for name, path in zip(names, exchange.paths, strict=True):
            paths[name].perform(path)
            if several:
                rest(path, identification.homing)
        if with_gait(identification.what, identification.network):
            for name, path in zip(names, exchange.paths, strict=True):
                if not path.mirrors:
                    swing_to(path, HANGING_RAD, paths[name].identification.guess, identification.homing)

    outcome = run_safely(link, tap, recorder, identification.network, identification.limits, perform)
    return outcome, {name: path.segments for name, path in paths.items()}


def pulls(identification: Identification, *, gait: bool) -> str:
    """Return the largest forces that an identification pulls, as a sentence; `gait`: with its gait trials."""
    bench, found = identification.network.bench, []
    for name, limits in by_path(identification.limits, bench).items():
        top_n = TOP_SHARE * limits.start_n
        most = {"stiffness": HIGH_N, "swing": LOW_N, "ramp": top_n, "pull": top_n}
        start_n = max(most.get(kind, 0.0) for kind in procedure(identification.what))
        start_n = max(start_n, top_n) if gait else start_n
        then = f", then to at most {reached_n(start_n):.0f} N" if start_n else ""
        found.append(f"{f'{name}: ' if len(bench.force_paths) > 1 else ''}Pulls START to at most "
                     f"{reached_n(identification.homing.top_n):.0f} N while homing{then}.")
    return " ".join(found)


def _shared(progress: Progress, done: float, part: float, what: str, share: float) -> None:
    progress(what, done + part * share)


def walk(
    link: Link, tap: can.BusABC | None, recorder: CycleSink | None, identification: Identification,
    calibrations: Mapping[str, Calibration], progress: Progress = lambda what, share: None,
) -> tuple[str | None, dict[str, list[Segment]]]:
    """Run the gait trials of an identification; return the cause of a stop, None if completed, and their segments.

    `calibrations` and segments are by force path. The controller runs without an earlier discrepancy, which the new
    one replaces.
    """
    known = {name: dataclasses.replace(one, discrepancy=None) for name, one in calibrations.items()}
    segments: dict[str, list[Segment]] = {name: [] for name in known}
    trials = gait_trials.run(link, tap, recorder, identification.network, identification.limits,
                             identification.homing, known, _recorded, TOP_SHARE)
    for i, (reason, walked) in enumerate(trials, 1):
        if reason is not None:
            return reason, segments
        for name, own in walked.items():
            segments[name] += own
        progress("gait", i / len(gait_trials.GAITS))
    return None, segments


def with_gait(what: str, network: Network) -> bool:
    """Return whether a procedure ends with gait trials: each force path needs its END sensor and its knee drive."""
    described = wire(network)
    return what in WALKED and all(path.end > 0 and path.knee in described.drives for path in described.paths)


def with_discrepancy(calibration: Calibration, segments: Sequence[Segment]) -> Calibration:
    """Return the calibration with the discrepancy that follows from the gait trials among the segments, if there are
    any.

    Homing before a gait trial found the bench as it was identified: later homings are taken relative to it.
    """
    beyond = discrepancy_fit.fit(segments, calibration, calibration_fit.rest(segments))
    homed = [segment.homed for segment in segments if segment.homed]
    found = dict(zip(HOMED, np.mean(homed, axis=0).tolist(), strict=True)) if homed else {}
    return dataclasses.replace(calibration, discrepancy=beyond, **found)


def procedure(what: str) -> tuple[str, ...]:
    """Return the experiments that identify `what`; raises `InputError` for an unknown procedure."""
    if what not in PROCEDURES:
        raise InputError(f"identify {what}: expected one of {', '.join(PROCEDURES)}.")
    return PROCEDURES[what]


def calibrate(what: str, segments: Sequence[Segment], guess: Calibration, *, bench: str, date: str,
              trial: str) -> Calibration:
    """Return the calibration from the segments of a procedure; undetermined scalars stay as in `guess`."""
    told: dict[str, tuple[float, ScalarEvidence]] = {}
    still = calibration_fit.rest(segments)
    told |= {name: (seen.value, seen.evidence) for name, seen in calibration_fit.start_at_rest(segments).items()}
    kinds = procedure(what)
    if "stiffness" in kinds:
        told |= _named(("stiffness_a", "stiffness_b", "rope_zero"),
                       calibration_fit.stiffness(segments, still.start_offset))
        drive = calibration_fit.bandwidth(segments)
        told["servo_bandwidth"] = drive.value, drive.evidence
    if "swing" in kinds:
        told |= _named(("rope_per_knee", "swing_p"), calibration_fit.swing(segments))
    if "ramp" in kinds:
        fitted, intervals = calibration_fit.loops(segments, _replaced(guess, told), still)
        for name, interval in intervals.items():
            if name == "rope_per_knee" and "swing" not in kinds:
                continue
            r_squared = told[name][1].r_squared if name in told else math.nan
            told[name] = getattr(fitted, name), dataclasses.replace(interval, r_squared=r_squared)
        told |= _as_homed(segments, _replaced(guess, told), still)
        told["identified_to"] = fitted.identified_to, ScalarEvidence(math.nan, math.nan)
    evidence = dict(guess.evidence) | {
        name: dataclasses.replace(proof, date=date, trial=trial) for name, (_, proof) in told.items()}
    together = fitted.correlation if "ramp" in kinds else guess.correlation
    return dataclasses.replace(_replaced(guess, told), evidence=evidence, bench=bench, label=trial,
                               correlation=together)


def _as_homed(
    segments: Sequence[Segment], found: Calibration, still: calibration_fit.Rest
) -> dict[str, tuple[float, ScalarEvidence]]:
    """Return the homing result of this session: the loop most like homing's own, at its knee angle."""
    ramps = [s for s in segments if s.kind == "ramp" and abs(float(s.knee[0]) - RAMP_KNEES_RAD[1]) < SAME_KNEE_RAD]
    if not ramps:
        return {}
    like = min(ramps, key=lambda s: abs(float(s.start.max()) - HALF_N))
    none = ScalarEvidence(math.nan, math.nan)
    return {name: (value, none) for name, value in zip(HOMED, calibration_fit.homed(like, found, still), strict=True)}


def _named(names: tuple[str, ...], line: LineFit) -> dict[str, tuple[float, ScalarEvidence]]:
    return dict(zip(names, zip(line.coefficients, line.evidence, strict=True), strict=True))


def _replaced(guess: Calibration, told: Mapping[str, tuple[float, ScalarEvidence]]) -> Calibration:
    values: dict[str, float] = {name: value for name, (value, _) in told.items()}
    return dataclasses.replace(guess, **values)  # type: ignore[arg-type]


def recorded(trial: Trial) -> list[Segment]:
    """The experiments that a trial recorded, from its events and its columns; cycles with a lost input are left out.

    Raises `InputError` where the trial holds none.
    """
    segments: list[Segment] = []
    begun: dict[str, int] = {}
    homed: tuple[float, ...] = ()
    time_ns, columns = trial.time_ns, trial.columns
    for event in trial.events:
        if event.kind != "identify":
            continue
        edge, kind, *more = event.text.split()
        if edge == "homed":
            homed = (float(kind), *map(float, more))
        elif edge == "begin":
            begun[kind] = event.time_ns
        elif kind in begun:
            rows = (columns["missed_inputs"] == 0) & (time_ns >= begun[kind]) & (time_ns < event.time_ns)
            segments.append(Segment(kind, float(np.median(np.diff(time_ns))) * 1e-9,
                                    *(columns[name][rows] for name in COLUMNS))._replace(homed=homed))
            homed = ()
    if not segments:
        raise InputError(f"{trial.path}: records no experiment of an identification; give a trial of bowden identify.")
    return segments


def _recorded(exchange: Exchange, kind: str, motion: Callable[[], object]) -> Segment:
    """Run a motion and return its columns; events mark its begin and end in the trial."""
    kept: list[KeptCycle] = []
    exchange.kept = kept
    exchange.log.event(exchange.inputs.sync_ns, "identify", exchange.name, f"begin {kind}")
    try:
        motion()
    finally:
        exchange.kept = None
        exchange.log.event(exchange.inputs.sync_ns, "identify", exchange.name, f"end {kind}")
    columns = dict(zip(KeptCycle._fields, np.array(kept).T, strict=True))
    return Segment(kind=kind, period_s=exchange.wire.period_ns * 1e-9, **columns)


class _Experiments:
    """The experiments of one procedure, in order; what they record is in `segments`."""

    def __init__(self, identification: Identification, progress: Progress) -> None:
        self.identification = identification
        self.segments: list[Segment] = []
        self._progress = progress
        self._steps = {"rest": self._rest, "stiffness": self._stiffness, "swing": self._swing, "ramp": self._ramp,
                       "pull": self._pull}

    def perform(self, exchange: Exchange) -> None:
        """Home, and run the experiments of the procedure; the drives are enabled."""
        given = self.identification
        home(exchange, given.guess, given.homing, SLACK_M, guessed=True)
        kinds = PROCEDURES[given.what]
        for i, kind in enumerate(kinds):
            self._progress(kind, i / len(kinds))
            self._steps[kind](exchange)
            self._slacken(exchange)
        self._progress("done", 1.0)

    def _record(self, exchange: Exchange, kind: str, motion: Callable[[], object]) -> None:
        self.segments.append(_recorded(exchange, kind, motion))

    def _slacken(self, exchange: Exchange) -> None:
        moves.reel(exchange, -SPEED_M_S, lambda inputs: inputs.start_n < 1.0, REACH_M, "the rope does not go slack")
        servo, knee = exchange.targets
        moves.move(exchange, servo - SLACK_M, knee, SPEED_M_S, self.identification.homing.knee_rad_s)

    def _rest(self, exchange: Exchange) -> None:
        self._record(exchange, "rest", lambda: moves.settle(exchange, REST_S))

    def _stiffness(self, exchange: Exchange) -> None:
        swing_to(exchange, RAMP_KNEES_RAD[1], self.identification.guess, self.identification.homing)
        self._reel(exchange, LOW_N)
        for _ in range(PULLS):
            self._record(exchange, "stiffness", lambda: self._reel(exchange, HIGH_N, -LOW_N))

    def _ramp(self, exchange: Exchange) -> None:
        for knee in RAMP_KNEES_RAD:
            swing_to(exchange, knee, self.identification.guess, self.identification.homing)
            for whole, speed in RAMPS:
                self._record(exchange, "ramp", functools.partial(self._pulled, exchange, whole, speed))
            self._slacken(exchange)

    def _pull(self, exchange: Exchange) -> None:
        swing_to(exchange, RAMP_KNEES_RAD[1], self.identification.guess, self.identification.homing)
        for speed in (SLOW_M_S, FAST_M_S):
            self._record(exchange, "ramp", functools.partial(self._pulled, exchange, True, speed))

    def _pulled(self, exchange: Exchange, whole: bool, speed_m_s: float) -> None:
        """Pull to the top, or to half the load, and release to slack."""
        until = self._at_top if whole else _above(HALF_N)
        moves.reel(exchange, speed_m_s, until, REACH_M, "the rope does not tighten")
        moves.reel(exchange, -speed_m_s, _below(SLACK_N), REACH_M, "the rope does not go slack")

    def _at_top(self, inputs: Inputs) -> bool:
        return inputs.end_n > TOP_END_N or inputs.start_n > TOP_SHARE * self.identification.limits.start_n

    def _swing(self, exchange: Exchange) -> None:
        swing_to(exchange, SWING_FROM_RAD, self.identification.guess, self.identification.homing)
        self._reel(exchange, LOW_N)
        self._record(exchange, "swing", lambda: swing_held(
            exchange, self.identification.guess.rope_per_knee, LOW_N, _swings(exchange.wire.period_ns * 1e-9)))

    def _reel(self, exchange: Exchange, *forces_n: float) -> None:
        """Pull to each START force, N, in turn; a negative one is released to."""
        for force in forces_n:
            if force > 0.0:
                moves.reel(exchange, SPEED_M_S, _above(force), REACH_M, "the rope does not tighten")
            else:
                moves.reel(exchange, -SPEED_M_S, _below(-force), REACH_M, "the rope does not go slack")


def _swings(period_s: float) -> Iterator[float]:
    """Return the knee angles, rad, by control cycle."""
    for step in range(round(SWINGS * SWING_S / period_s)):
        share = 0.5 * (1.0 - math.cos(2.0 * math.pi * step * period_s / SWING_S))
        yield SWING_FROM_RAD + share * (SWING_TO_RAD - SWING_FROM_RAD)


def _above(force_n: float) -> Callable[[Inputs], bool]:
    return lambda inputs: inputs.start_n > force_n


def _below(force_n: float) -> Callable[[Inputs], bool]:
    return lambda inputs: inputs.start_n < force_n
