"""Motions of an experiment on the bench: each kind of `physics.effects.experiment_motions`, done in the running cycle.

A motion starts from the last targets, is led at its stated speed, and never reads END.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, assert_never

from master.cycle.exchange import Exchange
from master.motion import moves
from master.motion.home import swing_to
from master.settings import Homing
from physics.calibration import Calibration
from physics.effects.experiment_motions import Dither, Hold, Knee, Motion, Pull, Release, Swing, Wind

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
