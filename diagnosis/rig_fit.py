"""Identification of a rig other than the bench (seal, turning axis, cable drive, motor) from its reference trials.

The search of the diagnosis selects the terms of the rig (Coulomb friction, inertia, unbalance …).  A second search, on
the first part of each trial alone, measures how well such a model predicts the last part.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from diagnosis.data.table import Table
from diagnosis.judgement import verdict
from diagnosis.judgement.judge import Judge
from diagnosis.problem import blocks
from diagnosis.problem.healthy_trials import HealthyTrials
from diagnosis.problem.problem import ProblemSetting, build_problem
from diagnosis.search.search import FittedEffects
from parameters import InputError
from physics.parameters import RELATION_PARAMETERS

TOLD: Final = 0.7
"""Largest 1σ of a determined constant, relative to its value or to its search scale, whichever is larger."""

PROMISING: Final = 3
"""Number of further terms fitted in full in each round: those that a linear screen ranks first."""
LOWERED: Final = 0.02
"""Least share by which a further term must lower the squared error on held-out cycles: about 1 % of the RMSE."""
NO_TERMS: Final = ("START sensor", "END sensor", "converter", "supply", "bus")
"""Sites of effects that are faults and therefore no terms of a rig.

`_completed` excludes `demand_gain`, too: a gain of the force is confounded with free friction."""


class RigConstant(NamedTuple):
    """Constant of a rig in its SI unit: value, and 95 % interval from the curvature of the fit."""

    value: float
    low: float
    high: float


class FittedRig(NamedTuple):
    """Rig as identified from its reference trials.

    `effects`: terms that an ideal transmission lacks.  `on_bounds`: sentences on terms that reached a bound of the
    search.  `constants`: by name of `physics.parameters`.  `relations`: by prediction equation its `unit`; `left`, the
    RMSE of the fit; `unseen`, the RMSE on the last part of each trial, predicted by a fit to the first part; and
    `spread`, the RMS variation of the measured output in the last part.
    """

    effects: tuple[str, ...]
    on_bounds: tuple[str, ...]
    constants: dict[str, RigConstant]
    relations: dict[str, dict[str, Any]]


def fit(first: Sequence[Table], rest: Sequence[Table], whole: Sequence[Table]) -> FittedRig:
    """Fit a rig to `whole` trials, and test a second fit, to their `first` parts, on the `rest`.

    Raises `InputError` if the columns allow no prediction equation.
    """
    setting, found = _searched(whole)
    model, judged = _completed(found), _completed(_searched(first)[1])
    ahead = [b for b in blocks.blocks_of(rest, setting.checked, None, setting.rate_hz) if b.keep.size]
    relations: dict[str, dict[str, Any]] = {}
    for name in setting.checked:
        mine = [b for b in ahead if b.relation.name == name]
        relations[name] = {
            "unit": next(b.relation.unit for b in setting.blocks if b.relation.name == name),
            "left": blocks.rmse(b.residual(model.fit.values) for b in setting.blocks if b.relation.name == name),
            "unseen": blocks.rmse(b.residual(judged.fit.values) for b in mine) if mine else None,
            "spread": blocks.rmse(v - v.mean() for b in mine
                                  for v in (b.signals[b.relation.output][b.keep],)) if mine else None}
    return FittedRig(tuple(model.names), tuple(found.on_bounds()), _constants(model), relations)


def _searched(tables: Sequence[Table]) -> tuple[ProblemSetting, Judge]:
    """Return the problem that the trials define, and the search of the diagnosis over that problem."""
    setting = build_problem(tables, HealthyTrials(), None)
    if not setting.checked:
        lacks = "; ".join(f"{n} lacks {', '.join(c)}" for n, c in setting.missing.items() if c)
        raise InputError(f"{', '.join(t.source for t in tables)}: no relation can be fitted ({lacks}); give trials "
                         "with the columns of one.")
    return setting, Judge(setting, ())


def _completed(found: Judge) -> FittedEffects:
    """Return the model of the search with every further term that lowers the held-out error by `LOWERED` or more.

    The verdict of a diagnosis needs certainty of each term; a prediction only needs a lower held-out error.
    """
    model = found.found.best
    terms = [c for c in found.search.offered if c.site not in NO_TERMS and c.name != "demand_gain"]
    while True:
        more = min(found.search.grow(model, PROMISING, terms), key=lambda m: m.score, default=model)
        if more.score >= (1.0 - LOWERED) * model.score:
            return model
        model = more


def _constants(model: FittedEffects) -> dict[str, RigConstant]:
    """Return the constants that the trials determine, each with an interval inside the bounds of its table."""
    found = {}
    for free in model.fit.free:
        sigma, at = verdict.curvature_sigma(model, free.name), model.fit.values[free.name]
        if not 0.0 < sigma < TOLD * max(free.scale, abs(at)):
            continue
        low, high = RELATION_PARAMETERS[free.name].rig_bounds if free.name in RELATION_PARAMETERS else (
            free.low, free.high)
        found[free.name] = RigConstant(at, max(at - 1.96 * sigma, low), min(at + 1.96 * sigma, high))
    return found
