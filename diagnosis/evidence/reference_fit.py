"""Fit of the reference trials: bench constants, discrepancy and noise with their joint posterior.

Bench and trials have one joint mode, each trial departing from the bench by its session: a trial's session never
counts as the bench.  The discrepancy is a Gaussian process in random Fourier features of states that the fitted model
simulates under the trial's motion, never of its sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from diagnosis.evidence.forward_model import ForwardModel, jacobian, predicted
from diagnosis.evidence.likelihood_data import Recording
from diagnosis.evidence.posterior import CLOSE, LONGEST, Gaussian, Observed, PosteriorMode, bounded, loss, mode
from physics.laws import Array

FEATURES: Final = 60
"""Random Fourier features of each output: with 120 the held-out likelihood of reference trials is the same."""
IN_SAMPLE: Final = 2.0
"""Factor of the residual variance of a single reference trial, which no other one predicts, and of a rig's."""
HELD_OUT: Final = 1.3
"""The same where other trials predict it: cavity residuals are partly fitted."""
MOST_TAU: Final = 12.0
"""Largest inflation of the noise by autocorrelation."""
QUARTERS: Final = (0.25, 0.5, 0.75)
STAGES: Final = 3
"""Estimates of noise and discrepancy, each after a descent to the joint mode."""
PRIOR_SESSIONS: Final = 3.0
"""Weight of a model's own deviations between sessions, in sessions: two sessions determine a scatter badly."""
ROUNDS: Final = 8
"""Steps of a descent."""


@cache
def waves(signals: tuple[str, ...], states: int) -> dict[str, tuple[Array, Array]]:
    """Return frequencies and phases of the features by output, from a fixed seed: length 2 in standardised states."""
    random = np.random.default_rng(7)
    return {name: (random.normal(size=(FEATURES, states)) / 2.0, random.uniform(0.0, 2.0 * np.pi, FEATURES))
            for name in signals}


class Scaling(NamedTuple):
    """Mean and 1σ of the states over the reference trials."""

    mean: Array
    sd: Array


@dataclass(frozen=True)
class ReferenceFit:
    """The bench as its reference trials show it.

    `prior`: of the constants and the discrepancy of a further trial, session deviation included; `bench`: the same of
    the bench alone.  `model_error`: variance by output and load quarter, N²; `tau`: inflation by autocorrelation.
    `cost`: of a reference trial at its mode, per datum; it is above 0 whatever the bench is.
    `identified`: coordinates and feature weights at each reference trial's mode.  `scatter_n`: RMS by output, N, that
    the models of the other reference trials miss on one (of a single one: on itself).
    """

    model: ForwardModel
    outputs: tuple[str, ...]
    origin: Array
    bench: Gaussian
    prior: Gaussian
    scaling: Scaling
    amplitude: Array
    model_error: Array
    tau: Array
    quarters: Array
    trials: int
    scatter_n: Mapping[str, float]
    cost: float
    identified: tuple[tuple[Array, Array], ...] = ()

    def missed(self, observed: Observed) -> Array:
        """Return what the models of the reference trials, averaged, leave of the data."""
        models = self.identified
        if self.model.pools_sessions:
            count, mean = len(self.model.constants.free), self.bench.mean
            q = self.origin.copy()
            q[list(self.model.constants.free)] += mean[:count]
            models = ((q, mean[count:]),)
        return np.asarray(np.mean([observed.data - observed.predicted(q) - observed.features @ c
                                   for q, c in models], axis=0))

    @property
    def rmse_n(self) -> float:
        """RMS of the model's judged outputs that a reference trial's model misses on another."""
        told = [e**2 for name, e in self.scatter_n.items() if name in self.model.judged]
        return float(np.sqrt(np.mean(told)))

    def starts(self) -> list[Array]:
        """Return where a fit of a further trial starts besides the prior's mean: the reference trials' modes."""
        return [np.concatenate([(q - self.origin)[list(self.model.constants.free)], c]) for q, c in self.identified]

    def observe(self, *trials: Recording) -> Observed:
        """Return trials of one session as data of this bench."""
        states = [self.model.simulated_states(self.origin, trial) for trial in trials]
        made = [features(self.model, s, self.scaling, self.outputs) for s in states]
        return Observed(self.model, trials, np.concatenate(made),
                        np.concatenate([1.0 / self._variance(t, s) for t, s in zip(trials, states, strict=True)]),
                        self.tau, self.cost)

    def _variance(self, trial: Recording, states: Array) -> Array:
        quarter = np.searchsorted(self.quarters, states[self.model.load_state])
        parts = []
        for k, name in enumerate(self.outputs):
            variance = self.model.growth(trial, name) * self.model_error[k][quarter] + trial.noise_n[name] ** 2
            parts.append((variance + self.model.aliased(self.origin, trial, name)) * self.tau[k])
        return np.concatenate(parts)


