"""The controller beyond the paper: friction in series with pre-sliding, preview, drive inverse, learning.

Pure functions without END. The desired force is given in advance, so the model is inverted for the instant at which a
target will act, with the drive's lag compensated. The residual is fed back from START by the paper's impedance and
learnt from gait cycle to gait cycle (`learning`). The drive's own tracking error is learnt separately, from the
encoder, in every phase; changes of friction are estimated (`friction_following`).
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from estimation.transfer.homing_fit import HomingFit
from master.control import learning
from master.control.controller_io import ControllerInput, ControllerOutput, Trace
from master.control.friction_following import (
    LEAST_SHARE,
    FrictionChange,
    evidence_of,
    follow,
    friction_evidence,
    law_at,
)
from master.control.gait_table import GaitTable, at
from master.settings import Impedance
from physics import end_discrepancy, inverse
from physics.calibration import Calibration
from physics.inverse import Law
from physics.laws import Array

NAN = math.nan
DEPARTURES = 9
"""Samples of the knee's departure from its reference that are kept for its derivative: the span in control cycles,
plus one."""
SLIDING = 0.9
"""Pre-sliding states beyond which START determines END again; the feedback is frozen while they change sign."""
FOLLOWED, TURNING, GAIN_ERROR, NORMAL_95 = 0.03, 0.15, 0.003, 1.96
"""Standard errors: of a followed exponent and of a turning one, relative; of START's gain; and the normal quantile."""
TURNED, TURNING_FAST = 0.3, 0.002
"""Share of the feedback's gain while friction turns over; change of ln(START/END) in a control cycle that halves it."""
REACH_M = 4.5e-3
"""Greatest distance, m, of a target from the expected rope position: beyond the servo's window (0x6065, 5 mm) the
drive stops.
"""
FADED_S = 0.06
"""Time in which learnt corrections fade out where a phase is lost, and in where it is found, s."""
TARGET_CYCLES = 2
"""A target is taken over at the next SYNC and reached one cycle later."""


class Ahead(NamedTuple):
    """Model's result for one control cycle: rope position less slack, m; START and the rope's drag in it, N;
    exponents, slowness, slips; distance of the leg from the knee's drive by backlash, rad; the identified discrepancy
    of ln(START/END) and its standard deviation; desired END force, N, and slack, m."""

    position: float
    start: float
    drag: float
    by_sheath: float
    by_knee: float
    sheath_slow: float
    knee_slow: float
    rope_slip: float
    fabric_slip: float
    leg: float
    discrepancy: float
    doubt: float
    desired: float
    slack: float

    @property
    def slides_fully(self) -> bool:
        """True if rope and fabric both slide fully, each in either direction."""
        return abs(self.rope_slip) > SLIDING and abs(self.fabric_slip) > SLIDING


class ExtendedState(NamedTuple):
    """Memory of the controller.

    `law` is the model with friction as `followed` so far. `leg`: distance of the leg from the knee's drive, and the
    drive's angle, rad, farthest ahead. `seen_m`: last rope position. `departures`: of the knee from its reference,
    the latest last. `paths`: the model's results for this control cycle up to the farthest ahead; `wanted`: the
    desired positions, m, from this control cycle on. `resting`: control cycles before the feedback acts again.
    `learnt` and `tracked`: corrections by sample of the gait cycle, m, for the force and for the drive. `history`:
    linked list (sample, feedback, tracking error, observation, older) of the gait cycle so far. `place` and `rate`: of
    the last control cycle, in samples of the gait; a felt phase makes them fractions. `shifted_m`: shift of the rope's
    zero since homing, as it is followed. `learnt_share`: how much of both corrections acts; without a phase none.
    """

    law: Law
    followed: FrictionChange = FrictionChange()
    deviation_m: float = 0.0
    leg: tuple[float, float] = (0.0, NAN)
    seen_m: float = NAN
    slip: tuple[float, ...] = tuple(inverse.Slip())
    slips: tuple[float, ...] = end_discrepancy.UNTURNED
    departures: tuple[float, ...] = ()
    paths: tuple[Ahead, ...] = ()
    wanted: tuple[float, ...] = ()
    resting: int = 0
    learnt: tuple[float, ...] = ()
    tracked: tuple[float, ...] = ()
    history: Any = None
    place: float = 0.0
    rate: float = 1.0
    shifted_m: float = 0.0
    learnt_share: float = 1.0


