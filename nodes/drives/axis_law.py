"""One drive tick of one axis: bounds, position following, braking, tightening the rope; set-points on their arrival.

Compiled functions over two flat float64 arrays, `s` (state) and `g` (settings), SI at the axis (rope metres at the
drum, or radians at the knee); the loops are those of `physics.drive_loops`. numba's cache does not see a change in an
imported module, so that module's digest is a constant of the compiled functions.
"""

import hashlib
import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

from physics import drive_loops
from physics.drive_loops import GAINS, LOOP_STATES, loop, velocity_loop

POSITION_INTEGRAL, VELOCITY_INTEGRAL, SATURATED, FOLLOWING, VELOCITY_DEMAND, SPEED_LOW, SPEED_HIGH, LIMITED, YIELDING, \
    TIME_NS, POSITION, VELOCITY, TORQUE, DEMAND, RAMP, TARGET, FRESH, SEGMENT_VELOCITY, SEGMENT_LEFT_S, FOLLOWING_S, \
    STILL_S, STOP_LEFT_S, START, TENSION, TENSION_AGE_S, FREE_HIGH, TENSION_HIGH, POSITION_BEFORE, APART, GAINED, \
    ACTING, EVENTS, STATES = range(33)
"""Slots of `s`, the first five those of `physics.drive_loops`; `STATES` is their number."""

KP, KI, KV, KVI, TORQUE_BOUND, SPEED_MAX, FEED_FORWARD, VELOCITY_OFFSET, TORQUE_OFFSET, TORQUE_MAX, TORQUE_HIGH, \
    TORQUE_LOW, UNTRUSTED_TORQUE, HOLD_TORQUE, MODE, PERIOD_S, LOW, HIGH, RESOLUTION, WINDOW, WINDOW_S, \
    DECELERATION, STILL_SPEED, STILL_FOR_S, TENSION_LIMIT, YIELD_PER_N, PRELOAD, SEARCH_SPEED, ZERO_SPEED, \
    HOMING_ACCELERATION, TRAVEL, TARGET_VELOCITY, TARGET_TORQUE, RAW_PER_SI, ORIGIN, MILLE_PER_NM, \
    APART_LIMIT, GAINED_LIMIT, SETTINGS = range(39)
"""Slots of `g`, the first six those of `physics.drive_loops.Gains`; `SETTINGS` is their number."""

OFF, FOLLOW, SPEED, PUSH, STOP, TIGHTEN = range(6)
"""Values of `g[MODE]`: no torque; follow positions; follow a velocity; give a torque; brake; wind in to a tension."""

STOPPED, LOST_TRACK, TIGHT, NOT_TIGHT, DISAGREE, RUNAWAY = 1, 2, 4, 8, 16, 32
"""Bits of `s[EVENTS]`, set here, cleared by the reader: at rest; following error timed out; preload held; preload not
found within the travel, or without a trusted tension; velocity and position contradict each other; the stage drives the
drum against the torque that is demanded."""

COUNTS: Final = 9
"""Integers that the function `counts` writes."""
IS_LIMITED, IS_OFF_TRACK, IS_YIELDING, IS_MOVING = 1, 2, 4, 8
"""Bits of the last integer of `counts`."""

