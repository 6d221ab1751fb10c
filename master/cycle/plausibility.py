"""Consistency of one cycle's inputs, in every state of the bench: no sensor is trusted alone.

One compiled step over two flat float64 arrays, `s` (state) and `g` (settings), SI. It returns the violated relation
and its size, without naming a cause. Relations, each with a tolerance in its unit:

    servo    position against the answer of a position loop to the targets, m;
    knee     angle against the way from the target of two cycles before to the next one, rad;
             at a low rate the drive is between them when it is read;
    ratio    ln(START/END) within friction's bounds, which reverse with rope motion (pre-sliding), N at START;
    force    servo force − START against M·a + friction, over a window of `WINDOW_S`, N;
    start    rope and knee against START by the stretch of the path, m;
    end      rope and knee against END by the same stretch, m;
    still    a tension that repeats to the last bit while the other one changes, N;
             a position that does so while its target moves, m or rad.

Until homing is over (`learn`), ratio and force use wide assumed values, and start and end say only that a rope that
pays out gains no tension, however stiff it is: where it does, the knee is not where its encoder says. Homing's pull
and release then give this bench's inertia, drive friction, stretch and friction bounds by least squares.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit

SERVO_TRACK, KNEE_TRACK, RATIO, FORCE, BY_START, BY_END, STILL_START, STILL_END, STILL_SERVO, STILL_KNEE, \
    RELATIONS = range(11)
"""Compared relations, in the order of their array slots; `RELATIONS` is their number."""

AXES: Final = ((SERVO_TRACK, STILL_SERVO), (KNEE_TRACK, STILL_KNEE))
"""Relations of servo and of knee that hold while the other drive is off."""
WINDOW: Final = 64
"""Greatest number of cycles in the window of `force`."""
FORCE_TERMS, STRETCH_TERMS = 4, 3

(T1, T2, K1, K2, PREDICTED, SLIP, LAST_TRAVEL, FRESH, FILLED, SAME_START, SAME_END, AT_START, AT_END, OLD_START,
 OLD_END, PLACE, SUM, SUM_SIGN, SUM_V, RISE_LOW, RISE_HIGH, TRUSTED, FORCE_ROWS, STRETCH_ROWS, FORCE_SQUARES,
 SAME_SERVO, SAME_KNEE, OLD_SERVO, OLD_KNEE, LED_SERVO, LED_KNEE, SPEED, MOST_FLOW, HELD_BACK,
 OUT_M, OUT_N, OUT_KNEE) = range(37)
"""Indices of `s`: targets of the last two cycles, the position loop's answer, the slip state; cycles since a restart
and since the window's beginning, repeated values; the window's place and sums; the results of homing so far;
`MOST_FLOW`: the greatest speed of its windows, m/s; `HELD_BACK`: what of the targets' limiting the drive has still to
make up for, m; `OUT_M`, `OUT_N`, `OUT_KNEE`: least position of the rope, m, and least mean tension, N, since it last
went in or the knee moved, and the knee angle then, rad."""
RATIOS = 37
"""Slots of the normalised residual of each relation, signed: 1 is its tolerance."""
COUNTS = RATIOS + RELATIONS
READINGS = COUNTS + RELATIONS
"""Slots of measured and expected value of each relation, in pairs."""
RING = READINGS + 2 * RELATIONS
"""Slot of the ring of START/servo-force differences, then of positions, signs and speeds."""
NORMAL_FORCE = RING + 4 * WINDOW
NORMAL_STRETCH = NORMAL_FORCE + FORCE_TERMS * (FORCE_TERMS + 1)
STATES = NORMAL_STRETCH + STRETCH_TERMS * (STRETCH_TERMS + 1)

(PERIOD_S, BANDWIDTH, CYCLES, LEARNED, ROPE_PER_KNEE, KNEE_HOME, ROPE_COMPLIANCE, PRESLIDING, INERTIA, COULOMB, VISCOUS,
 OFFSET, C0, C1, C2, TOP_N, LOW, HIGH, KNOWN_FLOW, WITH_END, WITH_KNEE, STICKS, SETTINGS) = range(23)

LEARNING, LEARNT = 0.0, 1.0
TRACK_M, TRACK_SHARE = 1.5e-3, 0.35
KNEE_RAD, KNEE_S = 0.010, 2.5e-3
RATIO_N, RATIO_N_S_M, FORCE_N, FORCE_SHARE = 5.0, 15.0, 10.0, 0.7
FORCE_S, FLOW_N_S_M = 1.5e-3, 30.0
"""Time differences of force, START and position by the current loop and the sensor's filter, s. A further half period
comes from the difference of positions. Then the departure of drive friction from a straight line beyond the speed
that homing reached, N·s/m."""
STRETCH_M, STRETCH_N, SWING_SHARE, BEYOND = 1.8e-3, 5.0, 0.06, 0.25
AGREES, ALONE = 0.6, 2.5
WIDE: Final = 0.95
"""|ln(START/END)| that no healthy path passes; assumed for benches that have not been homed."""
LEAST_FRICTION: Final = 0.1
"""Least assumed ln(START/END) of sliding, if homing shows less."""
SLOW_M_S: Final = 5e-3
TAUT_N: Final = 3.0
SAME_FOR_S: Final = 0.012
FROZEN, FROZEN_M = 3.0, 0.1e-3
"""Frozen servo position: cycles at one value, and motion of the target meanwhile, m, from which it is the cause of
another finding."""
STILL_M, STILL_RAD, STILL_RAD_S = 0.3e-3, 1.5e-3, 0.15
"""Distance, m and rad, by which a target may go on while its encoder repeats one value, and the speed, rad/s, at which
a knee that turns back may stick where strides differ, up to twice `STILL_RAD`: a healthy one stuck for 10 ms."""
PERSIST: Final = 2.0
"""Cycles in a row beyond a tolerance that make a finding: one alone is a disturbed frame.  In 500 healthy trials not
even a single cycle passed a tolerance (`make healthy`).  Larger: each cycle adds 50 degrees/s to a knee that a
reversed stage drives."""
DOUBT: Final = 0.8
"""Normalised residual from which on a limit that was passed may be the consequence of something else."""


@njit(inline="always")
def _held(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


@njit(inline="always")
def _compare(s: Any, relation: int, seen: float, expected: float, tolerance: float) -> None:
    """Store a relation's normalised residual; count the consecutive cycles beyond the tolerance."""
    ratio = (seen - expected) / tolerance
    s[RATIOS + relation] = ratio
    s[READINGS + 2 * relation], s[READINGS + 2 * relation + 1] = seen, expected
    s[COUNTS + relation] = s[COUNTS + relation] + 1.0 if abs(ratio) > 1.0 else 0.0


