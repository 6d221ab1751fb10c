"""Evidence of each effect while a trial runs, updated by gait cycle: one linear Gaussian model with closed forms.

The model of a gait cycle is e = Hx + Es + noise.  e is the residual of the data at the most probable constants without
an effect (the null mode), x the change of constants and discrepancy, prior N(0, P), H its Jacobian; s ~ N(0, 1) is the
size of an effect along its column E; W is the inverse covariance of the noise.  With the sums over cycles A = ΣHᵀWH,
B = ΣHᵀWE, C = ΣEᵀWE, b = ΣHᵀWe, d = ΣEᵀWe, the logarithm of the effect's Bayes factor K is

    M = P⁻¹ + A,   x = M⁻¹b,   G = C − BᵀM⁻¹B,   g = d − Bᵀx        ln K = ½ gᵀ(I + G)⁻¹g − ½ ln det(I + G)

An effect that begins in cycle c has the sums of B, C, d from c on.  Its evidence is the mean over a beginning before
the trial (half of the prior) and in each later cycle.

The linear model is a screen with two errors: early cycles remain linearised at an earlier null mode, and a model error
that repeats in every cycle is counted as new evidence each time.  If ln K exceeds the detection threshold, the recorded
cycles are diagnosed with the full model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import logsumexp

from estimation.data.table import Table, table
from estimation.likelihood_data import PathRecording
from estimation.linear_sums import EffectColumns, effect_columns, slopes, summed
from estimation.outputs import predict
from estimation.posterior import bayes_factor, bounded
from estimation.reference_fit import ReferenceFit
from physics.forward.path_constants import CONSTANTS, FREE, INDEX
from physics.laws import Array

Flags = NDArray[np.bool_]
MOTION_COLUMNS: Final = ("time_s", "servo_position_m", "knee_angle_rad", "tension_start_n", "tension_end_n",
                         "servo_force_n", "desired_force_n")


@dataclass(frozen=True)
class WatchVerdict:
    """Suspicion after one gait cycle.

    `suspected`: effects that the diagnosis of the cycles names, best first; `nats`: log Bayes factor of the best effect
    `best`, by the diagnosis if it is suspected, else by the linear model; `since`: cycle in which it most likely began
    (0: before the trial).  `end_error_n`: RMS of END as simulated with the suspected effect, against the desired force
    where it is recorded, else against the reference condition; `cost_percent`: the same beyond `reference_n`, of the
    peak.
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


class Naming(NamedTuple):
    """Rule by which an effect is named.

    `threshold`: log Bayes factor of the linear model, nats, from which cycles are diagnosed.  `diagnosed`: function of
    a number of latest cycles; it returns the effects that their diagnosis names, best first, with their log Bayes
    factors, or None for cycles that are too few.
    """

    threshold: float
    diagnosed: Callable[[int], Mapping[str, float] | None]


@dataclass
class DiagnosisSchedule:
    """Cycles after which suspected cycles are diagnosed again: few enough that a watch keeps up with its trial.

    They are diagnosed once the trial is `grown` times as long as at the last diagnosis.  A change that began after
    that is diagnosed earlier, the first time at once, the k-th time k cycles after the last diagnosis.
    """

    grown: float = 4.0 / 3.0
    diagnosed: int = 0
    later: int = 0

    def due(self, count: int, since: int) -> bool:
        """Return whether `count` cycles are diagnosed, of which the change likeliest began in number `since`."""
        return count >= self.grown * self.diagnosed or (
            since > 0 and since >= self.diagnosed and count >= self.diagnosed + self.later)

    def done(self, count: int) -> None:
        """Enter a diagnosis after `count` cycles."""
        self.later += count < self.grown * self.diagnosed
        self.diagnosed = count


class EffectSums(NamedTuple):
    """Sums over the data of a gait cycle that the evidence of an effect needs, of n base and m effect columns.

    `cross`: B, shape (n, m).  `square`: C, shape (m, m).  `pull`: d, shape (m,).  A and b count over the whole trial
    alone and are not stored for each cycle.
    """

    cross: Array
    square: Array
    pull: Array

    def __add__(self, other: EffectSums) -> EffectSums:  # type: ignore[override]
        """Return the sums over the data of both."""
        return EffectSums(self.cross + other.cross, self.square + other.square, self.pull + other.pull)


