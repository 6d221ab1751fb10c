"""Homing: the encoder zero and the homing fit, at 13 % of gait, from a pull and a release.

After homing x = x1(F) + k2·(θk − θk(13 %)) holds. (10) is a fit through pulling and releasing, so the zero comes from
the middle of a friction loop, never from one side of it. The rope is pulled through the preload, on to the point from
which the release slides again, and back through the preload. Before anything faster moves, the result is compared with
the calibration, and the sensors with each other; what disagrees is refused with both numbers.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

import numpy as np

from estimation.transfer.homing_fit import HomingFit, adapt
from master.cycle import drives
from master.cycle.exchange import NEEDED, Exchange
from master.cycle.inputs import Inputs
from master.cycle.plausibility import HomingBaseline
from master.motion import moves
from master.network.bringup import BringUpError
from master.network.sdo import SdoError
from master.settings import Homing
from physics import laws, stretch
from physics.calibration import NOMINAL, Calibration, nominal
from physics.laws import Array

STRETCH: Final = 1.6
"""Greatest ratio between homing's stretch and an identified bench's: day and creep change it by a tenth."""
STRETCH_NOMINAL: Final = 2.5
"""Largest ratio of stretches for the packaged calibration, which belongs to no bench."""
STRETCH_GUESSED: Final = 5.0
"""Largest ratio of stretches for a bench about to be identified: 5 to 25 mm at 60 N are usual benches, a unit that is
wrong by a factor of ten is outside."""
CENTRE: Final = 0.45
"""|mean of ln(START/END)| of pull and release, zero by friction alone; ln 2 is a gain of two."""
FORCE_RMS_N: Final = 6.0
PACKAGED_ROPE_PER_KNEE: Final = nominal().rope_per_knee
"""Rope per knee angle, m/rad, of a human-sized knee: the packaged calibration's rope_per_knee."""
SWING_UNLIKE: Final = 0.25
"""Relative departure from `PACKAGED_ROPE_PER_KNEE` beyond which homing measures it; usual benches stay within 0.15."""
SWING: Final = 0.2
"""Greatest relative difference between homing's rope_per_knee and a calibration's."""


def refuse_swing(calibration: Calibration, found: float) -> None:
    """Raise `BringUpError`, with both numbers, if homing `found` a rope_per_knee, m/rad, unlike the calibration's."""
    if abs(found / calibration.rope_per_knee - 1.0) > SWING:
        raise BringUpError(
            f"calibration {calibration.label}: its rope_per_knee is {calibration.rope_per_knee:.4f} m/rad, homing "
            f"found {found:.4f} m/rad; identify this bench (bowden identify all) and start again.")


def refuse_disagreement(exchange: Exchange, calibration: Calibration, *, guessed: bool = False) -> None:
    """Take over the results of homing; raises `BringUpError` if they disagree with the calibration.

    A `guessed` calibration is about to be measured: its stretch may be another bench's.
    """
    learned = exchange.plausibility.learn(calibration.stiffness_a, calibration.stiffness_b)
    sentence = disagreement(learned, calibration, guessed=guessed) or among_sensors(learned)
    if sentence is not None:
        raise BringUpError(sentence)


def disagreement(learned: HomingBaseline, calibration: Calibration, *, guessed: bool = False) -> str | None:
    """Return a sentence if homing's stretch differs from the calibration's, with both numbers; None if it agrees."""
    known = STRETCH_NOMINAL if calibration.label == NOMINAL else STRETCH
    ratio, most = learned.stretch_ratio, STRETCH_GUESSED if guessed else known
    if ratio < 1.0 / most or ratio > most:
        top = learned.top_n
        declared = 1e3 * (calibration.stiffness_b * 0.75 * top + calibration.stiffness_a * 0.9375 * top**2)
        return (f"calibration {calibration.label}: its rope and fabric stretch by {declared:.2f} mm from "
                f"{0.25 * top:.3g} to {top:.3g} N, homing found {ratio * declared:.2f} mm; identify this bench (bowden "
                "identify all) and start again.")
    return None


def among_sensors(learned: HomingBaseline) -> str | None:
    """Return a sentence if the sensors contradict each other beyond friction, with both numbers; None otherwise."""
    centre = 0.5 * (learned.low + learned.high)
    if learned.low and learned.high and abs(centre) > CENTRE:
        return (f"homing: pulled and released, START is {100.0 * 2.718281828 ** centre:.0f} % of END in the middle, "
                "where friction leaves 100 %; check the scaling of both sensors (0x6126) and tare them.")
    if learned.force_rms_n > FORCE_RMS_N:
        return (f"homing: the servo's force and START disagree by {learned.force_rms_n:.1f} N rms beyond friction and "
                f"inertia, expected below {FORCE_RMS_N:g} N; check START's scaling (0x6126) and the servo's torque.")
    return None


