"""Detection limits of an experiment before it is recorded: the smallest size of each effect that it would show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from diagnosis.evidence.decision import SET_SHARE
from diagnosis.evidence.detection_limits import DetectionLimit, detection_limits
from diagnosis.evidence.evidence_finder import EvidenceFinder
from estimation.data import integrity
from estimation.data.table import Table
from estimation.likelihood_data import MOTION
from estimation.posterior import SessionData, mode
from parameters import InputError
from physics.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class EffectLimit:
    """Detection limit of one effect in an experiment.

    `size`: smallest visible departure of the parameter (None: not visible).  `signal`: output with the largest
    response.  `like`: effects with about the same response.
    """

    effect: str
    site: str
    parameter: str
    unit: str
    size: float | None
    likely: tuple[float, float]
    signal: str | None
    like: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """Detection limits of an experiment; `signals`: by output, unit and `floor`, the error in the reference condition.

    `blind`: effects of the catalogue that change no output of the experiment.
    """

    limits: tuple[EffectLimit, ...]
    signals: Mapping[str, Mapping[str, Any]]
    blind: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the plan as plain values; `smallest` is null for an effect that is not visible."""
        return {"signals": {name: dict(row) for name, row in self.signals.items()},
                "effects": [{"effect": one.effect, "site": one.site, "parameter": one.parameter, "unit": one.unit,
                             "smallest": one.size, "likely": list(one.likely), "signal": one.signal,
                             "like": list(one.like)} for one in self.limits],
                "blind": list(self.blind)}


def plan(simulated: Table, healthy: Sequence[Table] = (), calibration: Mapping[str, Any] | None = None) -> Plan:
    """Return the detection limits of an experiment, from a simulated trial of it in the reference condition.

    `healthy`: reference trials of the bench (none: the bench population and its `calibration`).  Raises `InputError` if
    the trial cannot be simulated.
    """
    given = integrity.usable(simulated, MOTION)
    finder = EvidenceFinder([integrity.usable(t, MOTION) for t in healthy], calibration=calibration)
    refused = finder.lacking([given])
    if refused:
        raise InputError(refused)
    with threadpool_limits(1, user_api="blas"):
        reference = finder.reference([given])
        observed = reference.observe(finder.model.record(given))
        null = mode(observed, reference.prior_of(observed), start=reference.starts()[0])
        limits = detection_limits(observed, null, finder.model.constants.named(reference.bench_coordinates()))
    return Plan(tuple(_limit(name, limit, observed, limits) for name, limit in limits.items()),
                {name: {"unit": finder.model.signals[name], "floor": reference.scatter_n[name]}
                 for name in reference.outputs},
                tuple(name for name in CATALOGUE if name not in limits))


def _limit(
    name: str, limit: DetectionLimit, observed: SessionData, limits: Mapping[str, DetectionLimit],
) -> EffectLimit:
    own = limit.response
    shares = [float(observed.part(own.effect, k) @ observed.part(own.applied, k)) for k in range(len(observed.outputs))]
    like = tuple(other for other, one in limits.items() if other != name and one.value is not None
                 and own.alike(one.response) >= 1.0 - 0.5 * SET_SHARE)
    declared = next(p for p in CATALOGUE[name].parameters if p.name == limit.parameter)
    seen = limit.value is not None
    return EffectLimit(name, CATALOGUE[name].site, limit.parameter, limit.unit, limit.value, declared.likely,
                       observed.outputs[int(np.argmax(shares))] if seen else None, like if seen else ())
