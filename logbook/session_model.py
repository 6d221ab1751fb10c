"""Bench constants over many sessions: one linear Gaussian model, and the session variance measured from it.

Equations, with s a session, all coordinates relative to the reference model:

    y_s = q_s + ε_s, information Λ_s of the session's trials        q_s = b + R_s r + δ_s,  δ_s ~ N(0, diag(σ²))
    b ~ N(0, bench_sd²)      r: offset of constants that maintenance reset, R_s = 1 after it, r ~ N(0, bench_sd²)

σ is estimated from the reference sessions by expectation maximisation under an inverse-gamma prior about the published
session deviations, which weighs as much as `PRIOR_SESSIONS` sessions.  A session that agrees with neither the session
before it nor the one after it weighs less (`agreeing`): the fit of a trial can end at a poor local minimum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from logbook.database import Note, StoredEstimate
from physics.laws import Array
from physics.path_constants import BENCH_SD, FREE, NAMES, SESSION_SD

CONSTANTS: Final = tuple(NAMES[i] for i in FREE)
"""Names of the constants that a session estimates."""
PRIOR_SESSIONS: Final = 3.0
"""Weight of the published session deviations, in sessions: with less, ten sessions underestimate a variance."""
ROUNDS: Final = 40
"""Steps of expectation maximisation: the deviations change by less than 1 % afterwards."""
PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "cable": ("cable", "bend", "load", "viscous", "dry", "cable_travel", "cable_rest", "rest_speed", "memory", "lead",
              "before", "zero"),
    "fabric": ("fabric", "wrap", "fabric_travel", "fabric_rest", "stiffness", "curve2", "curve3", "before", "prompt",
               "slow", "creep", "creep_time", "zero"),
    "knee": ("play", "gap", "arm", "arm2", "arm3", "zero"),
    "start": ("start_gain", "start_offset", "start_lag"),
    "end": ("end_gain", "end_offset", "end_lag"),
    "drive": ("drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset", "drive_asymmetry",
              "drive_viscous_asymmetry", "drive_travel", "demand_gain", "zero"),
}
"""Constants that maintenance of a part of the bench changes."""


class SessionData(NamedTuple):
    """Information matrix Λ of one session about the constants, and Λ·y."""

    id: int
    information: Array
    pull: Array


@dataclass(frozen=True)
class SessionModel:
    """All sessions under one model: `sd`: 1σ between sessions; `reset`: constants and last session before each reset.

    `information` M_s = (Λ_s⁻¹ + diag σ²)⁻¹ and `pull` of each session; `sessions` their numbers.
    """

    sessions: tuple[int, ...]
    information: Array
    pull: Array
    sd: Array
    reset: tuple[tuple[int, int], ...]
    data: tuple[SessionData, ...]

    def design(self, at: int) -> Array:
        """Return X of the session in row `at`: its mean is X·(b, r)."""
        size = len(CONSTANTS)
        out = np.zeros((size, size + len(self.reset)))
        out[:, :size] = np.eye(size)
        for k, (constant, after) in enumerate(self.reset):
            out[constant, size + k] = float(self.sessions[at] > after)
        return out

    def prior(self) -> Array:
        """Return the precision of (b, r) before any session."""
        sd = BENCH_SD[list(FREE)]
        return np.diag(np.concatenate([sd, [sd[c] for c, _ in self.reset]]) ** -2.0)

    def smoothed(self, moved: Array | None = None) -> tuple[Array, Array]:
        """Return each session's constants and their 1σ given that session and the bench, shape (sessions, q).

        `moved`: departure of each session from the bench by a change, same shape; without it a change is shrunk.
        """
        shift = np.zeros_like(self.pull) if moved is None else moved
        precision, pull = self.prior(), np.zeros(len(CONSTANTS) + len(self.reset))
        designs = [self.design(k) for k in range(len(self.sessions))]
        for x, m, h, by in zip(designs, self.information, self.pull, shift, strict=True):
            precision = precision + x.T @ m @ x
            pull = pull + x.T @ (h - m @ by)
        covariance = np.linalg.inv(precision)
        bench = covariance @ pull
        means, sds = [], []
        for x, one, by in zip(designs, self.data, shift, strict=True):
            inner = np.linalg.inv(one.information + np.diag(self.sd**-2.0))
            means.append(inner @ (one.pull + (x @ bench + by) / self.sd**2))
            sds.append(np.sqrt(np.diag(inner)))
        return np.array(means), np.array(sds)


class SessionDeparture(NamedTuple):
    """Departure of a session from the bench: its constants and that over the scatter of sessions; `probability` that a
    healthy session departs as far."""

    departure: Array
    scatters: Array
    probability: float


def departure_of(model: SessionModel, session: SessionData) -> SessionDeparture:
    """Return the distance of a further session, outside the model's, from the bench."""
    last = model.design(len(model.sessions) - 1)
    precision, pull = model.prior(), np.zeros(len(CONSTANTS) + len(model.reset))
    for k, (m, h) in enumerate(zip(model.information, model.pull, strict=True)):
        x = model.design(k)
        precision, pull = precision + x.T @ m @ x, pull + x.T @ h
    covariance = np.linalg.inv(precision)
    bench = last @ covariance @ pull
    prior = np.diag(model.sd**2) + last @ covariance @ last.T
    inner = np.linalg.inv(session.information + np.linalg.inv(prior))
    residual = session.pull - session.information @ bench
    departure = inner @ residual
    lengths, axes = np.linalg.eigh(session.information + session.information @ prior @ session.information)
    kept = lengths > 1e-9 * lengths[-1]
    squared = float(np.sum((axes[:, kept].T @ residual) ** 2 / lengths[kept]))
    return SessionDeparture(departure, departure / np.sqrt(np.diag(prior)), float(chi2.sf(squared, int(kept.sum()))))