@dataclass(frozen=True)
class ExtendedConfig:
    """Constants of `step`; `ahead` is the delay, `lag` the drive's and `start_lag` START's, in control cycles.

    `beyond` is the identified discrepancy, packed; None where the calibration has none.
    """

    gait: GaitTable
    law: Law
    zero_m: float
    start_offset_n: float
    ahead: int
    lag: float
    decay: float
    gain_m_n: float
    filter: learning.LearningFilter
    tracking: learning.LearningFilter
    noise_n: float
    start_lag: float
    start_gain: float
    least_n: float
    beyond: Array | None
    migration: tuple[float, float]


def configure(calibration: Calibration, day: HomingFit, gait: GaitTable, impedance: Impedance,
              migration: tuple[float, float] = (0.0, 0.0)) -> ExtendedConfig:
    """Compute the controller's constants once, from calibration, the session's homing fit, gait and impedance.

    `migration`: largest shift of the rope's zero that is followed, m: from one gait cycle to the next, and in total.
    """
    decay = math.exp(-impedance.stiffness_n_m / impedance.damping_n_s_m * gait.period_s)
    lag = 1.0 / (2.0 * math.pi * calibration.servo_bandwidth) / gait.period_s
    ahead = max(TARGET_CYCLES, round(calibration.servo_delay / gait.period_s))
    return ExtendedConfig(
        gait=gait,
        law=inverse.law(calibration, gait.period_s, day.friction, day.softness),
        zero_m=day.zero_m,
        start_offset_n=day.start_offset_n,
        ahead=ahead,
        lag=lag,
        decay=decay,
        gain_m_n=(1.0 - decay) / impedance.stiffness_n_m,
        filter=learning.design(gait.samples, gait.period_s, round(ahead + lag)),
        tracking=learning.design(gait.samples, gait.period_s, ahead, learning.TRACKED_HZ),
        noise_n=calibration.start_noise,
        start_lag=(calibration.start_lag + day.lag_s) / gait.period_s,
        start_gain=calibration.start_gain,
        least_n=LEAST_SHARE * max(gait.desired),
        beyond=None if calibration.discrepancy is None else calibration.discrepancy.packed(
            gait.period_s, calibration.presliding, calibration.fabric_presliding),
        migration=migration,
    )


class EndEstimate(NamedTuple):
    """END as START tells it: `force_n`, START without its lag, N, START/END beyond the drag, and START's rate, N per
    control cycle."""

    force_n: float
    start_n: float
    ratio: float
    rate_n: float


