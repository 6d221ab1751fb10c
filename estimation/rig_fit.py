"""Identification of a rig other than the bench (seal, turning axis, cable drive, motor) from its reference trials.

The constants are those of the forward model of rigs, stated as parameters of `physics.parameters`.  A second fit, to
the first part of each trial alone, measures how well such a model predicts the last part.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from estimation.data.table import Table
from estimation.fitted_quantities import quantities
from estimation.joint_fit import fit_reference
from estimation.reference_fit import ReferenceFit
from estimation.rig_model import RigModel, rig_model_of
from physics.laws import Array
from physics.parameters import ESTIMATED


@dataclass(frozen=True)
class Constant:
    """One fitted constant: value, 95 % interval, unit, and whether the data determine its value."""

    value: float
    low: float
    high: float
    unit: str
    determined: bool


class FittedRig(NamedTuple):
    """Rig as identified from its reference trials.

    `effects`: terms that an ideal transmission lacks.  `constants`: by name of `physics.parameters`.  `signals`: by
    output its `unit`; `left`, what reference trials miss of each other; `unseen`, the RMSE on the last part of each
    trial, predicted by a fit to the first part; and `spread`, the RMS variation of the output in the last part.
    """

    effects: tuple[str, ...]
    constants: dict[str, Constant]
    signals: dict[str, dict[str, Any]]


def fit(first: Sequence[Table], rest: Sequence[Table], whole: Sequence[Table]) -> FittedRig:
    """Fit a rig to `whole` trials, and test a second fit, to their `first` parts, on the `rest`.

    Raises `InputError` if the columns have no output of the forward model.
    """
    model, fitted = _fitted(whole)
    early, judged = _fitted(first)
    ahead = judged.observe(*(early.record(t) for t in rest))
    signals: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(judged.outputs):
        measured = [trial.part(trial.data, k) for trial in ahead.trials]
        signals[name] = {"unit": model.signals[name], "left": fitted.scatter_n[name],
                         "unseen": _rms(ahead.part(judged.missed(ahead), k)),
                         "spread": _rms(np.concatenate([v - v.mean() for v in measured]))}
    constants = _constants(model, fitted)
    terms = tuple(name for name, hypothesis in model.hypotheses.items()
                  if _beside_ideal(next(iter(hypothesis.reads)), constants))
    return FittedRig(terms, constants, signals)


def _beside_ideal(parameter: str, constants: Mapping[str, Constant]) -> bool:
    """Return whether the interval of a parameter excludes its value in an ideal transmission."""
    if parameter not in constants:
        return False
    return not constants[parameter].low <= ESTIMATED[parameter].in_ideal <= constants[parameter].high


def _fitted(tables: Sequence[Table]) -> tuple[RigModel, ReferenceFit]:
    model = rig_model_of(tables, tables)
    sessions: Any = model.sessions([model.record(t) for t in tables])
    return model, fit_reference(model, sessions)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _constants(model: RigModel, fitted: ReferenceFit) -> dict[str, Constant]:
    """Return the constants that the trials determine, each with an interval inside the bounds of its table."""
    found = {}
    for name, own in quantities(fitted, lambda v: {n: read(v, v) for n, read in model.stated().items()}, 1.0).items():
        if own.determined:
            (low, high), unit = ESTIMATED[name].rig_bounds, model.rig.unit(ESTIMATED[name].unit)
            inside = [min(max(each, low), high) for each in (own.value, *own.interval())]
            found[name] = Constant(inside[0], inside[1], inside[2], unit, True)
    return found
