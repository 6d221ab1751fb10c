"""Pairs of identical motion: a trial beside a reference trial of the same motion, of which only the difference counts.

    y − e_r = f(q_r + δ; m) + Φ(c_r + d) + ε        e_r: residual of the reference trial at its own mode (q_r, c_r)

The model error under one motion repeats under it, so that e_r removes it.  δ = s − s_r and d are differences of two
sessions.  s_r, the departure of session r from the bench, is known as far as all reference trials determine it.  What
absorbs model error (gains of `ForwardModel.surrogate_sd`, feature weights) repeats, too: its 1σ is √2 times that of one
session.  Evidence is averaged over the scatter of structural constants, up to the stated one, or a larger one that
several reference trials do not exclude.  ε: sensor noise of both trials, and of the model error the share that changes
between sessions (`ForwardModel.session_share`); at least twice the variance of e_r between gait cycles.
"""

import copy
import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import block_diag

from diagnosis.evidence.hypothesis_search import OtherMinimum, TrialModes, search
from estimation.likelihood_data import GRID_S, Recording
from estimation.posterior import Gaussian, SessionData, mode, root_of
from estimation.reference_fit import ReferenceFit, SessionPrior
from physics.laws import Array

REPEAT: Final = "repeat"
"""Name of the experiment that repeats the motion of a reference trial (`bowden trial --motion-of`)."""


@dataclass(frozen=True)
class Pair:
    """A trial less the residual of reference trial number `reference`: its data, and its prior about that trial.

    `session_priors`: priors by the scatter between sessions, as in `TrialModes`.  `lag`: samples by which the reference
    trial is behind.
    """

    observed: SessionData
    prior: Gaussian
    session_priors: Sequence[tuple[float, Gaussian]]
    reference: int
    lag: int


def paired(fit: ReferenceFit, references: Sequence[Recording], observed: SessionData) -> Pair | None:
    """Return the pair of a trial and the reference trial of its motion; None without such a reference trial.

    `references`: recordings in the order of `fit.identified`.  Sessions of several trials have no pair.
    """
    if fit.model.pools_sessions or len(observed.trials) != 1 or len(references) != len(fit.identified):
        return None
    trial = observed.trials[0]
    lags = [(k, _lag(trial, other)) for k, other in enumerate(references)]
    found = [(k, lag) for k, lag in lags if lag is not None]
    if not found:
        return None
    number, lag = found[0]
    return pair_of(fit, references[number], observed, number, lag)


def search_trial(fit: ReferenceFit, references: Sequence[Recording], observed: SessionData, alone: bool = True
                 ) -> tuple[TrialModes, Pair | None]:
    """Return the modes of a trial, and its pair if a reference trial has its motion: then the modes are the pair's.

    `alone`: whether effects are sought in a trial without a pair.
    """
    pair = paired(fit, references, observed)
    if pair is None:
        return search(observed, fit.prior_of(observed), fit, fit.session_priors_of(observed), alone), None
    found = search(pair.observed, pair.prior, fit, pair.session_priors)
    # the model's error repeats, so that a departure that is left is the effect's own, not one that all effects share
    found.each_dispersed = len(fit.identified) == 1
    if fit.bench_nats is not None:
        found.other_minimum = functools.partial(_moved, references[pair.reference], observed, pair)
    return found, pair


def _moved(other: Recording, observed: SessionData, pair: Pair, found: TrialModes, rounds: int = 2, least: float = 0.3,
           shares: Sequence[float] = (1.0, 0.5, 0.25)) -> OtherMinimum:
    """Return the pair about the bench that predicts the difference of its trials best.

    The bench b ~ N(0, B) acts on the difference by (J(q_r + δ) − J(q_r))·b, δ that of the null.  With these columns
    beside the features the null's mode has b, too.  `rounds`: of δ and b in turns.  `least`: smallest singular value of
    a column, in σ of the data.  `shares`: of b that are tried, since B is linearised at the reference trials' mode.
    That share counts at which null and reference trials, fitted anew, are likeliest.
    """
    fit, null = found.reference, found.null
    assert fit.bench_nats is not None
    free, size = list(fit.model.constants.free), found.prior.mean.size
    root = root_of(fit.bench.covariance[:len(free), :len(free)])
    before = pair.observed.jacobian(fit.identified[pair.reference][0], free)[1]
    for _ in range(rounds):
        across = (pair.observed.jacobian(null.q, free)[1] - before) @ root
        _, lengths, axes = np.linalg.svd(np.sqrt(pair.observed.weight)[:, None] * across, full_matrices=False)
        axes = axes[lengths > least].T
        wide = replace(pair.observed, features=np.hstack([pair.observed.features, across @ axes]))
        prior = Gaussian(pair.prior.origin, np.append(pair.prior.mean, np.zeros(axes.shape[1])),
                         block_diag(pair.prior.covariance, np.eye(axes.shape[1])))
        starts = (None, np.append(null.x[:size], np.zeros(axes.shape[1])))
        null = min((mode(wide, prior, start=x) for x in starts), key=lambda at: at.cost)
    whole, tried = root @ (axes @ null.x[size:]), []
    for shift in (share * whole for share in shares):
        about = pair_of(_with_bench(fit, pair.reference, shift), other, observed, pair.reference, pair.lag)
        at = mode(about.observed, about.prior, start=null.x[:size] + np.pad(shift, (0, size - shift.size)))
        modes = replace(found, observed=about.observed, prior=about.prior, session_priors=about.session_priors,
                        single={}, variants={})
        tried.append((at.log_evidence, OtherMinimum(modes, fit.bench_nats(shift), at.x)))
    return max(tried, key=lambda each: each[0] + each[1].nats)[1]


