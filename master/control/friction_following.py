"""Friction followed over gait cycles: START tells of it against the force that the stretch tells.

The rule of this file: pure; one gait cycle of evidence, one Bayesian least squares, half of the way.  With y the
logarithm of START by the END force that rope and knee position give,

    y = f·Σ ci·si + β·Σ ci·si·e^(−(vi/vs)²) + z·dlnF/dx,

where f scales the friction, β is its breakaway, and z, an error of the zero, is let go of: it is the same both ways,
which friction is not.  END plays no part.  START is taken with its lag, as it was when the bench was identified.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from physics.inverse import Law, adapted, held_by_position

LEAST_N = 8.0
STEP = 0.5
NOISE_N = 0.5
"""Error of START against the model that is believed of one sample."""
PRIOR = (0.1, 0.2, 0.3e-3)
"""Standard deviations by which a gait cycle may differ from the last: f, β, z (m)."""
BREAKAWAY_MOST = 1.5
SCALE_STEP = 0.2


class Evidence(NamedTuple):
    """What one control cycle says: y, and what multiplies f, β and z; `weight` 1/σ of y."""

    y: float
    friction: float
    breakaway: float
    zero: float
    weight: float


def friction_evidence(
    law: Law, position: float, knee: float, start: float, by_sheath: float, by_knee: float, sheath_slow: float,
    knee_slow: float,
) -> Evidence | None:
    """The evidence of one control cycle, None where START or the stretch is too small to tell."""
    if start < LEAST_N:
        return None
    force = held_by_position(law, position, knee, start, by_sheath)
    if not force > LEAST_N:
        return None
    sheath, on_knee = by_sheath / (1.0 + law.breakaway * sheath_slow), by_knee / (1.0 + law.breakaway * knee_slow)
    softness = law.linear + 2.0 * law.quadratic * force + law.rope_compliance
    return Evidence(math.log(start / force), sheath + on_knee, sheath * sheath_slow + on_knee * knee_slow,
                    -1.0 / (softness * force), force / NOISE_N)


def follow(law: Law, evidence: list[Evidence]) -> Law:
    """The law after one gait cycle, moved half-way to what the evidence says."""
    if len(evidence) < 10:
        return law
    rows = np.array(evidence)
    weight = rows[:, 4] / math.sqrt(len(rows) / 25.0)
    slopes = rows[:, 1:4] * weight[:, None]
    prior = np.diag([1.0 / sigma for sigma in PRIOR])
    wanted = np.concatenate([rows[:, 0] * weight, [1.0 / PRIOR[0], law.breakaway / PRIOR[1], 0.0]])
    found = np.linalg.lstsq(np.vstack([slopes, prior]), wanted, rcond=None)[0]
    friction = 1.0 + STEP * min(SCALE_STEP, max(-SCALE_STEP, float(found[0]) - 1.0))
    breakaway = law.breakaway + STEP * (float(found[1]) / max(float(found[0]), 0.3) - law.breakaway)
    return adapted(law, friction, min(BREAKAWAY_MOST, max(0.0, breakaway)))


def evidence_of(history: Any) -> list[Evidence]:
    """The evidence in a linked list (sample, feedback, evidence, older)."""
    found = []
    while history is not None:
        _sample, _feedback, one, history = history
        if one is not None:
            found.append(one)
    return found
