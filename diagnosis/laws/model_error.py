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

    Parts of a trial without gait cycles are parts of its time: nothing in it is seen to repeat, or not to.
    """

    def __init__(self, observed: SessionData, prior: Gaussian, reference: ReferenceFit,
                 blocks: Sequence[NDArray[np.intp]]) -> None:
        """Lay out the errors on the data.  `blocks`: cycle number of each bin, by trial."""
        self._observed, outputs = observed, observed.outputs
        count, growth = observed.features.shape[1], float(np.mean(observed.growth))
        self._level = growth * np.array([np.mean(reference.model_error[reference.outputs.index(n)]) for n in outputs])
        self._discrepancy = np.einsum("nk,kl,nl->n", observed.features, prior.covariance[-count:, -count:],
                                      observed.features)
        self._phases = self._numbered([_parts(trial.phase, b.size) for trial, b in zip(
            observed.trials, blocks, strict=True)])
        cycles = self._numbered(blocks)
        self.columns: Array = np.concatenate([
            _shared(self._phases, self._discrepancy + self._level[self._phases % len(outputs)]),
            _shared(cycles, self._level[cycles % len(outputs)])], axis=1)

    def _numbered(self, parts: Sequence[NDArray[np.intp]]) -> NDArray[np.intp]:
        """Return a number for the output and the part of each datum; `parts`: of each bin, by trial."""
        count = len(self._observed.outputs)
        return np.concatenate([(np.arange(count)[:, None] + count * part).ravel() for part in parts])

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


def _parts(phase: Array | None, count: int) -> NDArray[np.intp]:
    """Return the part of the gait cycle of each of `count` bins; without a phase, the part of the trial."""
    share = np.arange(count) / count if phase is None else phase
    return np.minimum((share * PARTS).astype(np.intp), PARTS - 1)


def _shared(numbers: NDArray[np.intp], variance: Array) -> Array:
    """Return a column for each number: 1σ of an error that all its data share, of their mean `variance`."""
    _, place = np.unique(numbers, return_inverse=True)
    sd = np.sqrt(np.bincount(place, variance) / np.bincount(place))
    columns = np.zeros((numbers.size, sd.size))
    columns[np.arange(numbers.size), place] = sd[place]
    return columns