def step(
    seen: ControllerInput, state: ExtendedState, config: ExtendedConfig
) -> tuple[ControllerOutput, ExtendedState, Trace]:
    """Return one control cycle: the model's rope position for the time at which the target acts, plus feedback and
    correction."""
    gait = config.gait
    now = seen.sample % gait.samples if seen.place is None else seen.place
    state = _with_history(seen, state, config, now)
    departures = _departures(state, gait, seen.knee_angle_rad, now, seen.rate)
    paths, slip, slips, leg = look_ahead(state, config, now, departures, seen)
    here = paths[0]
    # a felt phase is led on to the instant at which a target acts; what was asked for then is what is desired now
    desired, slack = (gait.wanted(now, knee_rad=seen.knee_angle_rad) if seen.place is None
                      else (here.desired, here.slack))
    end = _end_from_start(seen.start_n, paths, config)
    resting = max(state.resting - 1, 0) if here.slides_fully else config.filter.lead
    deviation = _fed_back(state.deviation_m, desired, slack, end, paths, resting, config)
    position, feedforward = _rope(paths, config, state.shifted_m)
    fade = gait.period_s / FADED_S
    share = min(1.0, state.learnt_share + fade) if seen.rate > 0.0 else max(0.0, state.learnt_share - fade)
    force = deviation + (share * at(state.learnt, now) if state.learnt else 0.0)
    wanted = (*state.wanted, position + force)[-(config.ahead + 1):]
    target = feedforward + force + (share * at(state.tracked, now) if state.tracked else 0.0)
    reached = _reachable(target, seen.servo_position_m, state.seen_m)
    history = None
    if seen.share == 1.0:
        missed = wanted[0] - seen.servo_position_m if len(wanted) > config.ahead else 0.0
        # anti-windup: where the target is held back, a larger correction would change nothing
        history = (now, deviation if slack == 0.0 else 0.0, missed if reached == target else 0.0,
                   _evidence(seen, state, config, now, desired, slack, end, here) if not resting else None,
                   state.history)
    after = ExtendedState(
        state.law, state.followed, deviation, leg, seen.servo_position_m, slip, slips, departures, paths,
        wanted, resting, state.learnt, state.tracked, history, now, seen.rate, state.shifted_m,
        share)
    half = _half_width(max(end.force_n, 0.0), end.ratio, end.rate_n, resting / config.filter.lead, here, config)
    trace = Trace(desired, end.force_n, feedforward, deviation, end.ratio, here.rope_slip, here.fabric_slip, half,
                  state.shifted_m)
    return ControllerOutput(reached, at(gait.knee, now + TARGET_CYCLES * seen.rate)), after, trace


def _with_history(seen: ControllerInput, state: ExtendedState, config: ExtendedConfig, now: float) -> ExtendedState:
    """Return the memory after a gait cycle that has just ended; a stride whose phase was lost teaches nothing."""
    if state.history is None:
        return state
    if seen.share < 1.0:
        return state._replace(history=None)
    ended = now == 0 if seen.place is None else now < state.place - 0.5 * config.gait.samples
    return on_cycle_end(state, config) if ended else state


def _end_from_start(start_n: float, paths: tuple[Ahead, ...], config: ExtendedConfig) -> EndEstimate:
    """Estimate END, N: START by its offset, gain and lag, less the rope's drag, by e^(exponents + discrepancy).

    The lag is undone by the model's rate, since the measured one is noise.
    """
    here, after = paths[0], paths[min(1, len(paths) - 1)]
    ratio = math.exp(here.by_sheath + here.by_knee + here.discrepancy)
    rate = after.start - here.start
    start = (start_n - config.start_offset_n) / config.start_gain + config.start_lag * rate
    return EndEstimate((start - here.drag) / ratio, start, ratio, rate)


def _fed_back(deviation: float, desired: float, slack: float, end: EndEstimate, paths: tuple[Ahead, ...], resting: int,
              config: ExtendedConfig) -> float:
    """Return the deviation of the rope, m, of the paper's impedance, (12)–(15) with M = 0: B·ẋ + K·x = desired − END.

    It decays by e^(−K·t/B) in a control cycle; at idle nothing drives it.
    """
    if slack > 0.0:
        return deviation * config.decay
    heard = _heard(paths, resting)
    apart = trusted(desired - end.force_n, paths[0].doubt * desired)
    return (1.0 - heard + heard * config.decay) * deviation + heard * config.gain_m_n * apart


def _evidence(seen: ControllerInput, state: ExtendedState, config: ExtendedConfig, now: float, desired: float,
              slack: float, end: EndEstimate, here: Ahead) -> Any:
    """Return this control cycle's observation of friction and backlash; None at idle or below `least_n`."""
    if slack > 0.0 or desired <= config.least_n:
        return None
    return friction_evidence(
        state.law, state.followed, seen.servo_position_m - (config.zero_m + state.shifted_m),
        seen.knee_angle_rad + here.leg, end.start_n, here.drag, here[3:7], _side(state, here, config.gait, now),
        config.least_n)


