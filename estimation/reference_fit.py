"""Reference condition of a bench: posterior of its constants and discrepancy, prior and noise of a further trial.

The discrepancy is a Gaussian process in random Fourier features.  Its inputs are states that the fitted model simulates
under the trial's motion, not sensor readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from estimation.forward_model import ForwardModel, predicted
from estimation.likelihood_data import Recording
from estimation.posterior import Gaussian, SessionData, SessionDeparture
from physics.laws import Array

FEATURES: Final = 60
"""Random Fourier features per output; 120 features give the same held-out likelihood of reference trials."""


@cache
def waves(signals: tuple[str, ...], states: int) -> dict[str, tuple[Array, Array]]:
    """Return frequencies, shape (`FEATURES`, states), and phases, shape (`FEATURES`,), of the features by output.

    They are drawn from a fixed seed; the length scale is 2 in standardised states.
    """
    random = np.random.default_rng(7)
    return {name: (random.normal(size=(FEATURES, states)) / 2.0, random.uniform(0.0, 2.0 * np.pi, FEATURES))
            for name in signals}


class SessionPrior(NamedTuple):
    """Prior of a further trial under one scatter of the structural constants between sessions.

    `log_factor`: ln κ, of the scatter over the stated one.  `log_probability`: that of κ, given the reference trials,
    among those of at most 1.  `session`: variance between sessions of constants and feature weights.
    """

    log_factor: float
    log_probability: float
    prior: Gaussian
    session: Array


class Scaling(NamedTuple):
    """Mean and standard deviation of the states over the reference trials, each of shape (states,).

    `quarters`: quartiles of the load state, which divide the data for the estimate of the model error.
    """

    mean: Array
    sd: Array
    quarters: Array


def scaling_of(model: ForwardModel, states: Sequence[Array]) -> Scaling:
    """Return the scaling of the states of several trials, each of shape (states, bins)."""
    every = np.concatenate(states, axis=1)
    return Scaling(every.mean(axis=1), every.std(axis=1) + 1e-6,
                   np.quantile(every[model.load_state], [0.25, 0.5, 0.75]))


class Reach(NamedTuple):
    """Smallest and largest value of each motion signal over the reference trials, each of shape (signals,)."""

    lowest: Array
    highest: Array

    def exceeded(self, motion: Array) -> float:
        """Return by how much `motion`, shape (signals, bins), exceeds the range, relative to it; the largest of all."""
        outside = np.maximum(motion.max(axis=1) - self.highest, self.lowest - motion.min(axis=1))
        return float(np.max(outside / (self.highest - self.lowest + 1e-6), initial=0.0))


def reach_of(model: ForwardModel, trials: Sequence[Recording]) -> Reach:
    """Return the range of the motion of several trials."""
    every = np.concatenate([model.motion(trial) for trial in trials], axis=1)
    return Reach(every.min(axis=1), every.max(axis=1))


@dataclass(frozen=True)
class ReferenceFit:
    """Bench as fitted to its reference trials.

    `bench`: posterior of the bench's constants and discrepancy, about the coordinates `origin`.  `prior`: prior of a
    further trial, which is `bench` with the session deviation.  `model_error`: variance by output and load quarter, N².
    `tau`: noise inflation by output.  `cost`: mean cost per datum of the reference trials at their modes.  `reach`:
    range of their motion, None in a logbook that does not hold it.
    `identified`: coordinates and feature weights at the mode of each reference trial.  `scatter_n`: RMS error by
    output, N, of the other reference trials' models on one trial; a single trial is predicted by its model.
    `contradicted`: nats by which a restart of the fit found a better minimum than the first start, 0 if it did not.
    `session_priors`: priors by how far structural constants scatter between sessions, () where that is not known.
    `joint_minimum`: function of this fit, a further trial and its mode that returns the reference condition at their
    joint minimum; None for a condition that was not fitted here, and for pooled sessions.  `bench_nats`: function of a
    shift of the bench's free constants that returns the log probability of reference trials and bench there less that
    at the mode, nats; None likewise.  `misfit`: mean squared residual of the reference trials over its variance, by
    output, at least 1: the servo force of a drive that cogs has more, which no load quarter describes.  `departure`: of
    the reference trials from the bench, in session σ; none of a single one.
    """

    model: ForwardModel
    outputs: tuple[str, ...]
    origin: Array
    bench: Gaussian
    prior: Gaussian
    scaling: Scaling
    model_error: Array
    tau: Array
    scatter_n: Mapping[str, float]
    cost: float
    reach: Reach | None
    identified: tuple[tuple[Array, Array], ...] = ()
    contradicted: float = 0.0
    session_priors: tuple[SessionPrior, ...] = ()
    joint_minimum: Callable[[ReferenceFit, Recording, Array], JointMinimum] | None = None
    bench_nats: Callable[[Array], float] | None = None
    misfit: Array | float = 1.0
    departure: SessionDeparture = field(default_factory=lambda: SessionDeparture(0.0, 0.0))

    def warning(self) -> str:
        """Return a sentence if a restart of the fit contradicted the first minimum; else ""."""
        if not self.contradicted:
            return ""
        return (f"The reference fit has two minima: that of a restart from another reference trial is better by "
                f"{self.contradicted:.1f} nats and is used for all of them. Another reference trial, of another peak "
                "or cadence, would separate them.")

    def missed(self, observed: SessionData) -> Array:
        """Return the residual of the data from the averaged prediction of the reference trials' models, shape (data,).

        If sessions are pooled, the prediction is that of the bench.
        """
        models = self.identified
        if self.model.pools_sessions:
            models = ((self.bench_coordinates(), self.bench.mean[len(self.model.constants.free):]),)
        return np.asarray(np.mean([observed.data - observed.predicted(q) - observed.features @ c
                                   for q, c in models], axis=0))

    def bench_coordinates(self) -> Array:
        """Return the coordinates of all constants at the posterior mean of the bench."""
        return self.bench.coordinates(self.model.constants)

    def unlike(self, trial: Recording, source: str) -> str:
        """Return a sentence if the reference trials do not fit the model, so that they are of another rig; else "".

        `trial`: one of them, from the file `source`.
        """
        name = self.model.judged[0]
        missed = float(np.sqrt(np.mean(self.model_error[self.outputs.index(name)])))
        spread = float(np.std(trial.measured(name)))
        if missed <= self.model.unlike_share * spread:
            return ""
        what, unit = ("START" if name == "tension_start_n" else name), self.model.signals[name]
        return (f"{source}: the reference trials do not fit: the model misses {what} by {missed:.3g} {unit} of "
                f"{spread:.3g} {unit}; expected below {100 * self.model.unlike_share:g} %. Give reference trials of "
                "this bench, recorded as the trial is.")

    @property
    def rmse_n(self) -> float:
        """RMS error of a reference trial's model on another reference trial, over the model's judged outputs."""
        told = [e**2 for name, e in self.scatter_n.items() if name in self.model.judged]
        return float(np.sqrt(np.mean(told)))

    def starts(self) -> list[Array]:
        """Return further starts of a fit of a trial, besides the prior's mean: the modes of the reference trials."""
        return [np.concatenate([(q - self.origin)[list(self.model.constants.free)], c]) for q, c in self.identified]

    def observe(self, *trials: Recording) -> SessionData:
        """Return trials of one session as data with the features and weights of this bench."""
        states = [self.model.simulated_states(self.origin, trial) for trial in trials]
        made = [features(self.model, s, self.scaling, self.outputs) for s in states]
        beyond = [0.0 if self.reach is None else self.reach.exceeded(self.model.motion(t)) for t in trials]
        noise = NoiseModel(self.scaling.quarters, self.model_error, self.tau)
        weight = np.concatenate([1.0 / noise.variance(self.model, self.origin, t, s)
                                 for t, s in zip(trials, states, strict=True)])
        growth = np.concatenate([self._grown(t, excess) for t, excess in zip(trials, beyond, strict=True)])
        return SessionData(self.model, trials, np.concatenate(made), weight, self.tau, self.cost, growth, max(beyond),
                           self.misfit, max(1.0, self.departure.rms))

    def prior_of(self, observed: SessionData) -> Gaussian:
        """Return the prior of the session `observed`: session deviations grow where its motion exceeds the references'.
        """
        session = np.diag(self.prior.covariance - self.bench.covariance)
        return replace(self.prior, covariance=self.prior.covariance + np.diag(self._unseen(observed) * session))

    def session_priors_of(self, observed: SessionData) -> list[tuple[float, Gaussian]]:
        """Return log probability and prior of each scatter for the session `observed`, as `prior_of`.

        On a bench a scatter above the stated one counts as overdispersion.  One reference trial shows none.
        """
        if len(self.identified) < 2:
            return []
        growth = self._unseen(observed)
        return [(nats, replace(prior, covariance=prior.covariance + np.diag(growth * session)))
                for log_factor, nats, prior, session in self.session_priors
                if log_factor <= 0.0 or self.model.pools_sessions]

    def _unseen(self, observed: SessionData) -> Array:
        """Return the growth of the session's variances with motion beyond the references', constants first."""
        constants = [self.model.constants.names[i] in self.model.extrapolated for i in self.model.constants.free]
        discrepancy = np.repeat([name in self.model.judged for name in self.outputs], FEATURES)
        return np.asarray((self.model.unseen * observed.beyond) ** 2 * np.concatenate([constants, discrepancy]))

    def _grown(self, trial: Recording, beyond: float) -> Array:
        """Return, by datum, the growth with the measured signals over that with the reference condition's.

        A rig's model misses a motion `beyond` that of the reference trials in proportion.
        """
        measured, expected = (np.array([
            self.model.changing(trial, name, trial.part(data, k)) for k, name in enumerate(self.outputs)])
            for data in (trial.data, predicted(self.model, self.origin, trial)))
        faster = (1.0 + beyond) ** 2 if self.model.pools_sessions else 1.0
        return np.repeat(faster * np.maximum(1.0, measured / np.maximum(expected, 1e-12)), trial.bins)