MAX_DT_S: Final = 0.01
APART_S: Final = 0.3
"""Time constant, s, over which the distance by position is compared with the distance by velocity: a quarter of the
fastest gait. Shorter: a scale error of the encoder is not detected in slow gaits. Longer: a velocity gain that is 1 %
off trips."""
APART_SHARE: Final = 0.1
"""Greatest difference of both distances, as a share of the EDS' following-error window: 0.5 mm of rope, 0.5 degrees of
the knee. A narrower window that a user writes does not change it. Smaller: a velocity that is filtered over 1 ms trips
at the greatest speeds. Larger: the axis shakes for longer."""
GAINED_M_S: Final = 0.02
"""Speed of winding in, m/s, that a drum gains against its torque before its stage counts as one with the wrong sign.
Smaller: the noise of a velocity trips. Larger: the drum has more speed when the torque goes; a velocity loop with the
wrong sign doubles it each millisecond."""
STAGE_S: Final = 1e-3
"""Time constant, s, with which a stage's torque is taken to follow its demand: a current loop of 160 Hz. Shorter: a
slow one that still pushes after the demand has turned counts as one with the wrong sign. Longer: the drum has more
speed."""
TRUST_S: Final = 0.05
"""Age beyond which a tension is not trusted; the deadline of its PDO is shorter."""
YIELD_RATE: Final = 160.0
"""Rate at which the tension limiter closes on its limit, 1/s, on a rope of the assumed stiffness; well damped with the
3 ms between bridge and drum."""
HELD_FROM: Final = 0.9
"""Share of the tension limit from which on the rope limits the axis, so that a following error is not timed."""
TIGHTEN_PER_N: Final = 0.002
"""Rope speed per newton short of the preload, m/s/N: a time constant of 0.2 s on the soft rope, which averages noise.
"""
TIGHT_N: Final = 0.6
"""Band about the preload, four times the assumed noise of the bridge."""
TIGHT_S: Final = 0.25
NEWTON: Final = 0.01
"""Newtons per count of the tension objects."""
NO_TENSION: Final = -(1 << 15)
"""Process value of a sensor without a valid measurement."""
KEEPS, FOLLOWS, FEELS = range(3)
"""Effects of a received object in addition to its stored value: none; a new target; a tension."""


class RpdoEffect(NamedTuple):
    """Effect of a received object on the axis.

    `FOLLOWS`: a new target of `unit` (m or rad) per count from `origin`, at most `most` counts. `FEELS`: a tension of
    at most `most` N. Larger values are processed by the drive's own code.
    """

    action: int
    unit: float = 0.0
    origin: float = 0.0
    most: float = math.inf


def arrays() -> tuple[Any, Any]:
    """Return state `s` and settings `g` of an axis: at rest, torque off, no limits, all gains 0, period 1 ms."""
    s, g = np.zeros(STATES), np.zeros(SETTINGS)
    s[TENSION_AGE_S] = math.inf
    g[[TORQUE_BOUND, TORQUE_MAX, TORQUE_HIGH, UNTRUSTED_TORQUE]] = math.inf
    g[[SPEED_MAX, HIGH, WINDOW, APART_LIMIT, GAINED_LIMIT, TENSION_LIMIT, TRAVEL]] = math.inf
    g[LOW], g[TORQUE_LOW] = -math.inf, -math.inf
    g[PERIOD_S], g[RAW_PER_SI], g[MILLE_PER_NM] = 1e-3, 1.0, 1.0
    return s, g


@njit
def tell(s: Any, event: int) -> None:
    """Set an event flag for the drive."""
    s[EVENTS] = float(int(s[EVENTS]) | event)


@njit
def bound(s: Any, g: Any, mode: int, position: float) -> None:
    """Set the bounds: greatest speed, tension limit, near a position limit the speed that still stops there; torque.

    The tension's bound falls in proportion to the margin below the limit and turns to paying out above it; without a
    trusted tension the torque itself is bounded.
    """
    high = g[SPEED_MAX]
    low = -high
    if mode in (SPEED, PUSH):
        high = min(high, g[KP] * (g[HIGH] - position))
        low = max(low, g[KP] * (g[LOW] - position))
    trusted = s[TENSION_AGE_S] <= TRUST_S
    g[TORQUE_BOUND] = g[TORQUE_MAX] if trusted else min(g[TORQUE_MAX], g[UNTRUSTED_TORQUE])
    s[FREE_HIGH], s[TENSION_HIGH] = high, math.inf
    if trusted and g[TENSION_LIMIT] < math.inf:
        s[TENSION_HIGH] = max(-g[SPEED_MAX], g[YIELD_PER_N] * (g[TENSION_LIMIT] - s[TENSION]))
    s[SPEED_HIGH] = min(high, s[TENSION_HIGH])
    s[SPEED_LOW] = min(low, s[SPEED_HIGH])


