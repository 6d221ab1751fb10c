"""What the laws leave on healthy trials and a bench repeats: learnt per relation, held back where it is judged.

The rule of this file: a regression on features of motion and load that are measured, by radial basis functions about
a few samples of the healthy trials (a Gaussian process on a subset of regressors; Quiñonero-Candela and Rasmussen
2005), so that it goes to zero where no healthy trial has been; what counts is what it leaves on a trial (with one
trial, on cycles) that it has not seen.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.problem.blocks import Block
from physics import memory_laws
from physics.plant.leg import KNEE_AT_FIT
from physics.relations.measured import Signals

Array = NDArray[np.float64]
Values = Mapping[str, float]

CENTRES: Final = 160
LENGTHS: Final = (1.5, 3.0)
"""Lengths of the basis functions that are tried, in standard deviations of the features times the root of their
number over two."""
NOISES: Final = (0.03, 0.3, 3.0)
"""Ratios of noise to structure that are tried."""
SAMPLES: Final = 3000
"""Samples of one relation that it is learnt on."""
WORTH: Final = 0.97
"""RMSE on the unseen, of that without it, from which it is used."""
SMOOTH_S: Final = 0.03
MEMORIES_S: Final = (0.15, 0.8)
LOCAL: Final = 0.5
"""Length over which scatter is taken to be even, as `LENGTHS`."""
FEW: Final = 0.1
"""Samples about a place, of what there are about one in the mean, that say as much of it as all samples together."""
AMPLITUDE: Final = 0.3
"""1σ of the amplitude with which it returns on another trial."""


def slot(relation: str) -> str:
    """Name of the amplitude among the values of a fit."""
    return f"discrepancy.{relation}"


def features(signals: Signals, values: Values) -> Array:
    """Return the features, (samples, n): speed, slip, knee angle, tension, its rate, two memories of it.

    A knee that is not recorded is a locked one: such a trial may lie beside others whose knee moved.
    """
    time = signals["time_s"]
    found = []
    if signals.has("rope_m"):
        found += [np.tanh(signals["rope_m_s"] / 0.02), signals["rope_m_s"] / 0.1, memory_laws.slipped(
            signals["rope_m"], signals.fresh, max(values["presliding"], 5e-5))]
    found.append(signals["knee_angle_rad"] if signals.has("knee_angle_rad") else np.full(time.size, KNEE_AT_FIT))
    tension = next((signals[n] for n in ("tension_end_n", "tension_start_n") if signals.has(n)), None)
    if tension is not None:
        filled = np.nan_to_num(tension)
        smooth = memory_laws.lag(filled, time, signals.fresh, SMOOTH_S)
        found += [smooth, (filled - smooth) / SMOOTH_S,
                  *(memory_laws.lag(filled, time, signals.fresh, s) for s in MEMORIES_S)]
    return np.nan_to_num(np.column_stack(found)) if found else np.zeros((time.size, 0))


@dataclass(frozen=True)
class Discrepancy:
    """One relation's: `of` gives it at features; `left` is its RMSE on the unseen, `plain` the one without it."""

    left: float
    plain: float
    scale: Array = field(default_factory=lambda: np.zeros((2, 0)), repr=False)
    centres: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    weights: Array = field(default_factory=lambda: np.zeros(0), repr=False)
    length: float = 1.0
    noise: float = 1.0

    @property
    def used(self) -> bool:
        return self.weights.size > 0

    def of(self, at: Array) -> Array:
        """Return the discrepancy, in the relation's unit, at `at` (samples, features)."""
        if not self.used:
            return np.zeros(len(at))
        return np.asarray(_kernel((at - self.scale[0]) / self.scale[1], self.centres, self.length) @ self.weights)


def _kernel(at: Array, centres: Array, length: float) -> Array:
    near = at @ (-2.0 * centres.T)
    near += (at**2).sum(axis=1)[:, None]
    near += (centres**2).sum(axis=1)
    np.maximum(near, 0.0, out=near)
    near *= -1.0 / (at.shape[1] * length**2)
    return np.asarray(np.exp(near, out=near))


class _Normal(NamedTuple):
    """Normal equations of a basis on some samples; of sums and differences of samples they are such, too."""

    gram: Array
    right: Array
    samples: int

    def less(self, other: _Normal) -> _Normal:
        """Return them without the samples of `other`."""
        return _Normal(self.gram - other.gram, self.right - other.right, self.samples - other.samples)

    def weights(self, prior: Array, noise: float) -> Array:
        """Return the basis functions' weights; `noise` over structure weighs the prior."""
        matrix = self.gram + noise * prior
        matrix.flat[:: len(matrix) + 1] += 1e-8 * self.samples
        return np.asarray(np.linalg.solve(matrix, self.right))


def _normal(basis: Array, target: Array) -> _Normal:
    return _Normal(basis.T @ basis, basis.T @ target, target.size)


