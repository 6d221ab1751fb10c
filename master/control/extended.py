"""The controller beyond the paper: friction in series with pre-sliding, preview, drive inverse, learning.

The rule of this file: pure, and END is nowhere.  What is desired is known ahead, so the model is inverted for the
instant at which a target will act, and the drive's lag is undone; what is left is fed back from START by the
paper's impedance and learnt from gait cycle to gait cycle (`learning`), and so is what friction has become
(`friction`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from master.control import learning
from master.control.controller_io import ControllerInput, Outputs, Trace
from master.control.friction_following import evidence_of, follow, friction_evidence
from master.control.gait_table import GaitTable
from master.control.homing_fit import HomingFit
from master.settings import Impedance
from physics import inverse
from physics.calibration import Calibration
from physics.inverse import Law

NAN = math.nan
DEPARTURES = 9
"""Control cycles over which the knee's departure from its reference is differentiated, and one."""
SETTLED = 0.9
"""Pre-sliding states beyond which START tells of END again; while they turn over, the feedback holds still."""
FOLLOWED, TURNING, GAIN_ERROR, NORMAL_95 = 0.03, 0.15, 0.003, 1.96
"""Standard errors: of a followed exponent and of a turning one, relative; of START's gain; and the normal quantile."""
TARGET_CYCLES = 2
"""A target is taken over at the next SYNC and reached one cycle later."""


class Ahead(NamedTuple):
    """What the model answered for one control cycle: rope position less slack, m; exponents, slowness, slips."""

    position: float
    by_sheath: float
    by_knee: float
    sheath_slow: float
    knee_slow: float
    rope_slip: float
    fabric_slip: float

    @property
    def settled(self) -> bool:
        """Both slide fully, one way or the other."""
        return abs(self.rope_slip) > SETTLED and abs(self.fabric_slip) > SETTLED


class State(NamedTuple):
    """What the controller remembers.

    `law` is the model as friction was followed so far.  `departures`: of the knee from its reference, the latest
    last.  `paths`: the model's answers for this control cycle up to the farthest ahead.  `resting`: control cycles
    before the feedback listens again.  `learnt`: correction by sample of the gait cycle, m.  `history`: linked list
    (sample, feedback, evidence, older) of the gait cycle so far.
    """

    law: Law
    deviation_m: float = 0.0
    slip: tuple[float, ...] = tuple(inverse.Slip())
    departures: tuple[float, ...] = ()
    paths: tuple[Ahead, ...] = ()
    resting: int = 0
    learnt: tuple[float, ...] = ()
    history: Any = None


@dataclass(frozen=True)
class Config:
    """Constants of `step`; `ahead` is the delay and `lag` the drive's time constant, both in control cycles."""

    gait: GaitTable
    law: Law
    zero_m: float
    start_offset_n: float
    ahead: int
    lag: float
    decay: float
    gain_m_n: float
    filter: learning.Filter
    noise_n: float
    start_lag_s: float


def configure(calibration: Calibration, day: HomingFit, gait: GaitTable, impedance: Impedance) -> Config:
    """Fold the constants from a calibration, what homing found of the day, the gait and the impedance."""
    decay = math.exp(-impedance.stiffness_n_m / impedance.damping_n_s_m * gait.period_s)
    lag = 1.0 / (2.0 * math.pi * calibration.drive_bandwidth) / gait.period_s
    ahead = max(TARGET_CYCLES, round(calibration.loop_delay / gait.period_s))
    return Config(
        gait=gait,
        law=inverse.law(calibration, gait.period_s, day.friction, day.softness),
        zero_m=day.zero_m,
        start_offset_n=day.start_offset_n,
        ahead=ahead,
        lag=lag,
        decay=decay,
        gain_m_n=(1.0 - decay) / impedance.stiffness_n_m,
        filter=learning.design(gait.samples, gait.period_s, round(ahead + lag)),
        noise_n=calibration.start_noise,
        start_lag_s=calibration.start_lag,
    )


