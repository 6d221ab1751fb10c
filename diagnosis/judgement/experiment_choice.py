"""Choice of the experiment that best splits the ambiguity set of a gait trial, by predicted χ².

An experiment is proposed if the equations, on its motion, separate the chosen model from each competing hypothesis. The
competing model and all constants of the reference condition are refitted for this comparison. d: difference of the
predictions of both models in weights; J: slopes of the refitted parameters; P: their prior precision. The separation is
|d|² − dᵀJ·(JᵀJ + P)⁻¹·Jᵀd. It must reach the least fall of χ² of a verdict. As a share of the chosen effect's χ² it
must also exceed that of the gait, which did not split the set.

Motions are those of `physics.effects.separating_experiments`. END and the knee follow the waypoints. START and the rope
are predicted by the bench model's equations in the reference condition.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.table import table
from diagnosis.judgement.verdict import LEAST_FALL
from diagnosis.problem import blocks
from diagnosis.problem.floors import CORRELATION_LENGTH, FLOORS
from diagnosis.problem.prior import Free, Prior
from diagnosis.problem.problem import ProblemSetting
from diagnosis.search.search import FittedEffects, SearchResult
from physics.effects.catalogue import CATALOGUE
from physics.effects.experiment_motions import gaits
from physics.effects.separating_experiments import EXPERIMENTS
from physics.plant.leg import GRAVITY
from physics.relations.measured import Signals
from physics.relations.relation import RELATIONS, predict, uses

Array = NDArray[np.float64]
Values = Mapping[str, float]

RATE_HZ: Final = 25.0
GAIT: Final = "gait"
"""Name of the motion on which the ambiguity set was found: ten gait cycles."""
WEIGHT: Final = "weight"
"""Name of the equation that a known weight at END adds: reading of END, from the weight."""
SPLITS: Final = 0.10
"""Least excess of an experiment over the gait in the share of the effect's χ² that only the true model explains."""
RIDGE: Final = 1e-9
STEP: Final = 0.02
"""Step of a slope's difference, as a share of the parameter's scale."""
BEND: Final = 1.5
"""Factor on the sheath's bend angle in the second half of known_bend."""
SENSOR_SLOTS: Final = ("gain", "offset", "drift")
ROUNDS: Final = 7
"""Iterations that make START and the rope consistent: START is then within 0.1 N (RMS) of its prediction.

`tests/diagnosis/test_experiment_choice.py` measures this; with one iteration START is off by up to 7 N.
"""
CALCULATED: Final = tuple(name for name, experiment in EXPERIMENTS.items() if experiment.waypoints)
"""Experiments whose motion is defined by waypoints; no separation is calculated for the others."""


def choose(rivals: Sequence[str], found: SearchResult, setting: ProblemSetting) -> str | None:
    """Return the experiment that splits the ambiguity set `rivals`, chosen effects first; None if only these are in it.

    Experiments of the set's effects come first, then all others. Among those that split every pair, automatic ones
    precede manual ones, then the best one is taken. If none splits every pair, the experiment with the best worst pair
    is returned, automatic ones first. Without a calculation (a rig of another kind) the first automatic experiment of
    the effects is returned. Each pair is calculated with either model as the true one; the mean of both counts.
    """
    chosen = found.best.names
    others = [name for name in rivals if name not in chosen]
    if not others:
        return None
    named = list(dict.fromkeys(CATALOGUE[name].experiment for name in rivals))
    elsewhere = setting.any_rig or (setting.learnt is None and setting.reference.kind == "healthy")
    pairs = [] if elsewhere else [
        (Pair(found.best, model, setting), Pair(model, found.best, setting))
        for name in others if (model := _rival(found, name)) is not None]
    gained: dict[str, float] = {}
    for offered in (named, [name for name in CALCULATED if name not in named]):
        gained |= {name: min(0.5 * (either.gained(name) + reverse.gained(name)) for either, reverse in pairs)
                   for name in offered if name in CALCULATED and pairs}
        splits = [name for name in offered if gained.get(name, 0.0) >= SPLITS]
        if splits:
            return min(splits, key=lambda name: (bool(EXPERIMENTS[name].by_hand), -gained[name]))
    if helps := [name for name, gain in gained.items() if gain > 0.0]:
        return min(helps, key=lambda name: (bool(EXPERIMENTS[name].by_hand), -gained[name]))
    return next((name for name in named if not EXPERIMENTS[name].by_hand), named[0])


def _rival(found: SearchResult, name: str) -> FittedEffects | None:
    """Return the best model that contains `name` and as many effects as the chosen one; None if none was fitted."""
    held = [m for m in found.models if name in m.names and len(m.names) == len(found.best.names)]
    return min(held, key=lambda m: m.rank, default=None)


class Pair:
    """Pair of models: the predictions of the first, taken as true, are fitted by the second on any experiment."""

    def __init__(self, one: FittedEffects, other: FittedEffects, setting: ProblemSetting) -> None:
        nuisance = {f.name: f for f in setting.reference.nuisance}
        self._one, self._other, self._healthy = one.fit.values, other.fit.values, setting.reference.values
        self._weights, self._prior = setting.weights, setting.reference.prior
        own = {f.name for effect in one.effects for f in effect.frees}
        self._band = [f for f in nuisance.values() if f.name not in own]
        self._free = list((nuisance | {f.name: f for effect in other.effects for f in effect.frees}).values())

    def gained(self, name: str) -> float:
        """Return the share of χ² that only the true model explains, less that share on the gait.

        Negative infinity if the separation is too small to be detected.
        """
        left = self._apart(name, self._other, self._free)
        return -math.inf if left < LEAST_FALL else self._share(name, left) - self._gait

    @functools.cached_property
    def _gait(self) -> float:
        return self._share(GAIT, self._apart(GAIT, self._other, self._free))

    def _share(self, name: str, left: float) -> float:
        return left / max(self._apart(name, self._healthy, self._band), left, 1e-9)

    def _apart(self, name: str, other: Values, free: Sequence[Free]) -> float:
        """Return `apart` of the true model and `other` on the motion of experiment `name`."""
        signals = predicted_signals(name, tuple(self._healthy.items()))
        return apart(name, signals, self._one, other, free, self._weights, self._prior)


