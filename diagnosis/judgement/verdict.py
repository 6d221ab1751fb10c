"""What may be said: before and after on unseen cycles, intervals, the class, and the word for it.

The rule of this file: a figure is of cycles or files that the fit that made it has not seen, an interval comes
from drawing whole cycles again, and what the data do not decide is left undecided.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.problem.candidates import Candidate
from diagnosis.problem.cross_validation import CycleSquares
from diagnosis.search.search import FittedEffects, SearchResult
from physics.effects.effect import Effect

LEAST_GAIN: Final = 0.08
"""Share of a relation's RMSE on unseen cycles that an effect must take away."""
LEAST_FURTHER: Final = 1.0 - math.sqrt(0.7)
"""The same of what the first effect left: three tenths of its χ² beyond noise.  A law that is not quite the bench's own
leaves some of what it explains, and a second one bends to that."""
LEAST_FALL: Final = 40.0
"""χ² that says something at all: the oracle of the family of plants counts from there."""
BENT: Final = 100.0
"""χ² on unseen cycles that an effect must take away which leaves the healthy constants as strained as they were: on
healthy benches some law of the catalogue bends to what the laws leave there and takes up to 96."""
STRUCTURE: Final = 0.12
"""The same, of the χ² that the laws leave on a healthy bench beyond noise."""
MISMATCH: Final = 0.02
"""Share of a relation's whole excess below which a further effect mends only what the first one's law lacks; and of
what an effect takes away, which another relation may lose to it: its law is not quite the bench's own."""
LEAST_RATIO: Final = 80.0
"""n·ln(χ²₀/χ²₁) on unseen cycles that an effect must reach on a rig that nothing is known of."""
STRETCHED: Final = 0.5
"""How far outside of where the catalogue expects it, of that range, a further effect's parameter may be: beyond, it
mends what the first one's law lacks (of a friction that breaks away, a lever arm five times what is likely)."""
FURTHER_ELSEWHERE: Final = 0.3
"""Share of the χ² that the other effects leave in a relation, on unseen cycles, that one more must take away there: no
floor says what the laws' own shortcomings are, and a further law bends to them (a Stribeck curve takes 15 % on a real
cable drive, a tribometer 27 %, after its true causes)."""
LEAST_GAIN_ELSEWHERE: Final = 0.03
MISMATCH_ELSEWHERE: Final = 0.0
"""Shares of RMSE, and of the baseline's whole χ², that it must take away there."""
LAW: Final = 0.10
"""1σ of a parameter that another bench's laws cost, of its change: with it intervals cover 93.6 % of the 110 parameters
that the family's serials below 800 have (with 0.06, from another structure of tests/hidden, 90.9 %)."""
RIVAL_RMSE: Final = 0.10
RIVAL_GAIN: Final = 0.85
WORTH_A_LOOK: Final = 1.5
"""Cost of a fit, of the chosen one's, from which a model is no rival whatever unseen cycles say."""
STRANGE: Final = 1.33
"""RMSE on unseen cycles, in healthy floors, that no longer counts as healthy: like benches differ by so much."""
WANTING: Final = 1.2
"""The same from which, where none of the foremost effects pays, all are fitted."""
STRANGE_FALL: Final = 2.0 * BENT
"""χ² above a healthy trial's that a relation must have, too: a small one's floor is soon exceeded by a third."""
STRANGE_NAMED: Final = 0.225
"""The same where an effect was chosen: RMSE less one floor, times the share of the excess χ² that it left."""
STRANGE_SHARE: Final = 0.15
"""Share of the excess over healthy χ² that may remain as the chosen law's own mismatch."""
OPEN: Final = 0.1
"""Excess of a relation over its healthy χ², in that, from which a further effect is looked for."""
STRAINED: Final = 15.0
"""What the nuisance pays for standing away from what is known of it, from which an effect may be behind that; and by
which an effect may not raise it: a true cause relaxes the rest, a false one bends it."""
TWICE: Final = 2.0
THRICE: Final = 3.0
"""Standard deviations of χ² above its mean from which what the nuisance pays is no chance: one trial in twenty, where
that only costs a search of all effects, one in a thousand, where it opens the door to a second name."""
CERTAIN: Final = 2.0
"""Departure from the healthy value, in 1σ of the fit, below which a value says nothing."""
MATERIAL: Final = 0.5
"""Departure from absence that is a find, of the least that the catalogue expects (of a tenth of its largest, where
absence lies among what is expected)."""
DRAWS: Final = 400


def least_fall(structure: float, elsewhere: bool = False) -> float:
    """Return the χ² that an effect must take away on unseen cycles.

    `structure`: χ² that the laws leave on a healthy bench beyond noise, some law of the catalogue may bend to it.
    `elsewhere`: a rig of another kind, where an effect must take `FURTHER_ELSEWHERE` besides.
    """
    return max(LEAST_FALL if elsewhere else BENT, STRUCTURE * structure)


@dataclass(frozen=True)
class Figures:
    """One relation, in its unit: RMSE on held-out cycles and on holdout files, gain in % with its 95 % interval."""

    unit: str
    checked: bool
    floor: float | None = None
    rmse_before: float | None = None
    rmse_after: float | None = None
    holdout_before: float | None = None
    holdout_after: float | None = None
    gain_percent: float | None = None
    low: float | None = None
    high: float | None = None