@njit(inline="always")
def _tracking(s: Any, g: Any, limited: float, target: float, knee_target: float, position: float, knee: float) -> None:
    fade = 1.0 - math.exp(-g[BANDWIDTH] * g[PERIOD_S])
    if s[FRESH] <= 1.0:
        s[T1] = s[T2] = target
        s[K1] = s[K2] = knee_target
        s[PREDICTED] = position
    # a target is taken over at the next SYNC and seen one later: the loop's answer is to the target before last
    s[PREDICTED] += fade * (s[T2] - s[PREDICTED])
    s[HELD_BACK] = max(limited, (1.0 - fade) * s[HELD_BACK])
    lag = abs(s[T2] - s[PREDICTED]) + abs(s[T2] - s[T1])
    _compare(s, SERVO_TRACK, position, s[PREDICTED], TRACK_M + TRACK_SHARE * lag + 2.0 * s[HELD_BACK])
    _standing(s, STILL_SERVO, SAME_SERVO, position, s[PREDICTED], STILL_M + 2.0 * limited)
    if g[WITH_KNEE] > 0.0:
        moved = abs(s[K1] - s[K2]) + abs(knee_target - s[K1])
        reached = _held(knee, min(s[K1], s[K2]), max(s[K1], s[K2]))
        _compare(s, KNEE_TRACK, knee, reached, KNEE_RAD + KNEE_S * moved / g[PERIOD_S])
        sticks = min(STILL_RAD, g[STICKS] * g[PERIOD_S] * s[SAME_KNEE])
        _standing(s, STILL_KNEE, SAME_KNEE, knee, s[K2], STILL_RAD + sticks)
        # two frames that agree to the last bit are no disturbed one: another cycle adds 100 degrees/s at 500 Hz
        s[COUNTS + STILL_KNEE] *= PERSIST
    else:
        s[OLD_KNEE] = knee
    s[T2], s[T1], s[K2], s[K1] = s[T1], target, s[K1], knee_target


