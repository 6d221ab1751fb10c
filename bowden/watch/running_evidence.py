"""Evidence of each effect while a trial runs, updated by gait cycle: one linear Gaussian model with closed forms.

Each gait cycle is linearised at the present null mode; with base coordinates x (constants and discrepancy), effect
sizes s ~ N(0, 1) along the columns E and the sums over cycles A = ΣHᵀWH, B = ΣHᵀWE, C = ΣEᵀWE, b = ΣHᵀWe, d = ΣEᵀWe:

    M = P⁻¹ + A,   x = M⁻¹b,   G = C − BᵀM⁻¹B,   g = d − BᵀM⁻¹b        ln B = ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G)

An effect that begins in cycle c has the sums of B, C, d from c on.  Its evidence is the mean over a beginning before
the trial (half of the prior) and in each later cycle.  The verdict after the last cycle is the diagnosis of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp

from diagnosis.evidence.decision import SET_SHARE, detected, threshold
from estimation.data.table import Table, table
from estimation.likelihood_data import PathRecording
from estimation.outputs import predict
from estimation.posterior import bounded
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import HYPOTHESES, Variant
from physics.laws import Array
from physics.path_constants import CONSTANTS, FREE, INDEX, named

Flags = NDArray[np.bool_]
LEAD_S: Final = 2.5
"""Time simulated before a cycle, s, so that friction states are known at its start."""
MOST_CYCLES: Final = 64
"""Latest cycles in which an effect can begin; earlier ones count as its presence before the trial."""
FOREMOST: Final = 6
"""Variants by the whole trial, and as many by the latest cycle, for which beginnings are compared."""
CREEP_AT: Final = 1.5e-5
"""Creep, m/N, at which the slope by its time constant is taken: at zero creep the slope is zero."""
LARGEST_SIZE: Final = 2.5
"""Most σ of an effect at which its END force is simulated, as at the start of a fit."""
MOTION_COLUMNS: Final = ("time_s", "servo_position_m", "knee_angle_rad", "tension_start_n", "tension_end_n",
                         "servo_force_n", "desired_force_n")


@dataclass(frozen=True)
class WatchVerdict:
    """Suspicion after one gait cycle.

    `suspected`: effects not separated from the best one, best first, empty below the threshold of a name; `nats`: log
    Bayes factor of the best effect, named or not, `best`; `since`: cycle in which it most likely began (0: before the
    trial).  `end_error_n`: RMS of END as simulated with the suspected effect, against the desired force where it is
    recorded, else against the reference condition; `cost_percent`: the same beyond `reference_n`, of the peak.
    """

    cycle: int
    suspected: tuple[str, ...]
    best: str
    nats: float
    since: int
    end_error_n: float
    cost_percent: float

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {**self.__dict__, "suspected": list(self.suspected)}


class CycleSums(NamedTuple):
    """Sums of one cycle over its data: B, C and d of every effect column."""

    cross: Array
    square: Array
    pull: Array


class EffectColumns(NamedTuple):
    """Columns of one variant among all effect columns."""

    effect: str
    variant: Variant
    at: slice


class RunningEvidence:
    """Evidence of one running trial against the fit of the reference trials.

    `span_s`: length, s, that drifts refer to; `reference_n`: RMS, N, by which reference trials miss the desired force.
    """

    def __init__(self, reference: ReferenceFit, span_s: float, reference_n: float = 0.0) -> None:
        self.reference, self.span_s, self.reference_n = reference, span_s, reference_n
        self._size = reference.prior.mean.size
        self._precision = np.linalg.inv(reference.prior.covariance)
        self._beyond, self._least = -1.0, 0.0
        self._square, self._pull = np.zeros_like(self._precision), np.zeros(self._size)
        self._x = np.zeros(self._size)
        self._variants = _variants(reference)
        self._cycles: list[CycleSums] = []
        count = self._variants[-1].at.stop
        self._whole = CycleSums(np.zeros((self._size, count)), np.zeros((count, count)), np.zeros(count))
        self._earlier = 0

    def add(self, cycle: int, window: Mapping[str, Array], begins_s: float) -> WatchVerdict | None:
        """Add the gait cycle `cycle` and return the suspicion; None for a cycle too short to give data.

        `window`: columns from up to `LEAD_S` before the cycle, whose data begin at `begins_s`.
        """
        recording = _recording(window, self.reference.outputs)
        first_s = float(window["time_s"][0])
        recording.progress = np.clip((first_s + recording.time_s) / self.span_s, 0.0, 1.0)
        inside = recording.binned(recording.time_s) + first_s >= begins_s
        if not inside.any():
            return None
        self._take(recording, np.tile(inside, len(recording.outputs)))
        return self._verdict(cycle, window, recording, inside)

    def _take(self, recording: PathRecording, inside: Flags) -> None:
        """Linearise one cycle at the present null mode and add its sums."""
        observed = self.reference.observe(recording)
        if observed.beyond > self._beyond:
            self._beyond, self._least = observed.beyond, threshold(observed)
            self._precision = np.linalg.inv(self.reference.prior_of(observed).covariance)
        q = self._coordinates(self._x)
        base, effects = self._slopes(q, recording)
        design = np.concatenate([base.slopes, observed.features], axis=1)[inside]
        columns = effects[inside]
        residual = (recording.data - base.data - observed.features @ self._weights(self._x))[inside]
        weight = bounded(residual, observed.weight[inside])
        error = residual + design @ self._x
        heavy = design.T * weight
        self._square += heavy @ design
        self._pull += heavy @ error
        self._cycles.append(CycleSums(heavy @ columns, (columns.T * weight) @ columns, columns.T @ (weight * error)))
        self._whole = _added(self._whole, self._cycles[-1])
        if len(self._cycles) > MOST_CYCLES:
            self._cycles[:2] = [_added(*self._cycles[:2])]
            self._earlier += 1

    def _coordinates(self, x: Array) -> Array:
        """Return the coordinates of all constants at a departure from the prior's mean."""
        q = self.reference.prior.origin.copy()
        q[list(FREE)] += self.reference.prior.mean[:len(FREE)] + x[:len(FREE)]
        return np.asarray(q)

    def _weights(self, x: Array) -> Array:
        return np.asarray(self.reference.prior.mean[len(FREE):] + x[len(FREE):])

    def _slopes(self, q: Array, recording: PathRecording) -> tuple[_Base, Array]:
        """Return prediction and slopes by the free constants, and the columns of every effect, in one simulation."""
        wanted: dict[tuple[tuple[tuple[str, float], ...], str], int] = {}
        sets = [q, *(_moved(q, i) for i in FREE)]
        origins: dict[tuple[tuple[str, float], ...], int] = {(): 0}
        for part in self._variants:
            at = tuple(sorted(part.variant.at.items()))
            names = {n for d in part.variant.directions for n in _along(d.along)}
            if at not in origins:
                origins[at] = len(sets)
                sets.append(_origin(q, part.variant, names))
            for name in sorted(names):
                if (at, name) not in wanted:
                    wanted[(at, name)] = len(sets)
                    sets.append(_moved(sets[origins[at]], INDEX[name]))
        data = predict(np.stack(sets, axis=1), recording).data
        slopes = np.stack([(data[1 + k] - data[0]) / CONSTANTS.step[i] for k, i in enumerate(FREE)], axis=1)
        progress = np.tile(recording.binned(recording.progress), len(recording.outputs))

        def slope(at: tuple[tuple[str, float], ...], name: str) -> Array:
            return np.asarray((data[wanted[(at, name)]] - data[origins[at]]) / CONSTANTS.step[INDEX[name]])

        columns = []
        for part in self._variants:
            at = tuple(sorted(part.variant.at.items()))
            for direction in part.variant.directions:
                column = sum((share * (progress if "drift" in direction.along else 1.0) * slope(at, name)
                              for name, share in _along(direction.along).items()), np.zeros(data.shape[1]))
                columns.append(direction.sd * column)
        return _Base(data[0], slopes), np.stack(columns, axis=1)

    def _verdict(self, cycle: int, window: Mapping[str, Array], recording: PathRecording, inside: Flags
                 ) -> WatchVerdict:
        inner = cho_factor(self._precision + self._square)
        self._x = cho_solve(inner, self._pull)
        likely = self._foremost(inner)
        rated: dict[str, tuple[float, int, EffectColumns, Array]] = {}
        for part in likely:
            nats, since, sizes = self._beginnings(inner, part)
            if part.effect not in rated or nats > rated[part.effect][0]:
                rated[part.effect] = nats, since, part, sizes
        order = sorted(rated, key=lambda name: -rated[name][0])
        best = order[0]
        nats, since, part, sizes = rated[best]
        named_ones = detected({n: rated[n][0] for n in order}, self._least)
        suspected = tuple(n for n in order if named_ones and rated[n][0] >= SET_SHARE * rated[named_ones[0]][0])
        error, peak = self._end_error(window, recording, inside, part if named_ones else None, sizes)
        cost = np.sqrt(max(error**2 - self.reference_n**2, 0.0)) / peak if peak > 0.0 else 0.0
        return WatchVerdict(cycle, suspected, best, nats, since and since + self._earlier, error, 100.0 * float(cost))

    def _foremost(self, inner: Any) -> list[EffectColumns]:
        """Return the variants with the most evidence by the whole trial and by the latest cycle."""
        chosen: dict[int, EffectColumns] = {}
        for sums in (self._whole, self._cycles[-1]):
            carried = cho_solve(inner, sums.cross)
            square, pull = sums.square - sums.cross.T @ carried, sums.pull - carried.T @ self._pull
            gains = [_evidence(square[p.at, p.at], pull[p.at])[0] for p in self._variants]
            chosen |= {int(k): self._variants[k] for k in np.argsort(gains)[::-1][:FOREMOST]}
        return list(chosen.values())

    def _beginnings(self, inner: Any, part: EffectColumns) -> tuple[float, int, Array]:
        """Return evidence, likeliest first cycle and sizes of one variant, over all first cycles."""
        after = [CycleSums(c.cross[:, part.at], c.square[part.at, part.at], c.pull[part.at]) for c in self._cycles]
        sums = CycleSums(*(np.cumsum(np.stack(parts)[::-1], axis=0)[::-1] for parts in zip(*after, strict=True)))
        found = []
        for cross, square, pull in zip(*sums, strict=True):
            carried = cho_solve(inner, cross)
            found.append(_evidence(square - cross.T @ carried, pull - carried.T @ self._pull))
        nats = np.array([gain for gain, _ in found])
        prior = np.full(nats.size, -np.log(2.0))
        if nats.size > 1:
            prior[1:] -= np.log(nats.size - 1)
        since = int(np.argmax(nats + prior))
        return float(logsumexp(nats + prior)), since, found[since][1]

    def _end_error(self, window: Mapping[str, Array], recording: PathRecording, inside: Flags,
                   part: EffectColumns | None, sizes: Array) -> tuple[float, float]:
        """Return the RMS error of END in the latest cycle as it is simulated, N, and the peak of the undisturbed END.
        """
        q = self._coordinates(self._x)
        reference = q.copy()
        if part is not None:
            for name, value in part.variant.at.items():
                q[INDEX[name]] = CONSTANTS.coordinate(name, value)
            for direction, size in zip(part.variant.directions, sizes, strict=True):
                for name, share in direction.along.items():
                    q[INDEX[name]] += float(np.clip(size, -LARGEST_SIZE, LARGEST_SIZE)) * direction.sd * share
        _, path, row = predict(np.stack([q, reference], axis=1), recording)
        end, desired = (recording.binned(path.end[k])[inside] for k in row)
        if "desired_force_n" in window:
            given = np.interp(recording.time_s, window["time_s"] - window["time_s"][0], window["desired_force_n"])
            asked = recording.binned(given)[inside]
            desired = np.where(np.isfinite(asked), asked, desired)
        return float(np.sqrt(np.mean((end - desired) ** 2))), float(desired.max())


