"""Changes of a bench over sessions: evidence of a step or a ramp of each effect, since when, and a forecast.

An effect with direction e, prior σ_a and course w_s adds w_s·e·a to session s.  Step: w_s is 0 before a session and 1
from it; ramp: w_s rises from 0 to 1 at the newest session.  With a ~ N(0, σ_a²) and the bench integrated out

    g = Σ w_s eᵀh_s − kᵀP⁻¹H,  G = Σ w_s² eᵀM_s e − kᵀP⁻¹k,  k = Σ w_s X_sᵀM_s e       (P, H: of bench and resets)
    ln B = ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G)            averaged over the course and the session that it begins in
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from logbook.session_model import CONSTANTS, SessionModel
from physics.effects.hypotheses import HYPOTHESES
from physics.laws import Array
from physics.path_constants import FREE, SESSION_SD, TABLE, coordinates_of, named, values

ALARM_NATS: Final = 8.0
"""Log Bayes factor from which a change is an alarm: `python -m benchmarks.logbook --alarms` prints the rate that it
gives on simulated benches without a change. If it is too small, such benches alarm; if it is too large, a drift is
reported some sessions later."""
SET_SHARE: Final = 0.5
"""Share of the best log Bayes factor from which an effect is in the ambiguity set, as in a single diagnosis."""
COURSES: Final = ("step", "ramp")
OTHER_SD: Final = 6.0
"""1σ of a change of a constant that no effect of the catalogue moves, in published session deviations."""
LEAST_SESSIONS: Final = 3
"""Sessions before a change can be detected."""


class ChangeCandidate(NamedTuple):
    """A candidate for a change: name, whether it is of the catalogue, columns e·σ_a, shape (constants, sizes)."""

    name: str
    known: bool
    columns: Array


class Change(NamedTuple):
    """A change: log Bayes factor in nats, its course, first session with its 95 % interval, departures in q."""

    name: str
    known: bool
    nats: float
    course: str
    since: int
    since_low: int
    since_high: int
    departure: Array
    departure_sd: Array


class Forecast(NamedTuple):
    """Sessions from now until a constant reaches a limit: middle and 95 % interval; None: not within the data."""

    constant: str
    limit: float
    sessions: float | None
    low: float | None
    high: float | None


def candidates(bench_q: Array) -> list[ChangeCandidate]:
    """Return candidate changes of a bench with coordinates `bench_q`, shape (len(TABLE),)."""
    constants = named(bench_q)
    place = {i: k for k, i in enumerate(FREE)}
    index = {TABLE[i].name: place[i] for i in FREE}
    found, moved = [], set()
    for name, hypothesis in HYPOTHESES.items():
        for variant in hypothesis.variants(constants):
            columns = []
            for direction in variant.directions:
                along = np.zeros(len(FREE))
                for constant, share in direction.along.items():
                    if constant in index:
                        along[index[constant]] = direction.sd * share
                        moved.add(constant)
                if along.any():
                    columns.append(along)
            if columns and not variant.at:
                found.append(ChangeCandidate(name, True, np.stack(columns, axis=1)))
    if "creep" in index:
        along = np.zeros((len(FREE), 1))
        along[index["creep"], 0] = 3e-5
        found.append(ChangeCandidate("fabric_creep", True, along))
        moved.add("creep")
    for name, k in index.items():
        if name not in moved:
            along = np.zeros((len(FREE), 1))
            along[k, 0] = OTHER_SD * SESSION_SD[FREE[k]]
            found.append(ChangeCandidate(name, False, along))
    return found


def search_changes(model: SessionModel, bench_q: Array) -> list[Change]:
    """Return the candidates by falling evidence; an empty list with fewer than `LEAST_SESSIONS` sessions."""
    if len(model.sessions) < LEAST_SESSIONS:
        return []
    best: dict[str, Change] = {}
    with threadpool_limits(1, user_api="blas"):
        search = _Search(model)
        for direction in candidates(bench_q):
            change = search.of(direction)
            if direction.name not in best or change.nats > best[direction.name].nats:
                best[direction.name] = change
    return sorted(best.values(), key=lambda change: -change.nats)


def alarms(changes: list[Change]) -> list[Change]:
    """Return the ambiguity set of the best change, best first; empty where it is below `ALARM_NATS`."""
    if not changes or changes[0].nats < ALARM_NATS:
        return []
    return [c for c in changes if c.nats >= SET_SHARE * changes[0].nats]


class _Search:
    """Sums over sessions that every candidate needs."""

    def __init__(self, model: SessionModel) -> None:
        self.model = model
        count = len(model.sessions)
        designs = [model.design(k) for k in range(count)]
        precision = model.prior() + sum(x.T @ m @ x for x, m in zip(designs, model.information, strict=True))
        self.pull = np.sum([x.T @ h for x, h in zip(designs, model.pull, strict=True)], axis=0)
        self.covariance = np.linalg.inv(precision)
        self.mean = self.covariance @ self.pull
        begins = np.arange(1, count)
        row = np.arange(count)
        step = (row >= begins[:, None]).astype(float)
        span = np.maximum(count - begins, 1)[:, None]
        ramp = np.clip((row - begins[:, None] + 1) / span, 0.0, 1.0)
        self.begins, self.weights = begins, {"step": step, "ramp": ramp}
        self.cross = np.stack([x.T @ m for x, m in zip(designs, model.information, strict=True)])

    def of(self, direction: ChangeCandidate) -> Change:
        """Return the evidence of one candidate, averaged over course and begin, with the likeliest of both."""
        e = direction.columns
        h = self.model.pull @ e
        m = np.einsum("ia,sij,jb->sab", e, self.model.information, e)
        k = np.einsum("spi,ia->spa", self.cross, e)
        nats, sizes, inners = [], [], []
        for course in COURSES:
            w = self.weights[course]
            kk = np.einsum("ws,spa->wpa", w, k)
            inner = np.eye(e.shape[1]) + np.einsum("ws,sab->wab", w**2, m) - np.einsum(
                "wpa,wpb->wab", kk, np.einsum("pq,wqb->wpb", self.covariance, kk))
            g = w @ h - np.einsum("wpa,p->wa", kk, self.mean)
            size = np.linalg.solve(inner, g[:, :, None])[:, :, 0]
            nats.append(0.5 * np.einsum("wa,wa->w", g, size) - 0.5 * np.linalg.slogdet(inner)[1])
            sizes.append(size)
            inners.append(inner)
        every = np.concatenate(nats)
        total = float(logsumexp(every) - np.log(every.size))
        at = int(every.argmax())
        share = np.exp(every - logsumexp(every)).reshape(len(COURSES), -1).sum(axis=0)
        summed = np.cumsum(share)
        low, high = (int(np.searchsorted(summed, q)) for q in (0.025, 0.975))
        session = self.model.sessions
        begin = at % self.begins.size
        sd = np.sqrt(np.einsum("ia,ab,ib->i", e, np.linalg.inv(np.concatenate(inners)[at]), e))
        return Change(direction.name, direction.known, total, COURSES[at // self.begins.size],
                      session[self.begins[begin]], session[self.begins[low]],
                      session[self.begins[min(high, self.begins.size - 1)]], e @ np.concatenate(sizes)[at], sd)


def forecast(model: SessionModel, bench_q: Array, change: Change, limits: Mapping[str, float]) -> list[Forecast]:
    """Return when each constant with a limit reaches it, by its slope since the change began."""
    numbers = np.array(model.sessions)
    since = int(np.searchsorted(numbers, change.since))
    found = []
    for constant, limit in limits.items():
        k = CONSTANTS.index(constant)
        row = FREE[k]
        if numbers.size - since < LEAST_TREND:
            found.append(Forecast(constant, limit, None, None, None))
            continue
        middle, spread = _trend(model, k, since)
        at_limit = values(bench_q)
        at_limit[row] = limit
        goal = coordinates_of(at_limit)[row] - bench_q[row]
        draws = np.random.default_rng(0).multivariate_normal(middle, spread, size=4000)
        left, pace = goal - draws[:, 0], draws[:, 1]
        ahead = np.where(left * pace > 0.0, left / np.where(pace == 0.0, 1e-300, pace), NEVER)
        low, middle_, high = (float(v) for v in np.quantile(np.minimum(ahead, NEVER), (0.025, 0.5, 0.975)))
        found.append(Forecast(constant, limit, *(v if v < NEVER else None for v in (middle_, low, high))))
    return found


NEVER: Final = 1e6
"""Sessions ahead beyond which no forecast is given."""
LEAST_TREND: Final = 4
"""Sessions since a change began from which a slope is estimated."""


def _trend(model: SessionModel, constant: int, since: int) -> tuple[Array, Array]:
    """Return a constant's present departure from the reference model and its slope per session, with covariance.

    Generalised least squares of bench, resets, and for this constant a step at session row `since` and a line from it.
    """
    count, size = len(model.sessions), len(CONSTANTS)
    first = model.design(0).shape[1]
    prior = np.zeros((first + 2, first + 2))
    prior[:first, :first] = model.prior()
    prior[first:, first:] = np.diag([TREND_SD**-2.0] * 2) / SESSION_SD[FREE[constant]] ** 2
    precision, pull = prior, np.zeros(first + 2)
    for row in range(count):
        x = np.zeros((size, first + 2))
        x[:, :first] = model.design(row)
        if row >= since:
            x[constant, first:] = 1.0, row - since
        precision = precision + x.T @ model.information[row] @ x
        pull = pull + x.T @ model.pull[row]
    covariance = np.linalg.inv(precision)
    last = np.zeros((2, first + 2))
    last[0, :first] = model.design(count - 1)[constant]
    last[0, first:] = 1.0, count - 1 - since
    last[1, first + 1] = 1.0
    return np.asarray(last @ covariance @ pull), np.asarray(last @ covariance @ last.T)


TREND_SD: Final = 20.0
"""1σ of a step and of a slope per session before any session, in published session deviations: wide."""


def shift_of(model: SessionModel, change: Change) -> Array:
    """Return the departure of each session from the bench by a change, shape (sessions, constants)."""
    row = np.arange(len(model.sessions))
    begin = int(np.searchsorted(np.array(model.sessions), change.since))
    step = (row >= begin).astype(float)
    ramp = np.clip((row - begin + 1) / max(row.size - begin, 1), 0.0, 1.0)
    return np.asarray((step if change.course == "step" else ramp)[:, None] * change.departure)