@njit(inline="always")
def _standing(s: Any, relation: int, same: int, value: float, target: float, room: float) -> None:
    """Compare the motion of the target with an encoder that repeats its value to the last bit."""
    if value != s[same + 2] or s[FRESH] <= 1.0:
        s[same], s[same + 2], s[same + 4] = 0.0, value, target
    s[same] += 1.0
    _compare(s, relation, target, s[same + 4], room)


@njit(inline="always")
def _ratio(s: Any, g: Any, position: float, start: float, end: float) -> float:
    """Return the expected ln(START/END) of sliding friction, and compare START with END."""
    travel = position - g[ROPE_COMPLIANCE] * start
    step = travel - s[LAST_TRAVEL] if s[FRESH] > 1.0 else 0.0
    s[LAST_TRAVEL] = travel
    # Dahl's state by the rope's travel; (3) and (7) in series then lie between their values for both directions
    goal = 1.0 if step > 0.0 else -1.0
    if abs(step) > 2e-6:
        s[SLIP] = goal - (goal - s[SLIP]) * math.exp(-abs(step) / g[PRESLIDING])
    s[SPEED] += 0.2 * (abs(step) / g[PERIOD_S] - s[SPEED])
    share = 0.5 * (1.0 + s[SLIP])
    middle = g[LOW] + share * (g[HIGH] - g[LOW])
    width = g[HIGH] - g[LOW]
    low, high = middle - 0.6 * width - 0.05, middle + 0.6 * width + 0.05
    low, high = max(low, g[LOW] - 0.15 * width - 0.1), min(high, g[HIGH] + 0.15 * width + 0.1)
    if g[LEARNED] == LEARNING:
        low, high = -WIDE, WIDE
    pulled = max(end, 0.0)
    least, most = pulled * math.exp(low), pulled * math.exp(high)
    room = RATIO_N + 0.05 * max(start, pulled) + RATIO_N_S_M * s[SPEED]
    if start > most:
        _compare(s, RATIO, start, most, room)
    elif start < least:
        _compare(s, RATIO, start, least, room)
    else:
        _compare(s, RATIO, start, start, room)
    return float(middle)


@njit(inline="always")
def _force(s: Any, g: Any, position: float, force: float, start: float) -> None:
    cycles = int(g[CYCLES])
    if s[FILLED] <= 1.0:
        s[PLACE] = s[SUM] = s[SUM_SIGN] = s[SUM_V] = 0.0
        for i in range(4 * WINDOW):
            s[RING + i] = 0.0
    count = int(s[FILLED]) - 1
    i = int(s[PLACE])
    before = s[RING + WINDOW + (i - 1) % (cycles + 2)] if count > 0 else position
    speed = (position - before) / g[PERIOD_S]
    sign = _held(speed / SLOW_M_S, -1.0, 1.0)
    difference = force - start
    n = cycles + 2
    old = (i - cycles) % n
    oldest = s[RING + old]
    s[SUM] += difference - oldest
    s[SUM_SIGN] += sign - s[RING + 2 * WINDOW + old]
    s[SUM_V] += speed - s[RING + 3 * WINDOW + old]
    s[RING + i], s[RING + WINDOW + i], s[RING + 2 * WINDOW + i], s[RING + 3 * WINDOW + i] = (
        difference, position, sign, speed)
    s[PLACE] = float((i + 1) % n)
    if count < cycles + 2:
        s[RATIOS + FORCE] = s[COUNTS + FORCE] = 0.0
        return
    # M·a + Coulomb + viscous·v + offset, averaged over the window: the acceleration from the speeds at its ends
    gained = (speed - (s[RING + WINDOW + (i - cycles) % n] - s[RING + WINDOW + (i - cycles - 1) % n]) / g[PERIOD_S])
    rate = gained / (cycles * g[PERIOD_S])
    mean, turned, flow = s[SUM] / cycles, s[SUM_SIGN] / cycles, s[SUM_V] / cycles
    expected = g[INERTIA] * rate + g[COULOMB] * turned + g[VISCOUS] * flow + g[OFFSET]
    apart = FORCE_S / g[PERIOD_S] + 0.5
    room = (FORCE_N + FORCE_SHARE * abs(g[INERTIA] * rate) + abs(difference - oldest) * apart / cycles
            + FLOW_N_S_M * max(0.0, abs(flow) - g[KNOWN_FLOW]))
    if g[LEARNED] == LEARNING:
        room *= 2.5
        _add(s, NORMAL_FORCE, FORCE_TERMS, (rate, turned, flow, 1.0), mean)
        s[FORCE_ROWS] += 1.0
        s[FORCE_SQUARES] += mean * mean
        s[MOST_FLOW] = max(s[MOST_FLOW], abs(flow))
    _compare(s, FORCE, mean, expected, room)


