"""Choice of the next experiment by predicting, for this bench, how far each experiment reduces the ambiguity set.

Each effect e of the set has a posterior from the trials so far: mode x̂, covariance Σ.  Its predictive distribution for
an experiment is N(μ, S), S = HΣHᵀ + W⁻¹.  The expected log Bayes factor of e against f is

    K(e, f) = ½[tr(S_f⁻¹S_e) − n + (μ_f − μ_e)ᵀS_f⁻¹(μ_f − μ_e) + ln det S_f − ln det S_e]

and its variance is about 2K.  K₀ is the expected log Bayes factor of e against the reference condition, g the log Bayes
factors so far.  After the experiment f has the share (g_f + K₀ − K)/(g_e + K₀) of the evidence of e.  Below `SET_SHARE`
f is out of the ambiguity set.  The probability that the experiment decides is that of the least distinct f, averaged
over the effects e that may be true.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.stats import norm

from diagnosis.evidence.decision import SET_SHARE
from diagnosis.evidence.hypothesis_search import TrialModes
from diagnosis.evidence.identical_motion import REPEAT, pair_of
from estimation.data.table import table
from estimation.likelihood_data import GRID_S, PathRecording, Recording
from estimation.outputs import predict
from estimation.posterior import SURROGATE, Gaussian, PosteriorMode, SessionData, root_of, widened
from estimation.reference_fit import ReferenceFit
from physics.effects.hypotheses import Variant
from physics.effects.separating_experiments import EXPERIMENTS
from physics.forward.force_path import KNEE_RAD, STRETCH_M
from physics.forward.path_constants import named
from physics.laws import Array

DECIDES: Final = 0.7
"""Probability from which an experiment counts as deciding; among deciding experiments the shortest comes first."""


@dataclass(frozen=True)
class PlannedExperiment:
    """Predicted outcome of one experiment on this bench; `seconds`: its length.

    `sure`: probability that only the true effect remains in the ambiguity set.  `with_reference`: that probability if
    the experiment is also recorded in the reference condition.  `nats`: least expected log Bayes factor between two
    effects of the set, which are `pair`.
    """

    name: str
    seconds: float
    sure: float
    with_reference: float
    nats: float
    pair: tuple[str, str]

    @property
    def best(self) -> float:
        """Larger one of the probabilities with and without a recording in the reference condition."""
        return max(self.sure, self.with_reference)


class _PredictiveDistribution:
    """Predictive distribution of an experiment's data under one effect, whitened: mean, and root of the covariance."""

    def __init__(self, at: PosteriorMode, variants: Sequence[Variant], prior: Gaussian, observed: SessionData,
                 slopes: tuple[Array, Array]) -> None:
        weight = np.sqrt(observed.weight)
        data, jacobian = slopes
        covariance = widened(observed.model.constants, prior, variants)[2]
        factor = root_of(covariance)
        inward = factor.T @ ((at.design.T * at.weight) @ at.design) @ factor
        inner = cholesky(np.eye(factor.shape[0]) + inward, lower=True)
        root = solve_triangular(inner, factor.T, lower=True).T
        design = np.concatenate([jacobian, observed.features], axis=1)
        self.mean = weight * (data + observed.features @ at.x[at.constants:])
        self.spread = weight[:, None] * (design @ root)
        self.square = np.eye(root.shape[1]) + self.spread.T @ self.spread
        self.solved = cho_factor(self.square)
        self.log_det = 2.0 * float(np.log(np.diag(self.solved[0])).sum())

    def against(self, other: _PredictiveDistribution) -> float:
        """Return K(self, other), the expected log Bayes factor of this effect against `other`, nats."""
        cross = other.spread.T @ self.spread
        off = other.mean - self.mean
        along = other.spread.T @ off
        own = self.square.trace() - self.square.shape[0]
        trace = own - float(np.trace(cho_solve(other.solved, other.square - np.eye(other.square.shape[0])))) - float(
            np.sum(cross * cho_solve(other.solved, cross)))
        squared = float(off @ off - along @ cho_solve(other.solved, along))
        return float(max(0.5 * (trace + squared + other.log_det - self.log_det), 0.0))


def predicted_experiments(found: TrialModes, among: Sequence[str], reference: ReferenceFit,
                          tried: Sequence[str] = (), walked: Sequence[Recording] = ()) -> list[PlannedExperiment]:
    """Return the predicted outcome of each experiment that the bench runs without a person, the most decisive first.

    `among`: the ambiguity set.  `tried`: experiments already run, which are omitted.  `walked`: the reference trials,
    whose motion can be repeated.  Returns [] if fewer than two effects of the set were fitted alone.
    """
    effects = [name for name in among if name in found.single]
    if len(effects) < 2:
        return []
    planned = [_planned(name, found, effects, reference) for name, one in EXPERIMENTS.items()
               if one.script and one.waypoints and name not in tried]
    if walked and REPEAT not in tried:
        planned += [_repeated(found, effects, reference, walked[-1], len(walked) - 1)]
    return sorted(planned, key=lambda one: (-min(one.best, DECIDES), one.seconds))


def _planned(name: str, found: TrialModes, effects: Sequence[str], reference: ReferenceFit) -> PlannedExperiment:
    q = reference.bench_coordinates()
    recording = motion_of(name, q, found.observed.trials[0])
    observed = reference.observe(recording)
    slopes = {effect: observed.jacobian(at.q, at.active)
              for effect, at in [("", found.null), *((e, found.single[e]) for e in effects)]}
    paired = _with_reference(reference, observed, q)
    sure = [_decides(found, effects, observed, slopes, prior) for prior in (reference.prior, paired)]
    chance, nats, pair = sure[0]
    return PlannedExperiment(name, float(recording.time_s[-1]), chance, sure[1][0], nats, pair)