def step(seen: ControllerInput, state: State, config: Config) -> tuple[Outputs, State, Trace]:
    """One control cycle: the model's rope position for when the target acts, plus feedback, plus what was learnt."""
    gait, samples = config.gait, config.gait.samples
    now = seen.sample % samples
    if now == 0 and state.history is not None:
        state = _on_cycle_end(state, config)
    departures = (*state.departures, seen.knee_angle_rad - gait.knee[now])[-DEPARTURES:]
    paths, slip = _look_ahead(state, config, now, departures)
    here = paths[0]
    ratio = math.exp(here.by_sheath + here.by_knee)
    desired = gait.desired[now]
    rate = (gait.desired[(now + 1) % samples] - desired) / gait.period_s
    start = seen.start_n - config.start_offset_n
    estimated = start / ratio + config.start_lag_s * rate
    resting = max(state.resting - 1, 0) if here.settled else config.filter.lead
    deviation, history = state.deviation_m, state.history
    if gait.slack[now] > 0.0:
        deviation *= config.decay
    else:
        evidence = None
        if not resting:
            deviation = config.decay * deviation + config.gain_m_n * (desired - estimated)
            evidence = friction_evidence(
                state.law, seen.servo_position_m - config.zero_m, seen.knee_angle_rad, start, *here[1:5])
        history = (now, deviation, evidence, history)
    speed = paths[-1].position - paths[max(-3, -len(paths))].position
    feedforward = config.zero_m + paths[max(-2, -len(paths))].position + 0.5 * config.lag * speed
    target = feedforward + deviation + (state.learnt[now] if state.learnt else 0.0)
    after = State(state.law, deviation, slip, departures, paths, resting, state.learnt, history)
    half = _half_width(max(estimated, 0.0), ratio, rate, resting / config.filter.lead, here, config)
    trace = Trace(desired, estimated, feedforward, deviation, ratio, here.rope_slip, here.fabric_slip, half)
    return Outputs(target, gait.knee[(now + TARGET_CYCLES) % samples]), after, trace


def _look_ahead(
    state: State, config: Config, now: int, departures: tuple[float, ...]
) -> tuple[tuple[Ahead, ...], tuple[float, ...]]:
    """The model's answer one control cycle beyond the delay, the knee led on at the speed of its departure."""
    gait, cycles = config.gait, config.ahead + 1
    then = (now + cycles) % gait.samples
    speed = (departures[-1] - departures[0]) / (DEPARTURES - 1)
    knee = gait.knee[then] + departures[-1] + cycles * speed
    position, _start, by_sheath, by_knee, sheath_slow, knee_slow, slip = inverse.inverse(
        state.law, state.slip, gait.desired[then], knee)
    answer = Ahead(position - gait.slack[then], by_sheath, by_knee, sheath_slow, knee_slow, slip[0], slip[1])
    return (*state.paths, answer)[-(config.ahead + 2):], slip


def _half_width(force: float, ratio: float, rate: float, resting: float, here: Ahead, config: Config) -> float:
    """Half the 95 % interval of the END estimate, N: START's noise, lag and gain, the friction followed and turning.

    While friction turns over, and `resting` (1…0) after it, an exponent may lie anywhere between both ends.
    """
    law = config.law
    whole = law.cable_exponent + law.fabric_offset + 0.5 * law.fabric_slope
    turning = TURNING * whole * max(1.0 - abs(here.rope_slip), 1.0 - abs(here.fabric_slip), resting)
    known = FOLLOWED * (abs(here.by_sheath) + abs(here.by_knee))
    relative = math.sqrt(turning * turning + known * known + GAIN_ERROR * GAIN_ERROR)
    return NORMAL_95 * math.hypot(config.noise_n / ratio, relative * force, 0.5 * config.start_lag_s * rate)


def _on_cycle_end(state: State, config: Config) -> State:
    """A gait cycle is over: its feedback is learnt, its evidence moves the friction."""
    return state._replace(
        law=follow(state.law, evidence_of(state.history)),
        learnt=learning.learn(state.learnt, state.history, config.gait.samples, config.filter),
        history=None,
    )
