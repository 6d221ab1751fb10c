"""Reference condition of a bench without reference trials: the bench population and, if known, its calibration.

    q ~ N(0, bench_sd²)                       population prior of the constants
    v = g(q) + N(0, σ²)                       calibration: g converts the path to parameters of the simulation
    c ~ N(0, amplitude²)                      discrepancy, of the size that benches of the population have

The posterior of q is that of the linearised g at its mode.  A constant without information on it, such as the rope
zero, keeps the wide prior, so that an effect on it cannot be detected.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from estimation.forward_model import ForwardModel
from estimation.joint_fit import first_mode
from estimation.likelihood_data import Recording
from estimation.path_model import MODEL_ERROR_N
from estimation.posterior import SURROGATE, Gaussian
from estimation.reference_fit import FEATURES, ReferenceFit, reach_of, scaling_of
from physics import bench_model
from physics.bench_model import BenchModel
from physics.forward.path_parameters import simulation_values
from physics.laws import Array
from physics.parameters import PARAMETERS

UNSTATED: Final = ("rope_zero", "home_preload")
"""Calibrated values that are not compared, since they depend on the tension at homing."""


class CalibratedValue(NamedTuple):
    """Calibrated value of a parameter of the simulation, SI, and its 1σ."""

    value: float
    sd: float


def stated_values(calibration: Mapping[str, Any] | None) -> dict[str, CalibratedValue]:
    """Return the values that a calibration determines, by parameter of the simulation; each has an interval.

    1σ has the difference between the value's equation and that of the path, too (`SURROGATE`).
    """
    model = bench_model.from_tables(calibration or {}, "calibration")
    if model.simulation:
        model = replace(model, values=model.simulation, evidence=model.simulation_evidence, simulation={},
                        correlation=None)
    middle = _simulated(model)
    names = [name for name, known in model.evidence.items() if math.isfinite(known.low + known.high)]
    moved = np.zeros((len(names), len(middle)))
    for row, name in zip(moved, names, strict=True):
        low, high = (_simulated(replace(model, values={**model.values, name: end}))
                     for end in (model.evidence[name].low, model.evidence[name].high))
        row[:] = [(high[parameter] - low[parameter]) / (2.0 * 1.96) for parameter in middle]
    together = np.eye(len(names)) if model.correlation is None else model.correlation.over(names)
    variance = np.einsum("ip,ij,jp->p", moved, together, moved)
    return {name: CalibratedValue(value, math.hypot(math.sqrt(max(of, 0.0)), SURROGATE * abs(value)))
            for (name, value), of in zip(middle.items(), variance, strict=True) if of > 0.0}


def _simulated(model: BenchModel) -> dict[str, float]:
    told = model.related()
    if "mu2" in told and "phi0" in told:  # the path has the exponent, not its factors
        told["mu2"] *= told["phi0"] / PARAMETERS["phi0"].nominal
    return {name: value for name, value in told.items() if name not in UNSTATED}


def reference_of_population(model: ForwardModel, trials: Sequence[Recording],
                            calibration: Mapping[str, Any] | None = None) -> ReferenceFit:
    """Return the reference condition for `trials` of a bench without reference trials.

    The origin, at which the states of the discrepancy are simulated, is a fit of the first trial under the prior.
    Model error and discrepancy are those of the population; autocorrelation doubles the variance.
    """
    free, outputs = list(model.constants.free), trials[0].outputs
    bench_mean, bench_covariance = _calibrated(model, stated_values(calibration))
    amplitude = np.array([MODEL_ERROR_N[name] for name in outputs])
    origin = first_mode(model, trials[0], Gaussian(
        _zeros(model), bench_mean, bench_covariance + np.diag(model.constants.session_sd[free] ** 2))).q
    states = [model.simulated_states(origin, trial) for trial in trials]
    features = np.repeat(amplitude**2, FEATURES)
    zero = np.zeros(features.size)
    mean = np.concatenate([bench_mean - origin[free], zero])
    covariance = np.zeros((mean.size, mean.size))
    covariance[:len(free), :len(free)] = bench_covariance
    covariance[range(len(free), mean.size), range(len(free), mean.size)] = features
    bench = Gaussian(origin, mean, covariance)
    session = np.concatenate([model.session_at(origin)[free] ** 2, model.session_share**2 * features])
    q = origin.copy()
    q[free] = np.where(np.sqrt(np.diag(bench_covariance)) < 0.99 * model.constants.bench_sd[free], bench_mean,
                       origin[free])
    return ReferenceFit(
        model, outputs, origin, bench, Gaussian(origin, mean, covariance + np.diag(session)),
        scaling_of(model, states), np.repeat(amplitude[:, None] ** 2, 4, axis=1), np.full(len(outputs), 2.0),
        {name: MODEL_ERROR_N[name] for name in outputs}, 1.0, reach_of(model, trials), ((q, zero),))


def _zeros(model: ForwardModel) -> Array:
    return np.zeros(len(model.constants))


def _calibrated(model: ForwardModel, stated: Mapping[str, CalibratedValue]) -> tuple[Array, Array]:
    """Return mean and covariance of the free constants' coordinates, given calibrated values.

    Mode of Σ((g(q) − v)/σ)² + Σ(q/bench_sd)², with the covariance of its linearisation.
    """
    free = list(model.constants.free)
    sd = model.constants.bench_sd[free]
    q = _zeros(model)
    names = [name for name in stated if name in simulation_values(model.constants.named(q))]
    if not names:
        return np.zeros(len(free)), np.diag(sd**2)
    value, width = (np.array(each) for each in zip(*(stated[name] for name in names), strict=True))

    def residual(x: Array) -> Array:
        q[free] = sd * x
        given = simulation_values(model.constants.named(q))
        return np.concatenate([(np.array([given[name] for name in names]) - value) / width, x])

    found = least_squares(residual, np.zeros(len(free)))
    return sd * found.x, np.linalg.inv(found.jac.T @ found.jac) * sd * sd[:, None]