def sessions_of(stored: Sequence[StoredEstimate]) -> list[SessionData]:
    """Return the sessions of stored estimates: the information of a session's trials adds up."""
    found: dict[int, SessionData] = {}
    for one in stored:
        mean, covariance, prior_sd, _ = one.estimate
        precision: Array = np.asarray(np.linalg.inv(covariance), np.float64)
        information = _positive(np.asarray(precision - np.diag(prior_sd**-2.0), np.float64))
        pull = precision @ mean
        before = found.get(one.session)
        found[one.session] = SessionData(one.session, information, pull) if before is None else SessionData(
            one.session, before.information + information, before.pull + pull)
    return [found[number] for number in sorted(found)]


def fit_sessions(sessions: Sequence[SessionData], notes: Sequence[Note], references: int) -> SessionModel:
    """Fit sessions and the session deviations of the first `references` of them."""
    first = sessions[0].id if sessions else 0
    reset = tuple(sorted({(CONSTANTS.index(name), note.after) for note in notes for name in note.resets
                          if name in CONSTANTS and note.after >= first}))
    with threadpool_limits(1, user_api="blas"):
        sessions = agreeing(sessions, measured_sd(sessions[:references]))
        sd = measured_sd(sessions[:references])
        spread = [_with_deviation(one, sd) for one in sessions]
    size = len(CONSTANTS)
    return SessionModel(
        tuple(one.id for one in sessions), np.array([m for m, _ in spread]).reshape(-1, size, size),
        np.array([h for _, h in spread]).reshape(-1, size), sd, reset, tuple(sessions))


def agreeing(sessions: Sequence[SessionData], sd: Array) -> list[SessionData]:
    """Return the sessions with the information of each multiplied by its weight, at most 1.

    The weight is 1 over the Birge ratio, χ² by its degrees of freedom, of a session against the neighbour that it
    agrees with better.  Sessions after a change agree with each other; a session with a poor fit agrees with none.
    """
    if len(sessions) < 2:
        return list(sessions)
    prior = np.diag(BENCH_SD[list(FREE)] ** -2.0)
    spread = [_with_deviation(one, sd) for one in sessions]
    known = [np.asarray(np.linalg.inv(information + prior), np.float64) for information, _ in spread]
    ratios = np.full((2, len(sessions)), np.inf)
    for k in range(1, len(sessions)):
        ratios[0, k] = _birge_ratio(known[k - 1], spread[k - 1][1], *spread[k])
        ratios[1, k - 1] = _birge_ratio(known[k], spread[k][1], *spread[k - 1])
    weights = 1.0 / np.maximum(ratios.min(axis=0), 1.0)
    return [one._replace(information=w * one.information, pull=w * one.pull)
            for one, w in zip(sessions, weights, strict=True)]


def _birge_ratio(covariance: Array, pull: Array, information: Array, other: Array) -> float:
    """Return χ² by degrees of freedom of a session's pull `other`, predicted from another session's."""
    residual = other - information @ (covariance @ pull)
    lengths, axes = np.linalg.eigh(information + information @ covariance @ information)
    kept = lengths > 1e-9 * lengths[-1]
    return float(np.mean((axes[:, kept].T @ residual) ** 2 / lengths[kept]))


def measured_sd(sessions: Sequence[SessionData]) -> Array:
    """Estimate 1σ of each constant between sessions; with fewer than two sessions the published one."""
    published = SESSION_SD[list(FREE)]
    variance = published**2
    if len(sessions) < 2:
        return np.asarray(published)
    information, pull = np.stack([one.information for one in sessions]), np.stack([one.pull for one in sessions])
    for _ in range(ROUNDS):
        sd = np.sqrt(variance)  # everything in units of it: the constants' units differ by orders of magnitude
        scaled, drawn = information * sd[:, None] * sd, pull * sd
        inner = np.linalg.inv(np.eye(sd.size) + scaled)
        carried = inner @ scaled
        bench_covariance = np.linalg.inv(np.diag((sd / BENCH_SD[list(FREE)]) ** 2) + carried.sum(axis=0))
        bench = bench_covariance @ (inner @ drawn[:, :, None]).sum(axis=0)[:, 0]
        mean = (inner @ (drawn - scaled @ bench)[:, :, None])[:, :, 0]
        spread = np.diagonal(inner, axis1=1, axis2=2) + np.sum((carried @ bench_covariance) * carried, axis=2)
        total = variance * np.sum(mean**2 + spread, axis=0)
        variance = (PRIOR_SESSIONS * published**2 + total) / (PRIOR_SESSIONS + len(sessions))
    return np.asarray(np.sqrt(variance))


def resets_named(text: str) -> tuple[str, ...]:
    """Return the constants of the parts, or single constants, that a text names; START and END in capitals only."""
    given = {word.strip(".,;:()") for word in text.replace("-", " ").split()}
    words = {word.lower() for word in given if word not in ("start", "end", "Start", "End")}
    named = [c for part, constants in PARTS.items() if part in words for c in constants]
    return tuple(dict.fromkeys([*named, *(c for c in CONSTANTS if c in words)]))


def _with_deviation(one: SessionData, sd: Array) -> tuple[Array, Array]:
    """Return information matrix and vector with the session's own deviation integrated out."""
    inner = np.eye(sd.size) + one.information * sd**2
    solved = np.linalg.solve(inner, np.concatenate([one.information, one.pull[:, None]], axis=1))
    return 0.5 * (solved[:, :-1] + solved[:, :-1].T), solved[:, -1]


def _positive(information: Array) -> Array:
    lengths, axes = np.linalg.eigh(0.5 * (information + information.T))
    return np.asarray((axes * np.maximum(lengths, 0.0)) @ axes.T)