@njit(inline="always")
def _add(s: Any, at: int, terms: int, row: Any, value: float) -> None:
    """Add a row to normal equations: terms × (terms + 1) numbers, the last column the right-hand side."""
    for i in range(terms):
        for j in range(terms):
            s[at + i * (terms + 1) + j] += row[i] * row[j]
        s[at + i * (terms + 1) + terms] += row[i] * value


@njit(inline="always")
def _slope(g: Any, force: float) -> float:
    return float(max(2e-5, g[C1] + 2.0 * g[C2] * _held(force, 0.0, g[TOP_N])))


@njit(inline="always")
def _curve(g: Any, force: float) -> float:
    """Return the stretch, m, at a mean tension; beyond homing's range it is extrapolated by the slope there."""
    inside = _held(force, 0.0, g[TOP_N])
    return float(g[C0] + (g[C1] + g[C2] * inside) * inside + _slope(g, inside) * (force - inside))


@njit(inline="always")
def _one_stretch(
    s: Any, g: Any, relation: int, stretch: float, force: float, most: float, spread: float, knee: float
) -> None:
    """Compare the path's `stretch`, m, with the stretch expected at the tension `force`, N.

    A slack path, whose tension is drag alone, may be shorter by any length. `most` is the larger of the two sensors'
    mean tensions, N: the tolerance grows if it exceeds the largest tension of homing. `spread` is relative.
    """
    expected = _curve(g, max(force, 0.0))
    beyond = max(0.0, most - g[TOP_N])
    # homing's parabola may bend more than the bench does: beyond it the slope is between its last one and its mean one
    bent = max(0.0, g[C1] + g[C2] * g[TOP_N] - _slope(g, g[TOP_N])) * max(0.0, force - g[TOP_N])
    room_n = STRETCH_N + RATIO_N_S_M * s[SPEED] + spread * max(force, 0.0)
    room = (STRETCH_M + _slope(g, force) * room_n + BEYOND * 1e-3 * beyond + bent
            + SWING_SHARE * g[ROPE_PER_KNEE] * abs(knee - g[KNEE_HOME]))
    if force < TAUT_N + RATIO_N_S_M * s[SPEED] and stretch < expected:
        stretch = expected
    _compare(s, relation, stretch, expected, room)


@njit(inline="always")
def _stretch(s: Any, g: Any, middle: float, position: float, knee: float, start: float, end: float) -> None:
    stretch = position - g[ROPE_PER_KNEE] * (knee - g[KNEE_HOME]) - g[ROPE_COMPLIANCE] * start
    if g[LEARNED] == LEARNING:
        _pays_out(s, g, position, knee, math.sqrt(max(start, 0.0) * max(end, 0.0)), max(start, end))
        if start > TAUT_N and end > TAUT_N and abs(knee - g[KNEE_HOME]) < 0.05:
            # (10) over √(START·END), in which friction cancels
            mean = math.sqrt(start * end)
            _add(s, NORMAL_STRETCH, STRETCH_TERMS, (1.0, mean, mean * mean), stretch)
            s[STRETCH_ROWS] += 1.0
            s[TRUSTED] = max(s[TRUSTED], mean)
            if min(start, end) > 10.0:
                ratio = math.log(start / end)
                fade = 0.05
                if s[SLIP] > 0.9:
                    s[RISE_HIGH] += fade * (ratio - s[RISE_HIGH]) if s[RISE_HIGH] != 0.0 else ratio
                elif s[SLIP] < -0.9:
                    s[RISE_LOW] += fade * (ratio - s[RISE_LOW]) if s[RISE_LOW] != 0.0 else ratio
        return
    # tension in the middle of the path by either sensor: half of the exponent lies on each side
    half = math.exp(0.5 * middle)
    width, most = g[HIGH] - g[LOW], max(start, end)
    counts = s[COUNTS + BY_START], s[COUNTS + BY_END]
    _one_stretch(s, g, BY_START, stretch, start / half, most, 0.45 * width, knee)
    _one_stretch(s, g, BY_END, stretch, end * half, most, 0.3 * width, knee)
    _alone(s, BY_START, BY_END, counts[0])
    _alone(s, BY_END, BY_START, counts[1])