class _Base(NamedTuple):
    """Prediction at the point of linearisation and its slopes by the free constants."""

    data: Array
    slopes: Array


def _added(one: CycleSums, other: CycleSums) -> CycleSums:
    return CycleSums(*(a + b for a, b in zip(one, other, strict=True)))


def _evidence(square: Array, pull: Array) -> tuple[float, Array]:
    """Return the log Bayes factor of one variant, nats, and its sizes."""
    whole = np.eye(pull.size) + square
    size = np.linalg.solve(whole, pull)
    return float(0.5 * pull @ size - 0.5 * np.linalg.slogdet(whole)[1]), np.asarray(size)


def _variants(reference: ReferenceFit) -> list[EffectColumns]:
    """Return the columns of every variant that moves one of the outputs."""
    q = reference.prior.origin.copy()
    q[list(FREE)] += reference.prior.mean[:len(FREE)]
    found, first = [], 0
    for name, hypothesis in HYPOTHESES.items():
        if set(hypothesis.needs) <= set(reference.outputs):
            for variant in hypothesis.variants(named(q)):
                count = len(variant.directions)
                found.append(EffectColumns(name, variant, slice(first, first + count)))
                first += count
    return found


def _along(along: Mapping[str, float]) -> Mapping[str, float]:
    """Return a direction of the evidence; friction drift is scaled by the progress of the trial."""
    return {"cable": along["drift"], "fabric": along["drift"]} if "drift" in along else along


def _moved(q: Array, constant: int) -> Array:
    moved = q.copy()
    moved[constant] += CONSTANTS.step[constant]
    return moved


def _origin(q: Array, variant: Variant, names: set[str]) -> Array:
    """Return coordinates with the constants that a variant sets, and with creep if its time constant is varied."""
    at = q.copy()
    for name, value in variant.at.items():
        at[INDEX[name]] = CONSTANTS.coordinate(name, value)
    if "creep_time" in names:
        at[INDEX["creep"]] += CREEP_AT
    return at


def _recording(window: Mapping[str, Array], outputs: tuple[str, ...]) -> PathRecording:
    kept = {name: window[name] for name in ("time_s", "servo_position_m", "knee_angle_rad", *outputs)}
    given: Table = table("running trial", kept)
    return PathRecording(given)
