"""Procedures before and between trials: home the bench, zero a sensor, move one axis, take the tension off.

Each is one procedure inside the control cycle, with the trial's own limits and safe stop; it moves slowly, enables
only the drive that it moves, and returns its result.
"""

import math
import struct
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from eds.cia301 import SIGNATURE_ZERO
from eds.dictionary import key
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.inputs import END, KNEE, SERVO, START, Inputs
from master.motion import moves
from master.motion.home import home as find_home
from master.motion.home import reached_n, within
from master.network.bringup import BringUpError
from master.settings import Homing, Limits
from parameters import InputError
from physics.calibration import Calibration, nominal

Procedure = Callable[[Exchange], Mapping[str, float]]
"""Motion in the control cycle; returns results by name, with their unit."""

AXES: Final = {"servo": SERVO, "knee": KNEE}
SENSORS: Final = {"start": START, "end": END}
REST_S: Final = 0.5
CHECK_S: Final = 2.0
"""Time from the first cycle to a reading of a set-up check, s: a weight that swings, or a leg that is moved, rests."""
TARE_LIMIT_N: Final = 5.0
"""A slack rope's offset is below this; a reading above it is tension, and zeroing it would hide it."""
REACH_M: Final = 0.2
_OFFSET, _AUTO_ZERO = 0x6124, 0x6125


def home(calibration: Calibration, homing: Homing, slack_m: float) -> Procedure:
    """Find the encoder zero with at most `homing.least_n` of START tension, and slacken the rope at the end."""
    homing, calibration = within(homing, calibration, 0.0)

    def procedure(exchange: Exchange) -> Mapping[str, float]:
        drives.enable(exchange)
        found = find_home(exchange, calibration, homing, slack_m)
        inputs = exchange.inputs
        return {"friction_half_width_m": found.half_width_m, "servo_position_m": inputs.servo_position_m,
                "tension_start_n": inputs.start_n}

    return procedure


def home_pulls(homing: Homing) -> str:
    """Return the largest force that `home` pulls, as a sentence."""
    return f"Pulls START to at most {reached_n(within(homing, nominal(), 0.0)[0].top_n):.0f} N."


def tare(sensor: str) -> Procedure:
    """Zero one sensor at its present reading; no drive is enabled. Raises `InputError` for an unknown sensor."""
    place = _one_of(sensor, SENSORS, "sensor")

    def procedure(exchange: Exchange) -> Mapping[str, float]:
        node = exchange.path[place]
        if not node:
            raise BringUpError(f"the declared bench has no load cell {sensor}; tare one that it has")
        before = _mean(exchange, place)
        name = exchange.wire.nodes[node].name
        if not abs(before) < TARE_LIMIT_N:
            raise BringUpError(f"{name} reads {before:.2f} N; zeroing would hide a tension: release the rope, or check "
                               "the sensor")
        _zero(exchange, node, before)
        return {"before_n": before, "after_n": _mean(exchange, place)}

    return procedure


def reading(of: str) -> Procedure:
    """Read a load cell, N, or the knee, rad, at rest; no drive is enabled. Raises `InputError` for an unknown name."""
    place = _one_of(of, {**SENSORS, "knee": KNEE}, "sensor")

    def procedure(exchange: Exchange) -> Mapping[str, float]:
        if not exchange.path[place]:
            raise BringUpError(f"the declared bench has no {of}; check one that it has")
        moves.settle(exchange, CHECK_S)
        return {"reading": _mean(exchange, place)}

    return procedure


FURTHEST: Final = {SERVO: 0.15, KNEE: math.radians(110.0)}
"""Greatest distance of one jog, by axis."""
JOG_START_N: Final = 20.0
"""START tension at which a jog stops: a rope that is being tightened unseen."""
JOG_SHARE: Final = 0.5
"""Share of the configured START limit at which a jog stops."""
TOLERANCE_RAD: Final = math.radians(0.1)
"""Passing of a knee limit that counts as none: resolution of the drive and its following error at rest."""
BEHIND: Final = {SERVO: 2e-3, KNEE: math.radians(2.0)}
"""Largest distance from its target at which an axis may come to rest."""