@njit(inline="always")
def _pays_out(s: Any, g: Any, position: float, knee: float, mean: float, most: float) -> None:
    """Compare the tension gained while the rope pays out with the winding-in that such a gain takes."""
    # ten steps of the encoder are no winding in; on the stiffest path they are 0.5 N
    if s[FRESH] <= 1.0 or position > s[OUT_M] + 1e-5 or abs(knee - s[OUT_KNEE]) > KNEE_RAD:
        s[OUT_M], s[OUT_N], s[OUT_KNEE] = position, mean, knee
    s[OUT_M], s[OUT_N] = min(s[OUT_M], position), min(s[OUT_N], mean)
    room_n = RATIO_N + 0.05 * most + RATIO_N_S_M * s[SPEED]
    for relation in (BY_START, BY_END):
        _compare(s, relation, position, s[OUT_M] + _slope(g, mean) * (mean - s[OUT_N]), _slope(g, mean) * room_n)


@njit(inline="always")
def _alone(s: Any, relation: int, other: int, before: float) -> None:
    """Count a violation of the stretch by one tension if the other tension shows it, too, or from `ALONE` times the
    tolerance."""
    size = abs(s[RATIOS + relation])
    agrees = s[RATIOS + relation] * s[RATIOS + other] > 0.0 and abs(s[RATIOS + other]) > AGREES
    s[COUNTS + relation] = before + 1.0 if size > 1.0 and (agrees or size > ALONE) else 0.0


@njit(inline="always")
def _still(s: Any, g: Any, start: float, end: float) -> None:
    """Detect a tension that repeats to the last bit while the other one changes: a working converter has noise."""
    if start != s[OLD_START]:
        s[SAME_START], s[AT_END] = 0.0, end
    if end != s[OLD_END]:
        s[SAME_END], s[AT_START] = 0.0, start
    s[SAME_START] += 1.0
    s[SAME_END] += 1.0
    s[OLD_START], s[OLD_END] = start, end
    least = SAME_FOR_S / g[PERIOD_S] + 4.0
    room = RATIO_N + 0.1 * max(abs(start), abs(end))
    _compare(s, STILL_START, end if s[SAME_START] > least else s[AT_END], s[AT_END], room)
    _compare(s, STILL_END, start if s[SAME_END] > least else s[AT_START], s[AT_START], 1.5 * room + 0.3 * abs(end))


@njit(cache=True)
def step(
    s: Any, g: Any, limited: float, target: float, position: float, force: float, knee_target: float, knee: float,
    start: float, end: float,
) -> int:
    """Compare one cycle; return the violated relation, −1 for none.

    `limited` 0 or more: metres by which the tension bound holds the servo back, as it reports; targets are the ones
    sent before these inputs were latched.
    """
    s[FRESH] += 1.0
    s[FILLED] += 1.0
    _tracking(s, g, limited, target, knee_target, position, knee)
    _force(s, g, position, force, start)
    if g[WITH_END] > 0.0:
        middle = _ratio(s, g, position, start, end)
        _stretch(s, g, middle, position, knee, start, end)
        _still(s, g, start, end)
    for relation in range(RELATIONS):
        if s[COUNTS + relation] >= PERSIST:
            return relation
    return -1


