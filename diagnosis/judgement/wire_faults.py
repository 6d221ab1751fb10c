"""What wire and converter did to the values, before any law of the bench is asked: their ages and their grid.

The rule of this file: values as they were recorded, never filtered, each column against itself and against healthy
trials; ages where the recorder says them, else repeats, less those that the trial's own noise and grid give by chance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from diagnosis.data.table import AGE_SUFFIX, Table
from diagnosis.judgement.verdict import Figures
from physics import sampling_laws
from physics.effects.catalogue import CATALOGUE, Effect
from physics.laws import Array
from physics.sampling_laws import COUNTED

Values = Mapping[str, float]

SENSORS: Final[Mapping[str, str]] = {"start_sensor": "tension_start_n", "end_sensor": "tension_end_n"}
LEAST_SHARE: Final = 0.005
"""Share of stale values from which the wire is at fault: the least that the catalogue expects."""
UNLIKE: Final = 0.2
"""The same, of the repeats that healthy values show."""
SURE: Final = 6.0
"""The same, in 1σ of what chance gives."""
LEAST_MOVED: Final = 200
"""Samples that differ from their neighbour from which their steps say how often chance repeats one."""
LEAST_SPREAD: Final = 1.5
"""Spread of the steps, in grids, from which the chance of none is that of one."""
LEAST_STEP: Final = 0.1
"""Grid of a sensor, N, below which it is fine enough."""
COARSER: Final = 2.0
"""Grid against the healthy one from which it is at fault."""
LIKELY: Final = 10.0
"""Difference of log-likelihood within which two laws of age both stand."""
SIMPLER: Final = 3.0
"""Log-likelihood that a further parameter must be worth to come first."""
ON_GRID: Final = 1e-3
RAREST: Final = 1e-7
"""Chance of an age below which the law of ages says nothing: some values are late for another reason."""


@dataclass(frozen=True)
class Told:
    """One effect of wire or converter, its values, and how well it explains what was seen (less is better).

    `sigma`: 1σ of its share of the values; a time is of whole cycles and a grid exact.
    """

    effect: Effect
    values: Values
    misfit: float
    sigma: float = 0.0


@dataclass(frozen=True)
class Seen:
    """Counts of each age in cycles, the cycle time, s, and the chance of a repeat by noise and grid (None: true ages).

    `sigma`: 1σ of that chance.
    """

    counts: Array
    cycle_s: float
    chance: float | None
    sigma: float = 0.0

    @property
    def share(self) -> float:
        """Return the share of values that did not come in their cycle, less what chance explains."""
        stale = 1.0 - float(self.counts[0] / self.counts.sum())
        return stale if self.chance is None else max(0.0, 1.0 - (1.0 - stale) / (1.0 - self.chance))

    @property
    def rms_s(self) -> float:
        """Return the root mean square age, s."""
        return self.cycle_s * math.sqrt(float(self.counts @ np.arange(COUNTED + 1) ** 2.0) / self.counts.sum())


def ages(trials: Sequence[Table], healthy: Sequence[Table] = ()) -> Seen | None:
    """Return the values' ages on `trials`; None where neither the recorder nor their own noise tells.

    Values that sit on no grid repeat by chance as often as those of `healthy` trials.
    """
    cycle_s = float(np.median(np.diff(trials[0]["time_s"])))
    known = [values for t in trials for name, values in t.columns.items() if name.endswith(AGE_SUFFIX)]
    if known:
        held = np.concatenate([values[np.isfinite(values)] for values in known])
        return Seen(_counted(np.rint(held * 1e-9 / cycle_s)), cycle_s, None)
    read = [(t, name) for name in SENSORS.values() for t in trials if name in t]
    chances = [_chance(t, name) for t, name in read]
    for i, (given, name) in enumerate(read):
        rest = [_runs(h, name) > 0 for h in healthy if name in h and step(given, name) == step(h, name) == 0.0]
        if rest:
            share = float(np.mean(np.concatenate(rest)))
            chances[i] = Chance(share, 1.0 + share * len(given))
    told = [(_runs(t, name), chance) for (t, name), chance in zip(read, chances, strict=True) if chance is not None]
    if not told:
        return None
    runs = np.concatenate([r for r, _ in told])
    chance = float(np.average([c.share for _, c in told], weights=[r.size for r, _ in told]))
    return Seen(_counted(runs), cycle_s, min(chance, 0.9), math.sqrt(sum(c.variance for _, c in told)) / runs.size)


class Chance(NamedTuple):
    """The share of samples that repeat their neighbour by chance, and the variance of their count."""

    share: float
    variance: float


def _chance(given: Table, name: str) -> Chance | None:
    """Return the chance of a repeat from the column's own steps: as often as one grid step up or down, a little more.

    None where the noise is less than the grid: then nearly every value repeats, and nothing is to be learnt from it.
    """
    values = given[name][np.isfinite(given[name])]
    grid = step(given, name)
    if grid == 0.0:
        return Chance(0.0, 1.0)
    moved = np.rint(np.diff(values) / grid)
    near, away = float(np.sum(np.abs(moved) == 1.0)) / 2.0, moved[moved != 0.0]
    if away.size < LEAST_MOVED:
        return None
    spread = float(np.median(np.abs(away))) / 0.6745
    if spread < LEAST_SPREAD:
        return None
    expected = near * math.exp(0.5 / spread**2)
    return Chance(expected / max(values.size - 1, 1), expected + expected**2 / max(2.0 * near, 1.0))


def _counted(ages: Array) -> Array:
    return np.bincount(np.clip(ages, 0, COUNTED).astype(np.intp), minlength=COUNTED + 1).astype(np.float64)


def _runs(given: Table, name: str) -> Array:
    """Return, by sample, for how many cycles the value has been the same."""
    same = np.concatenate(([False], np.diff(given[name]) == 0.0))
    k = np.arange(same.size)
    return np.asarray(k - np.maximum.accumulate(np.where(same, 0, k)), dtype=np.float64)


def stale(seen: Seen) -> list[Told]:
    """Return the effects that could have made the values stale, the best first; none where they are fresh."""
    if seen.share < max(LEAST_SHARE, UNLIKE * (seen.chance or 0.0), SURE * seen.sigma):
        return []
    told = [_aged(effect, seen) for effect in CATALOGUE.values() if effect.stale is not None]
    best = min(t.misfit for t in told)
    able = [t for t in told if t.misfit - best < LIKELY]
    return sorted(able, key=lambda t: t.misfit + SIMPLER * len(t.effect.parameters))


def _aged(effect: Effect, seen: Seen) -> Told:
    """Fit one effect: what is a time is tried cycle by cycle, the share is fitted."""
    law = effect.stale
    assert law is not None
    times = [p for p in effect.parameters if p.unit == "s"]
    share = next(p for p in effect.parameters if not p.unit)
    tried = []
    for cycles in range(1, COUNTED + 1) if times else (0,):
        held = {p.name: cycles * seen.cycle_s for p in times}
        found = minimize_scalar(lambda p, held=held: _misfit(law({**held, share.name: p}, seen.cycle_s), seen),
                                bounds=(1e-4, 0.95), method="bounded")
        p = float(found.x)
        sigma = math.sqrt(p * (1.0 - p) / float(seen.counts.sum()))
        tried.append(Told(effect, {**held, share.name: p}, float(found.fun), sigma))
    return min(tried, key=lambda t: t.misfit)


def _misfit(law: sampling_laws.Staleness, seen: Seen) -> float:
    """Return the negative log-likelihood of the ages that were seen."""
    expected = sampling_laws.ages(law) if seen.chance is None else sampling_laws.repeats(law, seen.chance)
    return -float(seen.counts @ np.log(np.maximum(expected, RAREST)))


def step(given: Table, name: str) -> float:
    """Return the step of the grid on which all values of a column sit, N; 0 where there is none."""
    values = given[name][np.isfinite(given[name])]
    gaps = np.diff(np.unique(values))
    gaps = gaps[gaps > 1e-9]
    if not gaps.size:
        return 0.0
    least = float(gaps.min())
    off = np.abs(values / least - np.rint(values / least))
    return least if float(np.mean(off < ON_GRID)) > 0.999 else 0.0


def coarse(trials: Sequence[Table], healthy: Sequence[Table]) -> dict[str, tuple[float, float]]:
    """Return, by relation of a sensor, the grid of the trials and of healthy ones, N (0: none is known)."""
    found = {}
    for relation, name in SENSORS.items():
        if all(name in t for t in trials):
            mine, rest = (max((step(t, name) for t in group if name in t), default=0.0) for group in (trials, healthy))
            found[relation] = mine, rest
    return found


@dataclass(frozen=True)
class WireFindings:
    """What was found: effects that stand, the best first, and the figures of the relations that were looked at."""

    told: list[Told]
    figures: dict[str, Figures]

    def causes(self) -> list[dict[str, Any]]:
        """Return the chosen effect as the verdict tells it."""
        return [{"effect": t.effect.name, "site": t.effect.site, "gain_percent": 100.0, "parameters": {
            p.name: _told(t.values[p.name], 0.0 if p.unit else 1.96 * t.sigma, p.unit) for p in t.effect.parameters}}
            for t in self.told[:1]]


def _told(value: float, half: float, unit: str) -> dict[str, Any]:
    return {"value": value, "low": max(0.0, value - half), "high": value + half, "unit": unit}


def examine(trials: Sequence[Table], healthy: Sequence[Table]) -> WireFindings:
    """Say what wire and converter did to the values of `trials`."""
    grids, seen = coarse(trials, healthy), ages(trials, healthy)
    worst = max((mine for mine, rest in grids.values() if mine >= max(LEAST_STEP, COARSER * rest)), default=0.0)
    told = [Told(e, {e.parameters[0].name: worst}, 0.0) for e in CATALOGUE.values() if e.grid is not None and worst]
    figures = {name: Figures("N", True, rest / math.sqrt(12.0), mine / math.sqrt(12.0),
                             (rest if mine >= max(LEAST_STEP, COARSER * rest) else mine) / math.sqrt(12.0))
               for name, (mine, rest) in grids.items()}
    if seen is not None:
        # a coarse grid repeats values by itself
        told = told or stale(seen)
        figures["bus"] = Figures("s", True, None, seen.rms_s, seen.rms_s)
    return WireFindings(told, figures)