def jog(axis: str, distance: float, speed: float, limits: Limits | None = None) -> Procedure:
    """Move one axis alone by `distance` at no more than `speed`, m or rad; the other drive stays off.

    It stops, and reports the place, when START reaches its limit, when the drive refuses to go on, or when the knee
    passes its limits further than at the beginning. START's limit is the lesser of `JOG_START_N` above its first
    value and `JOG_SHARE` of that in `limits`. No drive is enabled for a target beyond the knee's limits. Raises
    `InputError` for an unknown axis, a speed of zero or above the limit, and a distance that no axis has.
    """
    place = _one_of(axis, AXES, "axis")
    limits = limits or Limits()
    fastest = limits.rope_m_s if place == SERVO else limits.knee_rad_s
    if speed > fastest:
        name = "rope_m_s" if place == SERVO else "knee_rad_s"
        raise InputError(f"jog {axis} --speed {_shown(place, speed)}/s: is above limits.{name}, "
                         f"{_shown(place, fastest)}/s; give a slower speed.")
    if not (speed > 0.0 and math.isfinite(distance)):
        raise InputError(f"jog {axis}: {distance:g} at {speed:g} a second is no motion; give a distance and a speed "
                         "above 0.")
    if abs(distance) > FURTHEST[place]:
        raise InputError(f"jog {axis} --by {_shown(place, distance)}: is further than the axis can go, "
                         f"{_shown(place, FURTHEST[place])}; give a shorter way.")

    def procedure(exchange: Exchange) -> Mapping[str, float]:
        if exchange.path[place] not in exchange.wire.drives:
            raise BringUpError(f"the declared bench has no drive of the {axis}; move it by hand")
        begun = _position(exchange.inputs, place)
        _refuse_beyond_limits(begun, begun + distance, place, axis, limits)
        begun_n = exchange.inputs.start_n
        drives.enable_alone(exchange, exchange.path[place])
        start = exchange.targets[place]
        stop_n = min(begun_n + JOG_START_N, JOG_SHARE * limits.start_n)
        steps = max(1, round(moves.PEAK_TO_MEAN * abs(distance) / speed * 1e9 / exchange.wire.period_ns))
        for step in range(1, steps + 1):
            _lead(exchange, place, start + distance * moves.smooth(step / steps))
            _refuse_beyond_limits(begun, _position(exchange.inputs, place), place, axis, limits, moved=True)
            if exchange.inputs.start_n > max(stop_n, begun_n + 1.0):
                raise BringUpError(f"START reached {exchange.inputs.start_n:.1f} N with {axis} at "
                                   f"{_shown(place, _position(exchange.inputs, place))}, "
                                   f"{_shown(place, abs(distance * moves.smooth(step / steps)))} of "
                                   f"{_shown(place, abs(distance))} done; release the rope, or go the other way")
        moves.settle(exchange, REST_S)
        inputs = exchange.inputs
        if abs(_position(inputs, place) - exchange.targets[place]) > BEHIND[place]:
            raise BringUpError(f"{axis} stopped at {_shown(place, _position(inputs, place))} and not at "
                               f"{_shown(place, start + distance)}: START {inputs.start_n:.1f} N; its drive held a "
                               "limit")
        return {"servo_position_m": inputs.servo_position_m, "knee_angle_rad": inputs.knee_angle_rad,
                "tension_start_n": inputs.start_n, "tension_end_n": inputs.end_n}

    return procedure


def jog_pulls(limits: Limits) -> str:
    """Return the largest force that `jog` pulls, as a sentence."""
    return (f"Stops where START reads {JOG_START_N:g} N more than at the beginning, and at "
            f"{JOG_SHARE * limits.start_n:g} N.")


def _position(inputs: Inputs, place: int) -> float:
    return inputs.servo_position_m if place == SERVO else inputs.knee_angle_rad


def _shown(place: int, value: float) -> str:
    return f"{value * 1e3:.1f} mm" if place == SERVO else f"{math.degrees(value):.1f} degrees"


def _refuse_beyond_limits(
    begun: float, at: float, place: int, axis: str, limits: Limits, *, moved: bool = False
) -> None:
    """Raise `BringUpError` where the knee is, or would go, beyond its limits and further out than where it began.

    A knee that stands outside may be moved back.  The rope has no limits of position until it is homed.
    """
    if place != KNEE:
        return
    low, high = limits.knee_low_rad, limits.knee_high_rad
    if min(low, begun) - TOLERANCE_RAD <= at <= max(high, begun) + TOLERANCE_RAD:
        return
    allowed = f"limits.knee_low_rad and knee_high_rad allow {_shown(place, low)} to {_shown(place, high)}"
    if moved:
        raise BringUpError(f"{axis} is at {_shown(place, at)}; {allowed}")
    raise BringUpError(f"{axis} would go to {_shown(place, at)}; {allowed}; nothing was moved, give a shorter way")


def release(homing: Homing, limits: Limits) -> Procedure:
    """Pay the rope out, the servo alone, until START is below its unwound limit."""

    def procedure(exchange: Exchange) -> Mapping[str, float]:
        inputs = drives.enable_alone(exchange, exchange.path.servo)
        before, at = inputs.start_n, exchange.targets[0]
        step = homing.rope_m_s * exchange.wire.period_ns * 1e-9
        while exchange.inputs.start_n >= limits.unwound_n:
            if at - exchange.targets[0] >= REACH_M:
                raise BringUpError(f"{REACH_M * 1e3:.0f} mm of rope paid out and START is at "
                                   f"{exchange.inputs.start_n:.1f} N; tare START or free the rope")
            _lead(exchange, SERVO, exchange.targets[0] - step)
        return {"before_n": before, "after_n": exchange.inputs.start_n, "paid_out_m": at - exchange.targets[0]}

    return procedure


def _zero(exchange: Exchange, node: int, reading_n: float) -> None:
    """Zero a sensor: subtract the mean reading, N, from offset 0x6124; without that object command auto-zero 0x6125."""
    link = exchange.link
    if key(_OFFSET, 1) in exchange.wire.nodes[node].dictionary.entries:
        offset = struct.unpack("<f", link.sdo_read(node, _OFFSET, 1))[0]
        link.sdo_write(node, _OFFSET, 1, struct.pack("<f", offset - reading_n))
    else:
        link.sdo_write(node, _AUTO_ZERO, 1, SIGNATURE_ZERO.to_bytes(4, "little"))


def _one_of(name: str, known: Mapping[str, int], what: str) -> int:
    if name not in known:
        raise InputError(f"{name!r} is no {what} of the bench; expected one of {', '.join(known)}.")
    return known[name]


def _mean(exchange: Exchange, place: int) -> float:
    """Return the mean reading of a load cell, N, or of the knee, rad, at rest."""
    bit, readings = 1 << place, []
    for _ in range(max(1, round(REST_S * 1e9 / exchange.wire.period_ns))):
        inputs = exchange.hold()
        if not inputs.missing & bit:
            readings.append({START: inputs.start_n, END: inputs.end_n, KNEE: inputs.knee_angle_rad}[place])
    return float(np.mean(readings)) if readings else math.nan


def _lead(exchange: Exchange, place: int, target: float) -> Inputs:
    """Run one cycle that moves one axis and holds the other."""
    servo, knee = exchange.targets
    return exchange.advance(*((target, knee) if place == SERVO else (servo, target)))
