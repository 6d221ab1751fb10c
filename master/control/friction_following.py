"""Friction estimated over gait cycles, from START and the END force that follows from the stretch.

Pure functions: the maximum a posteriori estimate from one gait cycle of observations. Its prior is the measurement of
today's homing, in every cycle anew. y is the logarithm of START (its lag and drag compensated) by the END force from
rope and knee position, minus the prediction of the model after homing:

    y = fs·cs + fk·ck + β·(cs·ss + ck·sk) + z·dlnF/dx + w·dlnF/dw + p·d·dlnF/dx.

fs and fk scale the friction in sheath and on knee, and β adds to both breakaways. Errors of the zero z, of the
stretch w and of backlash at the knee p (d: its direction) are nuisance parameters: they absorb their own residuals,
so that friction does not. A systematic model error can therefore move friction by a part of its prior, once, and not
a little more in every cycle. END is not used.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np

from physics.inverse import Law, elongation, held_by_position

LEAST_SHARE = 0.3
"""Share of the greatest force of the gait below which START and stretch are too uncertain."""
STEP = 0.5
NOISE_N = 0.5
"""Standard deviation of START against the model for one sample, N."""
EFFECTIVE_SAMPLES = 25.0
"""Effective number of independent samples in the observations of one gait cycle."""
HUBER = 1.5
ROUNDS = 5
PRIOR: Final = (0.025, 0.025, 0.05, 0.1e-3, 0.015, 0.1e-3)
"""Standard deviations from homing: fs, fk, β, z (m), w, p (m)."""
AS_HOMED: Final = (0.01, 0.01, 0.05, 0.1e-3, 0.015, 0.1e-3)
"""Prior standard deviations just after homing measured the friction; as `PRIOR`."""
LEAST_ROWS = 10
LEAST_BOTH = 0.1
"""Least share of the observations with slip in the opposite direction: one direction cannot separate friction from
stretch."""
SETTLING = 3
"""Gait cycles of observations until an error of the assumed backlash has fallen to an eighth."""


class FrictionChange(NamedTuple):
    """Estimated change of the bench since homing.

    Factors of the friction of sheath and knee, added breakaway; half of the backlash at the knee, m of rope.
    `cycles`: number of gait cycles that estimated the backlash, at most `SETTLING`; `first`: the next cycle's
    estimate of both factors.
    """

    sheath: float = 1.0
    knee: float = 1.0
    breakaway: float = 0.0
    play: float = 0.0
    cycles: int = 0
    first: tuple[float, ...] = ()


class CycleEvidence(NamedTuple):
    """Observation of one control cycle: y against the model after homing, coefficients of the six unknowns, 1/σ of y.
    """

    y: float
    sheath: float
    knee: float
    breakaway: float
    zero: float
    stretch: float
    play: float
    weight: float


def law_at(law: Law, followed: FrictionChange) -> Law:
    """Return the controller's model with the friction as it is followed."""
    sheath, knee, breakaway = followed[:3]
    return law._replace(
        cable_exponent=sheath * law.cable_exponent, fabric_offset=knee * law.fabric_offset,
        fabric_slope=knee * law.fabric_slope, breakaway=max(0.0, law.breakaway + breakaway),
        fabric_breakaway=max(0.0, law.fabric_breakaway + breakaway))


def friction_evidence(
    law: Law, followed: FrictionChange, position: float, knee: float, start: float, drag: float,
    exponents: tuple[float, float, float, float], side: float, least_n: float,
) -> CycleEvidence | None:
    """Return the observation of one control cycle, None if START or the stretch is too small.

    `law` is the model as followed; `exponents`: of sheath and knee by it, and their slowness; `start`, N, without lag
    and `drag`, N, of the rope in it; `knee` the leg's angle, the backlash as followed in it; `side` −1…1: position of
    the leg in its backlash; `least_n` at END.
    """
    by_sheath, by_knee, sheath_slow, knee_slow = exponents
    force = held_by_position(law, position, knee, start, drag, by_sheath)
    if not force > least_n or start - drag < least_n:
        return None
    whole, slope = elongation(law, force)
    slope += law.rope_compliance
    sheath, on_knee = by_sheath / followed.sheath, by_knee / followed.knee
    slower = (by_sheath * sheath_slow / (1.0 + law.breakaway * sheath_slow)
              + by_knee * knee_slow / (1.0 + law.fabric_breakaway * knee_slow))
    zero = -1.0 / (slope * force)
    y = math.log((start - drag) / force) - by_sheath - by_knee
    y += sheath * (followed.sheath - 1.0) + on_knee * (followed.knee - 1.0) + slower * followed.breakaway
    y += zero * side * followed.play
    return CycleEvidence(y, sheath, on_knee, slower, zero, (whole + law.rope_compliance * start) * -zero, zero * side,
                         force / NOISE_N)


def estimate(evidence: list[CycleEvidence], doubts: tuple[float, ...] = PRIOR) -> tuple[float, ...]:
    """Return the six unknowns estimated from one gait cycle, in the order of `PRIOR`, relative to the model after
    homing."""
    rows = np.array(evidence)
    weight = rows[:, 7] * math.sqrt(min(1.0, EFFECTIVE_SAMPLES / len(rows)))
    prior = np.diag([1.0 / sigma for sigma in doubts])
    found = np.zeros(len(doubts))
    robust = np.ones(len(rows))
    for _ in range(ROUNDS):
        by = weight * np.sqrt(robust)
        stacked = np.vstack([rows[:, 1:7] * by[:, None], prior])
        found = np.linalg.lstsq(stacked, np.concatenate([rows[:, 0] * by, np.zeros(len(doubts))]), rcond=None)[0]
        left = np.abs(rows[:, 0] - rows[:, 1:7] @ found) * rows[:, 7]
        robust = np.minimum(1.0, HUBER / np.maximum(left, 1e-9))
    return tuple(found.tolist())


def follow(followed: FrictionChange, evidence: list[CycleEvidence]) -> FrictionChange:
    """Return the state after one more gait cycle: half of the way to that cycle's estimate.

    The first `SETTLING` gait cycles estimate the backlash, which nothing else measures; all of them estimate the
    increase of breakaway since identification. Homing has just measured sliding friction. The next gait cycle's
    estimate of it is therefore the model's error, which is constant and subtracted from every later estimate.
    """
    pulling = sum(1 for each in evidence if each.sheath > 0.0)
    if len(evidence) < LEAST_ROWS or min(pulling, len(evidence) - pulling) < LEAST_BOTH * len(evidence):
        return followed
    found = estimate(evidence)
    as_homed = estimate(evidence, AS_HOMED)
    breakaway = followed.breakaway + STEP * (max(0.0, as_homed[2]) - followed.breakaway)
    if followed.cycles < SETTLING:
        play = followed.play + STEP * (max(0.0, as_homed[5]) - followed.play)
        return followed._replace(breakaway=breakaway, play=play, cycles=followed.cycles + 1)
    if not followed.first:
        return followed._replace(breakaway=breakaway, first=found[:2])
    sheath, knee = (1.0 + new - old for new, old in zip(found[:2], followed.first, strict=True))
    return followed._replace(
        sheath=followed.sheath + STEP * (sheath - followed.sheath),
        knee=followed.knee + STEP * (knee - followed.knee), breakaway=breakaway)


def evidence_of(history: Any) -> list[CycleEvidence]:
    """Return the observations of the gait cycles in a linked list, newest first."""
    found = []
    while history is not None:
        *_, one, history = history
        if one is not None:
            found.append(one)
    return found
