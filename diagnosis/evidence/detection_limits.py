"""Detection limits: the smallest size of each effect that trials would show.

    ln B(s) = ½ s²G²/(1 + G) − ½ ln(1 + G)        G = EᵀC⁻¹E for an effect of one prior σ, s its size in prior σ

The limit is the size at which ln B, over the overdispersion, reaches the threshold of a named effect.  E: change of
the data by the effect.  C: covariance of the data in the reference condition.  Two effects look alike if EᵀC⁻¹E' is
close to √(G·G').
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from diagnosis.evidence.decision import threshold
from diagnosis.evidence.hypothesis_search import hypotheses
from estimation.posterior import PosteriorMode, SessionData, response
from physics.effects.hypotheses import Variant
from physics.laws import Array


def least_size(square: float, nats: float) -> float:
    """Return the size, in prior σ, at which ln B reaches `nats`; `square`: G of one prior σ."""
    # the module's equation solved for s
    return float(np.sqrt((2.0 * nats + np.log1p(square)) * (1.0 + square)) / square) if square > 0.0 else np.inf


class EffectResponse(NamedTuple):
    """Response of the data to an effect of one prior σ: E, C⁻¹E, and G = EᵀC⁻¹E."""

    variant: Variant
    effect: Array
    applied: Array
    square: float
    nats: float

    @property
    def size(self) -> float:
        """Size, in prior σ, at which the log Bayes factor reaches `nats`, from which an effect is named."""
        return least_size(self.square, self.nats)

    def alike(self, other: EffectResponse) -> float:
        """Return the share of this effect's evidence that `other`, scaled, explains."""
        both = self.square * other.square
        return float(self.effect @ other.applied) ** 2 / both if both > 0.0 else 0.0


class DetectionLimit(NamedTuple):
    """Detection limit of one effect: smallest departure of its first parameter (None: not visible), and its response.
    """

    parameter: str
    unit: str
    value: float | None
    response: EffectResponse


def detection_limits(
    observed: SessionData, null: PosteriorMode, bench: Mapping[str, float], overdispersion: float = 1.0,
) -> dict[str, DetectionLimit]:
    """Return the detection limit of each effect, at the mode `null` and the constants `bench`.

    `overdispersion`: of the trial, by which log Bayes factors are divided.
    A limit outside the bounds of its parameter has the value None.
    """
    told: dict[str, DetectionLimit] = {}
    model, table = observed.model, null.table
    nats = threshold(model) * overdispersion
    for name, variants in hypotheses(observed, bench).items():
        parameter, read = next(iter(model.hypotheses[name].reads.items()))
        best = min((_response(observed, null, variant, nats) for variant in variants), key=lambda r: r.size)
        low, high, unit = model.limits(name, parameter)
        q, value = null.q.copy(), None
        if np.isfinite(best.size):
            for constant, share in best.variant.directions[0].along.items():
                q[table.index[constant]] += best.size * best.variant.directions[0].sd * share
            reached = read(table.named(q), bench)
            value = abs(reached - read(table.named(null.q), bench)) if low <= reached <= high else None
        told[name] = DetectionLimit(parameter, unit, value, best)
    return told


def _response(observed: SessionData, null: PosteriorMode, variant: Variant, nats: float) -> EffectResponse:
    effect, applied = response(null, observed, variant)
    return EffectResponse(variant, effect[:, 0], applied[:, 1], float(effect[:, 0] @ applied[:, 1]), nats)