def _rope(paths: tuple[Ahead, ...], config: ExtendedConfig, shifted_m: float) -> tuple[float, float]:
    """Return the rope position, m, wanted when the target acts, and the target that a drive with a lag needs for it.

    x + τ·ẋ of a first-order lag τ; ẋ over the last two control cycles.
    """
    position = config.zero_m + shifted_m + paths[max(-2, -len(paths))].position
    speed = paths[-1].position - paths[max(-3, -len(paths))].position
    return position, position + 0.5 * config.lag * speed


def _reachable(target: float, seen_m: float, before_m: float) -> float:
    """Return the target within `REACH_M` of where the rope will be when the target is reached."""
    moved = 0.0 if math.isnan(before_m) else seen_m - before_m
    then = seen_m + TARGET_CYCLES * moved
    return min(max(target, then - REACH_M), then + REACH_M)


def _departures(state: ExtendedState, gait: GaitTable, knee: float, now: float, rate: float) -> tuple[float, ...]:
    """Return the knee's departures from its reference, rad, this one last.

    If a felt phase is lost or found, the reference jumps: the older departures are then extrapolated from this one at
    the knee's measured speed.
    """
    departure = knee - at(gait.knee, now)
    known = state.departures
    if not known or (rate > 0.0) == (state.rate > 0.0):
        return (*known, departure)[-DEPARTURES:]
    samples = gait.samples
    led = [at(gait.knee, place % samples) - at(gait.knee, (place - step) % samples)
           for place, step in ((state.place, state.rate), (now, rate))]
    speed = (known[-1] - known[0]) / (DEPARTURES - 1) + led[0] - led[1]
    return tuple(departure - i * speed for i in range(DEPARTURES - 1, -1, -1))


def _heard(paths: tuple[Ahead, ...], resting: int) -> float:
    """Return the share of the feedback's gain: 1 while rope and fabric slide, less while they reverse.

    During a reversal the rope is stiffer by the factor in `TURNED`, and the faster START departs from END, the less END
    can be estimated from it.
    """
    if not resting:
        return 1.0
    here, after = paths[0], paths[min(1, len(paths) - 1)]
    change = abs(after.by_sheath + after.by_knee - here.by_sheath - here.by_knee)
    return TURNED / (1.0 + (change / TURNING_FAST) ** 2)


def trusted(error_n: float, doubt_n: float) -> float:
    """Return how much of an error of END is fed back and so learnt, N: e·e²/(e² + σ²).

    σ is the standard deviation of the estimate by the identified discrepancy; without one the error is taken whole.
    """
    if not doubt_n:
        return error_n
    square = error_n * error_n
    return error_n * square / (square + doubt_n * doubt_n)


def _side(state: ExtendedState, here: Ahead, gait: GaitTable, now: float) -> float:
    """Return the leg's position in its backlash, −1…1; before the backlash is estimated, the side behind the knee's
    motion."""
    if state.followed.play > 0.0:
        return here.leg * state.law.rope_per_knee / state.followed.play
    moved = at(gait.knee, now + 1) - at(gait.knee, (now - 1) % gait.samples)
    return -math.copysign(1.0, moved) if moved else 0.0


