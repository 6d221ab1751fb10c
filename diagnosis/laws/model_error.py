"""Errors of the fitted model that are no change of the bench, so that no term may describe them.

    discrepancy    a function of the bench's state: it repeats in each gait cycle, so that held-out cycles confirm it
    model error    residual of the reference trials: it may last a whole cycle, as a slow drift of a sensor does.  It
                   may be larger in one part of the cycle, such as where the rope gets taut
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimation.likelihood_data import Recording
from estimation.posterior import Gaussian, SessionData
from estimation.reference_fit import ReferenceFit
from physics.laws import Array

PARTS: Final = 50
"""Parts of a gait cycle with a discrepancy each: the width of a bump of the library."""


class ModelErrors:
    """Variances of discrepancy and model error in the trials of one session.

    `references`: recordings of the reference trials, in the order of `reference.identified`.  `columns`: 1σ of the
    errors that several data of a gait share, shape (data, errors).  Outside gait cycles nothing is seen not to repeat:
    there are none, and the whole discrepancy counts against a term.
    """

    def __init__(self, observed: SessionData, prior: Gaussian, reference: ReferenceFit,
                 blocks: Sequence[NDArray[np.intp]], references: Sequence[Recording]) -> None:
        """Lay out the errors on the data.  `blocks`: cycle number of each bin, by trial."""
        self._observed, outputs = observed, observed.outputs
        count, growth = observed.features.shape[1], float(np.mean(observed.growth))
        level = growth * np.array([np.mean(reference.model_error[reference.outputs.index(n)]) for n in outputs])
        self._discrepancy = np.einsum("nk,kl,nl->n", observed.features, prior.covariance[-count:, -count:],
                                      observed.features)
        parts = [_parts(trial) for trial in observed.trials]
        self._phases, cycles = (self._numbered(numbers) for numbers in (
            parts, [np.where(part < 0, -1, block) for part, block in zip(parts, blocks, strict=True)]))
        seen = np.pad(_seen(reference, references), ((0, 0), (0, 1)))  # outside the gait, part −1: nothing
        seen = seen[[reference.outputs.index(name) for name in outputs]]
        self._model = np.concatenate([np.maximum(level[:, None], seen[:, part]).ravel() for part in parts])
        self.columns: Array = np.concatenate([
            _shared(self._phases, self._discrepancy + self._model),
            _shared(cycles, level[cycles % len(outputs)])], axis=1)

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

        `change`: of the data's prediction by the term, shape (data,).  It is the model error's variance where the term
        acts, and the discrepancy's times the share of the change that repeats in each cycle.
        """
        counts, outputs = self._observed.weight > 0.0, self._observed.outputs
        least = {}
        for k, name in enumerate(outputs):
            if name in self._observed.model.judged:
                own = counts & (self._phases % len(outputs) == k)
                part, values = self._phases[own], change[own]
                sums, sizes, whole = np.bincount(part, values), np.bincount(part), max(values @ values, 1e-30)
                share = float((sums[sizes > 0]**2 / sizes[sizes > 0]).sum() / whole)
                least[name] = float(values**2 @ self._model[own] / whole + share * self._discrepancy[own].mean())
        return least


def _parts(trial: Recording) -> NDArray[np.intp]:
    """Return the part of the gait cycle of each bin; −1 outside the gait."""
    if trial.phase is None:
        return np.full(trial.rows.size, -1)
    return np.minimum(np.nan_to_num(trial.phase * PARTS, nan=-1.0).astype(np.intp), PARTS - 1)


def _seen(reference: ReferenceFit, references: Sequence[Recording]) -> Array:
    """Return the squared mean residual of the reference trials in each part of their cycles, N², (outputs, parts).

    The mean over the reference trials, a part and its two neighbours, since gaits differ.
    """
    squares: Array = np.zeros((len(reference.outputs), PARTS))
    if reference.model.pools_sessions:  # of a rig, which has no gait
        return squares
    for trial, (q, c) in zip(references, reference.identified, strict=True):
        known, part = reference.observe(trial), _parts(trial)
        missed, walked = known.data - known.predicted(q) - known.features @ c, part >= 0
        sizes = np.maximum(np.bincount(part[walked], minlength=PARTS), 1)
        for k in range(squares.shape[0]):
            sums = np.bincount(part[walked], trial.part(missed, k)[walked], PARTS)
            squares[k] += (sums / sizes) ** 2 / len(references)
    return np.asarray(np.mean([np.roll(squares, shift, axis=1) for shift in (-1, 0, 1)], axis=0))


def _shared(numbers: NDArray[np.intp], variance: Array) -> Array:
    """Return a column for each number of several data: 1σ of an error that they share, of their mean `variance`."""
    _, place, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    sd = np.sqrt(np.bincount(place, variance) / counts)
    several = np.flatnonzero(counts > 1)
    return np.asarray((place[:, None] == several) * sd[several])