SLACK_N = 1.0
REST_S = 0.2
AROUND = 0.2
"""Share of the preload around it within which START readings determine the crossing, by a straight line."""
HOLD_GAIN_M_S_N, HOLD_FILTER_S = 3e-3, 5e-3
"""Rope speed per newton that START lacks while the knee swings: 2 Hz at 20 N, stable against a stuck rope."""
BRISK = 4.0
"""Speed of a slack rope relative to that of a rope under tension."""
SWING_CHECK_RAD = 0.15
"""Shift of the rope by a swing of 6 mm at the packaged rope_per_knee: ten times the error of a loop's middle by
friction, within any knee's limits."""


LOOP: Final = 2.25
"""Least ratio of the loop's top to the preload: with the packaged friction the release slides again before it."""


LIFT: Final = 1.125
"""Ratio of the largest START tension while homing to the peak desired force. Friction keeps END below that peak."""


def within(homing: Homing, calibration: Calibration, peak_n: float) -> tuple[Homing, Calibration]:
    """Return homing that pulls no harder than a trial whose desired force reaches `peak_n`, N, and its calibration.

    The preload falls with the top, since equation (10) fixes the same zero at any tension.  The rope goes slower by
    as much, so that as many cycles see START near the preload.  `homing.least_n` may be reached whatever the peak is.
    """
    top = min(homing.top_n, max(homing.least_n, LIFT * peak_n))
    slower = top / homing.top_n
    return (dataclasses.replace(homing, top_n=top, rope_m_s=homing.rope_m_s * slower),
            dataclasses.replace(calibration, home_preload=min(calibration.home_preload, top / LOOP)))


def reached_n(top_n: float) -> float:
    """Return the largest START tension, N, of a homing that stops at `top_n`: the rope overshoots by a cycle or two.

    In the simulated bench population the largest are 13.7 N for 12 N, and 51.1 N for 45 N.
    """
    return 1.5 + 1.1 * top_n


class HomingResult(NamedTuple):
    """Result of homing: the half-width, m, of the friction loop at the preload, and the homing fit."""

    half_width_m: float
    day: HomingFit


Row = tuple[float, float, float]
"""START tension, N, rope position, m, knee angle, rad."""


def home(
    exchange: Exchange, calibration: Calibration, homing: Homing, slack_m: float, start_gain: float = 1.0,
    stretched: Callable[[Array, float], Array] | None = None, *, guessed: bool = False,
) -> HomingResult:
    """Home the servo, and slacken the rope by `slack_m` beyond the loss of its tension.

    Both drives must be enabled; `start_gain` is START's reading of 1 N. `stretched`: stretch, m, by effects beyond the
    calibration, of the loop's tensions, N, and its period, s. `guessed`: the calibration is the starting point of an
    identification, so another stretch is no contradiction. Raises `BringUpError` if the rope does not
    tighten, the loop has no crossing, or homing contradicts the calibration or itself.
    """
    knee_home = float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
    exchange.plausibility.begin_learning(calibration.rope_per_knee, knee_home, calibration.cable_compliance)
    swing_to(exchange, knee_home, calibration, homing)
    reading = slack_reading(exchange)
    pulled, released = _loop(exchange, homing)
    if stretched is not None:
        rows = pulled + released
        more = stretched(np.array([row[0] for row in rows]) / start_gain, exchange.wire.period_ns * 1e-9)
        rows = [(start_n, rope_m - of, knee) for (start_n, rope_m, knee), of in zip(rows, more.tolist(), strict=True)]
        pulled, released = rows[:len(pulled)], rows[len(pulled):]
    at = [crossing(rows, start_gain * calibration.home_preload) for rows in (pulled, released)]
    if abs(calibration.rope_per_knee / PACKAGED_ROPE_PER_KNEE - 1.0) > SWING_UNLIKE and not guessed:
        _refuse_other_swing(exchange, calibration, homing, sum(at) / 2.0, start_gain)
    refuse_disagreement(exchange, calibration, guessed=guessed)
    shift = float(stretch.position(calibration, calibration.home_preload)) - 0.5 * (at[0] + at[1])
    moves.move(exchange, exchange.targets[0] - slack_m, knee_home, homing.rope_m_s, homing.knee_rad_s)
    inputs = moves.settle(exchange, REST_S)
    drives.set_home(exchange, round((inputs.servo_position_m + shift) * 1e6))
    start, position, angle = np.array(pulled + released).T
    work = adapt(calibration, exchange.wire.period_ns * 1e-9, position + shift, start / start_gain, angle,
                 reading / start_gain, undeclared_lag(exchange, calibration))
    day = moves.hold_while(exchange, work)
    return HomingResult(0.5 * abs(at[0] - at[1]), day._replace(start_offset_n=reading))


def swing_held(exchange: Exchange, rope_per_knee: float, force_n: float, angles: Iterable[float]) -> None:
    """Lead the knee through `angles`, rad, with the rope following, START held by an integral of its error.

    With a knee without a drive the rope follows the encoder's angle.
    """
    period_s = exchange.wire.period_ns * 1e-9
    held, knee = exchange.targets
    if not exchange.knee_driven:
        knee = exchange.inputs.knee_angle_rad
    tension, share = force_n, min(1.0, period_s / HOLD_FILTER_S)
    for angle in angles:
        tension += share * (exchange.inputs.start_n - tension)
        held += HOLD_GAIN_M_S_N * (force_n - tension) * period_s
        led = angle if exchange.knee_driven else exchange.inputs.knee_angle_rad
        exchange.advance(held + rope_per_knee * (led - knee), angle)