def apart(name: str, signals: Signals, one: Values, other: Values, free: Sequence[Free], weights: Mapping[str, float],
          prior: Prior) -> float:
    """Return the χ² between two sets of values on the `signals` of experiment `name`, with `free` of `other` refitted.

    `weights`: of each checked equation, in its unit, reference RMSE times the root of the samples per effective sample.
    """
    relations = _readable(name, weights)
    told = {r: _told(name, signals, r, other, weights) for r in relations}
    difference = np.concatenate(
        [_told(name, signals, r, one, weights) - told[r] for r in relations] or [np.zeros(1)])
    rows, sizes, seen = [], [], []
    for f in free:
        step = STEP * f.scale * (-1.0 if other[f.name] + STEP * f.scale > f.high else 1.0)
        moved = {**other, f.name: other[f.name] + step}
        slope = np.concatenate([
            (_told(name, signals, r, moved, weights) - told[r]) / step if _reads(r, f.name) else np.zeros(told[r].size)
            for r in relations] or [np.zeros(1)])
        size = float(slope @ slope)
        if size > 0.0:
            rows.append(slope / math.sqrt(size))
            sizes.append(math.sqrt(size))
            seen.append(f)
    whole = float(difference @ difference)
    if not rows:
        return whole
    slopes = np.array(rows)
    along = slopes @ difference
    fitted = np.linalg.solve(
        slopes @ slopes.T + prior.precision(seen) / np.outer(sizes, sizes) + RIDGE * np.eye(len(rows)), along)
    return max(whole - float(fitted @ along), 0.0)


def _readable(name: str, weights: Mapping[str, float]) -> list[str]:
    """Return the checked equations that an experiment can test, and WEIGHT if a known weight hangs at END."""
    if name == "dead_weight":
        return [r for r in weights if r in RELATIONS and r not in ("servo", "knee", "drive_force")] + [WEIGHT]
    return [r for r in weights if r in RELATIONS]


def _reads(relation: str, slot: str) -> bool:
    return slot.startswith("end_") if relation == WEIGHT else slot in uses(RELATIONS[relation])


def _told(name: str, signals: Signals, relation: str, values: Values, weights: Mapping[str, float]) -> Array:
    """Return the prediction of an equation on an experiment under `values`, divided by the equation's weight."""
    if relation == WEIGHT:
        end = (values["end_gain"] * signals["tension_end_n"] + values["end_offset"]
               + values["end_drift"] * signals.progress
               + values["end_mass"] * GRAVITY * np.cos(signals["knee_angle_rad"]))
        return np.asarray(end / weights.get("friction", FLOORS["friction"] * math.sqrt(CORRELATION_LENGTH["friction"])))
    predicted, changed = predict(RELATIONS[relation], signals, values), _changed(name, values)
    if changed is not None:
        first = signals.progress < 0.5
        predicted = np.where(first, predicted, predict(RELATIONS[relation], signals, changed))
    return np.nan_to_num(predicted / weights[relation])


def _changed(name: str, values: Values) -> dict[str, float] | None:
    """Return the values in the second half of an experiment in which an operator changes the bench; else None."""
    if name == "known_bend":
        return {**values, "theta1": BEND * values["theta1"]}
    if name == "swapped_sensors":
        swapped = {f"{here}_{slot}": values[f"{there}_{slot}"] for slot in SENSOR_SLOTS
                   for here, there in (("start", "end"), ("end", "start"))}
        return {**values, **swapped}
    return None


@functools.lru_cache(maxsize=1)  # cached results of the submodels are larger than a trial
def predicted_signals(name: str, healthy: tuple[tuple[str, float], ...]) -> Signals:
    """Return the signals of an experiment's motion, predicted by the bench model at the values `healthy`.

    Each iteration predicts START from END and the rope's motion, then corrects the rope by the resulting error of the
    knee angle.
    """
    values = dict(healthy)
    points = gaits(10) if name == GAIT else EXPERIMENTS[name].waypoints
    ends = np.cumsum([1.0, *(seconds for seconds, _, _ in points)])
    time = np.arange(0.0, ends[-1], 1.0 / RATE_HZ)
    at = np.concatenate(([0.0], ends))
    end, knee = (np.interp(time, at, [points[0][place]] * 2 + [p[place] for p in points]) for place in (1, 2))
    knee = np.deg2rad(knee)
    signals = _signals(name, time, end, knee, end, values["rope_per_knee"] * knee)
    for _ in range(ROUNDS):
        rope = signals["servo_position_m"]
        start = predict(RELATIONS["friction"], signals, values)
        angle = predict(RELATIONS["kinematics"], _signals(name, time, end, knee, start, rope), values)
        signals = _signals(name, time, end, knee, start, rope + values["rope_per_knee"] * (knee - angle))
    return signals


def _signals(name: str, time: Array, end: Array, knee: Array, start: Array, rope: Array) -> Signals:
    columns = {"time_s": time, "tension_end_n": end, "tension_start_n": start, "knee_angle_rad": knee,
               "knee_target_rad": knee, "servo_position_m": rope, "servo_target_m": rope, "servo_force_n": start}
    return blocks.signals_of(table(name, columns), RATE_HZ)
