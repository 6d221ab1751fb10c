"""Errors of the simulation on a trial, on held-out cycles, by three models.

Each cycle is predicted by a fit to the others.  The gain of the effects is that of `named` over `session`, since a
session differs from the reference trials without an effect, too.

    reference   the models of the reference trials, averaged; nothing is fitted to the trial
    session     the session's constants and discrepancy are fitted, without an effect
    named       the chosen effects are fitted, too, by their equations alone: a shape that is fitted beside them would
                lower the error without being theirs
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from diagnosis.compared_signals import Figures, SignalResiduals
from estimation.data.table import Table
from estimation.likelihood_data import Recording
from estimation.posterior import Gaussian, PosteriorMode, SessionData, begun, loss, mode
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.laws import Array

ALONG: Final = ("gait_percent", "rope_m_s", "servo_position_m", "knee_angle_rad", "tension_start_n", "tension_end_n")


class Gain(NamedTuple):
    """Gain of the named effects over the adapted session, %, with its 95 % interval from whole cycles."""

    percent: float
    low: float
    high: float


@dataclass(frozen=True)
class HeldOut:
    """Errors of the data of `observed` by the models `reference`, `session` and `named`, each of shape (data,).

    `named`: None without a chosen effect.  `blocks`: by trial, the cycle number of each bin.
    """

    observed: SessionData
    reference: Array
    session: Array
    named: Array | None
    blocks: Sequence[NDArray[np.intp]]

    @property
    def judged(self) -> list[str]:
        """Names of the judged outputs that the trials have."""
        return [name for name in self.observed.model.judged if name in self.observed.outputs]

    def rms_n(self, which: str) -> float:
        """Return the RMS error over the judged outputs; `which`: "reference", "session" or "named"."""
        return self._rms(self.judged, which)

    def gain(self, names: Sequence[str] = (), draws: int = 400) -> Gain | None:
        """Return the gain over the outputs `names` (none: the judged ones); None if no effect is chosen.

        `draws`: bootstrap samples of whole cycles.
        """
        if self.named is None:
            return None
        without, with_effect = (self._squares(names or self.judged, which)[:, 0] for which in ("session", "named"))
        # cycles are the units of the bootstrap, since data within one are not independent
        draw = np.random.default_rng(0).integers(0, without.size, (draws, without.size))
        gains = 100.0 * (1.0 - np.sqrt(with_effect[draw].sum(axis=1) / without[draw].sum(axis=1)))
        low, high = np.percentile(gains, [2.5, 97.5])
        return Gain(100.0 * (1.0 - float(np.sqrt(with_effect.sum() / without.sum()))), float(low), float(high))

    def figures(self, reference: ReferenceFit, held: HeldOut | None = None) -> dict[str, Figures]:
        """Return the figures by output; `held`: errors of held-out trials, for the figures on these."""
        return {name: self._figures(name, reference.scatter_n[name], held) for name in self.observed.outputs}

    def _figures(self, name: str, floor: float, held: HeldOut | None) -> Figures:
        """Return the figures of one output."""
        first, adapted, last = self._errors(name)
        seen = (None, None, None) if held is None else held._errors(name)
        percent, low, high = self.gain([name]) or (None, None, None)
        return Figures(self.observed.model.signals[name], floor, first, adapted, last, seen[0], seen[1], seen[2],
                       percent, low, high)

    def _errors(self, name: str) -> tuple[float, float, float | None]:
        """Return the RMS error of one output by `reference`, `session` and, if effects are chosen, `named`."""
        return (self._rms([name], "reference"), self._rms([name], "session"),
                None if self.named is None else self._rms([name], "named"))

    def _rms(self, names: Sequence[str], which: str) -> float:
        squares, counts = self._squares(names, which).sum(axis=0)
        return float(np.sqrt(squares / counts))

    def _squares(self, names: Sequence[str], which: str) -> Array:
        """Return the sum of squared errors of outputs and the number of data that count, by cycle, shape (cycles, 2).
        """
        rows, observed = [], self.observed
        sides = zip(observed.each(getattr(self, which)), observed.each(observed.weight), self.blocks, strict=True)
        for (trial, rest), (_, weight), block in sides:
            errors = observed.model.errors(trial, rest)
            counts = np.stack([trial.part(weight, observed.outputs.index(name)) > 0.0 for name in names])
            squares = np.stack([errors[name] ** 2 for name in names]) * counts
            rows += [(float(squares[:, block == n].sum()), float(counts[:, block == n].sum()))
                     for n in np.unique(block)]
        return np.array(rows)

    def at_rest(self) -> list[str]:
        """Return a sentence on each output of a rig whose data at rest are in none of the figures."""
        told = []
        for k, name in enumerate(self.observed.outputs):
            rests = self.observed.part(self.observed.weight, k) == 0.0
            if self.observed.model.pools_sessions and rests.any():
                error = float(np.sqrt(np.mean(self.observed.part(self.reference, k)[rests] ** 2)))
                told.append(f"{name}: at rest, {100.0 * rests.mean():.0f} % of the data, the reference model "
                            f"misses it by {error:.3g} {self.observed.model.signals[name]} RMS; friction at rest is "
                            "anywhere up to its static value, so no figure counts these data.")
        return told

    def traces(self, tables: Sequence[Table]) -> dict[str, list[SignalResiduals]]:
        """Return measured signals with their errors under each model by output, one entry per trial."""
        made: dict[str, list[SignalResiduals]] = {name: [] for name in self.observed.outputs}
        models = (self.reference, self.session, self.session if self.named is None else self.named)
        sides = zip(*map(self.observed.each, models), tables, self.blocks, strict=True)
        for (trial, reference), (_, session), (_, last), table, block in sides:
            before, adapted, after = (self.observed.model.errors(trial, rest) for rest in (reference, session, last))
            along = _along(trial, table)
            for name in made:
                made[name].append(SignalResiduals(
                    name, self.observed.model.signals[name], trial.binned(trial.measured(name)), before[name],
                    adapted[name], after[name], block, along))
        return made


def held_out(observed: SessionData, prior: Gaussian, reference: ReferenceFit, chosen: Sequence[Variant],
             modes: tuple[PosteriorMode, PosteriorMode], blocks: Sequence[NDArray[np.intp]]) -> HeldOut:
    """Return the errors of a trial, each of its cycles predicted by fits to the others.

    `modes`: of the whole trial, without and with the `chosen` effects.
    """
    cycles, (null, named) = np.concatenate([np.tile(b, len(observed.outputs)) for b in blocks]), modes
    return HeldOut(observed, reference.missed(observed), left_out(observed, prior, [], null, cycles),
                   left_out(observed, prior, chosen, named, cycles) if chosen else None, blocks)


def left_out(observed: SessionData, prior: Gaussian, variants: Sequence[Variant], at: PosteriorMode,
             cycles: NDArray[np.intp]) -> Array:
    """Return the residual of each datum by a fit to the other `cycles` than its own; `at`: mode of all with `variants`.

    One Gauss–Newton step from that mode: x̂₋ᵢ = x̂ − (A − HᵢᵀWᵢHᵢ)⁻¹HᵢᵀWᵢrᵢ, A = P⁻¹ + HᵀWH (Cook and Weisberg 1982,
    deletion of several cases).  Where it does not lower the cost of the other cycles, they are fitted.
    """
    inward, left = at.inward, at.residual.copy()
    whole = np.eye(at.x.size) + at.factor.T @ at.information @ at.factor
    for cycle in np.unique(cycles):
        own = cycles == cycle
        light, root = at.weight[own, None] * inward[own], np.sqrt(np.where(own, 0.0, observed.weight))

        def cost(residual: Array, x: Array, root: Array = root) -> float:
            off = solve_triangular(at.factor, x - at.prior_mean, lower=True)
            return loss(residual, root) + float(off @ off)

        step = -at.factor @ np.linalg.solve(whole - inward[own].T @ light, light.T @ at.residual[own])
        q = at.q.copy()
        q[list(at.active)] += step[:at.constants]
        moved = rest(observed, replace(at, q=q, x=at.x + step))
        if not cost(moved, at.x + step) <= cost(at.residual, at.x):
            others = replace(observed, weight=np.where(own, 1e-9, observed.weight))
            moved = rest(observed, mode(others, prior, variants, begun(at, None, kept=variants)))
        left[own] = moved[own]
    return left


def rest(observed: SessionData, at: PosteriorMode) -> Array:
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


def cycles_of(table: Table, block_s: float = 2.0, least_s: float = 1.0) -> Array:
    """Return the cycle number of each sample; without cycle numbers, blocks of `block_s`, about one gait cycle.

    A trial that is too short for three of them has three blocks of `least_s` or more.  The last block also holds the
    remainder of the trial.
    """
    if "cycle" in table:
        return np.asarray(np.floor(np.nan_to_num(table["cycle"])))
    passed = table["time_s"] - table["time_s"][0]
    third_s = 0.333 * passed[-1]  # a little less than a third, so that rounding takes no block away
    blocks = np.floor(passed / min(block_s, max(least_s, third_s)))
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
