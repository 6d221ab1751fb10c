"""Evidence of each effect while a trial runs, updated by gait cycle: one linear Gaussian model with closed forms.

Each gait cycle is linearised at the present null mode; with base coordinates x (constants and discrepancy), effect
sizes s ~ N(0, 1) along the columns E and the sums over cycles A = ΣHᵀWH, B = ΣHᵀWE, C = ΣEᵀWE, b = ΣHᵀWe, d = ΣEᵀWe:

    M = P⁻¹ + A,   x = M⁻¹b,   G = C − BᵀM⁻¹B,   g = d − BᵀM⁻¹b        ln B = ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G)

An effect that begins in cycle c has the sums of B, C, d from c on.  Its evidence is the mean over a beginning before
the trial (half of the prior) and in each later cycle.  The verdict after the last cycle is the diagnosis of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp

from estimation.data.table import Table, table
from estimation.likelihood_data import PathRecording
from estimation.linear_sums import EffectColumns, effect_columns, slopes
from estimation.outputs import predict
from estimation.posterior import Observed, bounded
from estimation.reference_fit import ReferenceFit
from physics.laws import Array
from physics.path_constants import CONSTANTS, FREE, INDEX

Flags = NDArray[np.bool_]
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


class Naming(NamedTuple):
    """Rule by which an effect is named: threshold in nats by session; share of the best log Bayes factor from which an
    effect is in the ambiguity set."""

    threshold: Callable[[Observed], float]
    set_share: float


class RunningEvidence:
    """Evidence of one running trial against the fit of the reference trials, named by the rule `naming`.

    `span_s`: length, s, that drifts refer to; `reference_n`: RMS, N, by which reference trials miss the desired force.
    """

    def __init__(self, reference: ReferenceFit, span_s: float, naming: Naming, reference_n: float = 0.0) -> None:
        self.reference, self.span_s, self.naming, self.reference_n = reference, span_s, naming, reference_n
        self._size = reference.prior.mean.size
        self._precision = np.linalg.inv(reference.prior.covariance)
        self._beyond, self._least = -1.0, 0.0
        self._square, self._pull = np.zeros_like(self._precision), np.zeros(self._size)
        self._x = np.zeros(self._size)
        self._variants = effect_columns(reference)
        self._cycles: list[CycleSums] = []
        count = self._variants[-1].at.stop
        self._whole = CycleSums(np.zeros((self._size, count)), np.zeros((count, count)), np.zeros(count))
        self._earlier = 0

    def add(self, cycle: int, window: Mapping[str, Array], begins_s: float) -> WatchVerdict | None:
        """Add the gait cycle `cycle` and return the suspicion; None for a cycle too short to give data.

        `window`: columns from up to `gait_windows.LEAD_S` before the cycle, whose data begin at `begins_s`.
        """
        recording = _recording(window, self.reference.outputs)
        first_s = float(window["time_s"][0])
        recording.progress = np.clip((first_s + recording.time_s) / self.span_s, 0.0, 1.0)
        inside = recording.binned(recording.time_s) + first_s >= begins_s
        if not inside.any():
            return None
        self._take(recording, np.tile(inside, len(recording.outputs)))
        return self._verdict(cycle, window, recording, inside)

    def _take(self, recording: PathRecording, inside: Flags, most: int = 64) -> None:
        """Linearise one cycle at the present null mode and add its sums.

        An effect can begin in the latest `most` cycles; an earlier beginning counts as one before the trial.
        """
        observed = self.reference.observe(recording)
        if observed.beyond > self._beyond:
            self._beyond, self._least = observed.beyond, self.naming.threshold(observed)
            self._precision = np.linalg.inv(self.reference.prior_of(observed).covariance)
        q = self._coordinates(self._x)
        base = slopes(self.reference.model, self._variants, q, recording)
        design = np.concatenate([base.base, observed.features], axis=1)[inside]
        columns = base.effects[inside]
        residual = (recording.data - base.data - observed.features @ self._weights(self._x))[inside]
        weight = bounded(residual, observed.weight[inside])
        error = residual + design @ self._x
        heavy = design.T * weight
        self._square += heavy @ design
        self._pull += heavy @ error
        self._cycles.append(CycleSums(heavy @ columns, (columns.T * weight) @ columns, columns.T @ (weight * error)))
        self._whole = _added(self._whole, self._cycles[-1])
        if len(self._cycles) > most:
            self._cycles[:2] = [_added(*self._cycles[:2])]
            self._earlier += 1

    def _coordinates(self, x: Array) -> Array:
        """Return the coordinates of all constants at a departure from the prior's mean."""
        q = self.reference.prior.origin.copy()
        q[list(FREE)] += self.reference.prior.mean[:len(FREE)] + x[:len(FREE)]
        return np.asarray(q)

    def _weights(self, x: Array) -> Array:
        return np.asarray(self.reference.prior.mean[len(FREE):] + x[len(FREE):])

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
        named = nats >= self._least
        suspected = tuple(n for n in order if named and rated[n][0] >= self.naming.set_share * nats)
        error, peak = self._end_error(window, recording, inside, part if named else None, sizes)
        cost = np.sqrt(max(error**2 - self.reference_n**2, 0.0)) / peak if peak > 0.0 else 0.0
        return WatchVerdict(cycle, suspected, best, nats, since and since + self._earlier, error, 100.0 * float(cost))

    def _foremost(self, inner: Any, most: int = 6) -> list[EffectColumns]:
        """Return the `most` variants with the most evidence by the whole trial, and as many by the latest cycle."""
        chosen: dict[int, EffectColumns] = {}
        for sums in (self._whole, self._cycles[-1]):
            carried = cho_solve(inner, sums.cross)
            square, pull = sums.square - sums.cross.T @ carried, sums.pull - carried.T @ self._pull
            gains = [_evidence(square[p.at, p.at], pull[p.at])[0] for p in self._variants]
            chosen |= {int(k): self._variants[k] for k in np.argsort(gains)[::-1][:most]}
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
                   part: EffectColumns | None, sizes: Array, largest: float = 2.5) -> tuple[float, float]:
        """Return the RMS error of END in the latest cycle as it is simulated, N, and the peak of the undisturbed END.

        `largest`: most σ of an effect that is simulated, as at the start of a fit.
        """
        q = self._coordinates(self._x)
        reference = q.copy()
        if part is not None:
            for name, value in part.variant.at.items():
                q[INDEX[name]] = CONSTANTS.coordinate(name, value)
            for direction, size in zip(part.variant.directions, sizes, strict=True):
                for name, share in direction.along.items():
                    q[INDEX[name]] += float(np.clip(size, -largest, largest)) * direction.sd * share
        _, path, row = predict(np.stack([q, reference], axis=1), recording)
        end, desired = (recording.binned(path.end[k])[inside] for k in row)
        if "desired_force_n" in window:
            given = np.interp(recording.time_s, window["time_s"] - window["time_s"][0], window["desired_force_n"])
            asked = recording.binned(given)[inside]
            desired = np.where(np.isfinite(asked), asked, desired)
        return float(np.sqrt(np.mean((end - desired) ** 2))), float(desired.max())


def _added(one: CycleSums, other: CycleSums) -> CycleSums:
    return CycleSums(*(a + b for a, b in zip(one, other, strict=True)))


def _evidence(square: Array, pull: Array) -> tuple[float, Array]:
    """Return the log Bayes factor of one variant, nats, and its sizes."""
    whole = np.eye(pull.size) + square
    size = np.linalg.solve(whole, pull)
    return float(0.5 * pull @ size - 0.5 * np.linalg.slogdet(whole)[1]), np.asarray(size)


def _recording(window: Mapping[str, Array], outputs: tuple[str, ...]) -> PathRecording:
    kept = {name: window[name] for name in ("time_s", "servo_position_m", "knee_angle_rad", *outputs)}
    given: Table = table("running trial", kept)
    return PathRecording(given)
