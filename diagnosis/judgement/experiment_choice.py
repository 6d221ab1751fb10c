"""Which experiment splits a class of effects that one gait trial confuses: calculated, not listed.

The rule of this file: an experiment is proposed where the relations, on its motion, tell the chosen model from each
rival though the rival and all that a healthy bench may vary are fitted again.  d: difference of the two models'
predictions in floors; J: slopes of what is fitted, P its prior precision; what is left is
|d|² − dᵀJ·(JᵀJ + P)⁻¹·Jᵀd.  It must reach the verdict's own least fall of χ², and as a share of what the chosen
effect does it must exceed that of the gait: the same share on a gait has left the class.
Motions are those of `physics.effects.separating_experiments`.  END and the knee follow the waypoints; START and the
rope are what the bench model's relations predict for them at the values of the reference condition.
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
"""Name of the motion that the class of effects was found by: ten gait cycles."""
WEIGHT: Final = "weight"
"""The relation that a known weight at END adds: END's reading from the weight."""
SPLITS: Final = 0.10
"""Share of what the chosen effect does that an experiment must show beyond what the gait shows of it."""
RIDGE: Final = 1e-9
STEP: Final = 0.02
"""Step of a slope, of a slot's scale."""
BEND: Final = 1.5
"""Change of the sheath's bend in known_bend."""
SENSOR_SLOTS: Final = ("gain", "offset", "drift")
ROUNDS: Final = 7
"""Rounds in which START and the rope are brought to agree: START is then within 0.1 N (RMS) of its prediction.

`tests/diagnosis/test_experiment_choice.py` measures that; with one round START is off by up to 7 N.
"""
CALCULATED: Final = tuple(name for name, experiment in EXPERIMENTS.items() if experiment.waypoints)
"""Experiments whose motion has waypoints; of the others nothing is claimed."""


def choose(rivals: Sequence[str], found: SearchResult, setting: ProblemSetting) -> str | None:
    """Return the experiment that splits the class `rivals`, the chosen effects first; None where there is no class.

    Of those that the class's effects name, else of all: what splits every pair best and the bench runs by itself,
    then what splits every pair by hand.  Where none does, the one that is best at the worst pair, by itself first;
    without a calculation (a rig of which nothing is known) the first that is named.  Either model of a pair may be
    the true one: what counts is the mean of both ways.
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
    """Return the best model of as many effects in which `name` stands."""
    held = [m for m in found.models if name in m.names and len(m.names) == len(found.best.names)]
    return min(held, key=lambda m: m.rank, default=None)


class Pair:
    """One model, taken for the truth, against another that is fitted to what it says, on any experiment."""

    def __init__(self, one: FittedEffects, other: FittedEffects, setting: ProblemSetting) -> None:
        nuisance = {f.name: f for f in setting.reference.nuisance}
        self._one, self._other, self._healthy = one.fit.values, other.fit.values, setting.reference.values
        self._weights, self._prior = setting.weights, setting.reference.prior
        own = {f.name for effect in one.effects for f in effect.frees}
        self._band = [f for f in nuisance.values() if f.name not in own]
        self._free = list((nuisance | {f.name: f for effect in other.effects for f in effect.frees}).values())

    def gained(self, name: str) -> float:
        """Return by how much the share that only the true model explains exceeds the gait's, which left the class.

        Negative infinity where what is left is too little to be seen.
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
    """Return the χ² between two sets of values on the `signals` of experiment `name`, `free` of `other` fitted again.

    `weights`: of each checked relation, in its unit, its floor by the root of the samples that count as one.
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
    """Return the checked relations that an experiment can be asked for, and WEIGHT where one hangs at END."""
    if name == "dead_weight":
        return [r for r in weights if r in RELATIONS and r not in ("servo", "knee", "drive_force")] + [WEIGHT]
    return [r for r in weights if r in RELATIONS]


def _reads(relation: str, slot: str) -> bool:
    return slot.startswith("end_") if relation == WEIGHT else slot in uses(RELATIONS[relation])


def _told(name: str, signals: Signals, relation: str, values: Values, weights: Mapping[str, float]) -> Array:
    """Return what a relation predicts on an experiment under `values`, in weights."""
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
    """Return the values of an experiment's second half, where hands have changed the bench in between."""
    if name == "known_bend":
        return {**values, "theta1": BEND * values["theta1"]}
    if name == "swapped_sensors":
        swapped = {f"{here}_{slot}": values[f"{there}_{slot}"] for slot in SENSOR_SLOTS
                   for here, there in (("start", "end"), ("end", "start"))}
        return {**values, **swapped}
    return None


@functools.lru_cache(maxsize=1)  # what their laws remember is larger than a trial
def predicted_signals(name: str, healthy: tuple[tuple[str, float], ...]) -> Signals:
    """Return the signals of an experiment's motion as the bench model predicts them at the values `healthy`.

    Each round predicts START from END over the rope's motion, then winds the rope by as much as the knee angle that
    it gives is off.
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
