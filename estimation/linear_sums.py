"""Sums of a linearised recording over its data: of the constants, the discrepancy and every effect of the catalogue.

    e ≈ H·x + E·s + ε,  H = [∂f/∂q, Φ]        x departure from the reference posterior's mean, s sizes of effects
    square = TᵀWT,  pull = TᵀWe,  T = [H, E]

Sums of recordings of one session add up.  A watch adds gait cycles, a logbook sessions.

Sessions that depart from the point of linearisation by δ ~ N(0, D) have an error of second order beside noise:

    ε = f(q + δ) − f(q) − (∂f/∂q)·δ,  W⁻¹ = noise + E[εεᵀ], by a sample of δ
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from estimation.forward_model import ForwardModel
from estimation.likelihood_data import GRID_S, Recording
from estimation.posterior import slope_point
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Direction, Variant
from physics.forward.constant_table import ConstantTable
from physics.laws import Array

DRIFT: Final = "friction_drift"
DRIFTING: Final = ("cable", "fabric")
"""Constants that the constant `DRIFT` changes in proportion to the progress of a trial."""


class EffectColumns(NamedTuple):
    """Columns of one variant of an effect among the columns of all effects, E.

    `secant`: the column is the change of the prediction by 1σ of the effect, not the slope at no effect.
    """

    effect: str
    variant: Variant
    at: slice
    secant: bool = False


class Sums(NamedTuple):
    """Sums over data: `square`, shape (n + m, n + m), and `pull`, shape (n + m,), of n base and m effect columns."""

    square: Array
    pull: Array

    def __add__(self, other: Sums) -> Sums:  # type: ignore[override]
        """Return the sums over the data of both."""
        return Sums(self.square + other.square, self.pull + other.pull)


class Slopes(NamedTuple):
    """Prediction at one point, its slopes by the free constants, and the effect columns E, each with rows of data."""

    data: Array
    base: Array
    effects: Array


def effect_columns(fit: ReferenceFit) -> list[EffectColumns]:
    """Return the columns of every variant that moves one of the outputs.

    An effect along constants that cannot be negative has a secant, too: a dead band of the size of a worn gear is
    beyond the range in which the model is linear.
    """
    table = fit.model.constants
    values, found, first = table.named(fit.prior.coordinates(table)), [], 0
    for name, hypothesis in fit.model.hypotheses.items():
        if set(hypothesis.needs) <= set(fit.outputs):
            for variant in hypothesis.variants(values):
                forms = {table.rows[table.index[n]].form for d in variant.directions for n in d.along}
                for secant in (False, True) if forms == {"positive"} else (False,):
                    found.append(EffectColumns(name, variant, slice(first, first + len(variant.directions)), secant))
                    first = found[-1].at.stop
    return found


def slopes(model: ForwardModel, columns: Sequence[EffectColumns], q: Array, trial: Recording) -> Slopes:
    """Return prediction, slopes and effect columns at coordinates `q`, by one batch of simulations.

    A friction drift is the slope by the friction's coefficients, times the progress of the trial.
    """
    table = model.constants
    batch = _Batch(table, q)
    base = [batch.moved((), table.names[i]) for i in table.free]
    parts = []
    for part in columns:
        names = [n for d in part.variant.directions for n in _along(table, d.along)]
        origin = _origin(model, q, part.variant, names)
        parts.append([(d, [(batch.far(origin, d), 1.0)] if part.secant else [
            (batch.moved(origin, n), share) for n, share in _along(table, d.along).items()])
            for d in part.variant.directions])
    data = model.predict(np.stack(batch.sets, axis=1), trial)
    slope = [np.zeros(0) if of is None else (data[k] - data[of]) / by for k, (of, by) in enumerate(batch.of)]
    progress = np.tile(trial.binned(trial.progress), len(trial.outputs))
    effects = []
    for part_of in parts:
        for direction, terms in part_of:
            column = np.sum([share * slope[k] for k, share in terms], axis=0)
            effects.append(direction.sd * column * (progress if DRIFT in direction.along else 1.0))
    return Slopes(data[0], np.stack([slope[k] for k in base], axis=1), np.stack(effects, axis=1))


class _Batch:
    """Coordinate vectors to simulate; `of`: for each the number of its origin (None: it is one) and its distance."""

    def __init__(self, table: ConstantTable, q: Array) -> None:
        self.table, self.sets = table, [q]
        self.of: list[tuple[int | None, float]] = [(None, 0.0)]
        self._known: dict[tuple[tuple[tuple[int, float], ...], str], int] = {((), ""): 0}

    def moved(self, origin: tuple[tuple[int, float], ...], name: str) -> int:
        """Return the number of the vector with constant `name` one step away from `origin`, added if it is new.

        `origin`: changes of q by row."""
        if (origin, name) not in self._known:
            base = 0
            if origin:
                base = self._known.get((origin, ""), len(self.sets))
                if base == len(self.sets):
                    at = self.sets[0].copy()
                    for i, value in origin:
                        at[i] = value
                    self._add(origin, "", at, (None, 0.0))
            i = self.table.index[name]
            stepped = self.sets[base].copy()
            stepped[i] += self.table.step[i]
            self._add(origin, name, stepped, (base, self.table.step[i]))
        return self._known[origin, name]

    def far(self, origin: tuple[tuple[int, float], ...], direction: Direction) -> int:
        """Add the vector `origin` plus 1σ of an effect along a direction; return its number in the batch."""
        at = self.sets[0].copy()
        for i, value in origin:
            at[i] = value
        for name, share in direction.along.items():
            at[self.table.index[name]] += direction.sd * share
        self.sets.append(at)
        self.of.append((0, direction.sd))
        return len(self.sets) - 1

    def _add(self, origin: tuple[tuple[int, float], ...], name: str, at: Array, of: tuple[int | None, float]) -> None:
        self._known[origin, name] = len(self.sets)
        self.sets.append(at)
        self.of.append(of)


def _along(table: ConstantTable, along: Mapping[str, float]) -> Mapping[str, float]:
    """Return a direction of the evidence; a friction drift by the constants that it changes."""
    if DRIFT in along and all(name in table.index for name in DRIFTING):
        return dict.fromkeys(DRIFTING, along[DRIFT])
    return along


def _origin(model: ForwardModel, q: Array, variant: Variant, names: Sequence[str]) -> tuple[tuple[int, float], ...]:
    """Return row and value of each coordinate in which the point of a variant's slopes differs from `q`."""
    at = slope_point(model, q, variant, names)
    return tuple((int(i), float(at[i])) for i in np.flatnonzero(at != q))


