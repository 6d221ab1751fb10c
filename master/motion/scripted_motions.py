"""What an experiment is made of: one small motion after the other, each a row of data that knows how it is done.

The rule of this file: a motion starts from the last targets, is led at a stated speed, and never looks at END.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from master.cycle.exchange import Exchange
from master.motion import moves
from master.motion.home import swing_to
from master.settings import Homing
from physics.calibration import Calibration

REACH_M = 0.12
SLACK_N = 1.0


class MotionContext(NamedTuple):
    """What motions need to know of the bench."""

    calibration: Calibration
    homing: Homing


class Motion(Protocol):
    """One motion."""

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it, from the last targets on."""


@dataclass(frozen=True)
class Pull:
    """Wind the rope until START is above `start_n`."""

    start_n: float
    speed_m_s: float = 0.06

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it; raises `RefusedError` where the rope does not tighten."""
        moves.reel(exchange, self.speed_m_s, lambda inputs: inputs.start_n > self.start_n, REACH_M,
                   "the rope does not tighten")


@dataclass(frozen=True)
class Release:
    """Pay the rope out until START is below `start_n`, then `beyond_m` more."""

    start_n: float = SLACK_N
    speed_m_s: float = 0.06
    beyond_m: float = 0.0

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it; raises `RefusedError` where the rope does not go slack."""
        moves.reel(exchange, -self.speed_m_s, lambda inputs: inputs.start_n < self.start_n, REACH_M,
                   "the rope does not go slack")
        Wind(-self.beyond_m, self.speed_m_s).run(exchange, bench)


@dataclass(frozen=True)
class Wind:
    """Wind a length at constant speed; negative: pay it out."""

    length_m: float
    speed_m_s: float

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it, whatever the tension: the limits stop it."""
        servo, knee = exchange.targets
        steps = math.ceil(abs(self.length_m) / self.speed_m_s / _period_s(exchange))
        for step in range(1, steps + 1):
            exchange.advance(servo + self.length_m * step / steps, knee)


@dataclass(frozen=True)
class Hold:
    """Hold both axes."""

    seconds: float

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it."""
        moves.settle(exchange, self.seconds)


@dataclass(frozen=True)
class Dither:
    """Hold the rope with a sine of `amplitude_m` on it."""

    amplitude_m: float
    frequency_hz: float
    seconds: float

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it, in whole sines."""
        servo, knee = exchange.targets
        turn = 2.0 * math.pi * self.frequency_hz * _period_s(exchange)
        for step in range(1, round(round(self.seconds * self.frequency_hz) / self.frequency_hz / _period_s(exchange))):
            exchange.advance(servo + self.amplitude_m * math.sin(turn * step), knee)
        exchange.advance(servo, knee)


@dataclass(frozen=True)
class Knee:
    """Slacken the rope, then bring the knee to an angle, the rope led along; it stays locked there."""

    angle_rad: float

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it; raises `RefusedError` where the rope does not go slack."""
        swing_to(exchange, self.angle_rad, bench.calibration, bench.homing)


@dataclass(frozen=True)
class Swing:
    """Swing the knee once about where it is; the rope follows, or is held."""

    amplitude_rad: float
    seconds: float
    rope_follows: bool = False

    def run(self, exchange: Exchange, bench: MotionContext) -> None:
        """Do it, a sine from its middle to its middle."""
        servo, knee = exchange.targets
        ratio = bench.calibration.swing_k if self.rope_follows else 0.0
        steps = round(self.seconds / _period_s(exchange))
        for step in range(1, steps + 1):
            angle = self.amplitude_rad * math.sin(2.0 * math.pi * step / steps)
            exchange.advance(servo + ratio * angle, knee + angle)


def _period_s(exchange: Exchange) -> float:
    return exchange.wire.period_ns * 1e-9