def _repeated(found: TrialModes, effects: Sequence[str], reference: ReferenceFit, walked: Recording, number: int
              ) -> PlannedExperiment:
    """Return the predicted outcome of a trial with the motion of reference trial `number`, the recording `walked`."""
    pair = pair_of(reference, walked, reference.observe(walked), number, 0)
    slopes = {effect: pair.observed.jacobian(at.q, at.active)
              for effect, at in [("", found.null), *((e, found.single[e]) for e in effects)]}
    chance, nats, least = _decides(found, effects, pair.observed, slopes, pair.prior)
    return PlannedExperiment(REPEAT, float(walked.time_s[-1]), chance, chance, nats, least)


def _decides(found: TrialModes, effects: Sequence[str], observed: SessionData, slopes: dict[str, tuple[Array, Array]],
             prior: Gaussian) -> tuple[float, float, tuple[str, str]]:
    """Return the probability that only the true effect remains, and nats and names of the least distinct pair.

    The share of the evidence has a systematic error of twice `SURROGATE`, since evidence grows with the square of the
    size of an effect.  Without it each probability would be close to 0 or 1.
    """
    told = {effect: _PredictiveDistribution(
        found.single[effect], [found.variants[effect]], prior, observed, slopes[effect]) for effect in effects}
    null = _PredictiveDistribution(found.null, [], prior, observed, slopes[""])
    gains = found.gains()
    chances, least = [], (np.inf, (effects[0], effects[1]))
    for true in effects:
        whole = told[true].against(null)
        alone = 1.0
        for other in effects:
            if other == true:
                continue
            nats = told[true].against(told[other])
            least = min(least, (nats, (true, other)))
            best = gains[true] + whole
            share = (gains[other] + whole - nats) / best
            spread = np.hypot(2.0 * SURROGATE, np.sqrt(2.0 * nats) / best)
            alone = min(alone, float(norm.cdf((SET_SHARE - share) / spread)))
        chances.append(alone)
    return float(np.mean(chances)), float(least[0]), least[1]


def _with_reference(reference: ReferenceFit, observed: SessionData, q: Array) -> Gaussian:
    """Return the prior of a trial if the experiment were also recorded in the reference condition."""
    free = reference.model.constants.free
    _, jacobian = observed.jacobian(q, free)
    design = np.concatenate([jacobian, observed.features], axis=1)
    square = (design.T * observed.weight) @ design
    session = np.diag(reference.prior.covariance - reference.bench.covariance)
    information = np.linalg.solve(np.eye(session.size) + square * session, square)
    bench = np.linalg.inv(np.linalg.inv(reference.bench.covariance) + 0.5 * (information + information.T))
    covariance: Array = np.asarray(bench + np.diag(session), np.float64)
    return Gaussian(reference.prior.origin, reference.prior.mean, covariance)


def motion_of(name: str, q: Array, like: PathRecording | Any) -> PathRecording:
    """Return the simulated recording of experiment `name` on the bench at coordinates `q`.

    Outputs and sensor noise are those of the recorded trial `like`.
    """
    given = dict(_followed(name, q.tobytes(), q.size))
    columns = {n: v for n, v in given.items() if n not in ("tension_end_n", "servo_force_n") or n in like.outputs}
    recording = PathRecording(table(name, columns))
    recording.noise_n = dict(like.noise_n)
    return recording


@functools.lru_cache(maxsize=32)
def _followed(name: str, bench: bytes, size: int, rest_s: float = 1.0, rounds: int = 12
              ) -> tuple[tuple[str, Array], ...]:
    """Return the simulated columns of an experiment; `rounds` corrections of the rope lead END along the waypoints.

    `bench`: bytes of the coordinates, `size` of them, since a cached function needs hashable arguments.  The bench
    rests for `rest_s` at the first waypoint.
    """
    q = np.frombuffer(bench, np.float64, size)
    constants = named(q)
    points = EXPERIMENTS[name].waypoints
    at = np.concatenate([[0.0, rest_s], rest_s + np.cumsum([p.seconds for p in points])])
    time = np.arange(0.0, at[-1], GRID_S)
    end = np.interp(time, at, [points[0].end_n] * 2 + [p.end_n for p in points])
    knee = np.deg2rad(np.interp(time, at, [points[0].knee_deg] * 2 + [p.knee_deg for p in points]))
    on = knee - KNEE_RAD
    anchor = (constants["arm"] + (constants["arm2"] + constants["arm3"] * on) * on) * on
    per_n = STRETCH_M / constants["stiffness"]
    rope = constants["zero"] + anchor + 0.7 * per_n * end
    for _ in range(rounds):
        path = _simulated(time, rope, knee, end, q)
        # the whole correction would make the rope oscillate, by the friction of the path
        rope = rope + 0.6 * per_n * np.clip(end - path.end[0], -5.0, 5.0)
    path = _simulated(time, rope, knee, end, q)
    return tuple({"time_s": time, "servo_position_m": rope, "knee_angle_rad": knee, "tension_start_n": path.start[0],
                  "tension_end_n": path.end[0], "servo_force_n": path.start[0]}.items())


def _simulated(time: Array, rope: Array, knee: Array, end: Array, q: Array) -> Any:
    given = {"time_s": time, "servo_position_m": rope, "knee_angle_rad": knee, "tension_start_n": end}
    made = PathRecording(table("motion", given))
    padded = made.time_s.size
    path = predict(q[:, None], made).path
    fill = time.size - padded
    return path if not fill else path._replace(
        start=np.pad(path.start, ((0, 0), (0, fill)), mode="edge"),
        end=np.pad(path.end, ((0, 0), (0, fill)), mode="edge"))