class RunningEvidence:
    """Evidence of one running trial against the fit of the reference trials, named by the rule `naming`.

    `span_s`: length, s, that drifts refer to; `reference_n`: RMS, N, by which reference trials miss the desired force.
    """

    def __init__(self, reference: ReferenceFit, span_s: float, naming: Naming, reference_n: float = 0.0) -> None:
        self.reference, self.span_s, self.naming, self.reference_n = reference, span_s, naming, reference_n
        self._size = reference.prior.mean.size
        self._precision = np.linalg.inv(reference.prior.covariance)
        self._beyond = -1.0
        self._x = np.zeros(self._size)
        self._variants = effect_columns(reference)
        self._cycles: list[EffectSums] = []
        count = self._variants[-1].at.stop
        self._square, self._pull = np.zeros((self._size, self._size)), np.zeros(self._size)
        self._whole = EffectSums(np.zeros((self._size, count)), np.zeros((count, count)), np.zeros(count))
        self._earlier = 0
        self._named: Mapping[str, float] = {}
        self._schedule = DiagnosisSchedule()

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
            self._beyond = observed.beyond
            self._precision = np.linalg.inv(self.reference.prior_of(observed).covariance)
        base = slopes(self.reference.model, self._variants, self._null(), recording)
        design = np.concatenate([base.base, observed.features], axis=1)[inside]
        weights = self.reference.prior.mean[len(FREE):] + self._x[len(FREE):]
        residual = (recording.data - base.data - observed.features @ weights)[inside]
        sums = summed(design, base.effects[inside], residual + design @ self._x,
                      bounded(residual, observed.weight[inside]))
        base_columns, effects = slice(0, self._size), slice(self._size, None)
        self._square += sums.square[base_columns, base_columns]
        self._pull += sums.pull[base_columns]
        self._cycles.append(EffectSums(*(part.copy() for part in (
            sums.square[base_columns, effects], sums.square[effects, effects], sums.pull[effects]))))
        self._whole += self._cycles[-1]
        if len(self._cycles) > most:
            self._cycles[:2] = [self._cycles[0] + self._cycles[1]]
            self._earlier += 1

    def _null(self) -> Array:
        """Return the coordinates of all constants at the present null mode."""
        return self.reference.prior.coordinates(CONSTANTS, self._x[:len(FREE)])

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
        named = self._diagnosis(since) if nats >= self.naming.threshold else {}
        if named:
            best = next(iter(named))
            nats, since, part, sizes = (named[best] or nats, *rated.get(best, rated[order[0]])[1:])
        error, peak = self._end_error(window, recording, inside, part if part.effect in named else None, sizes)
        cost = np.sqrt(max(error**2 - self.reference_n**2, 0.0)) / peak if peak > 0.0 else 0.0
        return WatchVerdict(cycle, tuple(named), best, nats, since and since + self._earlier, error,
                            100.0 * float(cost))

    def _diagnosis(self, since: int) -> Mapping[str, float]:
        """Return the effects that the diagnosis of the cycles from number `since` on names, with log Bayes factors."""
        count = self._earlier + len(self._cycles)
        if self._schedule.due(count, since and since + self._earlier):
            found = self.naming.diagnosed(len(self._cycles) - since)
            if found is not None:
                self._named = found
                self._schedule.done(count)
        return self._named

    def _foremost(self, inner: Any, most: int = 6) -> list[EffectColumns]:
        """Return the `most` variants with the most evidence by the whole trial, and as many by the latest cycle."""
        chosen: dict[int, EffectColumns] = {}
        for sums in (self._whole, self._cycles[-1]):
            gains = [self._evidence(inner, [sums], p.at)[0][0] for p in self._variants]
            chosen |= {int(k): self._variants[k] for k in np.argsort(gains)[::-1][:most]}
        return list(chosen.values())

    def _evidence(self, inner: Any, sums: Sequence[EffectSums], at: slice) -> tuple[Array, list[Array]]:
        """Return log Bayes factor, shape (sums,), and sizes of the effect columns `at` that act in the data of each of
        `sums`."""
        cross = np.stack([of.cross[:, at] for of in sums])
        # G = C − BᵀM⁻¹B and g = d − Bᵀx of the module's docstring, with one solution for all of `sums`
        carried = cho_solve(inner, np.concatenate(cross, axis=1)).reshape(cross.shape[1], *cross.shape[::2])
        found = [bayes_factor(of.square[at, at] - b.T @ carried[:, k], of.pull[at] - b.T @ self._x)
                 for k, (of, b) in enumerate(zip(sums, cross, strict=True))]
        return np.array([nats for nats, _ in found]), [sizes for _, sizes in found]

    def _beginnings(self, inner: Any, part: EffectColumns) -> tuple[float, int, Array]:
        """Return evidence, likeliest first cycle and sizes of one variant, over all first cycles."""
        own = part.at
        after = accumulate(EffectSums(c.cross[:, own], c.square[own, own], c.pull[own]) for c in self._cycles[::-1])
        nats, sizes = self._evidence(inner, list(after)[::-1], slice(None))
        # half of the prior for a beginning before the trial, the other half evenly for the later cycles
        prior = np.full(nats.size, -np.log(2.0))
        if nats.size > 1:
            prior[1:] -= np.log(nats.size - 1)
        since = int(np.argmax(nats + prior))
        return float(logsumexp(nats + prior)), since, sizes[since]

    def _end_error(self, window: Mapping[str, Array], recording: PathRecording, inside: Flags,
                   part: EffectColumns | None, sizes: Array, largest: float = 2.5) -> tuple[float, float]:
        """Return the RMS error of END in the latest cycle as it is simulated, N, and the peak of the undisturbed END.

        `largest`: most σ of an effect that is simulated, as at the start of a fit.
        """
        q = self._null()
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


def _recording(window: Mapping[str, Array], outputs: tuple[str, ...]) -> PathRecording:
    kept = {name: window[name] for name in ("time_s", "servo_position_m", "knee_angle_rad", *outputs)}
    given: Table = table("running trial", kept)
    return PathRecording(given)
