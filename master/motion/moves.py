"""Slow motions: smooth in position and speed, each cycle checked like any other.

The rule of this file: a move ends at its target or raises, and never exceeds the speed that it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

from eds.bench_network import SERVO
from master.cycle.exchange import Exchange
from master.cycle.inputs import Inputs
from master.network.bringup import BringUpError

T = TypeVar("T")

PEAK_TO_MEAN = 1.5
"""Greatest by mean speed of the smooth step 3u² − 2u³."""


def smooth(share: float) -> float:
    """The smooth step 3u² − 2u³ of 0…1."""
    return share * share * (3.0 - 2.0 * share)


def move(exchange: Exchange, servo_m: float, knee_rad: float, rope_m_s: float, knee_rad_s: float) -> Inputs:
    """Move both axes together from their last targets, neither faster than its speed."""
    servo, knee = exchange.targets
    duration_s = PEAK_TO_MEAN * max(abs(servo_m - servo) / rope_m_s, abs(knee_rad - knee) / knee_rad_s)
    steps = max(1, round(duration_s * 1e9 / exchange.wire.period_ns))
    inputs = exchange.inputs
    for step in range(1, steps + 1):
        share = smooth(step / steps)
        inputs = exchange.advance(servo + share * (servo_m - servo), knee + share * (knee_rad - knee))
    return inputs


def settle(exchange: Exchange, duration_s: float) -> Inputs:
    """Hold the last targets for a while."""
    inputs = exchange.inputs
    for _ in range(round(duration_s * 1e9 / exchange.wire.period_ns)):
        inputs = exchange.hold()
    return inputs


def hold_while(exchange: Exchange, work: Generator[None, None, T]) -> T:
    """Hold the last targets, a cycle for each step of `work`, and return what it returns."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            return done.value  # type: ignore[no-any-return]
        exchange.hold()


def reel(
    exchange: Exchange, rope_m_s: float, until: Callable[[Inputs], bool], reach_m: float, why: str,
    seen: Callable[[Inputs], None] = lambda inputs: None,
) -> Inputs:
    """Wind the rope (negative speed: pay it out) at constant speed until `until` holds; every input goes to `seen`.

    Raises `BringUpError` with `why` when `reach_m` of rope did not do it.
    """
    servo, knee = exchange.targets
    start, step = servo, rope_m_s * exchange.wire.period_ns * 1e-9
    inputs = exchange.inputs
    while not until(inputs):
        if abs(servo - start) >= reach_m:
            name = exchange.wire.nodes[SERVO].name
            raise BringUpError(f"{name}: {reach_m * 1e3:.0f} mm of rope and START is at {inputs.start_n:.1f} N: {why}.")
        servo += step
        inputs = exchange.advance(servo, knee)
        seen(inputs)
    return inputs
