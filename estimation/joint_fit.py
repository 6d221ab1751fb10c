"""Fit of the reference trials: one joint mode of bench and trials, discrepancy, noise and scatter between sessions.

The model is hierarchical: each trial departs from the bench by a session deviation.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp

from estimation.forward_model import ForwardModel, jacobian, predicted
from estimation.likelihood_data import Recording
from estimation.posterior import (
    CLOSE,
    HUBER,
    LONGEST,
    Gaussian,
    PosteriorMode,
    SessionData,
    SessionDeparture,
    between_sessions,
    bounded,
    descended,
    loss,
    mode,
)
from estimation.reference_fit import (
    FEATURES,
    JointMinimum,
    NoiseModel,
    ReferenceFit,
    SessionPrior,
    autocorrelation,
    features,
    reach_of,
    scaling_of,
)
from physics.laws import Array

POOLED: Final = 2.0
"""Factor from residual variance to model error of a rig, whose pooled sessions differ in more than its constants.

With 1, repeats of a rubber seal are named `presliding`."""
PRIOR_SESSIONS: Final = 3.0
"""Weight of the model's prior 1σ between sessions, in equivalent sessions.

Two sessions alone would determine the scatter badly."""


def fit_reference(model: ForwardModel, trials: Sequence[Recording], session_sd: Mapping[str, float] | None = None,
                  close: float = CLOSE, shares: Sequence[float] = (1.0, 0.5, 0.25, 0.125)) -> ReferenceFit:
    """Fit the reference trials of one bench, which all have the same outputs.

    `session_sd`: 1σ between sessions by constant, in coordinates, from a logbook (None: the published one).  `close`:
    decrease of the joint cost in one step and per trial below which the joint mode counts as reached.  `shares`: of the
    RMS residual of constants alone, from which the amplitude of the discrepancy is taken.
    """
    return _Fit(model, trials, session_sd, close, shares).run()


def first_mode(model: ForwardModel, trial: Recording, prior: Gaussian, starts: int = 4) -> PosteriorMode:
    """Return the best of the modes of one trial from several starts, without a discrepancy; `prior`: of constants.

    A first descent with `HUBER` times the noise, in which few residuals are outliers, avoids local minima.  Half of the
    starts, those with the smallest cost after it, are then descended with the noise itself.
    """
    free, none = list(model.constants.free), np.zeros((trial.data.size, 0))
    weight = np.repeat([model.first_noise[n] ** -2 for n in trial.outputs], trial.bins)
    even = np.ones(len(trial.outputs))
    rough, fine = (SessionData(model, (trial,), none, w, even, 1.0, np.ones(w.size))
                   for w in (weight / HUBER**2, weight))
    begin = [(at - prior.origin)[free] for at in model.scanned(model.origin(trial), trial)[:starts]]
    near = [mode(rough, prior, start=start).x for start in begin]
    near.sort(key=lambda x: mode(fine, prior, start=x, descends=False).cost)
    return min((mode(fine, prior, start=x) for x in near[:(starts + 1) // 2]), key=lambda m: m.cost)


@dataclass(frozen=True)
class _Linear:
    """A trial linearised at its mode: error e ≈ H·(departure from the origin) + noise, with design H and weights W.

    `information`: HᵀWH.  `pull`: HᵀWe.
    """

    design: Array
    error: Array
    weight: Array

    @cached_property
    def information(self) -> Array:
        scaled = self.design * np.sqrt(self.weight)[:, None]
        return np.asarray(scaled.T @ scaled)

    @cached_property
    def pull(self) -> Array:
        return np.asarray(self.design.T @ (self.weight * self.error))


class _Fit:
    """State of the reference fit: joint mode of bench and trials, linearised trials, model error, scaling.

    `bench` and `at`: departure of the bench and of each trial from the origin, constants first, then feature weights.
    `common`: common factor κ² on the variances of the model's `scattered` constants between sessions.
    """

    bench: Array
    at: list[Array]

    def __init__(self, model: ForwardModel, trials: Sequence[Recording],
                 session_sd: Mapping[str, float] | None, close: float, shares: Sequence[float]) -> None:
        self.close, self.shares = close, shares
        self.model, self.constants, self.free = model, model.constants, list(model.constants.free)
        self.trials = trials
        self.stated_sd = session_sd or {}
        self.session_sd = self._stated(self.constants.session_sd)
        self.bench_sd: Array = self.constants.bench_sd[self.free].copy()
        for name, sd in model.surrogate_sd.items():
            self.bench_sd[self.free.index(self.constants.index[name])] = sd
        self.outputs = trials[0].outputs
        self.reach = reach_of(model, trials)
        self.origin = model.origin(trials[0])
        fine = np.array([model.first_noise[name] for name in self.outputs])
        self.amplitude = 0.5 * fine
        self.model_error = np.repeat(fine[:, None] ** 2, 4, axis=1)
        self.tau = np.ones(len(self.outputs))
        self.scatter_n: dict[str, float] = {}
        self.linear: list[_Linear] = []
        self.contradicted, self.common = 0.0, 1.0
        self.identified: list[tuple[Array, Array]] = []
        self.wide = Gaussian(self.origin, np.zeros(len(self.free)), np.diag(self.bench_sd**2))
        self.alone: list[Array] = []

    def run(self, stages: int = 3) -> ReferenceFit:
        """Fit the first trial from several starts, then all trials jointly, and return the fit.

        Estimates of noise and discrepancy alternate with descents to the joint mode, `stages` times.
        """
        self._recentre(self._alone(self.trials[0]))
        for stage in range(stages):
            if stage == 1:
                self._recentre(self._constants(self.bench))
            self._descend()
            self._noise()
            self._amplitudes()
            if len(self.trials) > 1:
                self._scatter()
        if len(self.trials) > 1 and not self.model.pools_sessions:
            self._restart()
        return self._finished()

    def _alone(self, trial: Recording) -> Array:
        """Return the coordinates at the mode of one trial by itself, and store them as a further start."""
        self.alone.append(first_mode(self.model, trial, self.wide).q)
        return self.alone[-1]

    def _restart(self, least: float = 3.0, most: int = 3) -> None:
        """Descend once more from the own modes of the `most` last trials, and take the best minimum for all trials.

        At a minimum that is 12 nats worse, three of six repeats in the reference condition were named viscous friction.
        `least`: gain, nats, from which a restart contradicts the first minimum; 3 are odds of 20 to 1.
        """
        self._descend()
        first, best = self._cost(self.bench, self.at), (self.bench, self.at)
        for trial in self.trials[1:][-most:]:
            self.bench, self.at = best
            self._begin(self._alone(trial))
            self._descend()
            gain = 0.5 * (first - self._cost(self.bench, self.at))
            if gain >= max(least, self.contradicted):
                self.contradicted, best = gain, (self.bench, self.at)
        self.bench, self.at = best
        if self.contradicted:
            self._noise()
            self._amplitudes()

    def _begin(self, q: Array) -> None:
        """Set the constants of bench and trials to the coordinates `q`."""
        size, own = len(self.free), (q - self.origin)[self.free]
        self.bench = np.concatenate([own, self.bench[size:]])
        self.at = [np.concatenate([own, x[size:]]) for x in self.at]

    def joint_minimum(self, fit: ReferenceFit, trial: Recording, x: Array) -> JointMinimum:
        """Return the reference condition of `fit` at the best joint minimum of reference trials and a further `trial`.

        `x`: mode of the trial under `fit`, where the descents begin that do not begin at a mode of one trial by itself.
        Under the joint posterior of a bench of another structure minima are several, and a further trial may decide
        between them, which the Gaussian of one of them cannot.
        """
        both = copy.copy(self)
        both.trials, both.at = [*self.trials, trial], [*self.at, x]
        both.states = [*self.states, self.model.simulated_states(self.origin, trial)]
        both.features = [*self.features, features(self.model, both.states[-1], self.scaling, self.outputs)]
        both._weigh()
        best, least = (self.bench, both.at), np.inf
        for q in (None, *self.alone, first_mode(self.model, trial, self.wide).q):
            both.bench, both.at = best
            if q is not None:
                both._begin(q)
            both._descend()
            cost = both._cost(both.bench, both.at)
            if cost < least:
                best, least = (both.bench, both.at), cost
        there = copy.copy(self)
        there.bench, there.at = best[0], best[1][:-1]
        bench, nats = there._posterior()
        found = replace(fit, bench=bench, prior=there._further(bench), identified=tuple(there.identified),
                        session_priors=there._session_priors(bench), joint_minimum=None,
                        departure=there._departure())
        nats -= copy.copy(self)._posterior()[1]
        # ln p(y) of the reference trials over all scatters is that of the stated one less its log probability
        sides = zip(fit.session_priors, found.session_priors, strict=True) if len(self.trials) > 1 else ()
        nats += sum(here.log_probability - other.log_probability for here, other in sides if here.log_factor == 0.0)
        return JointMinimum(found, nats, best[1][-1])

    def bench_nats(self, shift: Array) -> float:
        """Return ln p of bench and reference trials with the bench's free constants moved by `shift`, less that here.

        Discrepancy and departures of the trials are fitted anew there.  Far along the posterior that is linearised at
        one trial the cost is up to 3.5 times that of the posterior (decision 65).
        """
        there, whole = copy.copy(self), np.pad(shift, (0, self.bench.size - shift.size))
        there.bench, there.at = self.bench + whole, [x + whole for x in self.at]
        there._descend(held=True)
        return 0.5 * (self._cost(self.bench, self.at) - there._cost(there.bench, there.at))

    def _posterior(self) -> tuple[Gaussian, float]:
        """Return the posterior of the bench by the trials linearised where they stand, and its log evidence, nats.

        The evidence of `_joint`, and the data's: −½eᵀWe, with Huber's loss at the point in place of its quadratic.
        """
        self._identify()
        mean, nats = self._joint(range(len(self.trials)))
        for k, linear in enumerate(self.linear):
            residual = self._residual(k, self.at[k])
            nats -= 0.5 * float(linear.error @ (linear.weight * linear.error) - residual @ (linear.weight * residual)
                                + loss(residual, np.sqrt(self.weight[k])))
        return replace(self._bounded(), mean=mean.mean), nats

    def _further(self, bench: Gaussian) -> Gaussian:
        """Return the prior of a further trial."""
        # features stay those simulated at the origin: the states change by far less than the length scale
        return Gaussian(bench.origin, bench.mean + self._lift(bench.mean),
                        bench.covariance + np.diag(self._session()))

    def _finished(self) -> ReferenceFit:
        """Descend with the last estimates of noise and discrepancy, and return the fit."""
        self._descend()
        self._identify()
        self.scatter_n = self._missed()
        bench = self._bounded()
        fit = ReferenceFit(self.model, self.outputs, self.origin, bench, self._further(bench), self.scaling,
                           self.model_error, self.tau, self.scatter_n, self._mean_cost(), self.reach,
                           tuple(self.identified), self.contradicted, self._session_priors(bench),
                           *((None, None) if self.model.pools_sessions else (self.joint_minimum, self.bench_nats)))
        own = [fit.observe(trial).misfit(self._residual(k, self.at[k])) for k, trial in enumerate(self.trials)]
        return replace(fit, misfit=np.maximum(1.0, np.mean(own, axis=0)), departure=self._departure())

    def _departure(self) -> SessionDeparture:
        """Return the departure of the reference trials from the bench, in session σ; none of a single one."""
        if len(self.trials) == 1 or self.model.pools_sessions:
            return SessionDeparture(0.0, 0.0)
        known = [self._joint([i for i in range(len(self.trials)) if i != k])[0].covariance
                 for k in range(len(self.trials))]
        return between_sessions(np.stack(self.at) - self.bench, np.sqrt(self._session()),
                                [linear.information for linear in self.linear], known)

    def _bounded(self) -> Gaussian:
        """Return the bench at the joint mode, its covariance linearised where "positive" constants are above 0.

        Near 0 the smooth maximum of such a constant is flat, so that the trials would seem not to bound it from above.
        """
        q = self._constants(self.bench)
        # dv/dq where the constant acts over dv/dq at the mode, by which each column of H grows
        ratio = self.constants.slope(self.constants.lifted(q)) / self.constants.slope(q)
        scale = np.ones(self.bench.size)
        scale[:len(self.free)] = ratio[self.free]
        self.linear = [replace(linear, design=linear.design * scale) for linear in self.linear]
        return replace(self._joint(range(len(self.trials)))[0], mean=self.bench)

    def _lift(self, departure: Array) -> Array:
        """Return the departure that lifts each "positive" constant to where its value follows its coordinate."""
        q = self._constants(departure)
        lift = np.zeros(departure.size)
        lift[:len(self.free)] = (self.constants.lifted(q) - q)[self.free]
        return lift

    def _stated(self, published: Array) -> Array:
        """Return 1σ between sessions by constant: from the logbook if it has the constant, else as published."""
        sd = published.copy()
        for name, stated in self.stated_sd.items():
            sd[self.constants.index[name]] = stated
        return sd

    def _scatter(self) -> None:
        """Estimate 1σ between sessions of the model's `scattered` constants, from the reference trials.

        Their values are scaled by a common factor, then each by one step of expectation maximisation; the prior of
        each σ² is inverse-gamma about its scaled value, with the weight of `PRIOR_SESSIONS` sessions.
        """
        count, names = len(self.trials), self.constants.names
        rows = [k for k, i in enumerate(self.free) if names[i] in self.model.scattered]
        at = [self.free[k] for k in rows]
        prior = self._stated(self.model.session_at(self.origin))[at] ** 2
        self.common = self._common_factor(at, prior)
        self.session_sd[at] = np.sqrt(prior * self.common)
        deviation, left = np.sqrt(self._session()), np.zeros(len(rows))
        for linear in self.linear:
            inner = np.linalg.inv(np.eye(deviation.size) + deviation[:, None] * linear.information * deviation)
            left += np.diag(inner)[rows] * (1.0 - 1.0 / count)
        # E step: squared departure from the sessions' mean, since a narrow prior may hold the bench away from it, and
        # the variance that the data leave of each; M step under the inverse-gamma prior
        moved = np.var([x[rows] for x in self.at], axis=0) * count
        known = self.session_sd[at] ** 2
        self.session_sd[at] = np.sqrt((PRIOR_SESSIONS * known + moved + left * known) / (PRIOR_SESSIONS + count - 1.0))

    def _common_factor(self, at: Sequence[int], prior: Array) -> float:
        """Return the posterior mean of a common factor κ² on the variances `prior` of the constants `at`."""
        # not beyond e: the evidence of linearised trials with loose constants is no measure of them (a motor that
        # repeats to 2 % would have all of it at e³)
        logs = np.arange(-3.0, 2.0)
        nats = np.array([nats for _, nats in self._by_factor(at, np.sqrt(prior), logs)])
        share = np.exp(nats - nats.max())
        return float(share @ np.exp(2.0 * logs) / share.sum())

    def _by_factor(self, at: Sequence[int], sd: Array, logs: Array) -> Iterator[tuple[Gaussian, float]]:
        """Set 1σ between sessions of the constants `at` to κ·`sd` for each ln κ of `logs`; yield bench and ln p(κ | y).

        The posterior of κ, up to a constant, has the prior ln κ ~ N(0, 1): the sessions of one bench differ by a third
        of another's, or by three times as much.
        """
        for log in logs:
            # a new array, since the copies of `joint_minimum` share the old one
            self.session_sd = self.session_sd.copy()
            self.session_sd[at] = np.exp(log) * sd
            bench, nats = self._joint(range(len(self.trials)))
            yield bench, nats - 0.5 * float(log) ** 2

    def _session_priors(self, stated: Gaussian) -> tuple[SessionPrior, ...]:
        """Return the prior of a further trial for each scatter of the `structural` constants.

        `stated`: posterior of the bench with the stated one.  Two reference trials do not decide κ, and one
        does not bear on it, so that evidence is averaged over it.
        """
        at = [self.constants.index[name] for name in self.model.structural]
        if not at:
            return ()
        sd, middle, logs = self.session_sd, self._joint(range(len(self.trials)))[0].mean, np.arange(-3.0, 2.0)
        # the common factor of constants that are scattered, too, is averaged over in place of its mean
        scattered = [name in self.model.scattered for name in self.model.structural]
        unscaled = sd[at] / np.sqrt(np.where(scattered, self.common, 1.0))
        found = [(float(log), nats, self._further(replace(bench, mean=stated.mean + bench.mean - middle)),
                  self._session())
                 for log, (bench, nats) in zip(logs, self._by_factor(at, unscaled, logs), strict=True)]
        self.session_sd = sd
        whole = float(logsumexp([nats for log, nats, _, _ in found if log <= 0.0]))
        return tuple(SessionPrior(log, nats - whole, prior, session) for log, nats, prior, session in found)

    def _mean_cost(self) -> float:
        """Return the mean cost per datum of the reference trials at their modes."""
        costs = [self._trial_cost(k, self.bench, x) / np.count_nonzero(self.weight[k]) for k, x in enumerate(self.at)]
        return float(np.mean(costs))

    def _constants(self, x: Array) -> Array:
        """Return the coordinates of all constants at a departure from the origin."""
        q = self.origin.copy()
        q[self.free] += x[:len(self.free)]
        return np.asarray(q)

    def _descend(self, held: bool = False) -> None:
        """Move to the joint mode of bench and trials; `held`: the bench's constants stay."""
        (self.bench, self.at), _, self.linear = descended(
            (self.bench, self.at), lambda x: self._cost(*x), lambda x: self._linearised(x[1]),
            partial(self._stepped, held=held), self.close * len(self.trials))

    def _stepped(self, x: tuple[Array, list[Array]], trials: Sequence[_Linear], damping: float,
                 held: bool = False) -> tuple[Array, list[Array]]:
        """Return bench and trials after a damped step on the linearised `trials`, at most `LONGEST` bench σ long.

        `damping`: weight of the squared step, in bench σ and session σ, beside the cost.
        `held`: the bench's constants make no step.
        """
        bench, at = x
        free, scale, deviation = len(self.free), np.sqrt(self._bench_variance()), np.sqrt(self._session())
        square, pull = (1.0 + damping) * np.eye(scale.size), -bench / scale
        pull[:free] += self._middle()
        eliminated = []
        for own_x, linear in zip(at, trials, strict=True):
            # each trial's own departure is eliminated (Schur complement), so that one system of the bench's size is
            # solved
            information, downhill = linear.information, linear.pull - linear.information @ own_x
            inner = cho_factor((1.0 + damping) * np.eye(scale.size) + deviation[:, None] * information * deviation)
            side = deviation[:, None] * information * scale
            own, across = cho_solve(inner, deviation * downhill - (own_x - bench) / deviation), cho_solve(inner, side)
            square += scale[:, None] * information * scale - side.T @ across
            pull += scale * downhill - side.T @ own
            eliminated.append((own, across))
        if held:
            square[:free], square[:, :free], pull[:free] = 0.0, 0.0, 0.0
            square[range(free), range(free)] = 1.0
        step = cho_solve(cho_factor(square), pull)
        moves = [scale * step + deviation * (own - across @ step) for own, across in eliminated]
        longest = max(float(np.abs(each[:free] / self.bench_sd).max()) for each in (scale * step, *moves))
        share = min(1.0, LONGEST / longest)
        return bench + share * scale * step, [own_x + share * each for own_x, each in zip(at, moves, strict=True)]

    def _cost(self, bench: Array, at: Sequence[Array]) -> float:
        """Return the joint cost of bench and trials: misfit, session deviations, prior of the bench."""
        centre = self._middle()
        own = bench / np.sqrt(self._bench_variance())
        own[:len(self.free)] -= centre
        total = float(own @ own)
        return total + sum(self._trial_cost(k, bench, x) for k, x in enumerate(at))

    def _middle(self) -> Array:
        """Return the population's middle as a departure from the origin, in population σ; 0 for regressed constants."""
        centre: Array = -self.origin[self.free] / self.bench_sd
        for name in self.model.regressed:
            centre[self.free.index(self.constants.index[name])] = 0.0
        return centre

    def _trial_cost(self, k: int, bench: Array, x: Array) -> float:
        """Return the cost of one trial at departures `x`: misfit and session deviation from the bench."""
        off = (x - bench) / np.sqrt(self._session())
        return loss(self._residual(k, x), np.sqrt(self.weight[k])) + float(off @ off)

    def _residual(self, k: int, x: Array) -> Array:
        trial = self.trials[k]
        told = predicted(self.model, self._constants(x), trial) + self.features[k] @ x[len(self.free):]
        return np.asarray(trial.data - told)

    def _linearised(self, at: Sequence[Array]) -> list[_Linear]:
        """Return each trial, linearised at its departure in `at`."""
        found = []
        for x, trial, own, weight in zip(at, self.trials, self.features, self.weight, strict=True):
            data, slopes = jacobian(self.model, self._constants(x), trial, self.free)
            design, residual = np.concatenate([slopes, own], axis=1), trial.data - data - own @ x[len(self.free):]
            found.append(_Linear(design, residual + design @ x, bounded(residual, weight)))
        return found

    def _recentre(self, q: Array) -> None:
        """Set the origin to `q`, simulate the states of the discrepancy there, and reset bench and trials to it."""
        self.states = [self.model.simulated_states(q, trial) for trial in self.trials]
        self.scaling = scaling_of(self.model, self.states)
        self.features = [features(self.model, s, self.scaling, self.outputs) for s in self.states]
        self.origin = q
        self.session_sd = self._stated(self.model.session_at(q))
        self._set_amplitude([self.trials[0].data - predicted(self.model, q, self.trials[0])], self.trials[:1])
        self.bench = np.zeros(len(self.free) + FEATURES * len(self.outputs))
        self.at = [self.bench for _ in self.trials]
        self._weigh()

    def _weigh(self) -> None:
        """Set the weight of each datum, by trial, from model error and noise."""
        noise = NoiseModel(self.scaling.quarters, self.model_error, self.tau)
        self.weight = [1.0 / noise.variance(self.model, self.origin, trial, states)
                       for trial, states in zip(self.trials, self.states, strict=True)]

    def _set_amplitude(self, rest: Sequence[Array], trials: Sequence[Recording]) -> None:
        self.amplitude = np.array([
            np.sqrt(np.mean([np.mean(t.part(r, k) ** 2) for r, t in zip(rest, trials, strict=True)]))
            for k in range(len(self.outputs))])

    def _bench_variance(self) -> Array:
        return np.concatenate([self.bench_sd ** 2, np.repeat(self.amplitude**2, FEATURES)])

    def _session(self) -> Array:
        return np.concatenate([self.session_sd[self.free] ** 2,
                               self.model.session_share**2 * np.repeat(self.amplitude**2, FEATURES)])

    def _joint(self, which: Sequence[int]) -> tuple[Gaussian, float]:
        """Return posterior of the bench, about `origin`, and log evidence, nats, of the linearised trials `which`.

        The session deviation Σ of each trial is integrated out: information A(I + ΣA)⁻¹, A = HᵀWH.  The evidence lacks
        terms that do not depend on the priors.
        """
        scale = np.sqrt(self._bench_variance())
        deviation = np.sqrt(self._session()) / scale
        size = scale.size
        information, pull = np.eye(size), np.zeros(size)
        pull[:len(self.free)] = self._middle()
        evidence = -0.5 * float(pull @ pull)
        for k in which:
            linear = self.linear[k]
            # A(I + ΣA)⁻¹ in a symmetric form, with the root of Σ on both sides
            square, error = scale[:, None] * linear.information * scale, scale * linear.pull
            inner = cho_factor(np.eye(size) + deviation[:, None] * square * deviation)
            side, across = deviation[:, None] * square, cho_solve(inner, deviation * error)
            information += square - side.T @ cho_solve(inner, side)
            pull += error - side.T @ across
            evidence += 0.5 * float(deviation * error @ across) - float(np.log(np.diag(inner[0])).sum())
        # ln p = ½ gᵀΛ⁻¹g − ½ ln det Λ of the bench, Λ the information; the axes keep Λ ≥ I despite rounding
        lengths, axes = np.linalg.eigh(0.5 * (information + information.T))
        lengths, pull = np.maximum(lengths, 1.0), axes.T @ pull  # the prior alone has 1
        evidence += 0.5 * float((pull**2 / lengths - np.log(lengths)).sum())
        covariance = (axes / lengths) @ axes.T * scale[:, None] * scale
        return Gaussian(self.origin, scale * (axes @ (pull / lengths)), covariance), evidence

    def _noise(self, least_share: float = 0.1) -> None:
        """Estimate model error by load quarter and autocorrelation from the residuals at the modes.

        A rig's reference trials may be few data, so its number of data is reduced by the degrees of freedom of the fit,
        to a share `least_share` at least.
        """
        shape = (len(self.outputs), 4)
        squares, counts, fitted, self.tau = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape[0])
        for i, (trial, states) in enumerate(zip(self.trials, self.states, strict=True)):
            residual = self._residual(i, self.at[i])
            determined = self._determined(i) if self.model.pools_sessions else np.zeros(residual.size)
            quarter = np.searchsorted(self.scaling.quarters, states[self.model.load_state])
            for k, name in enumerate(self.outputs):
                rest = trial.part(residual, k)
                known = trial.noise_n[name] ** 2 + self.model.unpredicted(self.origin, trial, name)
                counted = np.isfinite(known) & np.ones(rest.size, np.bool_)
                self.tau[k] += autocorrelation(rest[counted]) / len(self.trials)
                squared = np.minimum(rest**2, HUBER**2 * np.median(rest[counted] ** 2) + 1e-9) - known
                for j in range(4):
                    inside = counted & (quarter == j)
                    squares[k, j] += float(squared[inside].sum())
                    counts[k, j] += int(inside.sum())
                    fitted[k, j] += float(trial.part(determined, k)[inside].sum())
        least = np.array([[self.model.least[name] ** 2] for name in self.outputs])
        left = np.maximum(counts, 1)
        if self.model.pools_sessions:
            left = np.maximum(left - self.tau[:, None] * fitted, least_share * left) / POOLED
        self.model_error = np.maximum(squares / left, least)
        self._weigh()
        self._identify()

    def _identify(self) -> None:
        """Store each trial's model at its mode, and linearise the trials there."""
        self.identified = [(self._constants(x), x[len(self.free):]) for x in self.at]
        self.linear = self._linearised(self.at)

    def _determined(self, k: int) -> Array:
        """Return by how much each datum of trial `k` determines its own prediction: diagonal of H(HᵀWH + P⁻¹)⁻¹HᵀW."""
        linear = self.linear[k]
        scale = np.sqrt(self._bench_variance() + self._session())
        design = linear.design * scale * np.sqrt(linear.weight)[:, None]
        # diagonal of the hat matrix
        inner = np.eye(scale.size) + design.T @ design
        return np.asarray((design * np.linalg.solve(inner, design.T).T).sum(axis=1))

    def _amplitudes(self) -> None:
        """Estimate the amplitude of the discrepancy by output: one of `shares` of the RMS residual of constants alone.

        The share has the largest evidence: a residual that no state explains is noise.  Larger shares, which the
        evidence of START and END often prefers, would let the discrepancy take up effects.
        """
        rest = []
        for linear in self.linear:
            part = linear.design[:, :len(self.free)]
            root = np.sqrt(linear.weight)
            scale = self.bench_sd
            design = part * scale * root[:, None]
            at = np.linalg.solve(np.eye(len(self.free)) + design.T @ design, design.T @ (linear.error * root))
            rest.append(linear.error - part @ (scale * at))
        self._set_amplitude(rest, self.trials)
        every = range(len(self.trials))
        for k, most in enumerate(self.amplitude.copy()):
            told = []
            for share in self.shares:
                self.amplitude[k] = share * most
                told.append(self._joint(every)[1])
            self.amplitude[k] = self.shares[int(np.argmax(told))] * most

    def _missed(self) -> dict[str, float]:
        """Return the RMS error by output, N, of the other trials' averaged models on each reference trial.

        A single reference trial is predicted by its own model.
        """
        squares: dict[str, list[float]] = {name: [] for name in self.outputs}
        for j, trial in enumerate(self.trials):
            models = self._others(j)
            rest = np.mean([trial.data - predicted(self.model, q, trial) - self.features[j] @ c
                            for q, c in models], axis=0)
            for name, error in self.model.errors(trial, np.asarray(rest)).items():
                counted = np.isfinite(self.model.unpredicted(self.origin, trial, name) + np.zeros(error.size))
                squares[name].append(float(np.mean(error[counted] ** 2)))
        return {name: float(np.sqrt(np.mean(each))) for name, each in squares.items()}

    def _others(self, j: int) -> list[tuple[Array, Array]]:
        """Return the models that predict reference trial `j`: those of the other trials, else its own.

        If sessions are pooled, the model is the bench fitted to the other trials.
        """
        others = [k for k in range(len(self.trials)) if k != j] or [j]
        if not self.model.pools_sessions:
            return [self.identified[k] for k in others]
        mean = self._joint(others)[0].mean
        return [(self._constants(mean), mean[len(self.free):])]