def learn(at: Sequence[Array], rests: Sequence[Array], groups: Sequence[NDArray[np.intp]]) -> Discrepancy:
    """Learn one relation's from features `at` and residuals `rests` of each healthy trial.

    `groups`: by sample, what is held back together (the trial's number, or with one trial the cycle's).
    """
    x, y, group = np.concatenate(list(at)), np.concatenate(list(rests)), np.concatenate(list(groups))
    plain = math.sqrt(float(np.mean(y**2))) if y.size else math.nan
    labels = np.unique(group)
    if not x.shape[1] or len(labels) < 2 or y.size < 4 * CENTRES:
        return Discrepancy(plain, plain)
    scale, chosen, centres = _sampled(x)
    fold = group[chosen] % 5 if len(labels) > 5 else np.searchsorted(labels, group[chosen])
    chosen = chosen[np.argsort(fold, kind="stable")]  # side by side, so that a fold is a view of the whole
    ends = np.cumsum(np.bincount(fold))
    folds = [slice(end - count, end) for end, count in zip(ends, np.bincount(fold), strict=True)]
    x, y = (x[chosen] - scale[0]) / scale[1], y[chosen]
    whole = float(np.mean(y**2))
    best: tuple[float, float, float] = (math.inf, 0.0, 0.0)
    weights = np.zeros(0)
    for length in LENGTHS:
        basis, prior = _kernel(x, centres, length), _kernel(centres, centres, length)
        held = [(basis[f], y[f]) for f in folds]
        own, every = [_normal(*part) for part in held], _normal(basis, y)
        for noise in NOISES:
            left = sum(float(((target - part @ every.less(mine).weights(prior, noise)) ** 2).sum())
                       for (part, target), mine in zip(held, own, strict=True)) / y.size
            if left < best[0]:
                best, weights = (left, length, noise), every.weights(prior, noise)
    left, length, noise = best
    if left >= WORTH**2 * whole:
        return Discrepancy(plain, plain)
    return Discrepancy(plain * math.sqrt(left / whole), plain, scale, centres, weights, length, noise)


def again(known: Discrepancy, at: Sequence[Array], rests: Sequence[Array]) -> Discrepancy:
    """Learn it from other trials, of as many as are given, with the smoothness of `known`."""
    if not known.used:
        return known
    x, y = np.concatenate(list(at)), np.concatenate(list(rests))
    scale, chosen, centres = _sampled(x)
    x, y = (x[chosen] - scale[0]) / scale[1], y[chosen]
    normal, prior = _normal(_kernel(x, centres, known.length), y), _kernel(centres, centres, known.length)
    return dataclasses.replace(known, scale=scale, centres=centres, weights=normal.weights(prior, known.noise))


def _sampled(x: Array) -> tuple[Array, NDArray[np.intp], Array]:
    """Return mean and deviation of the features, the samples that are learnt on, and the centres, scaled."""
    scale = np.stack([x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)])
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.permutation(len(x))[:SAMPLES])
    centres = x[np.sort(rng.permutation(len(x))[:CENTRES])]
    return scale, chosen, (centres - scale[0]) / scale[1]


@dataclass(frozen=True)
class Scatter:
    """A mean square by where in motion and load: a kernel's local mean; where no sample has been, what it is on the
    whole."""

    scale: Array = field(repr=False)
    centres: Array = field(repr=False)
    squares: Array = field(repr=False)
    counts: Array = field(repr=False)
    whole: float

    def of(self, at: Array) -> Array:
        """Return the mean square at `at` (samples, features), in the relation's unit squared."""
        near = _kernel((at - self.scale[0]) / self.scale[1], self.centres, LOCAL)
        few = FEW * float(self.counts.mean())
        return np.asarray((near @ self.squares + few * self.whole) / (near @ self.counts + few))


def scatter(at: Array, squares: Array, least: float = 0.0) -> Scatter:
    """Return where `squares` (samples) are how large, from features `at`; nowhere below `least`."""
    scale, chosen, centres = _sampled(at)
    near = _kernel((at[chosen] - scale[0]) / scale[1], centres, LOCAL)
    counts = near.sum(axis=0)
    return Scatter(scale, centres, np.maximum(near.T @ squares[chosen], least * counts), counts,
                   max(float(np.mean(squares)), least))


def certainty(structure: Array, noise: Array) -> Array:
    """Return how much each sample counts, 1 in the mean square, from its mean squares of structure and of noise."""
    cost = structure + noise
    return np.asarray(1.0 / np.sqrt(cost * np.mean(1.0 / cost)))


@dataclass(frozen=True)
class Corrected(Block):
    """A block less what its relation is known to leave, by an amplitude that the fit may move.

    `certainty`: by sample, how much more (or less) it counts than the relation's samples do in the mean.
    """

    plain: Block
    known: Array
    amplitude: str | None
    certainty: Array | None = None

    def residual(self, values: Values) -> Array:
        rest = self.plain.residual(values)
        if self.amplitude is not None:
            rest = rest - values[self.amplitude] * self.known
        return rest if self.certainty is None else self.certainty * rest


def corrected(block: Block, learnt: Mapping[str, Discrepancy], values: Values,
              certainty: Array | None = None) -> Block:
    """Return `block` with what `learnt` knows of its relation taken off; itself where nothing is known."""
    name = block.relation.name
    known = name in learnt and learnt[name].used
    if not known and certainty is None:
        return block
    off = learnt[name].of(features(block.signals, values)[block.keep]) if known else np.zeros(block.keep.size)
    return Corrected(block.relation, block.signals, block.keep, block.cycle,
                     block.uses | ({slot(name)} if known else set()), plain=block, known=off,
                     amplitude=slot(name) if known else None, certainty=certainty)
