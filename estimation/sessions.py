"""Sessions of one bench under one reference posterior: scatter between sessions, and evidence of a step or a ramp.

With s a session, x_s its departure from the posterior's mean and a the sizes of an effect, all with a Gaussian prior:

    e_s = H_s x_s + E_s (a₀ + w_s a + α_s) + ε_s        x_s = b + R_s r + w_s h c + δ_s
    b ~ N(0, population),  δ_s ~ N(0, D),  a₀, a ~ N(0, 1)
    r: offset of constants that maintenance reset, and a departure like c of all of them; R_s = 1 after it

w_s: 0 before the change; from its first session on 1 (step), or rising to 1 at the newest session (ramp).  a₀ is the
size of the effect in all sessions: what the model's equations miss in each of them alike is no change.  c ~ N(0, D₀),
D₀ the published D: what the effect's equation misses of the change departs alike in each changed session.  h is 0 or 1
with equal weights.  α_s ~ N(0, `SURROGATE`²) is the scatter of the effects that no constant of a session follows; it is
kept in δ_s below.  δ_s is integrated out of the sums T of a session (`linear_sums`) with K = (D⁻¹ + A)⁻¹, A = HᵀWH:

    S = T − T_H K T_Hᵀ,  g = t − T_H K HᵀWe        information about (b, r, c, a₀, a), and its pull

The covariance D of the constants between sessions is estimated by expectation maximisation with and without the change,
under an inverse-Wishart prior about variances v that have an inverse-gamma prior about the published ones (hierarchy of
Huang and Wand 2013).  On a bench of another structure the constants scatter together, and one of them more than
published; but a change does not hide in a scatter that it has itself enlarged.
The order in which sessions were entered has no influence.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import logsumexp
from scipy.stats import chi2

from estimation.linear_sums import EffectColumns, SessionSums, Sums
from estimation.posterior import SURROGATE
from estimation.reference_fit import ReferenceFit
from physics.laws import Array

COURSES: Final = ("step", "ramp")


class Change(NamedTuple):
    """A change of the bench: log Bayes factor, nats, course, row of its first session with the 95 % interval of rows.

    `sizes`: of the effect along its directions, in prior σ, at the newest session, with their 1σ.  `part`: its columns.
    """

    effect: str
    nats: float
    course: str
    since: int
    since_low: int
    since_high: int
    sizes: Array
    sizes_sd: Array
    part: EffectColumns


class Reset(NamedTuple):
    """Maintenance: row of a free constant, and the number of sessions before it."""

    constant: int
    before: int


@dataclass(frozen=True)
class _IntegratedSessions:
    """Sessions with their deviations integrated out: S, g, K of each, and the log likelihood's constant part, nats.

    Rows of S and g: b, r, then the effect columns.
    """

    square: Array
    pull: Array
    inner: Array
    constant: float


class _Information(NamedTuple):
    """Information about (a₀, a) of all effects and its pull; `nats`: log evidence after (b, r, c) are integrated out.
    """

    nats: float
    square: Array
    pull: Array


class _Evidence(NamedTuple):
    """Log evidence, nats, of one variant: without a change, shape (), and with it, shape (h, course and begin).

    `sizes`: of the effect and their 1σ with each, shape (h, course and begin, directions).
    """

    none: float
    changed: Array
    sizes: Array
    sizes_sd: Array


class SessionSequence:
    """Sessions of one bench in the order of their dates.

    `fit`: the reference posterior.  `references`: number of sessions from the first on in which no change begins.
    """

    def __init__(self, fit: ReferenceFit, columns: Sequence[EffectColumns], sessions: Sequence[SessionSums],
                 references: int, resets: Sequence[Reset] = (), scatter_sessions: float = 30.0) -> None:
        """Store the sessions; `scatter_sessions`: weight of the published variance of a constant, in sessions.

        If it is too small, an enlarged scatter explains a change; if it is too large, benches that scatter more than
        published alarm.  Of 20 benches without a change, after 14 to 20 sessions, one reaches 12.5 nats with 60 and
        none more than 5.9 with 30; with 10, a stiffness of -12 % has 5 nats less than with 30.
        """
        self.fit, self.columns, self.resets, self.references = fit, columns, tuple(resets), references
        table = fit.model.constants
        self.free, self.count = len(table.free), len(sessions)
        # the least whole weight of a proper inverse-Wishart prior whose mode is diag(v)
        self.scatter_sessions, self.weight = scatter_sessions, 2.0 * self.free + 1.0
        deviation = np.diag(fit.prior.covariance - fit.bench.covariance)
        self.published = deviation[:self.free]
        self.population = table.bench_sd[list(table.free)] ** 2
        amplitude = deviation[self.free:] / fit.model.session_share**2
        unit = np.sqrt(np.concatenate([self.population, amplitude, np.ones(columns[-1].at.stop)]))
        self.basis = _basis([one.sums.square * unit[:, None] * unit for one in sessions[:max(references, 1)]],
                            self.free, unit.size - columns[-1].at.stop) * unit[:, None]
        self.size = self.basis.shape[1] - columns[-1].at.stop
        # 1σ of c: the published scatter between sessions
        self.offset = np.full(self.size, fit.model.session_share)
        self.offset[:self.free] = np.sqrt(self.published / self.population)
        self.known = self.size + self._maintained(0).shape[1]
        self.growth = [self._growth(one.growth) for one in sessions]
        self.sums = [self._reduced(one, row) for row, one in enumerate(sessions)]
        loose = [self.known + k for part in columns if not self._followed(part)
                 for k in range(part.at.start, part.at.stop)]
        # rows of δ_s among those of the sums (b, r, effects)
        self.scattered = np.array([*range(self.size), *loose])

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
        common = [float(row >= before) * np.diag(self.offset) for before in sorted({one.before for one in self.resets})]
        return np.concatenate([reset, *common], axis=1)

    def _growth(self, growth: Array) -> Array:
        """Return the growth of a session's deviation in the reduced basis."""
        of = self.basis[self.free:growth.size, self.free:self.size]
        return np.concatenate([growth[:self.free],
                               (of**2 * growth[self.free:, None]).sum(axis=0) / (of**2).sum(axis=0)])

    def _followed(self, part: EffectColumns) -> bool:
        """Return whether an effect is a departure of constants of a session, so that it scatters as they do.

        Without a scatter of all others three of eleven benches without a change reach 6.4 to 12.1 nats.
        """
        table = self.fit.model.constants
        followed = {table.names[i] for i in table.free}
        return not part.variant.at and {n for d in part.variant.directions for n in d.along} <= followed

    def until(self, row: int) -> "SessionSequence":
        """Return the sequence of the sessions before `row`."""
        earlier = copy(self)
        earlier.sums, earlier.growth, earlier.count = self.sums[:row], self.growth[:row], row
        return earlier

    # -- scatter between sessions ------------------------------------------------------------------------------------

    def integrated(self, covariance: Array) -> _IntegratedSessions:
        """Return the sessions with deviations of a `covariance` of the free constants, in coordinates, integrated out.
        """
        rows, deviation = self.scattered, self._deviation(covariance)
        squares, pulls, inners, constant = [], [], [], 0.0
        for sums, growth in zip(self.sums, self.growth, strict=True):
            grown = np.sqrt(np.pad(growth, (0, rows.size - self.size), constant_values=1.0))
            root = np.linalg.cholesky(grown[:, None] * deviation * grown)
            factor = cho_factor(np.eye(rows.size) + root.T @ sums.square[np.ix_(rows, rows)] @ root)
            inner = root @ cho_solve(factor, root.T)
            across = sums.square[:, rows]
            squares.append(sums.square - across @ inner @ across.T)
            pulls.append(sums.pull - across @ (inner @ sums.pull[rows]))
            inners.append(inner)
            constant += 0.5 * float(sums.pull[rows] @ inner @ sums.pull[rows])
            constant -= float(np.log(np.diag(factor[0])).sum())
        # log density of the prior of D and v, but for terms that neither changes
        v, inverse = self._scale(covariance), np.linalg.inv(covariance)
        share = v / self.published
        prior = -0.5 * self.weight * float(np.linalg.slogdet(covariance)[1] + np.sum(v * np.diag(inverse) - np.log(v)))
        prior -= 0.5 * self.scatter_sessions * float(np.sum(np.log(share) + 1.0 / share))
        return _IntegratedSessions(np.array(squares), np.array(pulls), np.array(inners), constant + prior)

    def _deviation(self, covariance: Array) -> Array:
        """Return the covariance of δ_s: constants and discrepancy in units of the population's σ, sizes of effects."""
        further = np.full(self.scattered.size - self.free, SURROGATE**2)
        further[:self.size - self.free] = self.fit.model.session_share**2
        return np.asarray(block_diag(covariance / np.sqrt(np.outer(self.population, self.population)),
                                     np.diag(further)))

    def design(self, part: EffectColumns | None = None, weight: float = 0.0) -> Array:
        """Return the columns of (b, r), and with an effect of (c, a₀, a), among those of a session's sums."""
        every, known = np.eye(self.sums[0].pull.size), self.known
        if part is None:
            return every[:, :known]
        own = every[:, known + part.at.start:known + part.at.stop]
        return np.concatenate([every[:, :known], weight * every[:, :self.size] * self.offset, own, weight * own],
                              axis=1)

    def scatter(self, change: Change | None = None, rounds: int = 12) -> Array:
        """Return the covariance of the free constants between sessions, by expectation maximisation given a change.

        The deviations change by less than 2 % after so many `rounds`.
        """
        free, unit = self.free, np.sqrt(np.outer(self.population, self.population))
        v, designs = self.published, self._designs(change)
        covariance = np.diag(v)
        for _ in range(rounds):
            sessions = self.integrated(covariance)
            of, mean = _solved(designs, sessions)
            total = np.zeros((free, free))
            for u, sums, inner in zip(designs, self.sums, sessions.inner, strict=True):
                # E step: mean and covariance of the session's deviation, with the uncertainty of (b, r, c, a₀, a)
                carried = inner[:free] @ (sums.square[self.scattered] @ u)
                deviation = inner[:free] @ sums.pull[self.scattered] - carried @ mean
                total += np.outer(deviation, deviation) + inner[:free, :free] + carried @ of @ carried.T
            # M step of D given v, then of v given D
            covariance = (self.weight * np.diag(v) + total * unit) / (self.weight + self.count)
            v = self._scale(covariance)
        return np.asarray(covariance)

    def _scale(self, covariance: Array) -> Array:
        """Return the v of largest density given D: the root of d/dv of ν (ln v − v (D⁻¹)ₖₖ) − n (ln v + v₀/v)."""
        inverse, less = np.diag(np.linalg.inv(covariance)), self.weight - self.scatter_sessions
        root = np.sqrt(less**2 + 4.0 * self.weight * self.scatter_sessions * inverse * self.published)
        return np.asarray((less + root) / (2.0 * self.weight * inverse))

    def _designs(self, change: Change | None) -> list[Array]:
        if change is None:
            return [self.design()] * self.count
        return [self.design(change.part, w) for w in self.weights_of(change)]

    # -- changes -----------------------------------------------------------------------------------------------------

    @property
    def begins(self) -> NDArray[np.intp]:
        """Rows of the sessions in which a change can begin."""
        return np.arange(max(self.references, 1), self.count)

    def weights(self) -> dict[str, Array]:
        """Return the share 0 … 1 of a change in each session, by its course; shape (begins, sessions)."""
        row = np.arange(self.count)
        begins = self.begins[:, None]
        return {"step": (row >= begins).astype(float),
                "ramp": np.clip((row - begins + 1) / np.maximum(self.count - begins, 1), 0.0, 1.0)}

    def weights_of(self, change: Change) -> Array:
        """Return the share 0 … 1 of a change in each session, shape (sessions,)."""
        return np.asarray(self.weights()[change.course][change.since - self.begins[0]])

    def search(self) -> tuple[list[Change], Array]:
        """Return the changes, best first, one an effect, and the covariance of the free constants between sessions.

        Evidence of a change against that of no change, each with the scatter of the constants that it supports best.
        """
        plain = self.scatter()
        if not self.begins.size:
            return [], plain
        offered = [plain, np.diag(self.published)]
        found = [self._evidence(each) for each in offered]
        changes = self._changes(found)
        offered.append(self.scatter(changes[0]))
        found.append(self._evidence(offered[-1]))
        changes = self._changes(found)
        best = max(range(len(found)), key=lambda k: max(float(of.changed.max()) for of in found[k]))
        return changes, offered[best]

    def _evidence(self, covariance: Array) -> list[_Evidence]:
        """Return the log evidence of each variant with deviations of a `covariance` of the free constants."""
        sessions, weights = self.integrated(covariance), np.concatenate(list(self.weights().values()))
        known = [self._known(sessions, w, h) for h in (0.0, 1.0) for w in weights]
        nats = np.array([each.nats for each in known]) + sessions.constant
        effects, found = self.columns[-1].at.stop, []
        for part in self.columns:
            row = np.arange(part.at.start, part.at.stop)
            row = np.concatenate([row, effects + row])
            found.append(_variant(np.array([each.square[np.ix_(row, row)] for each in known]),
                                  np.array([each.pull[row] for each in known]), nats, (2, len(weights))))
        return found

    def _known(self, sessions: _IntegratedSessions, w: Array, h: float) -> _Information:
        """Return the information about (a₀, a) of all effects after (b, r, c) are integrated out.

        `w`: share of the change in each session.
        """
        base, effects = self.known, slice(self.known, None)
        c = slice(0, self.size if h else 0)
        scale = h * self.offset[c]
        always, always_pull = sessions.square.sum(axis=0), sessions.pull.sum(axis=0)
        once, once_pull, twice = np.tensordot(w, sessions.square, 1), w @ sessions.pull, np.tensordot(
            w**2, sessions.square, 1)
        inside = np.block([[always[:base, :base], once[:base, c] * scale],
                           [scale[:, None] * once[c, :base], scale[:, None] * twice[c, c] * scale]])
        between = np.block([[always[:base, effects], once[:base, effects]],
                            [scale[:, None] * once[c, effects], scale[:, None] * twice[c, effects]]])
        pull = np.concatenate([always_pull[:base], scale * once_pull[c]])
        factor = cho_factor(np.eye(pull.size) + inside)
        carried = cho_solve(factor, np.column_stack([pull, between]))
        square = np.block([[always[effects, effects], once[effects, effects]],
                           [once[effects, effects], twice[effects, effects]]])
        return _Information(0.5 * float(pull @ carried[:, 0]) - float(np.log(np.diag(factor[0])).sum()),
                            square - between.T @ carried[:, 1:],
                            np.concatenate([always_pull[effects], once_pull[effects]]) - between.T @ carried[:, 0])

    def _changes(self, found: Sequence[Sequence[_Evidence]]) -> list[Change]:
        """Return the best variant of each effect, best first; `found`: evidence by covariance and variant."""
        none: dict[str, float] = {}
        for of in found:
            for part, one in zip(self.columns, of, strict=True):
                none[part.effect] = max(one.none, none.get(part.effect, -np.inf))
        best: dict[str, Change] = {}
        for k, part in enumerate(self.columns):
            offered = [of[k] for of in found]
            every = np.max([one.changed for one in offered], axis=0)
            nats = float(logsumexp(every)) - float(np.log(every.size)) - none[part.effect]
            if part.effect not in best or nats > best[part.effect].nats:
                likeliest = max(offered, key=lambda one: float(one.changed.max()))
                best[part.effect] = self._change(part, nats, every, likeliest)
        return sorted(best.values(), key=lambda change: -change.nats)

    def _change(self, part: EffectColumns, nats: float, every: Array, found: _Evidence) -> Change:
        """Return a change with its likeliest course and begin, and the 95 % interval of its begin."""
        begins = self.begins
        share = np.exp(every - logsumexp(every)).sum(axis=0)
        summed = np.cumsum(share.reshape(len(COURSES), -1).sum(axis=0))
        low, high = (int(np.searchsorted(summed, q)) for q in (0.025, 0.975))
        at = int(share.argmax())
        h = int(found.changed[:, at].argmax())
        return Change(part.effect, nats, COURSES[at // begins.size], int(begins[at % begins.size]), int(begins[low]),
                      int(begins[min(high, begins.size - 1)]), found.sizes[h, at], found.sizes_sd[h, at], part)

    # -- constants ---------------------------------------------------------------------------------------------------

    def moved(self, change: Change) -> tuple[Array, Array]:
        """Return departure of the free constants by a change at the newest session and its 1σ, in coordinates."""
        table = self.fit.model.constants
        out, square = np.zeros(self.free), np.zeros(self.free)
        for direction, size, sd in zip(change.part.variant.directions, change.sizes, change.sizes_sd, strict=True):
            for name, share in direction.along.items():
                if table.index[name] in table.free:
                    k = table.free.index(table.index[name])
                    out[k] += share * direction.sd * size
                    square[k] += (share * direction.sd * sd) ** 2
        return out, np.sqrt(square)

    def constants(self, covariance: Array, change: Change | None = None) -> tuple[Array, Array]:
        """Return each session's free constants and their 1σ, departures from the reference, shape (sessions, free)."""
        sessions, designs = self.integrated(covariance), self._designs(change)
        weights = np.zeros(self.count) if change is None else self.weights_of(change)
        known, mean = _solved(designs, sessions)
        of, unit = np.zeros(self.free) if change is None else self.moved(change)[0], np.sqrt(self.population)
        means, sds = [], []
        for u, w, sums, inner in zip(designs, weights, self.sums, sessions.inner, strict=True):
            carried = inner[:self.free] @ (sums.square[self.scattered] @ u)
            whole = u[:self.free] - carried
            means.append((u[:self.free] @ mean + inner[:self.free] @ sums.pull[self.scattered] - carried @ mean) * unit
                         + w * of)
            sds.append(np.sqrt(np.diag(inner)[:self.free] + np.sum((whole @ known) * whole, axis=1)) * unit)
        return np.array(means), np.array(sds)

    def departure(self, session: SessionSums, covariance: Array) -> tuple[Array, Array, float]:
        """Return how far a further session is from the bench: its constants' departure, that over the scatter, and the
        probability that a session in the reference condition departs as far in all constants together."""
        known, mean = _solved(self._designs(None), self.integrated(covariance))
        last = np.concatenate([np.eye(self.size), self._maintained(self.count)], axis=1)
        sums, bench, growth = self._reduced(session, self.count), last @ mean, np.sqrt(self._growth(session.growth))
        deviation = self._deviation(covariance)[:self.size, :self.size]
        prior = last @ known @ last.T + growth[:, None] * deviation * growth
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


def _solved(designs: Sequence[Array], sessions: _IntegratedSessions) -> tuple[Array, Array]:
    """Return covariance and mean of the parameters of `designs`, with a prior of N(0, 1)."""
    precision, pull = np.eye(designs[0].shape[1]), np.zeros(designs[0].shape[1])
    for u, square, g in zip(designs, sessions.square, sessions.pull, strict=True):
        precision, pull = precision + u.T @ square @ u, pull + u.T @ g
    covariance: Array = np.asarray(np.linalg.inv(precision), np.float64)
    return covariance, covariance @ pull


def _variant(blocks: Array, pulls: Array, base: Array, shape: tuple[int, int]) -> _Evidence:
    """Return the evidence of one variant from the information about (a₀, a) and its pull with each h, course and begin.

    `base`: log evidence of (b, r, c) alone; the first is that without c.
    """
    half = pulls.shape[1] // 2
    precision = np.eye(2 * half) + blocks
    covariance = np.linalg.inv(precision)
    sizes = np.einsum("wab,wb->wa", covariance, pulls)
    nats = 0.5 * np.einsum("wa,wa->w", pulls, sizes) - 0.5 * np.linalg.slogdet(precision)[1]
    # without a change: a₀ alone, without c
    none = precision[0, :half, :half]
    alone = 0.5 * pulls[0, :half] @ np.linalg.solve(none, pulls[0, :half]) - 0.5 * np.linalg.slogdet(none)[1]
    sds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, half:])
    return _Evidence(float(base[0] + alone), (base + nats).reshape(shape), sizes[:, half:].reshape(*shape, half),
                     sds.reshape(*shape, half))


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