@njit
def run(s: Any, g: Any, wanted: float, velocity: float, dt_s: float) -> float:
    """Return the torque, N·m, of the velocity loop for the velocity `wanted`, within the bounds."""
    given = min(s[SPEED_HIGH], max(s[SPEED_LOW], wanted))
    if given != wanted:
        s[LIMITED] = 1.0
    return float(velocity_loop(s[:LOOP_STATES], g[:GAINS], velocity, given, dt_s))


@njit
def interpolate(s: Any, g: Any, dt_s: float) -> None:
    """Move the demand along a straight line to the newest target, over one interpolation period.

    The target keeps `g[LOW]` … `g[HIGH]`, the line's slope `g[SPEED_MAX]`: a line too steep is drawn out.
    """
    target = min(g[HIGH], max(g[LOW], s[TARGET]))
    if s[FRESH] != 0.0:
        s[FRESH] = 0.0
        way = target - s[DEMAND]
        slope = min(g[SPEED_MAX], max(-g[SPEED_MAX], way / g[PERIOD_S]))
        s[SEGMENT_VELOCITY] = slope
        s[SEGMENT_LEFT_S] = way / slope if slope != 0.0 else 0.0
    spent = min(dt_s, s[SEGMENT_LEFT_S])
    s[DEMAND] += s[SEGMENT_VELOCITY] * spent
    s[SEGMENT_LEFT_S] -= spent
    s[RAMP] = s[SEGMENT_VELOCITY] * spent / dt_s if dt_s > 0.0 else 0.0
    if target != s[TARGET] or s[SEGMENT_LEFT_S] > g[PERIOD_S]:
        s[LIMITED] = 1.0


@njit
def follow(s: Any, g: Any, position: float, velocity: float, dt_s: float) -> float:
    """Return the torque, N·m, that follows the interpolated positions; set a flag if the following error lasts too
    long.

    While the tension's bound holds the axis back, the error is not timed, on two conditions: the axis moves as fast as
    the bound allows, or the rope is near its limit. An axis at rest below it has lost its track.
    """
    interpolate(s, g, dt_s)
    forward = g[FEED_FORWARD] * s[RAMP] + g[VELOCITY_OFFSET]
    error = s[DEMAND] - position
    wanted = forward + g[KP] * error + s[POSITION_INTEGRAL]
    s[YIELDING] = 1.0 if wanted > s[SPEED_HIGH] and s[SPEED_HIGH] < g[SPEED_MAX] else 0.0
    slow = velocity < 0.5 * s[SPEED_HIGH] and s[TENSION] < HELD_FROM * g[TENSION_LIMIT]
    held = s[YIELDING] != 0.0 and not slow
    if abs(error) <= g[WINDOW] or held:
        s[FOLLOWING_S] = 0.0
    else:
        s[FOLLOWING_S] += dt_s
        if s[FOLLOWING_S] > g[WINDOW_S]:
            tell(s, LOST_TRACK)
    if s[SPEED_LOW] <= wanted <= s[SPEED_HIGH]:
        torque = loop(s[:LOOP_STATES], g[:GAINS], position, velocity, s[DEMAND], forward, dt_s)
    else:
        torque = run(s, g, wanted, velocity, dt_s)
    s[FOLLOWING] = error
    return float(torque)


@njit
def push(s: Any, g: Any, velocity: float) -> float:
    """Return the demanded torque, reduced by the speed bounds; the tension's bound keeps the torque that holds its
    limit."""
    high = min(g[KV] * (s[FREE_HIGH] - velocity), g[HOLD_TORQUE] + g[KV] * (s[TENSION_HIGH] - velocity))
    given = max(g[KV] * (s[SPEED_LOW] - velocity), min(high, g[TARGET_TORQUE]))
    if given != g[TARGET_TORQUE]:
        s[LIMITED] = 1.0
    return float(given)