def features(model: ForwardModel, states: Array, scaling: Scaling, outputs: Sequence[str]) -> Array:
    """Return the features of the discrepancy, block-diagonal by output, shape (data, features)."""
    even = (states - scaling.mean[:, None]) / scaling.sd[:, None]
    bins = states.shape[1]
    out = np.zeros((bins * len(outputs), FEATURES * len(outputs)))
    for k, name in enumerate(outputs):
        lengths, phases = waves(tuple(model.signals), model.states)[name]
        out[k * bins:(k + 1) * bins, k * FEATURES:(k + 1) * FEATURES] = np.cos(even.T @ lengths.T + phases) * np.sqrt(
            2.0 / FEATURES)
    return out


def fit_reference(model: ForwardModel, trials: Sequence[Recording], session_sd: Mapping[str, float] | None = None
                  ) -> ReferenceFit:
    """Fit the reference trials of one bench, which all have the same outputs.

    `session_sd`: 1σ between sessions by constant, in coordinates, as a logbook measured it (None: the published one).
    """
    return _Fit(model, trials, session_sd).run()


class _Linear(NamedTuple):
    """A trial linearised at its mode: design H and error e with e ≈ H·(departure from the origin) + noise."""

    design: Array
    error: Array
    weight: Array


class _Fit:
    """State of the reference fit: joint mode of the bench and of each trial, linearised trials, model error, scaling.

    `bench`, `at`: departures from the origin of constants and feature weights, of the bench and of each trial.
    """

    bench: Array
    at: list[Array]

    def __init__(self, model: ForwardModel, trials: Sequence[Recording],
                 session_sd: Mapping[str, float] | None = None) -> None:
        self.model, self.constants, self.free = model, model.constants, list(model.constants.free)
        self.trials = trials
        self.stated_sd = session_sd or {}
        self.session_sd = self._stated(self.constants.session_sd)
        self.bench_sd: Array = self.constants.bench_sd[self.free]
        self.outputs = trials[0].outputs
        self.origin = model.origin(trials[0])
        fine = np.array([model.first_noise[1][name] for name in self.outputs])
        self.amplitude = 0.5 * fine
        self.model_error = np.repeat(fine[:, None] ** 2, 4, axis=1)
        self.tau = np.ones(len(self.outputs))
        self.quarters = np.zeros(3)
        self.scatter_n: dict[str, float] = {}
        self.linear: list[_Linear] = []
        self.identified: list[tuple[Array, Array]] = []

    def run(self) -> ReferenceFit:
        """Fit the first trial from several starts, then all jointly; noise and discrepancy in turns with the mode."""
        best = min((self._first(at) for at in self.model.scanned(self.origin, self.trials[0])), key=lambda m: m.cost)
        self._recentre(best.q)
        for stage in range(STAGES):
            if stage == 1:
                self._recentre(self._constants(self.bench))
            self._descend()
            self._noise()
            self._amplitudes()
            if self.model.pools_sessions and len(self.trials) > 1:
                self._scatter()
        self.linear = [self._linearised(k) for k in range(len(self.trials))]
        bench = self._bounded(self._posterior(range(len(self.trials))))
        # features are simulated at the bench's own constants; their change is far below their length scale
        prior = Gaussian(bench.origin, bench.mean + self._lift(bench.mean),
                         bench.covariance + np.diag(self._session()))
        return ReferenceFit(self.model, self.outputs, self.origin, bench, prior, self.scaling, self.amplitude,
                            self.model_error, self.tau, self.quarters, len(self.trials), self.scatter_n,
                            self._mean_cost(), tuple(self.identified))

    def _bounded(self, bench: Gaussian) -> Gaussian:
        """Return the bench with the covariance that follows where "positive" constants act.

        At a value near 0 the smooth maximum is flat, so that the trials seem not to bound the coordinate from above.
        """
        q = self._constants(bench.mean)
        ratio = self.constants.slope(self.constants.lifted(q)) / self.constants.slope(q)
        scale = np.ones(bench.mean.size)
        scale[:len(self.free)] = ratio[self.free]
        self.linear = [linear._replace(design=linear.design * scale) for linear in self.linear]
        return replace(bench, covariance=self._posterior(range(len(self.trials))).covariance)

    def _lift(self, departure: Array) -> Array:
        """Return how far "positive" constants are below where they act, as a departure."""
        q = self._constants(departure)
        lift = np.zeros(departure.size)
        lift[:len(self.free)] = (self.constants.lifted(q) - q)[self.free]
        return lift

    def _stated(self, published: Array) -> Array:
        """Return 1σ between sessions by constant: of those that a logbook measured, as it did."""
        sd = published.copy()
        for name, stated in self.stated_sd.items():
            sd[self.constants.index[name]] = stated
        return sd

    def _scatter(self) -> None:
        """Estimate how far sessions lie apart from the reference trials, by steps of expectation maximisation.

        σ² is inverse-gamma about the model's own value with the weight of `PRIOR_SESSIONS` sessions.
        """
        prior = self._stated(self.model.session_at(self.origin))[self.free] ** 2
        squares = np.zeros(len(self.free))
        for k, x in enumerate(self.at):
            deviation = np.sqrt(self._session())
            design = self.linear[k].design * deviation
            inner = np.linalg.inv(np.eye(deviation.size) + (design.T * self.linear[k].weight) @ design)
            left = deviation**2 * np.diag(inner)
            squares += ((x - self.bench) ** 2 + left)[:len(self.free)]
        count = len(self.trials)
        self.session_sd[self.free] = np.sqrt((PRIOR_SESSIONS * prior + squares) / (PRIOR_SESSIONS + count))

    def _mean_cost(self) -> float:
        """Return the cost per datum of the reference trials at their modes."""
        costs = [self._trial_cost(k, self.bench, x) / self.trials[k].data.size for k, x in enumerate(self.at)]
        return float(np.mean(costs))

    def _constants(self, x: Array) -> Array:
        """Return the coordinates of all constants at a departure from the origin."""
        q = self.origin.copy()
        q[self.free] += x[:len(self.free)]
        return np.asarray(q)

    def _descend(self) -> None:
        """Go to the joint mode of bench and trials by Gauss–Newton steps that lower the joint cost."""
        now = self._cost(self.bench, self.at)
        for _ in range(ROUNDS):
            self.linear = [self._linearised(k) for k in range(len(self.trials))]
            bench = self._posterior(range(len(self.trials))).mean
            at = [self._trial_given(k, bench) for k in range(len(self.trials))]
            longest = max(float(np.abs((there - here)[:len(self.free)] / self.bench_sd).max())
                          for here, there in zip([self.bench, *self.at], [bench, *at], strict=True))
            share = min(1.0, LONGEST / longest)
            while share > 0.01:
                tried = self.bench + share * (bench - self.bench)
                trials = [here + share * (there - here) for here, there in zip(self.at, at, strict=True)]
                then = self._cost(tried, trials)
                if then < now:
                    break
                share *= 0.4
            else:
                return
            self.bench, self.at, fall, now = tried, trials, now - then, then
            if fall < CLOSE * len(self.trials):
                return

    def _cost(self, bench: Array, at: Sequence[Array]) -> float:
        """Return the joint cost of bench and trials: misfit, session deviations, prior of the bench."""
        centre = self._middle()
        own = bench / np.sqrt(self._bench_variance())
        own[:len(self.free)] -= centre
        total = float(own @ own)
        return total + sum(self._trial_cost(k, bench, x) for k, x in enumerate(at))

    def _middle(self) -> Array:
        """Return the population's middle as departures from the origin, in population σ."""
        centre: Array = -self.origin[self.free] / self.bench_sd
        for name in self.model.regressed:
            centre[self.free.index(self.constants.index[name])] = 0.0
        return centre

    def _trial_cost(self, k: int, bench: Array, x: Array) -> float:
        """Return the cost of one trial: misfit and session deviation."""
        off = (x - bench) / np.sqrt(self._session())
        return loss(self._residual(k, x), np.sqrt(self._weight(k))) + float(off @ off)

    def _residual(self, k: int, x: Array) -> Array:
        trial = self.trials[k]
        told = predicted(self.model, self._constants(x), trial) + self.features[k] @ x[len(self.free):]
        return np.asarray(trial.data - told)

    def _weight(self, k: int) -> Array:
        return 1.0 / self._reference()._variance(self.trials[k], self.states[k])

    def _linearised(self, k: int) -> _Linear:
        x = self.at[k]
        data, slopes = jacobian(self.model, self._constants(x), self.trials[k], self.free)
        design = np.concatenate([slopes, self.features[k]], axis=1)
        residual = self.trials[k].data - data - self.features[k] @ x[len(self.free):]
        return _Linear(design, residual + design @ x, bounded(residual, self._weight(k)))

    def _trial_given(self, k: int, bench: Array) -> Array:
        """Return the mode of a linearised trial given the bench."""
        linear, deviation = self.linear[k], np.sqrt(self._session())
        inward = linear.design * deviation
        light = inward.T * linear.weight
        inner = cho_factor(np.eye(deviation.size) + light @ inward)
        return np.asarray(bench + deviation * cho_solve(inner, light @ (linear.error - linear.design @ bench)))

    def _first(self, at: Array) -> PosteriorMode:
        """Fit the first trial alone from coordinates `at`, without a discrepancy."""
        trial = self.trials[0]
        none = np.zeros((trial.data.size, 0))
        wide = Gaussian(self.origin, np.zeros(len(self.free)), np.diag(self.bench_sd**2))
        start = (at - self.origin)[self.free]
        weights = [np.repeat([noise[n] ** -2 for n in self.outputs], trial.bins) for noise in self.model.first_noise]
        rough, fine = (Observed(self.model, (trial,), none, weight, self.tau, 1.0) for weight in weights)
        return mode(fine, wide, start=mode(rough, wide, start=start, rounds=10).x, rounds=10)

    def _recentre(self, q: Array) -> None:
        """Take `q` as origin, at which the states of the discrepancy are simulated."""
        self.states = [self.model.simulated_states(q, trial) for trial in self.trials]
        every = np.concatenate(self.states, axis=1)
        self.scaling = Scaling(every.mean(axis=1), every.std(axis=1) + 1e-6)
        self.features = [features(self.model, s, self.scaling, self.outputs) for s in self.states]
        self.quarters = np.quantile(every[self.model.load_state], QUARTERS)
        self.origin = q
        self.session_sd = self._stated(self.model.session_at(q))
        self._set_amplitude([self.trials[0].data - predicted(self.model, q, self.trials[0])], self.trials[:1])
        self.bench = np.zeros(len(self.free) + FEATURES * len(self.outputs))
        self.at = [self.bench for _ in self.trials]

    def _set_amplitude(self, rest: Sequence[Array], trials: Sequence[Recording]) -> None:
        self.amplitude = np.array([
            np.sqrt(np.mean([np.mean(t.part(r, k) ** 2) for r, t in zip(rest, trials, strict=True)]))
            for k in range(len(self.outputs))])

    def _bench_variance(self) -> Array:
        return np.concatenate([self.bench_sd ** 2, np.repeat(self.amplitude**2, FEATURES)])

    def _session(self) -> Array:
        return np.concatenate([self.session_sd[self.free] ** 2,
                               self.model.session_share**2 * np.repeat(self.amplitude**2, FEATURES)])

    def _posterior(self, which: Sequence[int]) -> Gaussian:
        """Return the posterior of the bench, about `origin`, by the linearised trials of `which`.

        Each trial's own deviation Σ is integrated out: information A(I + ΣA)⁻¹, A = HᵀWH.
        """
        scale = np.sqrt(self._bench_variance())
        deviation = np.sqrt(self._session()) / scale
        size = scale.size
        information, pull = np.eye(size), np.zeros(size)
        pull[:len(self.free)] = self._middle()
        for k in which:
            linear = self.linear[k]
            root = np.sqrt(linear.weight)
            design = linear.design * scale * root[:, None]
            square, error = design.T @ design, design.T @ (linear.error * root)
            inner = cho_factor(np.eye(size) + deviation[:, None] * square * deviation)
            side = deviation[:, None] * square
            information += square - side.T @ cho_solve(inner, side)
            pull += error - side.T @ cho_solve(inner, deviation * error)
        lengths, axes = np.linalg.eigh(0.5 * (information + information.T))
        lengths = np.maximum(lengths, 0.5)
        covariance = (axes / lengths) @ axes.T * scale[:, None] * scale
        return Gaussian(self.origin, scale * ((axes / lengths) @ (axes.T @ pull)), covariance)

    def _reference(self) -> ReferenceFit:
        empty = Gaussian(self.origin, np.zeros(0), np.zeros((0, 0)))
        return ReferenceFit(self.model, self.outputs, self.origin, empty, empty, self.scaling, self.amplitude,
                            self.model_error, self.tau, self.quarters, len(self.trials), self.scatter_n, 1.0)

    def _noise(self) -> None:
        """Estimate the model error by load quarter and the autocorrelation from the residuals at the modes."""
        more = IN_SAMPLE if len(self.trials) == 1 or self.model.pools_sessions else HELD_OUT
        squares, counts = np.zeros((len(self.outputs), 4)), np.zeros((len(self.outputs), 4))
        tau = np.zeros(len(self.outputs))
        rests = [self._residual(k, x) for k, x in enumerate(self.at)]
        for residual, trial, states in zip(rests, self.trials, self.states, strict=True):
            quarter = np.searchsorted(self.quarters, states[self.model.load_state])
            for k, name in enumerate(self.outputs):
                rest = trial.part(residual, k)
                tau[k] += autocorrelation(rest) / len(rests)
                squared = np.minimum(rest**2, 25.0 * np.median(rest**2) + 1e-9) - trial.noise_n[name] ** 2
                for j in range(4):
                    squares[k, j] += float(squared[quarter == j].sum())
                    counts[k, j] += int((quarter == j).sum())
        least = np.array([[self.model.least[name] ** 2] for name in self.outputs])
        self.model_error = np.maximum(more * squares / np.maximum(counts, 1), least)
        self.tau = np.minimum(tau, MOST_TAU)
        self.identified = [(self._constants(x), x[len(self.free):]) for x in self.at]
        self.scatter_n = self._missed()

    def _amplitudes(self) -> None:
        """Estimate the amplitude of the discrepancy: RMS that the constants alone leave at the modes."""
        rest = []
        for linear in self.linear:
            part = linear.design[:, :len(self.free)]
            root = np.sqrt(linear.weight)
            scale = self.bench_sd
            design = part * scale * root[:, None]
            at = np.linalg.solve(np.eye(len(self.free)) + design.T @ design, design.T @ (linear.error * root))
            rest.append(linear.error - part @ (scale * at))
        self._set_amplitude(rest, self.trials)

    def _missed(self) -> dict[str, float]:
        """Return by output the RMS, N, that the others' models, averaged, miss on a trial (a single one: on itself)."""
        squares: dict[str, list[float]] = {name: [] for name in self.outputs}
        for j, trial in enumerate(self.trials):
            models = self._others(j)
            rest = np.mean([trial.data - predicted(self.model, q, trial) - self.features[j] @ c
                            for q, c in models], axis=0)
            for name, error in self.model.errors(trial, np.asarray(rest)).items():
                squares[name].append(float(np.mean(error**2)))
        return {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}

    def _others(self, j: int) -> list[tuple[Array, Array]]:
        """Return the models by which a reference trial is predicted: those of the others, if there are any.

        Where the trials estimate how far sessions lie apart, the bench that the others show.
        """
        others = [k for k in range(len(self.trials)) if k != j] or [j]
        if not self.model.pools_sessions:
            return [self.identified[k] for k in others]
        self.linear = self.linear or [self._linearised(k) for k in range(len(self.trials))]
        mean = self._posterior(others).mean
        return [(self._constants(mean), mean[len(self.free):])]


def autocorrelation(rest: Array) -> float:
    """Return 1 + 2Σ of the autocorrelation of a residual, up to the first lag below 0.05."""
    even = rest - rest.mean()
    power = float(np.mean(even**2))
    total = 1.0
    for lag in range(1, 40):
        share = float(np.mean(even[:-lag] * even[lag:])) / power if power > 0.0 else 0.0
        if share < 0.05:
            break
        total += 2.0 * share
    return total
