"""Errors of the fitted model that are no change of the bench, so that no term may describe them.

    discrepancy    a function of the bench's state: it repeats in each gait cycle, so that held-out cycles confirm it
    model error    residual of the reference trials: it may last a whole cycle, as a slow drift of a sensor does
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimation.posterior import Gaussian, SessionData
from estimation.reference_fit import ReferenceFit
from physics.laws import Array

PARTS: Final = 50
"""Parts of a gait cycle with a discrepancy each: the width of a bump of the library."""


class ModelErrors:
    """Variances of discrepancy and model error in the trials of one session.

    `columns`: 1σ of the errors that several data of a gait share, shape (data, errors).  Outside gait cycles
    nothing is seen not to repeat: there are none, and the whole discrepancy counts against a term.
    """

    def __init__(self, observed: SessionData, prior: Gaussian, reference: ReferenceFit,
                 blocks: Sequence[NDArray[np.intp]]) -> None:
        """Lay out the errors on the data.  `blocks`: cycle number of each bin, by trial."""
        self._observed, outputs = observed, observed.outputs
        count, growth = observed.features.shape[1], float(np.mean(observed.growth))
        self._level = growth * np.array([np.mean(reference.model_error[reference.outputs.index(n)]) for n in outputs])
        self._discrepancy = np.einsum("nk,kl,nl->n", observed.features, prior.covariance[-count:, -count:],
                                      observed.features)
        phases = [np.full(block.size, np.nan) if trial.phase is None else trial.phase
                  for trial, block in zip(observed.trials, blocks, strict=True)]
        self._phases, cycles = (self._numbered(parts) for parts in (
            [np.minimum(np.nan_to_num(p * PARTS, nan=-1.0).astype(np.intp), PARTS - 1) for p in phases],
            [np.where(np.isfinite(p), block, -1) for p, block in zip(phases, blocks, strict=True)]))
        self.columns: Array = np.concatenate([
            _shared(self._phases, self._discrepancy + self._level[self._phases % len(outputs)]),
            _shared(cycles, self._level[cycles % len(outputs)])], axis=1)

    def _numbered(self, parts: Sequence[NDArray[np.intp]]) -> NDArray[np.intp]:
        """Return a number for the output and the part of each datum; `parts`: of each bin, by trial, −1: its own."""
        count, numbers = len(self._observed.outputs), list[NDArray[np.intp]]()
        first = 1 + max(int(part.max()) for part in parts)
        for part in parts:
            own = np.where(part < 0, first + np.arange(part.size), part)
            numbers.append((np.arange(count)[:, None] + count * own).ravel())
            first += part.size
        return np.concatenate(numbers)

    def least_falls(self, change: Array) -> dict[str, float]:
        """Return the fall of the squared error that a term must exceed in one judged signal, N².

        `change`: of the data's prediction by the term, shape (data,).  It is the model error's variance, and the
        discrepancy's times the share of the change that repeats in each cycle.
        """
        counts = self._observed.weight > 0.0
        least = {}
        for k, name in enumerate(self._observed.outputs):
            if name in self._observed.model.judged:
                own = counts & (self._phases % self._level.size == k)
                part, values = self._phases[own], change[own]
                sums, sizes = np.bincount(part, values), np.bincount(part)
                share = float((sums[sizes > 0]**2 / sizes[sizes > 0]).sum() / max(values @ values, 1e-30))
                least[name] = float(self._level[k] + share * self._discrepancy[own].mean())
        return least


def _shared(numbers: NDArray[np.intp], variance: Array) -> Array:
    """Return a column for each number of several data: 1σ of an error that they share, of their mean `variance`."""
    _, place, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    sd = np.sqrt(np.bincount(place, variance) / counts)
    several = np.flatnonzero(counts > 1)
    return np.asarray((place[:, None] == several) * sd[several])
