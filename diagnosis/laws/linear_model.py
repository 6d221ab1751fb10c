"""Data linearised at a mode: evidence of further columns, and the posterior on the cycles outside each fold.

    e = A·u + ε,   u ~ N(0, I),   ε ~ N(0, W⁻¹).

    C⁻¹ = W − W A(I + AᵀWA)⁻¹AᵀW                              (Woodbury's identity).
    û = (I + AᵀWA)⁻¹AᵀWe,   C⁻¹e = W(e − A·û)
    ln B = ½ gᵀ(σ⁻²I + G)⁻¹g − ½ ln det(I + σ²G),   g = XᵀC⁻¹e,  G = XᵀC⁻¹X.

e: error of the data about the prior's mean.  A = HL: constants, discrepancy, terms, scaled by the root of their prior.
X: columns of a further term.  σ: prior 1σ of its coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from estimation.posterior import PosteriorMode
from physics.laws import Array


class LinearModel:
    """Posterior of linearised data: their residual, e − A·û, and the evidence of further columns."""

    def __init__(self, error: Array, weight: Array, inward: Array, square: Array) -> None:
        """Factor the model.  `square`: AᵀWA of `inward`, A, and `weight`, the diagonal of W."""
        self._weight, self._light = weight, np.ascontiguousarray(inward.T * weight)
        self._factor = np.linalg.cholesky(np.eye(square.shape[0]) + square)
        self.residual: Array = error - inward @ cho_solve((self._factor, True), self._light @ error)
        self._applied = weight * self.residual

    def evidence(self, columns: Array, sd: float, count: int) -> Array:
        """Return the evidence, nats, of each group of `count` columns, shape (data, columns), with the prior 1σ `sd`.
        """
        pull = (columns.T @ self._applied).reshape(-1, count)
        through = solve_triangular(self._factor, self._light @ columns, lower=True)
        groups, inner = (part.reshape(part.shape[0], -1, count) for part in (columns, through))
        square = np.einsum("nka,nkb->kab", self._weight[:, None, None] * groups, groups)
        square -= np.einsum("nka,nkb->kab", inner, inner)
        whole = np.eye(count) / sd**2 + square
        size = np.linalg.solve(whole, pull[:, :, None])[:, :, 0]
        return np.asarray(0.5 * (pull * size).sum(axis=1) - 0.5 * np.linalg.slogdet(sd**2 * whole)[1])


@dataclass
class FoldedModel:
    """Data linearised at a mode `at`, without its last `terms` columns, by fold.

    `fold`: number of the fold of each datum.  AᵀWA is formed once, fold by fold: that of all other folds is a sum.
    """

    at: PosteriorMode
    fold: NDArray[np.intp]
    terms: int = 0
    inward: Array = field(init=False)
    error: Array = field(init=False)
    squares: dict[int, Array] = field(init=False)

    def __post_init__(self) -> None:
        """Form AᵀWA of each fold, and the error about the prior's mean, in which the terms' part stays."""
        at = self.at
        self.inward = at.inward[:, :at.x.size - self.terms]
        off = at.x - at.prior_mean
        self.error = at.residual + at.slopes @ off[:at.constants] + at.features @ off[at.constants:]
        self.squares = {}
        for number in np.unique(self.fold).tolist():
            rows = self.fold == number
            self.squares[number] = (self.inward[rows].T * at.weight[rows]) @ self.inward[rows]

    def model(self, columns: Array, without: int | None = None) -> LinearModel:
        """Return the posterior with further `columns`, scaled by their prior 1σ, on the data outside a fold.

        `without`: number of that fold; None: all data.
        """
        weight = self.at.weight if without is None else np.where(self.fold == without, 0.0, self.at.weight)
        own = np.asarray(sum(part for number, part in self.squares.items() if number != without))
        light = weight[:, None] * columns
        across = self.inward.T @ light
        square = np.block([[own, across], [across.T, columns.T @ light]])
        return LinearModel(self.error, weight, np.concatenate([self.inward, columns], axis=1), square)
