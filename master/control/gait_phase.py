"""Phase of the gait from the knee angle alone: an extended Kalman filter about a template of the wearer's stride.

Pure functions: `step` takes its memory and returns it.  The angle is that of the mean stride at the phase, its
amplitude scaled, and what this stride departs from it, smooth in time; there is no clock:

    y = m + a·T(φ) + d,                                                              (1)
    φ' = ω,   ω' = −(ω − ω0)/τ + w1,   a' = −(a − 1)/τ + w2,   d'' = −2λd' − λ²d + w3.   (2)

T is the template less its mean m, ω0 the mean stride's rate, τ the duration of a stride.  (1) and (2) without d are
Thatte, Shah & Geyer (2019), IEEE Robot. Autom. Lett. 4, 3232, eqs. 1–4; d, a Matérn process of order 3/2 (Rasmussen &
Williams, Gaussian Processes, 2006, eq. 4.17 and B.2.1), has the errors of a template, which last for a part of a
stride: they are no white noise.  The filter is the discrete one of Simon, Optimal State Estimation (2006), eqs.
13.46–13.49, and sees speed through d, as the angle has next to no noise of its own.

Innovation test.  A stride is explained by what the filter has had to assume: while it walks, d, d', ω and a are drawn
from their stationary distributions, so their squared distance from it is below the 0.999 quantile of χ² with four
degrees of freedom.  Beyond `LOST` of that there is no phase.  Without a phase, the last half second of the angle, at
`DELAY_S`, is compared with the template at every phase and at five rates (a time-delay embedding; Takens 1981): the
phase whose likelihood is `ODDS` times that of every phase not near it begins the filter anew.
"""

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from master.control.gait_table import GaitTable, at
from physics.laws import Array

PHASE, RATE, SIZE, AWAY, AWAY_RATE, STATES = range(6)
"""Places of the filter's states: phase φ, cycles; rate ω, cycles/s; amplitude a of the stride, relative; departure d of
the knee from the stride, rad; its rate d', rad/s."""
COVARIANCE = STATES
HELD = COVARIANCE + STATES**2
"""First place of the memory behind the filter: 1 if a phase is estimated.  `SINCE`: control cycles since the last
angle was stored; `FILLED`: number of stored angles."""
SINCE, FILLED, LINKED = HELD + 1, HELD + 2, HELD + 3
RING = HELD + 4
DELAYS: Final = 25
DELAY_S: Final = 0.02
"""Number of kept angles and the time between two, s: half a second, which holds a swing or a stance."""
MEMORY = RING + DELAYS

RATE_SHARE, SIZE_SHARE = 0.06, 0.06
"""Standard deviation of a stride's rate and amplitude, relative: ± 8 and ± 10 % drawn evenly are 0.046 and 0.058."""
LAMBDA_T: Final = 11.0
"""Decay rate λ of the departure d times the duration of a stride: the autocorrelation of d falls to 0.5 after 15 % of
the gait, as that of the recorded strides does."""
NOISE_RAD: Final = 5e-4
"""Standard deviation of an encoder's angle, rad."""
LOST: Final = 18.5
"""χ² of four degrees of freedom at 0.999.

At 1 − 10⁻⁵ a wearer who stumbles at 5 % of the gait, with a flexion like that of a leg that is being loaded, was pulled
for 150 ms before the phase was lost.
"""
ODDS: Final = 1000.0
NEAR: Final = 0.1
PHASES: Final = 100
RATES: Final = (0.88, 0.94, 1.0, 1.06, 1.12)
FITS: Final = 13.8
"""χ² of two degrees of freedom at 0.999: how well a phase must explain the window."""


class Reading(NamedTuple):
    """Phase, cycles; rate, cycles/s; standard deviation of the phase, cycles, 0.29 (none at all) without a phase; χ² of
    the innovation test; whether there is a phase, and whether it was found in this control cycle."""

    phase: float
    rate: float
    doubt: float
    distance: float
    known: bool
    fresh: bool


