"""Detection limits: the smallest size of each effect that trials would show.

    B(s) = Σ_κ p_κ·exp(−½ s²G/(1 + G))/√(1 + G) / Σ_κ p_κ·exp(−½ s²G)        G = EᵀC⁻¹E for an effect of one prior σ

The limit is the size s, in prior σ, at which ln B, over the overdispersion, reaches the threshold of a named effect.
E: change of the data by the effect.  C: covariance of the data in the reference condition, for each factor κ on the
scatter between sessions over which evidence is averaged; p_κ: the trial's probability of κ.  Two effects look alike if
EᵀC⁻¹E' is close to √(G·G').
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp

from diagnosis.evidence.decision import threshold
from diagnosis.evidence.hypothesis_search import hypotheses
from estimation.posterior import PosteriorMode, SessionData, response, whitened
from physics.effects.hypotheses import Variant
from physics.laws import Array


def least_size(nats: float, squares: Sequence[float], weights: Sequence[float] = (0.0,), most: float = 1e4) -> float:
    """Return the size, in prior σ, at which ln B reaches `nats`; infinity if it is above `most`.

    `squares`: G by scatter.  `weights`: ln p_κ by scatter, up to a constant.
    """
    square, weight = np.array(squares), np.array(weights)

    def short(size: float) -> float:
        # the module's equation
        without = float(logsumexp(weight - 0.5 * size**2 * square))
        with_it = float(logsumexp(weight - 0.5 * (size**2 * square / (1.0 + square) + np.log1p(square))))
        return with_it - without - nats

    return float(brentq(short, 0.0, most)) if short(most) > 0.0 else np.inf


class EffectResponse(NamedTuple):
    """Response of the data to an effect of one prior σ: E, C⁻¹E, and G = EᵀC⁻¹E; `size`: its limit, prior σ."""

    variant: Variant
    effect: Array
    applied: Array
    square: float
    size: float

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
    scatters: Sequence[tuple[float, PosteriorMode]] = (),
) -> dict[str, DetectionLimit]:
    """Return the detection limit of each effect, at the mode `null` and the constants `bench`.

    `overdispersion`: of the trial, by which log Bayes factors are divided.  `scatters`: for each scatter between
    sessions ln p_κ and the null under it (none: that of `null` alone).
    A limit outside the bounds of its parameter has the value None.
    """
    told: dict[str, DetectionLimit] = {}
    model, table = observed.model, null.table
    nats = threshold(model) * overdispersion
    for name, variants in hypotheses(observed, bench).items():
        parameter, read = next(iter(model.hypotheses[name].reads.items()))
        best = min((_response(observed, null, variant, nats, scatters or [(0.0, null)]) for variant in variants),
                   key=lambda r: r.size)
        low, high, unit = model.limits(name, parameter)
        q, value = null.q.copy(), None
        if np.isfinite(best.size):
            for constant, share in best.variant.directions[0].along.items():
                q[table.index[constant]] += best.size * best.variant.directions[0].sd * share
            reached = read(table.named(q), bench)
            value = abs(reached - read(table.named(null.q), bench)) if low <= reached <= high else None
        told[name] = DetectionLimit(parameter, unit, value, best)
    return told


def _response(observed: SessionData, null: PosteriorMode, variant: Variant, nats: float,
              scatters: Sequence[tuple[float, PosteriorMode]]) -> EffectResponse:
    effects, applied = response(null, observed, variant)
    effect = effects[:, 0]
    squares = [float(effect @ whitened(each, effects[:, :1])[:, 0]) for _, each in scatters]
    return EffectResponse(variant, effect, applied[:, 1], float(effect @ applied[:, 1]),
                          least_size(nats, squares, [weight for weight, _ in scatters]))