def gain(before: CycleSquares, after: CycleSquares, relation: str) -> tuple[float, float, float]:
    """Return the gain in RMSE, %, and its 95 % interval from drawing whole cycles again."""
    a, _ = before.arrays(relation)
    b, _ = after.arrays(relation)
    draw = np.random.default_rng(0).integers(0, len(a), (DRAWS, len(a)))
    gains = 100.0 * (1.0 - np.sqrt(b[draw].sum(axis=1) / a[draw].sum(axis=1)))
    low, high = np.percentile(gains, [2.5, 97.5])
    return 100.0 * (1.0 - math.sqrt(b.sum() / a.sum())), float(low), float(high)


def cut(lesser: FittedEffects, model: FittedEffects, noise: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return, by relation, the share of RMSE on unseen cycles that `model` takes from `lesser`.

    `noise`: χ² by relation that no law can take away.
    """
    shares = {}
    for name, before in lesser.by_relation.items():
        after, least = model.by_relation[name], noise[name] if noise else 0.0
        if before > least:
            shares[name] = 1.0 - math.sqrt(max(after - least, 0.0) / (before - least))
    return shares


def rivals(found: SearchResult, says: Callable[[Candidate, FittedEffects], bool],
           pays: Callable[[FittedEffects, FittedEffects], bool]) -> tuple[str, ...]:
    """Return the effects that could stand in the chosen model, the chosen ones first.

    A rival takes the place of one chosen effect, with at least `RIVAL_GAIN` of what that one gains and within
    `RIVAL_RMSE` of the chosen model's RMSE; or, of a faint one, where it pays in that place and leaves less than
    `LEAST_FALL` more.  `says`: whether an effect is one in a model; a law that is freed with its level, at a value that
    says nothing, stands for the level alone.  `pays`: whether a model is worth what it has more than a lesser one.
    """
    best, others = found.best, dict[str, float]()
    for out in best.effects:
        left = found.model([c.name for c in best.effects if c is not out])
        if left is None:
            continue
        for model in found.models:
            strange = set(model.names) - set(best.names)
            if len(model.names) != len(best.names) or set(best.names) - set(model.names) != {out.name}:
                continue
            if model.fit.cost > WORTH_A_LOOK * best.fit.cost:
                continue
            # what either all cycles or unseen ones do not tell apart
            share = max((left.score - model.score) / max(left.score - best.score, 1e-9),
                        (left.fit.cost - model.fit.cost) / max(left.fit.cost - best.fit.cost, 1e-9))
            rival = next(c for c in model.effects if c.name in strange)
            if not says(rival, model):
                continue
            near = share >= RIVAL_GAIN and math.sqrt(max(model.score, 0.0) / best.score) - 1.0 <= RIVAL_RMSE
            apart = min(model.score - best.score, 2.0 * (model.fit.cost - best.fit.cost))
            if near or (apart < LEAST_FALL and pays(left, model)):
                others[strange.pop()] = model.rank
    return (*(c.name for c in best.effects), *sorted(others, key=lambda n: others[n]))


def unsplit(found: SearchResult, structure: float, differs: Callable[[Candidate, FittedEffects], bool]
            ) -> tuple[str, ...]:
    """Return what an experiment leaves of a class, the chosen effects first.

    A rival goes when it leaves more of χ² than the chosen effects, on unseen cycles and on all, by what an effect has
    to take to be one (`least_fall`, of the `structure` that the laws leave of healthy trials), or where its value does
    not differ from the healthy one.
    """
    best, least, others = found.best, least_fall(structure), dict[str, float]()
    for model in found.models:
        strange = [c for c in model.effects if c.name not in best.names]
        if len(model.names) == len(best.names) and len(strange) == 1 and differs(strange[0], model) and min(
                model.score - best.score, 2.0 * (model.fit.cost - best.fit.cost)) < least:
            others[strange[0].name] = model.rank
    return (*(c.name for c in best.effects), *sorted(others, key=lambda n: others[n]))


def material(effect: Effect, name: str, change: float) -> bool:
    """Whether a change from the healthy value is a share of what the catalogue expects of the effect.

    A shape without absence says nothing alone.
    """
    parameter = next((p for p in effect.parameters if p.name == name), None)
    if parameter is None or parameter.neutral is None:
        return False
    low, high = (end - parameter.neutral for end in parameter.likely)
    nearest = min(abs(low), abs(high)) if low * high > 0.0 else 0.1 * max(abs(low), abs(high))
    return abs(change) >= MATERIAL * nearest


def spread(fitted: Sequence[Mapping[str, float]], name: str, sigma: float, likeness: float, change: float) -> float:
    """Return the half width of a 95 % interval: what folds and curvature say, like benches, and the law's mismatch.

    `sigma`: from the curvature; `likeness`: 1σ of the healthy value; `change`: what the effect has moved it by.
    """
    values = np.array([f[name] for f in fitted])
    k = len(values)
    jackknife = math.sqrt((k - 1) / k * float(((values - values.mean()) ** 2).sum())) if k > 1 else 0.0
    # a rig's stiffness is not known to a share of an ideal one's
    return 1.96 * math.hypot(max(jackknife, sigma), likeness, LAW * min(abs(change), abs(float(values.mean()))))


def curvature_sigma(model: FittedEffects, name: str) -> float:
    """Return 1σ of a parameter from the fit's curvature."""
    scale = np.sqrt(np.maximum(np.diag(model.fit.curvature), 1e-300))
    even = model.fit.curvature / np.outer(scale, scale)
    at = [f.name for f in model.fit.free].index(name)
    covariance = np.linalg.pinv(even, rcond=1e-10) / np.outer(scale, scale)
    return math.sqrt(max(float(covariance[at, at]), 0.0))
