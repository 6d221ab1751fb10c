"""The constants of a rig of another kind, from its reference trials: a seal, a turning axis, a cable drive, a motor.

The rule of this file: the search of the diagnosis says which terms the rig has (Coulomb friction, inertia,
unbalance …); a second search, on the first part of each trial alone, says how well they predict the rest.
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
"""1σ, of a constant's value or of the scale on which it is searched, below which the trials have said something."""

PROMISING: Final = 3
"""Further terms that are fitted in full, the most promising by their slopes."""
LOWERED: Final = 0.02
"""Share of the squared error on unseen cycles by which a further term lowers it at least: 1 % of the RMSE."""
NO_TERMS: Final = ("START sensor", "END sensor", "converter", "supply", "bus")
"""Sites of effects that are faults and no terms of a rig; nor is a gain of the force, beside free friction."""


class RigConstant(NamedTuple):
    """A constant of a rig: its value, and its 95 % interval by the fit's curvature, in its SI unit."""

    value: float
    low: float
    high: float


class FittedRig(NamedTuple):
    """What reference trials say of a rig.

    `effects`: the terms that an ideal transmission lacks; `on_bounds`: sentences on those that the bounds of the search
    stopped; `constants`: by name of `physics.parameters`; `relations`:
    for each relation that was checked its unit, `left`, RMSE of the fit, and `unseen`, RMSE on the last part of each
    trial, which a fit of its own had not seen, beside the `spread` of what is predicted there.
    """

    effects: tuple[str, ...]
    on_bounds: tuple[str, ...]
    constants: dict[str, RigConstant]
    relations: dict[str, dict[str, Any]]


def fit(first: Sequence[Table], rest: Sequence[Table], whole: Sequence[Table]) -> FittedRig:
    """Fit a rig to `whole` trials, and judge a fit to their `first` parts on the `rest`.

    Raises `InputError` where no relation between the columns can be checked.
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
    """Return what the trials are compared on, and the search of the diagnosis over it."""
    setting = build_problem(tables, HealthyTrials(), None)
    if not setting.checked:
        lacks = "; ".join(f"{n} lacks {', '.join(c)}" for n, c in setting.missing.items() if c)
        raise InputError(f"{', '.join(t.source for t in tables)}: no relation can be fitted ({lacks}); give trials "
                         "with the columns of one.")
    return setting, Judge(setting, ())


def _completed(found: Judge) -> FittedEffects:
    """Return what the search chose, with every further term that lowers the error on cycles that a fit had not seen.

    A verdict names a term where it is certain; a prediction wants it where it helps.
    """
    model = found.found.best
    terms = [c for c in found.search.offered if c.site not in NO_TERMS and c.name != "demand_gain"]
    while True:
        more = min(found.search.grow(model, PROMISING, terms), key=lambda m: m.score, default=model)
        if more.score >= (1.0 - LOWERED) * model.score:
            return model
        model = more


def _constants(model: FittedEffects) -> dict[str, RigConstant]:
    """Return the constants that the trials determine, each within the bounds that its table states."""
    found = {}
    for free in model.fit.free:
        sigma, at = verdict.curvature_sigma(model, free.name), model.fit.values[free.name]
        if not 0.0 < sigma < TOLD * max(free.scale, abs(at)):
            continue
        low, high = RELATION_PARAMETERS[free.name].rig_bounds if free.name in RELATION_PARAMETERS else (
            free.low, free.high)
        found[free.name] = RigConstant(at, max(at - 1.96 * sigma, low), min(at + 1.96 * sigma, high))
    return found
