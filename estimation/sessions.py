"""Sessions of one bench under one reference posterior: evidence that an effect began in one of them.

With s a session, x_s its departure from the posterior's mean, and a the size of an effect, all with a Gaussian prior:

    e_s = H_s x_s + E_s a + ε_s        x_s = b + R_s r + δ_s,  b ~ N(0, population),  δ_s ~ N(0, D),  D as published
    r: offset of constants that maintenance reset, and a departure like δ of all of them; R_s = 1 after it

δ_s is integrated out of the sums T of a session (`linear_sums`) with K = (D⁻¹ + A)⁻¹, A = HᵀWH.  b and r are those of
all sessions together.  Each session then has a score of the effect, of unit variance if all this holds:

    S = T − T_H K T_Hᵀ,  g = t − T_H K HᵀWe,  u_s = (g − S b̂)_a / √(1 + S_aa)

It does not hold on a bench of another structure: its scatter is not the published one.  So the scores of an effect are
a series whose own scatter σ is unknown (regression with a conjugate prior, Raftery, Madigan and Hoeting 1997):

    u_s = q_s (m + w_s d) + v_s + n_s + ε_s,  q_s = S_aa / √(1 + S_aa)
    ε_s ~ N(0, σ²),  ν₀/σ² ~ χ²(ν₀),  m, d, v, n ~ N(0, σ² V)

w_s: 0 before the change; from its first session on 1 (step), or rising to 1 at the newest session (ramp).  v_s: error
of the model in the motion of a session, one for all sessions of a motion.  n_s: change by a maintenance.  The order in
which sessions were entered has no influence.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp
from scipy.stats import chi2

from estimation.linear_sums import EffectColumns, SessionSums, Sums
from estimation.posterior import SURROGATE
from estimation.reference_fit import ReferenceFit
from physics.laws import Array

COURSES: Final = ("step", "ramp")


class Change(NamedTuple):
    """A change of the bench: log Bayes factor, nats, course, row of its first session with the 95 % interval of rows.

    `departure`: of the free constants at the newest session, in coordinates, and `departure_sd` its 1σ.
    """

    effect: str
    nats: float
    course: str
    since: int
    since_low: int
    since_high: int
    departure: Array
    departure_sd: Array


class Reset(NamedTuple):
    """Maintenance: row of a free constant, and the number of sessions before it."""

    constant: int
    before: int


@dataclass(frozen=True)
class _IntegratedSessions:
    """Sessions with their deviations integrated out: S, g, K of each.  Rows of S and g: b, r, then the effect columns.
    """

    square: Array
    pull: Array
    inner: Array


class SessionSequence:
    """Sessions of one bench in the order of their dates.

    `fit`: the reference posterior.  `references`: number of sessions from the first on in which no change begins.
    """

    def __init__(self, fit: ReferenceFit, columns: Sequence[EffectColumns], sessions: Sequence[SessionSums],
                 references: int, resets: Sequence[Reset] = ()) -> None:
        self.fit, self.columns, self.resets, self.references = fit, columns, tuple(resets), references
        table = fit.model.constants
        self.free, self.count = len(table.free), len(sessions)
        deviation = np.diag(fit.prior.covariance - fit.bench.covariance)
        self.published = deviation[:self.free]
        self.population = table.bench_sd[list(table.free)] ** 2
        amplitude = deviation[self.free:] / fit.model.session_share**2
        unit = np.sqrt(np.concatenate([self.population, amplitude, np.ones(columns[-1].at.stop)]))
        self.basis = _basis([one.sums.square * unit[:, None] * unit for one in sessions[:max(references, 1)]],
                            self.free, unit.size - columns[-1].at.stop) * unit[:, None]
        self.size = self.basis.shape[1] - columns[-1].at.stop
        # 1σ of δ in units of the population's σ
        self.offset = np.full(self.size, fit.model.session_share)
        self.offset[:self.free] = np.sqrt(self.published / self.population)
        self.known = self.size + self._maintained(0).shape[1]
        self.growth = [self._growth(one.growth) for one in sessions]
        self.motion = np.array([-1 if one.motion is None else one.motion for one in sessions])
        self.sums = [self._reduced(one, row) for row, one in enumerate(sessions)]
        # variance between sessions of the sizes of effects beside that of the constants
        self.loose = np.zeros(columns[-1].at.stop)
        for part in columns:
            self.loose[part.at] = 0.0 if self._followed(part) else SURROGATE**2

    def _reduced(self, session: SessionSums, row: int) -> Sums:
        """Return the sums of (b, r, effects) of a session, in units of the population's σ, of the reduced discrepancy.
        """
        base, effects = self.basis[:, :self.size], self.basis[:, self.size:]
        basis = np.concatenate([base, base @ self._maintained(row), effects], axis=1)
        return Sums(basis.T @ session.sums.square @ basis, basis.T @ session.sums.pull)

    def _maintained(self, row: int) -> Array:
        """Return the columns of r in a session, among those of b."""
        reset = np.zeros((self.size, len(self.resets)))
        for k, one in enumerate(self.resets):
            reset[one.constant, k] = float(row >= one.before)
        common = [float(row >= before) * np.diag(self.offset) for before in self._maintenance()]
        return np.concatenate([reset, *common], axis=1)

    def _maintenance(self) -> list[int]:
        """Return the numbers of sessions before each maintenance."""
        return sorted({one.before for one in self.resets})

    def _growth(self, growth: Array) -> Array:
        """Return the growth of a session's deviation in the reduced basis."""
        of = self.basis[self.free:growth.size, self.free:self.size]
        return np.concatenate([growth[:self.free],
                               (of**2 * growth[self.free:, None]).sum(axis=0) / (of**2).sum(axis=0)])

    def _followed(self, part: EffectColumns) -> bool:
        """Return whether an effect is a departure of constants of a session, so that it scatters as they do."""
        table = self.fit.model.constants
        followed = {table.names[i] for i in table.free}
        return not part.variant.at and {n for d in part.variant.directions for n in d.along} <= followed

    def until(self, row: int) -> "SessionSequence":
        """Return the sequence of the sessions before `row`."""
        earlier = copy(self)
        earlier.sums, earlier.growth, earlier.motion, earlier.count = (
            self.sums[:row], self.growth[:row], self.motion[:row], row)
        return earlier

    # -- scatter between sessions ------------------------------------------------------------------------------------

    def integrated(self, variance: Array) -> _IntegratedSessions:
        """Return the sessions with deviations of a `variance` of the free constants, in coordinates, integrated out."""
        own, squares, pulls, inners = slice(0, self.size), [], [], []
        for sums, growth in zip(self.sums, self.growth, strict=True):
            deviation = np.sqrt(self._deviation(variance) * growth)
            factor = cho_factor(np.eye(self.size) + deviation[:, None] * sums.square[own, own] * deviation)
            inner = deviation[:, None] * cho_solve(factor, np.diag(deviation))
            across = sums.square[:, own]
            squares.append(sums.square - across @ inner @ across.T)
            pulls.append(sums.pull - across @ (inner @ sums.pull[own]))
            inners.append(inner)
        return _IntegratedSessions(np.array(squares), np.array(pulls), np.array(inners))

    def _deviation(self, variance: Array) -> Array:
        """Return the variances of δ_s, constants and discrepancy, in units of the population's σ."""
        return np.concatenate([variance / self.population, self.offset[self.free:] ** 2])

    def _bench(self, sessions: _IntegratedSessions) -> tuple[Array, Array]:
        """Return covariance and mean of (b, r), with a prior of N(0, 1)."""
        precision = np.eye(self.known) + sessions.square[:, :self.known, :self.known].sum(axis=0)
        covariance: Array = np.asarray(np.linalg.inv(precision), np.float64)
        return covariance, covariance @ sessions.pull[:, :self.known].sum(axis=0)

    def scatter(self, rounds: int = 12, weight: float = 10.0) -> Array:
        """Return the variances of the free constants between sessions, in coordinates, by expectation maximisation.

        Each has an inverse-gamma prior about the published one, which counts as `weight` sessions.  They change by less
        than 2 % after so many `rounds`.
        """
        variance = self.published
        for _ in range(rounds):
            sessions = self.integrated(variance)
            covariance, mean = self._bench(sessions)
            total = np.zeros(self.free)
            for sums, inner in zip(self.sums, sessions.inner, strict=True):
                # E step: mean and variance of the session's deviation, with the uncertainty of (b, r)
                carried = inner[:self.free] @ sums.square[:self.size, :self.known]
                deviation = inner[:self.free] @ sums.pull[:self.size] - carried @ mean
                total += deviation**2 + np.diag(inner)[:self.free] + np.sum((carried @ covariance) * carried, axis=1)
            # M step
            variance = (weight * self.published + total * self.population) / (weight + self.count)
        return np.asarray(variance)

    # -- changes -----------------------------------------------------------------------------------------------------

    @property
    def begins(self) -> NDArray[np.intp]:
        """Rows of the sessions in which a change can begin."""
        return np.arange(max(self.references, 1), self.count)

    def weights(self) -> Array:
        """Return the share 0 … 1 of a change in each session, shape (courses, begins, sessions)."""
        row, begins = np.arange(self.count), self.begins[:, None]
        return np.stack([(row >= begins).astype(float),
                         np.clip((row - begins + 1) / np.maximum(self.count - begins, 1), 0.0, 1.0)])

    def search(self) -> list[Change]:
        """Return the changes, best first, one an effect; nothing where no session follows the reference sessions."""
        if not self.begins.size:
            return []
        sessions, rows = self.integrated(self.published), slice(self.known, None)
        information = np.diagonal(sessions.square, axis1=1, axis2=2)[:, rows]
        pull = sessions.pull[:, rows] - sessions.square[:, rows, :self.known] @ self._bench(sessions)[1]
        # an effect that is no departure of followed constants has a scatter of its own: S/(1 + σ²S)
        own = 1.0 + self.loose * information
        information, unit = information / own, np.sqrt(1.0 + information / own)
        scores = pull / own / unit
        series = [self._series(scores[:, k], information[:, k] / unit[:, k]) for k in range(scores.shape[1])]
        of: dict[str, list[tuple[_Series, EffectColumns, int]]] = {}
        for part in self.columns:
            of.setdefault(part.effect, []).extend(
                (series[part.at.start + k], part, k) for k in range(part.at.stop - part.at.start))
        return sorted((self._change(effect, each) for effect, each in of.items()), key=lambda change: -change.nats)

    def _series(self, scores: Array, carried: Array) -> "_Series":
        """Return the evidence of each course and begin in one series; `carried`: q, score of a size of 1σ."""
        weights = self.weights().reshape(-1, self.count)
        after = [(np.arange(self.count) >= before).astype(float) for before in self._maintenance()]
        motions = [(self.motion == each).astype(float) for each in np.unique(self.motion)]
        # 1σ, in the scatter of the scores: of a level 20 (any); of a motion, a maintenance and a change 2
        known = np.column_stack([carried, *(motions if len(motions) > 1 else ()), *after])
        variances = np.array([20.0] + [2.0] * known.shape[1]) ** 2
        none, _, _ = _regression(known[None], variances[:-1], scores)
        nats, mean, sd = _regression(np.concatenate([np.broadcast_to(known, (len(weights), *known.shape)),
                                                     (weights * carried)[:, :, None]], axis=2), variances, scores)
        return _Series(nats - none[0], mean, sd)

    def _change(self, effect: str, of: Sequence[tuple["_Series", EffectColumns, int]]) -> Change:
        """Return the change by one effect with its likeliest course and begin, and the 95 % interval of its begin."""
        begins, every = self.begins, np.array([series.nats for series, _, _ in of])
        share = np.exp(every - logsumexp(every)).sum(axis=0)
        summed = np.cumsum(share.reshape(len(COURSES), -1).sum(axis=0))
        low, high = (int(np.searchsorted(summed, q)) for q in (0.025, 0.975))
        at = int(share.argmax())
        series, part, k = of[int(every[:, at].argmax())]
        departure, table = np.zeros((2, self.free)), self.fit.model.constants
        for name, along in part.variant.directions[k].along.items():
            if table.index[name] in table.free:
                departure[:, table.free.index(table.index[name])] = along * part.variant.directions[k].sd * np.array(
                    [series.mean[at], series.sd[at]])
        return Change(effect, float(logsumexp(every)) - float(np.log(every.size)), COURSES[at // begins.size],
                      int(begins[at % begins.size]), int(begins[low]), int(begins[min(high, begins.size - 1)]),
                      departure[0], np.abs(departure[1]))

    # -- constants ---------------------------------------------------------------------------------------------------

    def constants(self, variance: Array) -> tuple[Array, Array]:
        """Return each session's free constants and their 1σ, departures from the reference, shape (sessions, free)."""
        sessions, unit = self.integrated(variance), np.sqrt(self.population)
        covariance, mean = self._bench(sessions)
        means, sds = [], []
        for row, (sums, inner) in enumerate(zip(self.sums, sessions.inner, strict=True)):
            carried = inner[:self.free] @ sums.square[:self.size, :self.known]
            whole = np.concatenate([np.eye(self.size), self._maintained(row)], axis=1)[:self.free] - carried
            means.append((whole @ mean + inner[:self.free] @ sums.pull[:self.size]) * unit)
            sds.append(np.sqrt(np.diag(inner)[:self.free] + np.sum((whole @ covariance) * whole, axis=1)) * unit)
        return np.array(means), np.array(sds)

    def departure(self, session: SessionSums, variance: Array) -> tuple[Array, Array, float]:
        """Return how far a further session is from the bench: its constants' departure, that over the scatter, and the
        probability that a session in the reference condition departs as far in all constants together."""
        known, mean = self._bench(self.integrated(variance))
        last = np.concatenate([np.eye(self.size), self._maintained(self.count)], axis=1)
        sums, bench = self._reduced(session, self.count), last @ mean
        prior = last @ known @ last.T + np.diag(self._deviation(variance) * self._growth(session.growth))
        square = sums.square[:self.size, :self.size]
        residual = sums.pull[:self.size] - square @ bench
        departure: Array = np.asarray(np.linalg.solve(np.linalg.inv(prior) + square, residual), np.float64)
        lengths, axes = np.linalg.eigh(square + square @ prior @ square)
        kept = lengths > 1e-9 * lengths[-1]
        # rᵀS⁻¹r with S the covariance of the residual, in the directions that the session determines
        squared = float(np.sum((axes[:, kept].T @ residual) ** 2 / lengths[kept]))
        own = departure[:self.free]
        return (own * np.sqrt(self.population), own / np.sqrt(np.diag(prior)[:self.free]),
                float(chi2.sf(squared, int(kept.sum()))))


class _Series(NamedTuple):
    """Evidence in one series: log Bayes factors, nats, sizes of the change and their 1σ, by course and begin."""

    nats: Array
    mean: Array
    sd: Array


def _regression(design: Array, variances: Array, values: Array, sessions: float = 16.0
                ) -> tuple[Array, Array, Array]:
    """Return log evidence, and mean and 1σ of the last coefficient, of designs of shape (designs, rows, columns).

    values = X·β + ε, ε ~ N(0, σ²), β ~ N(0, σ² V), ν₀/σ² ~ χ²(ν₀).  `variances`: diagonal of V.  `sessions`: ν₀, weight
    of a scatter of 1.  If it is too large, a bench that scatters more than published alarms; if it is too small, a
    small change is stated later.
    """
    # ln p = −½ ln det(I + XVXᵀ) − ½ (ν₀ + n) ln(ν₀ + yᵀ(I + XVXᵀ)⁻¹y), up to a constant of the values
    precision = np.diag(1.0 / variances) + design.transpose(0, 2, 1) @ design
    covariance = np.linalg.inv(precision)
    pull = np.einsum("dnc,n->dc", design, values)
    mean = np.einsum("dce,de->dc", covariance, pull)
    squared = sessions + values @ values - np.einsum("dc,dc->d", pull, mean)
    weight = sessions + values.size
    nats = -0.5 * (np.linalg.slogdet(precision)[1] + np.log(variances).sum() + weight * np.log(squared))
    return nats, mean[:, -1], np.sqrt(squared / weight * covariance[:, -1, -1])


def _basis(squares: Sequence[Array], free: int, size: int, least: float = 0.5) -> Array:
    """Return the basis of constants, of the discrepancy as far as the reference sessions determine it, and of effects.

    A direction of the discrepancy about which they have less than `least` of the prior's information stays at its mean:
    it changes no evidence by more than 0.2 nats, and without it a search is six times as fast.
    """
    lengths, axes = np.linalg.eigh(np.sum(squares, axis=0)[free:size, free:size])
    kept = axes[:, lengths >= least]
    total = squares[0].shape[0]
    out = np.zeros((total, free + kept.shape[1] + total - size))
    out[:free, :free] = np.eye(free)
    out[free:size, free:free + kept.shape[1]] = kept
    out[size:, free + kept.shape[1]:] = np.eye(total - size)
    return out
