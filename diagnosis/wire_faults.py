"""Faults of bus and converter, found before any submodel of the bench is fitted: staleness and quantisation of values.

Values are used as recorded, without filtering. Each column is compared with itself and with reference trials. Staleness
is taken from the recorder's ages if available, else from repeated values. Repeats by chance, due to the trial's own
noise and quantisation, are subtracted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from diagnosis.compared_signals import Figures
from diagnosis.evidence.decision import NAMED_NATS
from estimation.data.table import AGE_SUFFIX, Table
from estimation.posterior import SURROGATE
from physics import sampling_laws
from physics.effects.catalogue import CATALOGUE, Effect
from physics.laws import Array
from physics.sampling_laws import COUNTED

Values = Mapping[str, float]

SENSORS: Final[Mapping[str, str]] = {"start_sensor": "tension_start_n", "end_sensor": "tension_end_n"}


@dataclass(frozen=True)
class FittedFault:
    """Effect of bus or converter that was fitted: its values, and its misfit to the observed ages (less is better).

    `sigma`: 1σ of its share of the values; a time is a number of complete cycles, a quantisation step exact.
    """

    effect: Effect
    values: Values
    misfit: float
    sigma: float = 0.0


@dataclass(frozen=True)
class AgeHistogram:
    """Counts of each age in cycles, the cycle time, s, and the chance of a repeat by noise and quantisation.

    `chance`: None if the counts are true ages. `sigma`: 1σ of that chance, by counting and by its model (`SURROGATE`).
    """

    counts: Array
    cycle_s: float
    chance: float | None
    sigma: float = 0.0

    @property
    def share(self) -> float:
        """Return the share of values that did not arrive in their cycle, less the repeats by chance."""
        stale = 1.0 - float(self.counts[0] / self.counts.sum())
        return stale if self.chance is None else max(0.0, 1.0 - (1.0 - stale) / (1.0 - self.chance))

    @property
    def rms_s(self) -> float:
        """Return the root mean square age, s."""
        return self.cycle_s * math.sqrt(float(self.counts @ np.arange(COUNTED + 1) ** 2.0) / self.counts.sum())


def ages(trials: Sequence[Table], healthy: Sequence[Table] = ()) -> AgeHistogram | None:
    """Return the ages of values on `trials`; None if neither the recorder nor the values' own noise determines them.

    Values without quantisation repeat by chance as often as those of `healthy` trials.
    """
    cycle_s = float(np.median(np.diff(trials[0]["time_s"])))
    known = [values for t in trials for name, values in t.columns.items() if name.endswith(AGE_SUFFIX)]
    if known:
        held = np.concatenate([values[np.isfinite(values)] for values in known])
        return AgeHistogram(_counted(np.rint(held * 1e-9 / cycle_s)), cycle_s, None)
    read = [(t, name) for name in SENSORS.values() for t in trials if name in t]
    chances = [_chance(t, name) for t, name in read]
    for i, (given, name) in enumerate(read):
        rest = [_runs(h, name) > 0 for h in healthy if name in h and step(given, name) == step(h, name) == 0.0]
        if rest:
            share = float(np.mean(np.concatenate(rest)))
            chances[i] = Chance(share, 1.0 + share * len(given))
    runs_of = [(_runs(t, name), chance) for (t, name), chance in zip(read, chances, strict=True) if chance is not None]
    if not runs_of:
        return None
    runs = np.concatenate([r for r, _ in runs_of])
    chance = float(np.average([c.share for _, c in runs_of], weights=[r.size for r, _ in runs_of]))
    sigma = math.hypot(math.sqrt(sum(c.variance for _, c in runs_of)) / runs.size, SURROGATE * chance)
    return AgeHistogram(_counted(runs), cycle_s, min(chance, 0.9), sigma)


class Chance(NamedTuple):
    """Share of samples that repeat their neighbour by chance, and the variance of their count."""

    share: float
    variance: float


def _chance(given: Table, name: str) -> Chance | None:
    """Return the chance of a repeat from the column's steps: slightly above that of one quantisation step.

    None if most values that differ from their neighbour differ by one step, which is as large as the noise: then
    nearly every value repeats, which carries no information.
    """
    values = given[name][np.isfinite(given[name])]
    grid = step(given, name)
    if grid == 0.0:
        return Chance(0.0, 1.0)
    moved = np.rint(np.diff(values) / grid)
    near, away = float(np.sum(np.abs(moved) == 1.0)) / 2.0, moved[moved != 0.0]
    typical = float(np.median(np.abs(away))) if away.size else 0.0
    if typical <= 1.0:
        return None
    expected = near * math.exp(0.5 * (norm.ppf(0.75) / typical) ** 2)
    return Chance(expected / max(values.size - 1, 1), expected + expected**2 / max(2.0 * near, 1.0))


def _counted(ages: Array) -> Array:
    return np.bincount(np.clip(ages, 0, COUNTED).astype(np.intp), minlength=COUNTED + 1).astype(np.float64)


def _runs(given: Table, name: str) -> Array:
    """Return, by sample, for how many cycles the value has been constant."""
    same = np.concatenate(([False], np.diff(given[name]) == 0.0))
    k = np.arange(same.size)
    return np.asarray(k - np.maximum.accumulate(np.where(same, 0, k)), dtype=np.float64)


def stale(histogram: AgeHistogram) -> list[FittedFault]:
    """Return the effects that could have made the values stale, the best first; empty if the values are fresh.

    Stale: the share is one that the catalogue expects, and its Gaussian log-likelihood ratio, ½z², is `NAMED_NATS` or
    more.  Models within `NAMED_NATS` of the best are ranked with ½·ln(samples) for each parameter (BIC).
    """
    effects = [effect for effect in CATALOGUE.values() if effect.stale is not None]
    least = min(p.likely[0] for effect in effects for p in effect.parameters if not p.unit)
    if histogram.share < max(least, math.sqrt(2.0 * NAMED_NATS) * histogram.sigma):
        return []
    faults = [_aged(effect, histogram) for effect in effects]
    best = min(t.misfit for t in faults)
    able = [t for t in faults if t.misfit - best < NAMED_NATS]
    return sorted(able, key=lambda t: t.misfit + 0.5 * math.log(histogram.counts.sum()) * len(t.effect.parameters))


def _aged(effect: Effect, histogram: AgeHistogram) -> FittedFault:
    """Fit one effect: its time by trying each number of cycles, its share by maximum likelihood."""
    law = effect.stale
    assert law is not None
    times = [p for p in effect.parameters if p.unit == "s"]
    share = next(p for p in effect.parameters if not p.unit)
    tried = []
    for cycles in range(1, COUNTED + 1) if times else (0,):
        held = {p.name: cycles * histogram.cycle_s for p in times}
        found = minimize_scalar(
            lambda p, held=held: _misfit(law({**held, share.name: p}, histogram.cycle_s), histogram),
            bounds=(1e-4, 0.95), method="bounded")
        p = float(found.x)
        sigma = math.sqrt(p * (1.0 - p) / float(histogram.counts.sum()))
        tried.append(FittedFault(effect, {**held, share.name: p}, float(found.fun), sigma))
    return min(tried, key=lambda t: t.misfit)


def _misfit(law: sampling_laws.Staleness, histogram: AgeHistogram) -> float:
    """Return the negative log-likelihood of the observed ages under `law`; no age counts as rarer than 1 in all."""
    expected = sampling_laws.ages(law) if histogram.chance is None else sampling_laws.repeats(law, histogram.chance)
    return -float(histogram.counts @ np.log(np.maximum(expected, 1.0 / histogram.counts.sum())))


def step(given: Table, name: str) -> float:
    """Return the quantisation step of all values of a column, N; 0 if the values are not quantised."""
    values = given[name][np.isfinite(given[name])]
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-9]
    if not gaps.size:
        return 0.0
    least = float(gaps.min())
    return least if np.allclose(values / least, np.rint(values / least), atol=1e-3) else 0.0


def coarse(trials: Sequence[Table], healthy: Sequence[Table]) -> dict[str, tuple[float, float]]:
    """Return, by equation of a sensor, the quantisation step of the trials and of reference ones, N (0: unknown)."""
    found = {}
    for relation, name in SENSORS.items():
        if all(name in t for t in trials):
            mine, rest = (max((step(t, name) for t in group if name in t), default=0.0) for group in (trials, healthy))
            found[relation] = mine, rest
    return found


@dataclass(frozen=True)
class WireFindings:
    """Accepted effects of bus and converter, the best first, and the figures of the equations examined."""

    faults: list[FittedFault]
    figures: dict[str, Figures]

    def causes(self) -> list[dict[str, Any]]:
        """Return the chosen effect in the form of a verdict's causes."""
        return [{"effect": t.effect.name, "site": t.effect.site, "gain_percent": 100.0, "parameters": {
            p.name: _estimate(t.values[p.name], 0.0 if p.unit else 1.96 * t.sigma, p.unit)
            for p in t.effect.parameters}}
            for t in self.faults[:1]]


def _estimate(value: float, half: float, unit: str) -> dict[str, Any]:
    return {"value": value, "low": max(0.0, value - half), "high": value + half, "unit": unit}


def examine(trials: Sequence[Table], healthy: Sequence[Table]) -> WireFindings:
    """Return the effects of bus and converter on the values of `trials`."""
    grids, histogram = coarse(trials, healthy), ages(trials, healthy)
    (effect,) = (e for e in CATALOGUE.values() if e.grid is not None)
    quantum = effect.parameters[0]
    coarser = {name: mine for name, (mine, rest) in grids.items() if mine > rest and mine >= quantum.likely[0]}
    faults = [FittedFault(effect, {quantum.name: max(coarser.values())}, 0.0)] if coarser else []
    figures = {name: Figures("N", rest / math.sqrt(12.0), mine / math.sqrt(12.0), mine / math.sqrt(12.0),
                             (rest if name in coarser else mine) / math.sqrt(12.0))
               for name, (mine, rest) in grids.items()}
    if histogram is not None:
        # a coarse quantisation repeats values, too
        faults = faults or stale(histogram)
        figures["bus"] = Figures("s", None, histogram.rms_s, histogram.rms_s, histogram.rms_s)
    return WireFindings(faults, figures)