RAMP_S: Final = 0.06
"""Time, s, in which the force falls to zero after the phase is lost, and then in which the rope is paid out.

With the innovation test's own delay, a stumble is answered within a tenth of a second. Shorter: the target reaches the
drive's speed limit.
"""
MARGIN, SURE = 0.05, 0.01
"""Part of a stride for which the rope must stay slack before the force is asked for again, and the greatest standard
deviation of the phase then, cycles: half of that with which a phase begins, so that some time passes."""


def follow(share: float, reading: Reading, gait: GaitTable) -> float:
    """Return the share of the desired force that is asked for in the next control cycle.

    1 while there is a phase; from its loss on it falls to 0 in `RAMP_S`, and to −1, where the rope is paid out, in as
    long.  It is 1 again from a phase on at which the rope is slack anyway, so that the force begins where it always
    does.
    """
    if share == 1.0 and reading.known:
        return 1.0
    if share == -1.0 and reading.known and reading.doubt < SURE:
        place = reading.phase * gait.samples
        if at(gait.slack, place) == at(gait.slack, place + MARGIN * gait.samples) == max(gait.slack):
            return 1.0
    return max(-1.0, share - gait.period_s / RAMP_S)


@dataclass(frozen=True)
class PhaseConfig:
    """Constants of `step`: the template by sample of the stride, its mean, rate ω0 (1/s) and control period (s).

    `transition` and `added` are (2) over a control period: the matrix of the states, and the covariance that it adds.
    """

    template: Array
    transition: Array
    added: Array
    mean_rad: float
    rate_hz: float
    period_s: float
    away_rad: float

    @property
    def packed(self) -> tuple[float, ...]:
        """Return the scalars of the compiled functions."""
        return self.mean_rad, self.rate_hz, self.period_s, self.away_rad


def configure(knee_rad: Array, period_s: float, away_rad: float) -> PhaseConfig:
    """Return the constants for a mean stride, rad by sample of `period_s`, and a standard deviation of strides, rad."""
    rate_hz = 1.0 / (knee_rad.size * period_s)
    lam, fade = LAMBDA_T * rate_hz, math.exp(-rate_hz * period_s)
    decay, f = math.exp(-lam * period_s), np.eye(STATES)
    f[PHASE, RATE], f[RATE, RATE], f[SIZE, SIZE] = period_s, fade, fade
    turn = lam * period_s
    f[AWAY:, AWAY:] = decay * np.array([[1.0 + turn, period_s], [-lam * turn, 1.0 - turn]])
    still = np.diag([0.0, (RATE_SHARE * rate_hz) ** 2, SIZE_SHARE**2, away_rad**2, (lam * away_rad) ** 2])
    added = still - f @ still @ f.T  # what leaves each stationary distribution as it is
    added[PHASE, :], added[:, PHASE] = 0.0, 0.0
    return PhaseConfig(knee_rad - knee_rad.mean(), f, added, float(knee_rad.mean()), rate_hz, period_s, away_rad)


def initial() -> Array:
    """Return the memory before the first angle: no phase."""
    return np.zeros(MEMORY)


def step(config: PhaseConfig, memory: Array, angle_rad: float) -> tuple[Reading, Array]:
    """Return the reading after one more control cycle, and the memory; a NaN is an angle that did not come."""
    after = memory.copy()
    distance = _step(after, config.template, config.transition, config.added, config.packed, angle_rad)
    known = bool(after[HELD] > 0.0)
    doubt = math.sqrt(max(0.0, after[COVARIANCE])) if known else math.sqrt(1.0 / 12.0)
    return Reading(float(after[PHASE]), float(after[RATE]) if known else 0.0, min(doubt, math.sqrt(1.0 / 12.0)),
                   distance, known, known and memory[HELD] == 0.0), after


@njit(inline="always")
def _template(template: Any, phase: float) -> Any:
    """Return (T, dT/dφ) at a phase, cycles, by linear interpolation."""
    n = template.size
    x = (phase - math.floor(phase)) * n
    i = int(x)
    a, b = template[i % n], template[(i + 1) % n]
    return a + (x - i) * (b - a), (b - a) * n


