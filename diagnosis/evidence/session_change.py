"""Evidence of a mode averaged over what changes between sessions: scatter of the constants, and the discrepancy.

    y − f(q̂ + x) = Φ(c + d + a·d′) + ε        d′ ~ N(0, σ_c²), a of `ForwardModel.session_shares` with equal weights.

A rig whose structure is not the model's differs between sessions in more than its constants.  The further change is
linear at a mode, so that each evidence is a closed form of the mode's own matrices, under any prior; nothing is fitted
again.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.special import logsumexp

from estimation.posterior import Gaussian, PosteriorMode, root_of, widened
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array


def feature_sd(reference: ReferenceFit) -> Array:
    """Return 1σ of the weight of each feature of the discrepancy between benches."""
    session = np.diag(reference.prior.covariance - reference.bench.covariance)[len(reference.model.constants.free):]
    return np.asarray(np.sqrt(session) / reference.model.session_share)


def under(at: PosteriorMode, prior: Gaussian, variants: Sequence[Variant]) -> PosteriorMode:
    """Return the linearisation of a mode under another `prior`, which the `variants` of effects widen.

    ∫ exp(gᵀd − ½ dᵀMd) N(d; μ − x̂, LLᵀ) dd, M = HᵀWH, g = HᵀWr, in place of the same integral under the mode's own
    prior; both are linearised at x̂.
    """
    _, mean, covariance, _ = widened(at.table, prior, variants)
    factor = root_of(covariance)
    square, slope = at.information, at.design.T @ (at.weight * at.residual)

    def nats(mean: Array, factor: Array, inner: Any) -> float:
        off = mean - at.x
        pull = factor.T @ (slope - square @ off)
        return (float(slope @ off - 0.5 * off @ square @ off + 0.5 * pull @ cho_solve(inner, pull))
                - float(np.log(np.diag(inner[0])).sum()))

    inner = cho_factor(np.eye(mean.size) + factor.T @ square @ factor)
    gain = nats(mean, factor, inner) - nats(at.prior_mean, at.factor, at.inner)
    return replace(at, factor=factor, inner=inner, prior_mean=mean, log_evidence=at.log_evidence + gain)


def averaged(at: PosteriorMode, amplitude: Array, shares: Sequence[float]) -> float:
    """Return the log evidence of a mode, nats, averaged over the `shares` a of a further change of the discrepancy.

    `amplitude`: 1σ of each feature's weight between benches.  With C the covariance of the data about the prior's
    mean, e the error about it and y = L⁻¹(x̂ − μ): LᵀHᵀC⁻¹HL = I − inner⁻¹, LᵀHᵀC⁻¹e = y + inner⁻¹(LᵀHᵀWr − y); the
    features are the last rows of H.
    """
    count, own = at.constants, at.factor[at.constants:, at.constants:]
    departure = solve_triangular(at.factor, at.x - at.prior_mean, lower=True)
    light = at.weight * at.residual
    # LᵀHᵀWr − y, zero at an exact mode
    left = at.factor.T @ np.concatenate([light @ at.slopes, light @ at.features]) - departure
    columns = np.concatenate([left[:, None], np.eye(at.x.size)[:, count:]], axis=1)
    solved = cho_solve(at.inner, columns)[count:]
    # L is lower triangular, and the constants come first
    out = amplitude[:, None] * solve_triangular(own.T, np.eye(own.shape[0]), lower=False)
    # G = AΦᵀC⁻¹ΦA, A the amplitudes; in its eigenvectors the Gaussian integral over d′ is a product of scalars
    square = out @ (np.eye(own.shape[0]) - solved[:, 1:]) @ out.T
    lengths, axes = np.linalg.eigh(0.5 * (square + square.T))
    pull = (axes.T @ (out @ (departure[count:] + solved[:, 0]))) ** 2
    gains = [0.5 * float((share**2 * pull / (1.0 + share**2 * lengths) - np.log1p(share**2 * lengths)).sum())
             for share in shares]
    return at.log_evidence + float(logsumexp(gains)) - float(np.log(len(gains)))