def _with_bench(fit: ReferenceFit, number: int, shift: Array) -> ReferenceFit:
    """Return a fit whose bench and reference trial `number` are moved by `shift` in their free constants."""
    whole = np.pad(shift, (0, fit.prior.mean.size - shift.size))
    q, c = fit.identified[number]
    q = q.copy()
    q[list(fit.model.constants.free)] += shift
    identified = tuple((q, c) if k == number else each for k, each in enumerate(fit.identified))
    priors = tuple(each._replace(prior=replace(each.prior, mean=each.prior.mean + whole))
                   for each in fit.session_priors)
    return replace(fit, identified=identified, session_priors=priors,
                   prior=replace(fit.prior, mean=fit.prior.mean + whole))


def pair_of(fit: ReferenceFit, other: Recording, observed: SessionData, number: int, lag: int, odds: float = 20.0
            ) -> Pair:
    """Return the pair of a trial and reference trial `number`, the recording `other`, `lag` samples behind it.

    `odds`: of the stated scatter over a larger one from which reference trials exclude that.  Beside one alone, which
    shows no scatter, any change would be within a larger one.
    """
    known = fit.observe(other)
    design = np.hstack([known.jacobian(fit.identified[number][0], list(fit.model.constants.free))[1], known.features])
    information = (design.T * known.weight) @ design
    stated = SessionPrior(0.0, 0.0, fit.prior, np.diag(fit.prior.covariance - fit.bench.covariance))
    stated_nats = max((each.log_probability for each in fit.session_priors if each.log_factor == 0.0), default=0.0)
    least = stated_nats - np.log(odds) if len(fit.identified) > 1 else np.inf
    scatters = [each for each in fit.session_priors if each.log_factor <= 0.0 or each.log_probability > least]
    whole = float(np.logaddexp.reduce([each.log_probability for each in scatters]))
    return Pair(_difference(fit, known, observed, number, lag), _prior(fit, number, information, stated), [
        (each.log_probability - whole, _prior(fit, number, information, each)) for each in scatters], number, lag)


def _lag(trial: Recording, other: Recording, most_s: float = 2.0, identical: float = 0.01, covered: float = 0.8
         ) -> int | None:
    """Return by how many samples `other` is behind `trial`; None if it has another motion.

    `most_s`: largest lag that is tried.  `identical`: largest RMS difference of rope and knee, relative to their
    standard deviation.  A servo that replays a recorded motion repeats it to some 0.1 %; a controller that leads END
    moves the rope by 2 % otherwise where friction changed.
    `covered`: least share of the trial in which `other` has its motion.
    """
    own, known = (_motion(each) for each in (trial, other))
    rate, other_rate = (np.gradient(each[1]) for each in (own, known))
    most = round(most_s / GRID_S)
    size = 1 << int(np.ceil(np.log2(rate.size + other_rate.size)))
    # the lag with the largest cross-correlation of the knee's rate, by Fourier transforms
    alike = np.fft.irfft(np.conj(np.fft.rfft(rate, size)) * np.fft.rfft(other_rate, size), size)
    lag = int(np.argmax(np.concatenate([alike[-most:], alike[:most + 1]]))) - most
    first, last = max(0, -lag), min(own.shape[1], known.shape[1] - lag)
    if last - first < covered * own.shape[1]:
        return None
    # a zero of the encoder is no other motion: the standard deviation, not the RMS
    difference = own[:, first:last] - known[:, first + lag:last + lag]
    spread = np.maximum(own[:, first:last].std(axis=1), 1e-4)  # m and rad; a locked knee hardly moves
    return lag if float((difference.std(axis=1) / spread).max()) <= identical else None


