"""Reference of a diagnosis: parameter values in the reference condition, and bands inside which no effect is reported.

A band combines the interval of a calibration and the spread of the bench population. On a rig of another kind the
reference is an ideal transmission without bands: every departure from it is an effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from diagnosis.data.table import Table
from diagnosis.problem.blocks import Block
from diagnosis.problem.prior import NOTHING_TOGETHER, Free, Prior
from physics import bench_model
from physics.bench_model import BenchModel
from physics.calibration import ScalarEvidence
from physics.effects.catalogue import CATALOGUE
from physics.parameters import PARAMETERS, RELATION_PARAMETERS, healthy, ideal
from physics.plant.leg import KNEE_AT_FIT

BAND: Final = 3.0
"""Half width of a hard band, in 1σ of the bench population."""
LIKE_THIS_BENCH: Final = (0.7, 1.4)
"""Range of rope per knee angle, relative to the bench's own, in which a trial is attributed to such a bench."""


@dataclass(frozen=True)
class HealthyReference:
    """Reference values, and the parameters that a baseline fit may move; `kind`: calibration, nominal, healthy or none.

    `measured`: 1σ of the values that a calibration measured on this bench. `prior`: joint covariance of the reference
    values.
    """

    kind: str
    values: Mapping[str, float]
    nuisance: tuple[Free, ...]
    measured: Mapping[str, float] = field(default_factory=dict)
    prior: Prior = NOTHING_TOGETHER

    def within(self, band: Free, rest: Sequence[Free], values: Mapping[str, float]) -> bool:
        """Whether a value lies in its reference band, conditional on the constants `rest` at `values`."""
        mean, sigma = self.prior.expected(band, rest, values)
        return max(band.low, mean - BAND * sigma) < values[band.name] < min(band.high, mean + BAND * sigma)


IDENTIFIED: Final = ("mu1", "mu2", "phi0", "fabric_wrap", "cable_share", "presliding", "rope_per_knee", "rope_zero",
                     "stiffness_scale", "stiffness_shape", "servo_bandwidth", "servo_delay", "start_offset")
"""Parameters taken from a calibration by identification; all others keep their nominal reference value."""


def of_bench(calibration: Mapping[str, Any] | None) -> HealthyReference:
    """Return the reference of the bench in the signal table, with values of `calibration` where available."""
    values = {**healthy(), **_brought()}
    model = bench_model.from_tables(calibration or {}, "calibration")
    nuisance, spreads, told, known = [], _spreads(model), model.related(), model.at_work()
    values |= known
    measured = _measured(model)
    for name, p in RELATION_PARAMETERS.items():
        if name in measured:
            values[name] = told.get(name, p.nominal)
        values[name] = known.get(name, values[name])
        sigma = math.hypot(p.like_benches, spreads.get(name, 0.0))
        if sigma > 0.0:
            at, (low, high) = values[name], p.rig_bounds
            nuisance.append(Free(name, max(low, at - BAND * sigma), min(high, at + BAND * sigma), at, sigma, sigma))
    return HealthyReference("nominal" if calibration is None else "calibration", values, tuple(nuisance),
                            {n: math.hypot(sigma, _daily(n, values[n])) for n, sigma in _spreads(
                                model, ScalarEvidence.interval).items()})


def _measured(model: BenchModel) -> tuple[str, ...]:
    """Return the parameters that a model provides: all related ones if it was fitted to trials, else `IDENTIFIED`."""
    return tuple(model.related()) if model.fitted else IDENTIFIED


def _daily(name: str, value: float) -> float:
    """Return 1σ of a parameter between sessions; a tolerance is the half width of a uniform distribution."""
    tolerance = RELATION_PARAMETERS[name].daily
    if tolerance is None:
        return 0.0
    return tolerance.size * (abs(value) if tolerance.law == "factor" else 1.0) / math.sqrt(3.0)


def _spreads(model: BenchModel, ends: Callable[[ScalarEvidence, float], tuple[float, float]] = ScalarEvidence.again
             ) -> dict[str, float]:
    """Return 1σ of each parameter, propagated from the intervals of a bench model's scalars.

    `ends`: interval of one scalar; by default its repeatability, for comparisons on the same bench.
    """
    total: dict[str, float] = {}
    for measured, evidence in model.evidence.items():
        if not math.isfinite(evidence.low + evidence.high):
            continue
        low, high = (replace(model, values={**model.values, measured: end}).related()
                     for end in ends(evidence, model.values[measured]))
        for name in _measured(model):
            if name in low and low[name] != high[name]:
                total[name] = math.hypot(total.get(name, 0.0), (high[name] - low[name]) / (2.0 * 1.96))
    return total


def _brought() -> dict[str, float]:
    """Return the neutral values of parameters that only an effect's additional submodel reads."""
    return {p.name: sum(p.likely) / 2.0 if p.neutral is None else p.neutral
            for effect in CATALOGUE.values() for p in effect.parameters if p.name not in RELATION_PARAMETERS}


def of_unknown_rig(blocks: Sequence[Block]) -> HealthyReference:
    """Return an ideal transmission as reference; its offsets, ratios and load-free friction are free without prior."""
    values = {**ideal(), **_brought()}
    for block in blocks:
        s = block.signals
        if s.has("rope_m", "knee_angle_rad"):
            slope, level = np.polyfit(s["knee_angle_rad"], s["rope_m"], 1)
            values["rope_per_knee"], values["rope_zero"] = float(slope), float(level + slope * KNEE_AT_FIT)
            break
    nuisance = tuple(
        Free(name, *p.rig_bounds, values[name], math.inf, _scale(blocks, p.unit, values[name]))
        for name, p in RELATION_PARAMETERS.items() if p.free)
    return HealthyReference("none", values, nuisance)


def _scale(blocks: Sequence[Block], unit: str, at: float) -> float:
    spans = {"N": "tension_start_n", "m": "rope_m", "rad": "knee_angle_rad", "N·s/m": "rope_m_s"}
    if unit == "N·s/m":
        return 1.0
    name = spans.get(unit)
    held = [b.signals[name] for b in blocks if name is not None and b.signals.has(name)]
    return float(np.std(held[0])) if held else max(0.1 * abs(at), 1e-3)


def like_this_bench(tables: Sequence[Table]) -> bool:
    """Return whether rope and knee move together as on the bench of the signal table.

    Trials without both signals are attributed to that bench if they contain a force target or gait percent.
    """
    for given in tables:
        if "servo_position_m" in given and "knee_angle_rad" in given:
            angle, rope = given["knee_angle_rad"], given["servo_position_m"]
            known = np.isfinite(angle) & np.isfinite(rope)
            slope = float(np.polyfit(angle[known], rope[known], 1)[0])
            return LIKE_THIS_BENCH[0] < slope / PARAMETERS["rope_per_knee"].nominal < LIKE_THIS_BENCH[1]
    return any("desired_force_n" in t or "gait_percent" in t for t in tables)