@njit
def brake(s: Any, g: Any, velocity: float, dt_s: float) -> float:
    """Return the torque of a stop by `g[DECELERATION]`; set the flag `STOPPED` at rest or after the time limit."""
    ramp, change = s[RAMP], g[DECELERATION] * dt_s
    ramp = max(0.0, ramp - change) if ramp > 0.0 else min(0.0, ramp + change)
    s[RAMP] = ramp
    s[STOP_LEFT_S] -= dt_s
    still = ramp == 0.0 and abs(velocity) < g[STILL_SPEED]
    s[STILL_S] = s[STILL_S] + dt_s if still else 0.0
    if s[STILL_S] >= g[STILL_FOR_S] or s[STOP_LEFT_S] <= 0.0:
        tell(s, STOPPED)
    return float(run(s, g, ramp, velocity, dt_s))


@njit
def tighten(s: Any, g: Any, position: float, velocity: float, dt_s: float) -> float:
    """Return the torque that winds the rope in to the tension `g[PRELOAD]`; above half of it, it winds slower."""
    missing = g[PRELOAD] - s[TENSION]
    speed = g[SEARCH_SPEED] if missing > 0.5 * g[PRELOAD] else g[ZERO_SPEED]
    wanted = min(speed, max(-speed, TIGHTEN_PER_N * missing))
    change = g[HOMING_ACCELERATION] * dt_s
    s[RAMP] = min(s[RAMP] + change, max(s[RAMP] - change, wanted))
    s[STILL_S] = s[STILL_S] + dt_s if abs(missing) <= TIGHT_N else 0.0
    if s[TENSION_AGE_S] > TRUST_S or abs(position - s[START]) > g[TRAVEL]:
        tell(s, NOT_TIGHT)
    elif s[STILL_S] >= TIGHT_S:
        tell(s, TIGHT)
    return float(run(s, g, s[RAMP], velocity, dt_s))


@njit
def act(s: Any, g: Any, mode: int, position: float, velocity: float, dt_s: float) -> float:
    """Return the torque, N·m, of mode `mode` of the enabled drive, bounded; position and velocity in SI at the axis."""
    if mode == FOLLOW:
        torque = follow(s, g, position, velocity, dt_s)
    else:
        s[DEMAND], s[FOLLOWING], s[YIELDING] = position, 0.0, 0.0
        if mode == SPEED:
            s[RAMP] = g[TARGET_VELOCITY] + g[VELOCITY_OFFSET]
            torque = run(s, g, s[RAMP], velocity, dt_s)
        elif mode == PUSH:
            torque = push(s, g, velocity)
        elif mode == STOP:
            torque = brake(s, g, velocity, dt_s)
        else:
            torque = tighten(s, g, position, velocity, dt_s)
    torque += g[TORQUE_OFFSET]
    high, low = min(g[TORQUE_BOUND], g[TORQUE_HIGH]), max(-g[TORQUE_BOUND], g[TORQUE_LOW])
    given = min(high, max(low, torque))
    if given != torque or s[SATURATED] != 0.0:
        s[LIMITED] = 1.0
    return float(given)


@njit
def driven(s: Any, g: Any, velocity: float, dt_s: float) -> None:
    """Flag a stage with the wrong sign: the drum winds in faster against the torque that acts, `s[ACTING]`.

    That is the torque which was demanded before, `s[TORQUE]`, behind the lag of the stage.  A rope pulls
    the drum out and never pushes it in, so no load does that. A leg that swings against its strap does.
    """
    gained = velocity - s[VELOCITY]
    s[ACTING] += (s[TORQUE] - s[ACTING]) * (1.0 - math.exp(-dt_s / STAGE_S))
    s[GAINED] = s[GAINED] + gained if s[ACTING] < 0.0 < velocity and gained > 0.0 else 0.0
    if s[GAINED] > g[GAINED_LIMIT]:
        tell(s, RUNAWAY)


