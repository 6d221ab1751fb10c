"""Discrepancy of each equation in the reference condition: a regression of its residuals, validated held-out.

The features are measured motion and load. The basis functions are Gaussians about a few samples of the reference trials
(a Gaussian process on a subset of regressors; Quiñonero-Candela and Rasmussen 2005). The discrepancy therefore goes to
zero away from the reference trials. It is judged by the residual of held-out trials, or of held-out cycles if only one
trial exists.
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
"""Lengths of the basis functions to try, in standard deviations of the n features times √(n/2)."""
NOISES: Final = (0.03, 0.3, 3.0)
"""Ratios of noise variance to systematic variance to try."""
SAMPLES: Final = 3000
"""Most samples of one equation that its discrepancy is fitted to."""
WORTH: Final = 0.97
"""Held-out RMSE with the discrepancy, as a share of that without, above which the discrepancy is not used."""
SMOOTH_S: Final = 0.03
MEMORIES_S: Final = (0.15, 0.8)
LOCAL: Final = 0.5
"""Length of the kernel that averages the local mean square; same unit as `LENGTHS`."""
FEW: Final = 0.1
"""Weight of the global mean square in a local one, as a share of the mean number of samples about a centre."""
AMPLITUDE: Final = 0.3
"""1σ of the amplitude (mean 1) of the discrepancy on another trial."""


def slot(relation: str) -> str:
    """Return the name of a discrepancy's amplitude among the parameters of a fit."""
    return f"discrepancy.{relation}"


def features(signals: Signals, values: Values) -> Array:
    """Return the features, (samples, n): speed, slip, knee angle, tension, its rate, and two low-passed tensions.

    A knee angle that is not recorded is taken as constant (locked knee), so that such a trial can be combined with
    others.
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
    """Discrepancy of one equation as a function of features; `left`: its held-out RMSE; `plain`: RMSE without it."""

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
        """Return the discrepancy, in the equation's unit, at the features `at` (samples, n)."""
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
    """Normal equations of a basis on some samples; those of two sample sets can be added and subtracted."""

    gram: Array
    right: Array
    samples: int

    def less(self, other: _Normal) -> _Normal:
        """Return the normal equations without the samples of `other`."""
        return _Normal(self.gram - other.gram, self.right - other.right, self.samples - other.samples)

    def weights(self, prior: Array, noise: float) -> Array:
        """Return the coefficients of the basis functions; `noise`: ratio of noise to systematic variance."""
        matrix = self.gram + noise * prior
        matrix.flat[:: len(matrix) + 1] += 1e-8 * self.samples
        return np.asarray(np.linalg.solve(matrix, self.right))


def _normal(basis: Array, target: Array) -> _Normal:
    return _Normal(basis.T @ basis, basis.T @ target, target.size)


def learn(at: Sequence[Array], rests: Sequence[Array], groups: Sequence[NDArray[np.intp]]) -> Discrepancy:
    """Fit the discrepancy of one equation to the features `at` and residuals `rests` of each reference trial.

    `groups`: by sample, the number of the set that is held out together (trial, or cycle if only one trial exists).
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
    """Refit a discrepancy to the residuals `rests` of other trials, with kernel length and noise ratio of `known`."""
    if not known.used:
        return known
    x, y = np.concatenate(list(at)), np.concatenate(list(rests))
    scale, chosen, centres = _sampled(x)
    x, y = (x[chosen] - scale[0]) / scale[1], y[chosen]
    normal, prior = _normal(_kernel(x, centres, known.length), y), _kernel(centres, centres, known.length)
    return dataclasses.replace(known, scale=scale, centres=centres, weights=normal.weights(prior, known.noise))


def _sampled(x: Array) -> tuple[Array, NDArray[np.intp], Array]:
    """Return mean and deviation of the features, indices of the samples to fit, and the scaled centres."""
    scale = np.stack([x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)])
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.permutation(len(x))[:SAMPLES])
    centres = x[np.sort(rng.permutation(len(x))[:CENTRES])]
    return scale, chosen, (centres - scale[0]) / scale[1]


@dataclass(frozen=True)
class Scatter:
    """Local mean square of a residual by kernel average over features; the global one far from all samples."""

    scale: Array = field(repr=False)
    centres: Array = field(repr=False)
    squares: Array = field(repr=False)
    counts: Array = field(repr=False)
    whole: float

    def of(self, at: Array) -> Array:
        """Return the mean square at the features `at` (samples, n), in the square of the equation's unit."""
        near = _kernel((at - self.scale[0]) / self.scale[1], self.centres, LOCAL)
        few = FEW * float(self.counts.mean())
        return np.asarray((near @ self.squares + few * self.whole) / (near @ self.counts + few))


def scatter(at: Array, squares: Array, least: float = 0.0) -> Scatter:
    """Return the local mean of `squares` (samples) as a function of features `at`, at least `least`."""
    scale, chosen, centres = _sampled(at)
    near = _kernel((at[chosen] - scale[0]) / scale[1], centres, LOCAL)
    counts = near.sum(axis=0)
    return Scatter(scale, centres, np.maximum(near.T @ squares[chosen], least * counts), counts,
                   max(float(np.mean(squares)), least))


def certainty(structure: Array, noise: Array) -> Array:
    """Return the weight of each sample, of mean square 1, from the variances of model error and of noise."""
    cost = structure + noise
    return np.asarray(1.0 / np.sqrt(cost * np.mean(1.0 / cost)))


@dataclass(frozen=True)
class Corrected(Block):
    """Block whose residual is reduced by the expected discrepancy, times an amplitude that a fit may free.

    `certainty`: weight of each sample, relative to the equation's mean; None for equal weights.
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
    """Return `block` with its equation's discrepancy subtracted; `block` itself without discrepancy and weights."""
    name = block.relation.name
    known = name in learnt and learnt[name].used
    if not known and certainty is None:
        return block
    off = learnt[name].of(features(block.signals, values)[block.keep]) if known else np.zeros(block.keep.size)
    return Corrected(block.relation, block.signals, block.keep, block.cycle,
                     block.uses | ({slot(name)} if known else set()), plain=block, known=off,
                     amplitude=slot(name) if known else None, certainty=certainty)