def undeclared_lag(exchange: Exchange, calibration: Calibration) -> float:
    """Return START's lag, s, as the sensor declares it, beyond that of an unmeasured calibration; else 0."""
    proof = calibration.evidence.get("start_lag")
    if proof is not None and math.isfinite(proof.low):
        return 0.0
    declared = declared_lag(exchange, exchange.path.start)
    return 0.0 if declared is None else declared - calibration.start_lag


def declared_lag(exchange: Exchange, node_id: int) -> float | None:
    """Return the lag, s, of a CiA 404 channel by its interval (0x6114) and filter (0x61A0, 0x61A1); None without
    them.

    Half an interval for the sampling, half for its age; of a moving average half of its length in addition, and of a
    block average half of the block.
    """
    try:
        interval_us, kind, constant = (
            int.from_bytes(exchange.link.sdo_read(node_id, index, 1), "little") for index in (0x6114, 0x61A0, 0x61A1))
    except SdoError:
        return None
    averaged = {1: 0.5 * (constant - 1), 2: 0.5 * (constant - 1) + 0.5 * constant}.get(kind, 0.0)
    return (1.0 + averaged) * interval_us * 1e-6


def swing_to(exchange: Exchange, knee_rad: float, calibration: Calibration, homing: Homing) -> None:
    """Bring the knee there with the rope loose: paid out first, then led along with the knee."""
    moves.reel(exchange, -homing.rope_m_s, lambda inputs: inputs.start_n < SLACK_N, homing.reach_m,
               "the rope does not go slack; release it by hand or tare START")
    if not exchange.knee_driven:
        moves.follow_joint(exchange, knee_rad, calibration.rope_per_knee, homing.knee_rad_s)
    servo, knee = exchange.targets
    led = servo + calibration.rope_per_knee * (knee_rad - knee)
    moves.move(exchange, led, knee_rad, BRISK * homing.rope_m_s, homing.knee_rad_s)
    moves.settle(exchange, REST_S)


def slack_reading(exchange: Exchange) -> float:
    """Return START's mean reading, N, at rest with a slack rope."""
    readings = []
    for _ in range(round(REST_S * 1e9 / exchange.wire.period_ns)):
        inputs = exchange.hold()
        if not inputs.missing & NEEDED:
            readings.append(inputs.start_n)
    return float(np.mean(readings)) if readings else 0.0


def _loop(exchange: Exchange, homing: Homing) -> tuple[list[Row], list[Row]]:
    """Pull to the top and release to slack; return the rows of both."""
    pulled: list[Row] = []
    released: list[Row] = []
    moves.reel(exchange, homing.rope_m_s, lambda inputs: inputs.start_n > homing.top_n, homing.reach_m,
               "the rope does not tighten; take up its slack by hand", _into(pulled))
    moves.reel(exchange, -homing.rope_m_s, lambda inputs: inputs.start_n < SLACK_N, homing.reach_m,
               "the rope does not go slack; tare START",
               _into(released))
    return pulled, released


def _refuse_other_swing(
    exchange: Exchange, calibration: Calibration, homing: Homing, at_home_m: float, start_gain: float
) -> None:
    """Pull and release at a second knee angle: the shift of the loop's middle is the bench's rope_per_knee.

    The knee turns in the direction in which a wrong rope_per_knee makes the rope looser than it should be.
    """
    knee = exchange.targets[1]
    away = knee + math.copysign(SWING_CHECK_RAD, PACKAGED_ROPE_PER_KNEE - calibration.rope_per_knee)
    swing_to(exchange, away, calibration, homing)
    at = [crossing(rows, start_gain * calibration.home_preload) for rows in _loop(exchange, homing)]
    refuse_swing(calibration, (sum(at) / 2.0 - at_home_m) / (away - knee))
    swing_to(exchange, knee, calibration, homing)


def _into(rows: list[Row]) -> Callable[[Inputs], None]:
    def keep(inputs: Inputs) -> None:
        if not inputs.missing & NEEDED:
            rows.append((inputs.start_n, inputs.servo_position_m, inputs.knee_angle_rad))

    return keep


def crossing(rows: list[Row], preload_n: float) -> float:
    """Return the rope position, m, at the preload, of the straight line through (START, position) near it."""
    table = np.array([row[:2] for row in rows if abs(row[0] - preload_n) <= AROUND * preload_n])
    if len(table) < 3:
        raise BringUpError(f"homing: START was near {preload_n:g} N in {len(table)} cycles only; home more slowly.")
    _slope, offset = np.polyfit(table[:, 0] - preload_n, table[:, 1], 1)
    return float(offset)