def _compile(digest: int) -> tuple[Any, Any]:
    @njit(cache=True)
    def step(s: Any, g: Any, now_ns: int, position: float, velocity: float) -> float:
        _ = digest
        dt_s = min(MAX_DT_S, (now_ns - s[TIME_NS]) * 1e-9)
        moved = position - s[POSITION_BEFORE]
        s[POSITION_BEFORE] = position
        if g[RESOLUTION] > 0.0:
            position = math.floor(position / g[RESOLUTION] + 0.5) * g[RESOLUTION]
        mode = int(g[MODE])
        driven(s, g, velocity, dt_s)
        s[TIME_NS], s[POSITION], s[VELOCITY], s[LIMITED] = now_ns, position, velocity, 0.0
        s[TENSION_AGE_S] += dt_s
        torque = 0.0
        if mode == OFF:
            s[DEMAND], s[RAMP], s[FOLLOWING], s[VELOCITY_DEMAND], s[YIELDING] = position, 0.0, 0.0, 0.0, 0.0
            s[APART] = 0.0
        else:
            bound(s, g, mode, position)
            torque = act(s, g, mode, position, velocity, dt_s)
            s[APART] += moved - velocity * dt_s - s[APART] * dt_s / APART_S
            if mode != PUSH and abs(s[APART]) > g[APART_LIMIT]:
                tell(s, DISAGREE)
        s[TORQUE] = torque
        return torque

    @njit(cache=True)
    def counts(s: Any, g: Any, out: Any) -> None:
        unit, origin = g[RAW_PER_SI], g[ORIGIN]
        increments = s[POSITION] / g[RESOLUTION] if g[RESOLUTION] > 0.0 else 0.0
        for n, value in enumerate((
            (s[POSITION] - origin) * unit, s[VELOCITY] * unit, s[TORQUE] * g[MILLE_PER_NM],
            (s[DEMAND] - origin) * unit, s[RAMP] * unit, s[FOLLOWING] * unit, s[VELOCITY_DEMAND] * unit, increments,
        )):
            out[n] = math.floor(min(2147483647.0, max(-2147483648.0, value)) + 0.5)
        out[8] = (
            (IS_LIMITED if s[LIMITED] != 0.0 else 0) + (IS_OFF_TRACK if abs(s[FOLLOWING]) > g[WINDOW] else 0)
            + (IS_YIELDING if s[YIELDING] != 0.0 else 0) + (IS_MOVING if abs(s[VELOCITY]) >= g[STILL_SPEED] else 0))

    return step, counts


step, counts = _compile(int.from_bytes(hashlib.sha256(Path(drive_loops.__file__).read_bytes()).digest()[:7], "big"))
"""`step(s, g, now_ns, position, velocity)` → torque, N·m: one drive tick; the position is rounded to the encoder's
`g[RESOLUTION]`.  `counts(s, g, out)` writes nine integers: position, velocity, torque ‰, demanded position and
velocity, following error, the position loop's output, encoder increments, and the `IS_…` flags."""


def prepare() -> bool:
    """Compile both functions, or load them from numba's cache, before the cycle; return whether they were compiled."""
    s, g = arrays()
    step(s, g, 0, 0.0, 0.0)
    counts(s, g, np.zeros(COUNTS, np.int64))
    return bool(sum(step.stats.cache_misses.values()) + sum(counts.stats.cache_misses.values()))


@njit(cache=True)
def target(s: Any, unit: float, origin: float, raw: int) -> None:
    """Begin the straight line to a new target, `raw` counts of `unit` (m or rad) from `origin`."""
    s[TARGET] = raw * unit + origin
    s[FRESH] = 1.0


@njit(cache=True)
def way(s: Any, unit: float, origin: float, raw: int) -> float:
    """Return the distance from the last target to a new one, in counts."""
    return float(abs(raw * unit + origin - s[TARGET]) / abs(unit))


@njit(cache=True)
def feel(s: Any, raw: int) -> float:
    """Receive a tension, counts of `NEWTON`; return it in N."""
    tension = NEWTON * raw
    s[TENSION] = tension
    s[TENSION_AGE_S] = 0.0
    return tension
