"""Evidence of an effect averaged over a family of shapes and over the amplitude of the session's discrepancy.

    y − f(q̂ + x) = Φ(c + d + a·d′) + s·(f(q̂) − f(q̂ without the effect))·Φw + ε        d′, w ~ N(0, 1).

The equation of an effect differs from the bench's by a share s of the effect that depends on motion and load.
Examples are another pivot, load or speed law, or spread of travels.  Readings of sensors have exact equations: s = 0
for effects of sensors.  Constants of the session have inexact equations, too: the gain of the model without an effect
by shapes of their scatter is subtracted.  With and without an effect the discrepancy may change between sessions by a
further share a of it.  Both are linear at a mode, so that each evidence is a closed form; they are averaged with equal
weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import logsumexp

from estimation.posterior import Gaussian, Observed, PosteriorMode
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array


class Solved(NamedTuple):
    """Error e about the prior's mean and C⁻¹ applied to e and to further columns, at a mode."""

    error: Array
    applied_error: Array
    applied: Array


def feature_sd(reference: ReferenceFit) -> Array:
    """Return 1σ of the weight of each feature of the discrepancy between benches."""
    session = np.diag(reference.prior.covariance - reference.bench.covariance)[len(reference.model.constants.free):]
    return np.asarray(np.sqrt(session) / reference.model.session_share)


def averaged(observed: Observed, prior: Gaussian, at: PosteriorMode, variants: Sequence[Variant], amplitude: Array,
             null: PosteriorMode | None = None, sigmas: float = 2.0) -> float:
    """Return the log evidence of a mode, nats, averaged over shapes and amplitudes.

    `amplitude`: 1σ of each feature's weight between benches.  `variants`: effects that the mode has.  `null`: the mode
    without an effect, whose gain by shapes of the same constants is subtracted.  `sigmas`: the largest departure of a
    constant that counts there, in its 1σ between sessions; 95 % of sessions are within 2.
    """
    shape = shape_columns(observed, prior, at, variants)
    evidence = at.log_evidence + _gained(observed, at, shape, amplitude)
    if null is None or not shape.shape[1]:
        return evidence
    own = shape_columns(observed, prior, null, variants, sigmas)
    return evidence - _gained(observed, null, own, amplitude) + _gained(observed, null, own[:, :0], amplitude)


def _gained(observed: Observed, at: PosteriorMode, shape: Array, amplitude: Array) -> float:
    """Return by how much the average over shapes and amplitudes exceeds the log evidence of a mode, nats."""
    model, wide = observed.model, observed.features * amplitude
    shares = model.shape_shares if shape.shape[1] else (0.0,)
    columns = np.concatenate([wide, shape], axis=1)
    solved = _solved(at, columns)
    pull, square = columns.T @ solved.applied_error, columns.T @ solved.applied
    gains = []
    for width in model.session_shares:
        for share in shares:
            scale = np.repeat([width, share], [wide.shape[1], shape.shape[1]])
            used = scale > 0.0
            scaled = scale[used] * pull[used]
            inner = np.eye(scaled.size) + scale[used, None] * square[np.ix_(used, used)] * scale[used]
            gains.append(0.5 * float(scaled @ np.linalg.solve(inner, scaled) - np.linalg.slogdet(inner)[1]))
    return float(logsumexp(gains)) - float(np.log(len(gains)))


def shape_columns(observed: Observed, prior: Gaussian, at: PosteriorMode, variants: Sequence[Variant],
                  sigmas: float = np.inf) -> Array:
    """Return the response of the effects at a mode times each feature of the states, shape (data, features).

    It has no columns for effects of sensors, and for a model without shape shares.  `sigmas`: the departure of each
    constant that counts, at most, in its 1σ between sessions.
    """
    freed = [name for variant in variants for direction in variant.directions for name in direction.along]
    if not set(freed) & set(observed.model.extrapolated) or not any(observed.model.shape_shares):
        return np.zeros((observed.data.size, 0))
    table, moved, without, reference = at.table, at.q.copy(), at.q.copy(), prior.origin.copy()
    reference[list(table.free)] += prior.mean[:len(table.free)]
    rows = [table.index[name] for name in freed]
    without[rows] = reference[rows]
    if np.isfinite(sigmas):
        bound = np.zeros(at.q.size)
        bound[list(table.free)] = sigmas * np.sqrt(np.diag(prior.covariance)[:len(table.free)])
        moved[rows] = reference[rows] + np.clip(moved[rows] - reference[rows], -bound[rows], bound[rows])
    return np.asarray((observed.predicted(moved) - observed.predicted(without))[:, None] * observed.features)


def residual(at: PosteriorMode, columns: Array, shares: Sequence[float]) -> Array:
    """Return the residual of a mode after the shape `columns` are fitted, too, with the likeliest of the `shares`.

    Data of weight 0 are predicted.
    """
    if not columns.shape[1]:
        return at.residual
    solved = _solved(at, columns)
    best, left = -np.inf, at.residual
    # the mode's own residual is exact; only the change by the columns is linear
    without = solved.error - at.inward @ (at.inward.T @ solved.applied_error)
    for share in shares:
        pull = share * columns.T @ solved.applied_error
        inner = np.eye(pull.size) + share**2 * columns.T @ solved.applied
        step = np.linalg.solve(inner, pull)
        gain = 0.5 * float(pull @ step) - 0.5 * float(np.linalg.slogdet(inner)[1])
        if gain > best:
            whole = solved.applied_error - share * solved.applied @ step
            changed = solved.error - at.inward @ (at.inward.T @ whole) - share * columns @ step
            best, left = gain, at.residual + changed - without
    return np.asarray(left)


def _solved(at: PosteriorMode, columns: Array) -> Solved:
    inward, off = at.inward, at.x - at.prior_mean
    error = at.residual + at.slopes @ off[:at.constants] + at.features @ off[at.constants:]
    light = at.weight[:, None] * np.concatenate([error[:, None], columns], axis=1)
    applied = light - at.weight[:, None] * (inward @ cho_solve(at.inner, inward.T @ light))
    return Solved(error, applied[:, 0], applied[:, 1:])