def _compile() -> Any:
    @njit(cache=True)
    def step(s: Any, template: Any, transition: Any, added: Any, scalars: Any, angle: float) -> float:
        mean, rate0, dt, away = scalars
        if angle == angle:
            s[SINCE] += 1.0
            if s[SINCE] * dt >= DELAY_S:
                s[SINCE] = 0.0
                s[RING + 1:RING + DELAYS] = s[RING:RING + DELAYS - 1].copy()
                s[RING] = angle
                s[FILLED] = min(DELAYS, s[FILLED] + 1.0)
                if s[HELD] == 0.0 and s[FILLED] == DELAYS:
                    _acquire(s, template, mean, rate0, away)
        if s[HELD] == 0.0:
            return 0.0
        n = STATES
        lam = LAMBDA_T * rate0
        x = transition @ s[:n]
        x[RATE] += (1.0 - transition[RATE, RATE]) * rate0
        x[SIZE] += 1.0 - transition[SIZE, SIZE]
        p = transition @ s[COVARIANCE:COVARIANCE + n * n].reshape(n, n) @ transition.T + added
        if angle == angle:
            value, slope = _template(template, x[PHASE])
            h = np.array([x[SIZE] * slope, 0.0, value, 1.0, 0.0])
            ph = p @ h
            gain = ph / (h @ ph + NOISE_RAD**2)
            x += gain * (angle - mean - x[SIZE] * value - x[AWAY])
            p -= np.outer(gain, ph)
        x[PHASE] -= math.floor(x[PHASE])
        s[:n] = x
        s[COVARIANCE:COVARIANCE + n * n] = (0.5 * (p + p.T)).ravel()
        distance = ((x[AWAY] / away) ** 2 + (x[AWAY_RATE] / (lam * away)) ** 2
                    + ((x[RATE] / rate0 - 1.0) / RATE_SHARE) ** 2 + ((x[SIZE] - 1.0) / SIZE_SHARE) ** 2)
        if distance > LOST:
            s[HELD] = s[FILLED] = 0.0
        return float(distance)

    return step


@njit(cache=True)
def _acquire(s: Any, template: Any, mean: float, rate0: float, away: float) -> None:
    """Search the phase: compare the stored angles with the template at every phase and rate; start the filter if one
    fits."""
    misfit = np.empty(PHASES)
    rates = np.empty(PHASES)
    effective = 0.5 * LAMBDA_T * rate0 * DELAY_S * DELAYS
    for i in range(PHASES):
        misfit[i] = np.inf
        for ratio in RATES:
            total = 0.0
            for k in range(DELAYS):
                value, _slope = _template(template, i / PHASES - k * DELAY_S * ratio * rate0)
                total += (s[RING + k] - mean - value) ** 2
            if total < misfit[i]:
                misfit[i], rates[i] = total, ratio
    best = int(np.argmin(misfit))
    weight = effective / (DELAYS * away * away)
    other = np.inf
    for i in range(PHASES):
        apart = abs(i - best) / PHASES
        if min(apart, 1.0 - apart) > NEAR:
            other = min(other, misfit[i])
    if weight * misfit[best] > FITS or 0.5 * weight * (other - misfit[best]) < math.log(ODDS):
        return
    n = STATES
    lam = LAMBDA_T * rate0
    s[:n] = np.array([best / PHASES, rates[best] * rate0, 1.0, 0.0, 0.0])
    s[COVARIANCE:COVARIANCE + n * n] = np.diag(np.array([
        0.02**2, (RATE_SHARE * rate0) ** 2, SIZE_SHARE**2, away * away, (lam * away) ** 2])).ravel()
    s[HELD] = 1.0


_step: Final[Any] = _compile()
"""_step(memory, template, transition, added, scalars, angle) → χ² of the innovation test; changes the memory."""
