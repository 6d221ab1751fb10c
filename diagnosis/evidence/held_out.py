"""Errors of the simulation on a trial, without and with the chosen effects, on held-out cycles.

    before   prediction by the models of the reference trials, averaged; nothing is fitted to the trial
    after    prediction with the chosen effects; each half of the cycles is predicted by a fit to the other half
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.compared_signals import Compared
from diagnosis.findings import Figures
from estimation.data.table import Table
from estimation.likelihood_data import Recording
from estimation.posterior import Gaussian, Observed, PosteriorMode, begun, mode
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array

ALONG: Final = ("gait_percent", "rope_m_s", "servo_position_m", "knee_angle_rad", "tension_start_n", "tension_end_n")


@dataclass(frozen=True)
class HeldOut:
    """Errors `before` and `after` of the data of `observed`, shape (data,).

    `blocks`: by trial, the cycle number of each bin.
    """

    observed: Observed
    before: Array
    after: Array
    blocks: Sequence[NDArray[np.intp]]

    def rms_n(self, which: str) -> float:
        """Return the RMS error over the model's judged outputs; `which`: "before" or "after"."""
        model = self.observed.model
        parts = [errors[name] for trial, rest in self.observed.each(getattr(self, which))
                 for errors in (model.errors(trial, rest),) for name in model.judged if name in errors]
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    def figures(self, reference: ReferenceFit, held: HeldOut | None = None) -> dict[str, Figures]:
        """Return the figures by output; `held`: errors of held-out trials, for the figures on these."""
        return {name: self._figures(name, reference.scatter_n[name], held) for name in self.observed.outputs}

    def _figures(self, name: str, floor: float, held: HeldOut | None, draws: int = 400) -> Figures:
        """Return the figures of one output; `draws`: bootstrap samples of whole cycles, for the gain's interval."""
        before, after = self._squares(name, "before"), self._squares(name, "after")
        draw = np.random.default_rng(0).integers(0, len(before), (draws, len(before)))
        gains = 100.0 * (1.0 - np.sqrt(after[draw, 0].sum(axis=1) / before[draw, 0].sum(axis=1)))
        low, high = np.percentile(gains, [2.5, 97.5])
        first, last = self._rms(name, "before"), self._rms(name, "after")
        seen = [None, None] if held is None else [held._rms(name, which) for which in ("before", "after")]
        return Figures(self.observed.model.signals[name], floor, first, last, seen[0], seen[1],
                       100.0 * (1.0 - last / first), float(low), float(high))

    def _rms(self, name: str, which: str) -> float:
        squares, counts = self._squares(name, which).sum(axis=0)
        return float(np.sqrt(squares / counts))

    def _squares(self, name: str, which: str) -> Array:
        """Return the sum of squared errors and the number of data of each cycle, shape (cycles, 2)."""
        rows = []
        for (trial, rest), block in zip(self.observed.each(getattr(self, which)), self.blocks, strict=True):
            squares = self.observed.model.errors(trial, rest)[name] ** 2
            rows += [(float(squares[block == n].sum()), float((block == n).sum())) for n in np.unique(block)]
        return np.array(rows)

    def traces(self, tables: Sequence[Table]) -> dict[str, list[Compared]]:
        """Return measured signals with both errors by output, one entry per trial."""
        made: dict[str, list[Compared]] = {name: [] for name in self.observed.outputs}
        sides = zip(self.observed.each(self.before), self.observed.each(self.after), tables, self.blocks, strict=True)
        for (trial, before), (_, after), table, block in sides:
            errors = self.observed.model.errors
            first, last = errors(trial, before), errors(trial, after)
            along = _along(trial, table)
            for name in made:
                made[name].append(Compared(name, self.observed.model.signals[name], trial.binned(trial.measured(name)),
                                           first[name], last[name], block, along))
        return made


def held_out(observed: Observed, prior: Gaussian, reference: ReferenceFit, chosen: Sequence[Variant],
             base: PosteriorMode, blocks: Sequence[NDArray[np.intp]]) -> HeldOut:
    """Return the errors of a trial, each half of its cycles predicted by a fit of the chosen effects to the other half.

    The fits start at the mode `base`.
    """
    before = reference.missed(observed)
    if not chosen:
        return HeldOut(observed, before, before, blocks)
    half = np.concatenate([np.tile(b % 2, len(observed.outputs)) for b in blocks])
    left = before.copy()
    for fold in (0, 1):
        seen = replace(observed, weight=np.where(half == fold, 1e-9, observed.weight))
        at = mode(seen, prior, chosen, begun(base, None, kept=chosen))
        left = np.where(half == fold, rest(observed, at), left)
    return HeldOut(observed, before, left, blocks)


def rest(observed: Observed, at: PosteriorMode) -> Array:
    """Return the residual of data at a mode, which may be a fit to other data."""
    return np.asarray(observed.data - observed.predicted(at.q) - observed.features @ at.x[at.constants:])


def blocks_of(tables: Sequence[Table], trials: Sequence[Recording]) -> list[NDArray[np.intp]]:
    """Return the cycle number of each bin, by trial, counted on from trial to trial."""
    told: list[NDArray[np.intp]] = []
    first = 0
    for table, trial in zip(tables, trials, strict=True):
        number = cycles_of(table)[_nearest(trial, table)]
        block = (number - number.min()).astype(np.intp) + first
        told.append(block)
        first = int(block.max()) + 1
    return told


def cycles_of(table: Table, block_s: float = 2.0) -> Array:
    """Return the cycle number of each sample; without cycle numbers, blocks of `block_s`, about one gait cycle.

    The last block also holds the remainder of the trial.
    """
    if "cycle" in table:
        return np.asarray(np.floor(np.nan_to_num(table["cycle"])))
    blocks = np.floor((table["time_s"] - table["time_s"][0]) / block_s)
    return np.asarray(np.minimum(blocks, max(blocks[-1] - 1.0, 0.0)))


def _nearest(trial: Recording, table: Table) -> NDArray[np.intp]:
    """Return the sample at the time of each bin; columns that wrap are not interpolated."""
    at = np.searchsorted(table["time_s"], trial.binned(trial.time_s) + table["time_s"][0])
    return np.asarray(np.minimum(at, table["time_s"].size - 1))


def _along(trial: Recording, table: Table) -> Mapping[str, Array]:
    own = trial.along
    told = {"time_s": trial.binned(trial.time_s) + table["time_s"][0]}
    for name in ALONG:
        if name in own:
            told[name] = trial.binned(own[name])
        elif name in trial.outputs:
            told[name] = trial.binned(trial.measured(name))
        elif name in table:
            told[name] = np.nan_to_num(table[name][_nearest(trial, table)])
    return told