def look_ahead(
    state: ExtendedState, config: ExtendedConfig, now: float, departures: tuple[float, ...], seen: ControllerInput
) -> tuple[tuple[Ahead, ...], tuple[float, ...], tuple[float, ...], tuple[float, float]]:
    """Return the model's results, pre-sliding states and leg one control cycle beyond the delay.

    The knee is extrapolated at the speed of its departure; the leg follows the knee's drive with the estimated
    backlash.
    """
    gait, cycles = config.gait, config.ahead + 1
    then = (now + (cycles if seen.place is None else cycles * seen.rate)) % gait.samples
    speed = (departures[-1] - departures[0]) / (DEPARTURES - 1)
    knee = at(gait.knee, then) + departures[-1] + cycles * speed
    desired, slack = gait.wanted(then, seen.share, knee)
    half = state.followed.play / state.law.rope_per_knee
    moved = 0.0 if math.isnan(state.leg[1]) else knee - state.leg[1]
    behind = min(half, max(-half, state.leg[0] - moved))
    position, start, by_sheath, by_knee, sheath_slow, knee_slow, slip = inverse.inverse(
        state.law, state.slip, desired, knee + behind)
    drag = start - desired * math.exp(by_sheath + by_knee)
    beyond, doubt, slips = 0.0, 0.0, state.slips
    if config.beyond is not None:
        beyond, doubt, slips = end_discrepancy.evaluate(
            config.beyond, slips, desired, knee, state.slip, slip, sheath_slow, knee_slow)
    lacking = (start - drag) * math.expm1(beyond)
    answer = Ahead(
        position + state.law.rope_compliance * lacking - slack, start + lacking, drag, by_sheath, by_knee,
        sheath_slow, knee_slow, slip[0], slip[1], behind, beyond, doubt, desired, slack)
    return (*state.paths, answer)[-(config.ahead + 2):], slip, slips, (behind, knee)


def _half_width(force: float, ratio: float, rate: float, resting: float, here: Ahead, config: ExtendedConfig) -> float:
    """Return half of the 95 % interval of the END estimate, N: START's noise, lag and gain, and the uncertainty of
    friction.

    While friction turns over, and `resting` (1…0) after it, an exponent may lie anywhere between both ends.
    """
    law = config.law
    whole = law.cable_exponent + law.fabric_offset + 0.5 * law.fabric_slope
    turning = TURNING * whole * max(1.0 - abs(here.rope_slip), 1.0 - abs(here.fabric_slip), resting)
    known = FOLLOWED * (abs(here.by_sheath) + abs(here.by_knee))
    relative = math.sqrt(turning * turning + known * known + GAIN_ERROR * GAIN_ERROR + here.doubt * here.doubt)
    return NORMAL_95 * math.hypot(config.noise_n / ratio, relative * force, 0.5 * config.start_lag * rate / ratio)


def _migrated(learnt: Array, feedback: Array, shifted_m: float, config: ExtendedConfig) -> tuple[Array, Array, float]:
    """Return (learnt correction, feedback, shift) of a gait cycle, m, after the shift of the rope's zero is moved out
    of both.

    A shifted zero moves the rope equally under every load: the shift is the mean correction while a force is desired.
    It also applies at idle, where nothing measures it.
    """
    by_stride, in_all = config.migration
    taut = 1.0 - np.array(config.gait.slack) / max(config.gait.slack)
    held, fed = (float(column[taut == 1.0].mean()) for column in (learnt, feedback))
    after = shifted_m + min(max(held + fed, -by_stride), by_stride)
    after = min(max(after, -in_all), in_all)
    return learnt - held * taut, feedback - (after - shifted_m - held) * taut, after


def on_cycle_end(state: ExtendedState, config: ExtendedConfig) -> ExtendedState:
    """Update the memory at the end of a gait cycle: learn the feedback and the drive's errors, estimate the friction.
    """
    followed = follow(state.followed, evidence_of(state.history))
    feedback, missed = learning.columns(state.history, config.gait.samples)
    known, shifted_m = state.learnt, state.shifted_m
    if config.migration[1] > 0.0:
        held = np.array(known) if known else np.zeros(config.gait.samples)
        held, feedback, shifted_m = _migrated(held, feedback, shifted_m, config)
        known = tuple(held.tolist())
    learnt = learning.learn(known, feedback, config.filter)
    return state._replace(
        law=law_at(config.law, followed), followed=followed, learnt=learnt, shifted_m=shifted_m,
        tracked=learning.learn(state.tracked, missed, config.tracking), history=None)