class SessionSums(NamedTuple):
    """Sums of the trials of one session, with the growth of its deviation's variance by its motion, shape (n,).

    `motion`: number of the reference trial with the motion of the session's trials, None without one.
    """

    sums: Sums
    growth: Array
    motion: int | None

    def joined(self, other: SessionSums) -> SessionSums:
        """Return the sums over the trials of two parts of one session."""
        return SessionSums(self.sums + other.sums, np.maximum(self.growth, other.growth),
                           self.motion if self.motion == other.motion else None)


def session_sums(fit: ReferenceFit, columns: Sequence[EffectColumns], trial: Recording, references: Array
                 ) -> SessionSums:
    """Return the sums of a trial of a session.  `references`: `motion_spread` of each reference trial.

    All sessions are linearised at the reference posterior's mean, where they have the same slopes, and under one motion
    the same model error.  A session is not at its mode there: the error of the linearisation counts as noise.
    """
    observed, prior = fit.observe(trial), fit.prior
    q = prior.coordinates(fit.model.constants)
    made = slopes(fit.model, columns, q, trial)
    base, count = np.concatenate([made.base, observed.features], axis=1), len(fit.model.constants.free)
    error = observed.data - made.data - observed.features @ prior.mean[count:]
    session, grown = (np.diag(each.covariance - fit.bench.covariance) for each in (prior, fit.prior_of(observed)))
    further = linearisation_error(fit.model, q, made, np.sqrt(grown[:count]), trial)
    return SessionSums(summed(base, made.effects, error, observed.weight, further), grown / session,
                       _repeated(motion_spread(trial), references))


def linearisation_error(model: ForwardModel, q: Array, made: Slopes, session_sd: Array, trial: Recording,
                        draws: int = 48) -> Array:
    """Return F with E[εεᵀ] = FFᵀ, shape (data, draws), ε the error of the slopes `made` at `q` in another session.

    `session_sd`: 1σ between sessions of the free constants, in coordinates.  `draws`: twice as many change the log
    Bayes factors of a logbook by at most 0.8 nats.
    """
    # with a fixed seed, so that a logbook's sums do not depend on when they are made
    departures = np.random.default_rng(7).normal(size=(draws, session_sd.size)) * session_sd
    sets = np.repeat(q[:, None], draws, axis=1)
    sets[list(model.constants.free)] += departures.T
    return np.asarray((model.predict(sets, trial) - made.data - departures @ made.base.T).T / np.sqrt(draws))


def motion_spread(trial: Recording) -> Array:
    """Return the standard deviations of rope position, knee angle, and their rates, shape (4,), m, rad, m/s, rad/s."""
    moved = [trial.sampled(name) for name in ("servo_position_m", "knee_angle_rad")]
    return np.array([each.std() for each in (*moved, *(np.gradient(one, GRID_S) for one in moved))])


def _repeated(spread: Array, references: Array, alike: float = 0.05) -> int | None:
    """Return the number of the first reference trial with the motion of a trial; None without one.

    `alike`: largest relative difference of their spreads.  A controller that leads END moves the rope by 1 % otherwise
    where a knee's backlash grew by 26 mrad; a cadence of 1.35 s in place of 1.2 s differs by 12 %.
    """
    still = np.array([1e-4, 1e-4, 1e-3, 1e-3])  # a locked knee hardly moves
    away = np.max(np.abs(references - spread) / np.maximum(references, still), axis=1)
    found = np.flatnonzero(away <= alike)
    return int(found[0]) if found.size else None


def summed(base: Array, effects: Array, error: Array, weight: Array, further: Array | None = None) -> Sums:
    """Return the sums of columns over data with the `error` of the reference posterior's mean and `weight`s.

    `further`: columns F of a further error of the data with the covariance FFᵀ.
    """
    every = np.concatenate([base, effects], axis=1)
    heavy = every.T * weight
    if further is not None:
        # Woodbury's identity: (W⁻¹ + FFᵀ)⁻¹ = W − WF·(I + FᵀWF)⁻¹·FᵀW
        light = further.T * weight
        heavy -= (heavy @ further) @ np.linalg.solve(np.eye(further.shape[1]) + light @ further, light)
    return Sums(heavy @ every, heavy @ error)
