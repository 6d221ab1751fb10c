"""Slow motions: smooth in position and speed, each cycle checked like any other.

The rule of this file: a move ends at its target or raises, and never exceeds the speed that it is given.
"""

import math
from collections.abc import Callable, Generator
from typing import Final, TypeVar

from master.cycle.exchange import Exchange
from master.cycle.inputs import Inputs
from master.network.bringup import BringUpError

T = TypeVar("T")

REACHED_RAD: Final = math.radians(1.0)
"""Distance from the asked angle at which a joint that is moved by hand counts as there, rad."""
PATIENCE_S, REMINDED_S = 60.0, 2.0
"""Time limit, s, for a hand to bring a joint to the desired angle; time after which an event names the awaited angle.
"""
PEAK_TO_MEAN = 1.5
"""Ratio of greatest to mean speed of the smooth step 3u² − 2u³."""


def smooth(share: float) -> float:
    """Return the smooth step 3u² − 2u³ of u, 0…1."""
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


def follow_joint(exchange: Exchange, knee_rad: float, rope_per_knee: float, knee_rad_s: float) -> Inputs:
    """Ask whoever moves a joint without a drive to bring it to an angle; the rope goes along with the measured angle.

    `rope_per_knee`: rope by angle, m/rad.  Raises `BringUpError` for a joint that is not there in `PATIENCE_S`.
    """
    servo, knee = exchange.targets
    inputs = exchange.inputs
    begun = inputs.knee_angle_rad
    period_s = exchange.wire.period_ns * 1e-9
    steps = max(1, round(PEAK_TO_MEAN * abs(knee_rad - knee) / knee_rad_s / period_s))
    patience = steps + round(PATIENCE_S / period_s)
    for step in range(1, patience):
        if step > steps and abs(inputs.knee_angle_rad - knee_rad) < REACHED_RAD:
            return inputs
        if step == steps + round(REMINDED_S / period_s):
            exchange.log.event(inputs.sync_ns, "operator", "master",
                               f"bring the {_joint(exchange)} to {math.degrees(knee_rad):.0f} degrees and hold it "
                               f"there; it stands at {math.degrees(inputs.knee_angle_rad):.0f}.")
        inputs = exchange.advance(servo + rope_per_knee * (inputs.knee_angle_rad - begun),
                                  knee + smooth(min(1.0, step / steps)) * (knee_rad - knee))
    raise BringUpError(f"{_joint(exchange)}: asked to {math.degrees(knee_rad):.1f} degrees, it stands at "
                       f"{math.degrees(inputs.knee_angle_rad):.1f} after {PATIENCE_S:.0f} s: move it there and hold "
                       "it, or look at its encoder")


def _joint(exchange: Exchange) -> str:
    return exchange.wire.network.bench.joints[0].name


def settle(exchange: Exchange, duration_s: float) -> Inputs:
    """Hold the last targets for some time."""
    inputs = exchange.inputs
    for _ in range(round(duration_s * 1e9 / exchange.wire.period_ns)):
        inputs = exchange.hold()
    return inputs


def hold_while(exchange: Exchange, work: Generator[None, None, T]) -> T:
    """Hold the last targets, a cycle for each step of `work`, and return its result."""
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
    """Wind the rope (negative speed: unwind it) at constant speed until `until` holds; every input goes to `seen`.

    Raises `BringUpError` with `why` when `reach_m` of rope did not suffice.
    """
    servo, knee = exchange.targets
    start, step = servo, rope_m_s * exchange.wire.period_ns * 1e-9
    inputs = exchange.inputs
    while not until(inputs):
        if abs(servo - start) >= reach_m:
            name = exchange.wire.nodes[exchange.path.servo].name
            raise BringUpError(f"{name}: {reach_m * 1e3:.0f} mm of rope and START is at {inputs.start_n:.1f} N: {why}.")
        servo += step
        inputs = exchange.advance(servo, knee)
        seen(inputs)
    return inputs