class JointMinimum(NamedTuple):
    """Reference condition at another minimum: the fit, log evidence of its reference trials less that of the first
    minimum, nats, and the departures of a further trial there."""

    fit: ReferenceFit
    nats: float
    x: Array


class NoiseModel(NamedTuple):
    """Noise of the data: `model_error` by output and quarter of the load, N², and its inflation `tau` by output.

    `quarters`: quartiles of the load state.
    """

    quarters: Array
    model_error: Array
    tau: Array

    def variance(self, model: ForwardModel, origin: Array, trial: Recording, states: Array) -> Array:
        """Return the variance of each datum of a trial by model error, which grows with the signals, and noise."""
        quarter, expected = np.searchsorted(self.quarters, states[model.load_state]), predicted(model, origin, trial)
        return np.concatenate([self.tau[k] * (
            model.growth(trial, name, trial.part(expected, k)) * self.model_error[k][quarter]
            + trial.noise_n[name] ** 2 + model.unpredicted(origin, trial, name))
            for k, name in enumerate(trial.outputs)])


def autocorrelation(rest: Array, most: float = 12.0) -> float:
    """Return 1 + 2·Σ of the autocorrelations of a residual, summed up to the first lag with less than 0.05.

    It is at most `most`: a residual that hardly changes is no noise.
    """
    even = rest - rest.mean()
    power = float(np.mean(even**2))
    total = 1.0
    for lag in range(1, 40):
        share = float(np.mean(even[:-lag] * even[lag:])) / power if power > 0.0 else 0.0
        if share < 0.05:
            break
        total += 2.0 * share
    return min(total, most)


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