class Implausibility(NamedTuple):
    """A violated relation: its reading, the expected value, and the normalised residual of every relation."""

    relation: int
    seen: float
    expected: float
    ratios: tuple[float, ...]
    rope_per_knee: float = 0.0
    rope_per_knee_fits: float = 0.0
    """The calibration's rope by radian of the knee, m/rad, and the one for which the stretch would be as expected."""
    frozen: bool = False
    """The servo's position has repeated itself to the last bit while its target moved on."""


@dataclass
class HomingBaseline:
    """Results of homing that the plausibility checks start from.

    `stretch_ratio`: measured stretch between a quarter of `top_n` and `top_n`, N, divided by the calibration's; NaN
    without END.
    """

    force_rms_n: float
    low: float
    high: float
    stretch_ratio: float
    top_n: float


class Plausibility:
    """The compiled step with its arrays; `period_s` is the control period.

    Without END (`with_end` False) `servo`, `knee`, `force` and the positions' `still` remain: the servo's force alone
    contradicts START.  Without a knee drive (`with_knee` False) the joint is not compared with the angle asked for.
    """

    def __init__(self, period_s: float, *, with_end: bool = True, with_knee: bool = True) -> None:
        self.s, self.g = np.zeros(STATES), np.zeros(SETTINGS)
        self._zero_m = 0.0
        g = self.g
        g[PERIOD_S], g[BANDWIDTH] = period_s, 2.0 * math.pi * 20.0
        g[CYCLES] = min(WINDOW - 2, max(2, round(WINDOW_S / period_s)))
        g[PRESLIDING], g[ROPE_COMPLIANCE] = 5e-4, 3.7e-5
        g[INERTIA], g[COULOMB], g[VISCOUS] = 2.4, 2.0, 15.0
        g[LOW], g[HIGH] = -WIDE / 1.3, WIDE / 1.3
        g[TOP_N], g[WITH_END], g[WITH_KNEE] = 40.0, float(with_end), float(with_knee)

    def expect_strides(self) -> None:
        """Allow for the sticking of a knee that turns back slowly, as where strides differ."""
        self.g[STICKS] = STILL_RAD_S

    def restart(self) -> None:
        """Clear the memory of earlier cycles: after a gap, a change of the zero or of the mode."""
        self.s[FRESH] = self.s[FILLED] = 0.0
        self.s[COUNTS:COUNTS + RELATIONS] = 0.0

    def check(
        self, limited: float, targets: tuple[float, float], position: float, force: float, knee: float, start: float,
        end: float, relations: Sequence[int] = (),
    ) -> Implausibility | None:
        """Compare one cycle; return the finding of a relation (of those given, if any) after `PERSIST` cycles."""
        relation = step(self.s, self.g, limited, targets[0], position, force, targets[1], knee, start, end)
        if relations:
            relation = next((one for one in relations if self.s[COUNTS + one] >= PERSIST), -1)
        return None if relation < 0 else self.finding(relation)

    def coast(self, targets: tuple[float, float]) -> None:
        """Process a cycle with missing inputs: targets are extrapolated, averaging windows restart."""
        s, g = self.s, self.g
        s[FILLED] = 0.0
        left = math.exp(-g[BANDWIDTH] * g[PERIOD_S])
        s[PREDICTED] += (1.0 - left) * (s[T2] - s[PREDICTED])
        s[HELD_BACK] *= left
        s[T2], s[T1], s[K2], s[K1] = s[T1], targets[0], s[K1], targets[1]

    def follow(self, targets: tuple[float, float], inputs: Any) -> None:
        """Continue the comparison without drawing conclusions, during a stop."""
        if inputs.missing:
            self.coast(targets)
            return
        step(self.s, self.g, 0.0, targets[0], inputs.servo_position_m, inputs.servo_force_n, targets[1],
             inputs.knee_angle_rad, inputs.start_n, inputs.end_n)

    def hidden_n(self) -> float:
        """Return the tension, N, by which the servo's force, friction and inertia aside, exceeds START."""
        s = self.s
        beyond = float(s[READINGS + 2 * FORCE] - s[READINGS + 2 * FORCE + 1])
        return beyond if beyond > FORCE_N else 0.0

    def doubt(self) -> Implausibility | None:
        """Return the relation with the largest normalised residual if that exceeds `DOUBT`, else None."""
        ratios = np.abs(self.s[RATIOS:RATIOS + RELATIONS])
        worst = int(np.argmax(ratios))
        return self.finding(worst) if ratios[worst] > DOUBT else None

    def finding(self, relation: int) -> Implausibility:
        """Return the present residuals of all relations."""
        s, g = self.s, self.g
        seen, expected = float(s[READINGS + 2 * relation]), float(s[READINGS + 2 * relation + 1])
        swing, bent = float(g[ROPE_PER_KNEE]), float(s[OLD_KNEE] - g[KNEE_HOME])
        fits = swing + (seen - expected) / bent if relation in (BY_START, BY_END) and abs(bent) > 0.1 else swing
        frozen = bool(s[SAME_SERVO] >= FROZEN and abs(s[PREDICTED] - s[LED_SERVO]) > FROZEN_M)
        return Implausibility(relation, seen, expected, tuple(float(value) for value in s[RATIOS:RATIOS + RELATIONS]),
                              swing, fits, frozen)

    def learn(self, quadratic: float, linear: float) -> HomingBaseline:
        """Use the results of homing from here on; `quadratic`, `linear`: coefficients of the calibration's (10), with
        the rope's own stretch."""
        s, g = self.s, self.g
        force = _solved(s, NORMAL_FORCE, FORCE_TERMS)
        rows = max(1.0, s[FORCE_ROWS])
        right = s[NORMAL_FORCE + FORCE_TERMS:NORMAL_STRETCH:FORCE_TERMS + 1]
        squares = max(0.0, (s[FORCE_SQUARES] - float(force @ right)) / rows)
        curve = _solved(s, NORMAL_STRETCH, STRETCH_TERMS)
        g[[INERTIA, COULOMB, VISCOUS, OFFSET]], g[KNOWN_FLOW] = force, s[MOST_FLOW]
        g[[C0, C1, C2]] = curve
        low, high = s[RISE_LOW], s[RISE_HIGH]
        bound = max(abs(low), abs(high), LEAST_FRICTION) if low and high else WIDE / 1.3
        g[LOW], g[HIGH] = -bound, bound
        g[TOP_N], g[LEARNED] = max(10.0, s[TRUSTED]), LEARNT
        top = min(40.0, g[TOP_N])
        way, square = 0.75 * top, 0.9375 * top**2  # from a quarter of the top to the top
        found = (curve[1] + g[ROPE_COMPLIANCE]) * way + curve[2] * square
        ratio = found / (linear * way + quadratic * square) if g[WITH_END] else math.nan
        return HomingBaseline(math.sqrt(squares), float(s[RISE_LOW]), float(s[RISE_HIGH]), float(ratio), top)

    def begin_learning(self, rope_per_knee: float, knee_home: float, compliance: float) -> None:
        """Restart the identification from a calibration's geometry, before the pull of homing."""
        g, s = self.g, self.s
        g[ROPE_PER_KNEE], g[KNEE_HOME], g[ROPE_COMPLIANCE], g[LEARNED] = rope_per_knee, knee_home, compliance, LEARNING
        s[NORMAL_FORCE:STATES] = 0.0
        s[[FORCE_ROWS, STRETCH_ROWS, FORCE_SQUARES, TRUSTED, RISE_LOW, RISE_HIGH, MOST_FLOW]] = 0.0

    def follow_zero(self, zero_m: float) -> None:
        """Expect the stretch by a rope's zero that has moved by `zero_m` since homing."""
        self.g[C0] += zero_m - self._zero_m
        self._zero_m = zero_m

    def shift(self, by_m: float) -> None:
        """Shift the remembered positions by `by_m`: homing has set the drive's zero."""
        self.g[C0] += by_m
        self.restart()


WINDOW_S: Final = 0.016


def _solved(s: Any, at: int, terms: int) -> Any:
    table = s[at:at + terms * (terms + 1)].reshape(terms, terms + 1)
    left = table[:, :terms] + np.diag(1e-9 * np.maximum(np.diag(table[:, :terms]), 1e-12))
    return np.linalg.solve(left, table[:, terms])


def prepare() -> None:
    """Compile the step, or load it from numba's cache, before time matters."""
    Plausibility(1e-3).check(0.0, (0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0)