def _motion(trial: Recording) -> Array:
    """Return rope position, m, and knee angle, rad, shape (2, samples)."""
    return np.stack([trial.sampled(name) for name in ("servo_position_m", "knee_angle_rad")])


def _difference(fit: ReferenceFit, known: SessionData, observed: SessionData, number: int, lag: int,
                inflation: float = 1.5) -> SessionData:
    """Return the trial less the residual of the reference trial `known`, which is `lag` samples behind.

    `inflation`: factor on the variance.  Without it a healthy pair of `tests/diagnosis/test_diagnosis_gates.py` has a
    lack of fit (1.9 times the variance), since a residual at its own mode is smaller than that of another trial.
    """
    trial, other = observed.trials[0], known.trials[0]
    q, c = fit.identified[number]
    missed = known.data - known.predicted(q) - known.features @ c
    at, have = trial.rows * trial.width + lag, other.rows * other.width
    inside = (at >= have[0]) & (at <= have[-1])
    errors = {name: np.interp(at, have, error) for name, error in fit.model.errors(other, missed).items()}
    made = copy.copy(trial)
    made.data = trial.data - fit.model.weighed(trial, errors)
    variance = []
    for k, name in enumerate(fit.outputs):
        # weights are 1/(τ·(model error + noise)), of which the sensor noise has no τ
        model = 1.0 / observed.part(observed.weight, k) - observed.tau[k] * trial.noise_n[name] ** 2
        stated = (trial.noise_n[name] ** 2 + other.noise_n[name] ** 2
                  + fit.model.session_share**2 * np.maximum(model, 0.0))
        # what the bench does not repeat in the next cycle it repeats no better in another session
        variance.append(np.maximum(stated, 2.0 * np.interp(at, have, cycle_variance(other, other.part(missed, k)))))
    weight = np.where(np.tile(inside, len(fit.outputs)), 1.0 / (inflation * np.concatenate(variance)), 0.0)
    return replace(observed, trials=(made,), weight=weight, tau=np.ones(len(fit.outputs)))


def cycle_variance(trial: Recording, missed: Array, phases: int = 100, wide: int = 2) -> Array:
    """Return the variance of the residual `missed` between gait cycles at each bin's phase; 0 outside 3 or more cycles.

    The mean of each cycle is left out: a zero that drifts is no snap.  `phases`: of the cycle.  `wide`: phases on
    either side over which the variance is averaged.
    """
    out = np.zeros(missed.size)
    if trial.phase is None:
        return out
    walked, grid = np.flatnonzero(np.isfinite(trial.phase)), np.arange(phases) / phases
    phase = trial.phase[walked]
    cycles = [rows for rows in np.split(np.arange(phase.size), np.flatnonzero(np.diff(phase) < -0.5) + 1)
              if np.ptp(phase[rows]) > 0.9]
    if len(cycles) < 3:
        return out
    each = np.array([np.interp(grid, phase[rows], missed[walked[rows]]) for rows in cycles])
    variance = np.var(each - each.mean(axis=1, keepdims=True), axis=0, ddof=1)
    even = np.mean([np.roll(variance, k) for k in range(-wide, wide + 1)], axis=0)
    out[walked] = np.interp(phase, grid, even)
    return out


def _prior(fit: ReferenceFit, number: int, information: Array, further: SessionPrior) -> Gaussian:
    """Return the prior of a trial with the motion of reference trial `number`.

    `information`: HᵀWH of that reference trial at its mode.  `further`: prior of a trial of any motion, mean b̂ and
    covariance B + S.  With P = (S⁻¹ + HᵀWH)⁻¹ and s_r = P·HᵀWH·(x_r − b) + N(0, P), the trial has the mean b̂ and the
    covariance S + P + P·HᵀWH·B·HᵀWH·P.
    """
    q, c = fit.identified[number]
    free, names = list(fit.model.constants.free), fit.model.constants.names
    session, bench = np.diag(further.session), further.prior.covariance - np.diag(further.session)
    root = np.sqrt(session)
    left = root @ np.linalg.solve(np.eye(c.size + len(free)) + root @ information @ root, root)
    known = left @ information
    covariance = session + left + known @ bench @ known.T
    absorbs = np.array([names[i] in fit.model.surrogate_sd for i in free] + [True] * c.size)
    covariance = np.where(absorbs[:, None] | absorbs, 2.0 * session, covariance)
    return Gaussian(fit.origin, np.where(absorbs, np.concatenate([(q - fit.origin)[free], c]), further.prior.mean),
                    0.5 * (covariance + covariance.T))
