"""Parameters of the simulation from reference trials, in two steps.

First the force path is fitted and converted to parameters of the simulation.  Then the simulation itself is fitted,
starting from these parameters.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from estimation import simulation
from estimation.data.table import Table
from estimation.likelihood_data import LOWPASS_HZ
from estimation.path_model import PATH_MODEL
from estimation.reference_fit import ReferenceFit, fit_reference
from estimation.rig_fit import determined
from estimation.transfer.trial_calibration import scalars_of
from physics.bench_model import BenchModel
from physics.calibration import ScalarEvidence
from physics.laws import Array
from physics.parameters import ESTIMATED, Parameter
from physics.path_constants import INDEX, SESSION_SD
from physics.path_parameters import DIRECT, simulation_values
from physics.plant import imposed
from physics.plant.imposed import ImposedMotion, Tensions
from physics.plant.state_layout import PlantParameters
from physics.simulated_bench import plant_of, readings

Values = Mapping[str, float]

REFITTED: Final = (
    "mu1", "mu2", "fabric_wrap", "load_slope", "viscous", "stribeck_ratio", "presliding", "fabric_presliding_ratio",
    "stiffness_scale", "stiffness_shape", "cable_share", "rope_zero", "rope_per_knee", "timestamp_skew", "end_delay")
"""Parameters of the second fit: those in which the force path and the simulation differ."""
OWN: Final = {name: float(SESSION_SD[INDEX[row]]) for name, row in (
    ("rope_zero", "zero"), ("start_offset", "start_offset"), ("end_offset", "end_offset"))}
"""Parameters that deviate from trial to trial, with the published 1σ between sessions, SI."""


@dataclass(frozen=True)
class IdentifiedBench:
    """Parameters of the simulation, SI, converted from a fitted force path.

    `sigma` and `prior_sigma`: posterior and prior 1σ by parameter.  `scalars`: scalars of a calibration, and
    `scalar_sigma`: posterior 1σ of those that the trials determine.  `warning`: sentence on another minimum of the fit
    ("": none).  `unlike`: sentence on why the trials are not of a rope over a knee ("": they are).
    """

    values: Values
    sigma: Values
    prior_sigma: Values
    unlike: str = ""
    scalars: Values = dataclasses.field(default_factory=dict)
    scalar_sigma: Values = dataclasses.field(default_factory=dict)
    warning: str = ""


def identified(trials: Sequence[Table]) -> IdentifiedBench:
    """Fit the force path to reference trials of one bench and return it as parameters of the simulation."""
    outputs = [n for n in PATH_MODEL.signals if all(n in t for t in trials)]
    recordings = [PATH_MODEL.record(dataclasses.replace(t, columns={
        n: v for n, v in t.columns.items() if n not in PATH_MODEL.signals or n in outputs})) for t in trials]
    try:
        fit = fit_reference(PATH_MODEL, recordings)
    except (ZeroDivisionError, np.linalg.LinAlgError):  # no rope has such constants
        return IdentifiedBench({}, {}, {}, f"{trials[0].source}: no constants of the model predict the trials.")
    unlike = fit.unlike(recordings[0], trials[0].source)
    return IdentifiedBench({}, {}, {}, unlike) if unlike else dataclasses.replace(
        identified_by(fit), warning=fit.warning())


def identified_by(fit: ReferenceFit) -> IdentifiedBench:
    """Return a fitted force path as parameters of the simulation."""
    names, free = _determined(fit.outputs), list(fit.model.constants.free)
    size = len(free)
    path = _path(fit, fit.bench.mean[:size])
    values, scalars = simulation_values(path), scalars_of(path)
    after, before = fit.bench.covariance[:size, :size], np.diag(fit.model.constants.bench_sd[free] ** 2)
    prior = _sigma(fit, before, list(scalars), scalars_of)
    return IdentifiedBench(values, _sigma(fit, after, names), _sigma(fit, before, names), "", scalars, {
        name: sd for name, sd in _sigma(fit, after, list(scalars), scalars_of).items() if determined(sd, prior[name])})


def bench_model_of(fit: ReferenceFit) -> BenchModel:
    """Return a fitted force path as a bench model: each determined parameter with its 95 % interval."""
    bench = identified_by(fit)
    return BenchModel({n: bench.values[n] for n in bench.sigma}, {
        n: ScalarEvidence(bench.values[n] - 1.96 * sd, bench.values[n] + 1.96 * sd) for n, sd in bench.sigma.items()})


def _path(fit: ReferenceFit, departure: Array) -> dict[str, float]:
    q = fit.origin.copy()
    q[list(fit.model.constants.free)] += departure
    return fit.model.constants.named(q)


def _determined(outputs: Sequence[str]) -> list[str]:
    """Return the parameters of the simulation that the outputs can determine."""
    every = [*REFITTED, *DIRECT, "cable_bend", "rope_per_knee_quadratic", "drive_presliding"]
    return [n for n in dict.fromkeys(every) if ("tension_end_n" in outputs or not n.startswith("end_"))
            and ("servo_force_n" in outputs or not n.startswith(("drive_", "demand_")))]


def _sigma(fit: ReferenceFit, covariance: Array, names: Sequence[str],
           convert: Callable[[Values], Values] = simulation_values) -> dict[str, float]:
    """Return 1σ of each quantity that `convert` returns: √(gᵀΣg), g its gradient by the coordinates of the path."""
    here = fit.bench.mean[:covariance.shape[0]]
    base = convert(_path(fit, here))
    step = 0.3 * fit.model.constants.session_sd[list(fit.model.constants.free)]
    slopes = np.zeros((len(names), here.size))
    for k, size in enumerate(step):
        moved = here.copy()
        moved[k] += size
        values = convert(_path(fit, moved))
        slopes[:, k] = [(values[n] - base[n]) / size for n in names]
    variance = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
    return dict(zip(names, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))


class _Simulated:
    """Comparison of one trial with the simulation; the last simulated plant is cached."""

    def __init__(self, given: Table, seconds: float) -> None:
        last = int(np.searchsorted(given["time_s"], given["time_s"][0] + seconds))
        self.table = dataclasses.replace(given, columns={n: v[:last] for n, v in given.columns.items()})
        self.signals = [n for n in simulation.SIGNALS if n in given]
        known = np.flatnonzero(simulation.counted(self.table) & np.all(
            [np.isfinite(self.table[n]) for n in self.signals], axis=0))
        self.rows = known[:: max(1, round(1.0 / (LOWPASS_HZ * float(np.median(np.diff(self.table["time_s"]))))))]
        self._motion: ImposedMotion = simulation.motion(self.table, 0.0)
        self._last: tuple[PlantParameters, Tensions] | None = None

    def residual(self, values: Values) -> Array:
        """Return measured less simulated tensions, N, at samples `1 / LOWPASS_HZ` apart."""
        plant = plant_of(values, simulation.length_s(self.table))
        if self._last is None or self._last[0] != plant:
            self._last = plant, imposed.simulate(plant, self._motion)
        told = readings(self.table["time_s"], self._last[1], values)
        return np.concatenate([(self.table[n] - getattr(told, n))[self.rows] for n in self.signals])


def _size(parameter: Parameter) -> float:
    """Return the size of a parameter: its nominal value, or half its likely range under a fault if that is larger."""
    low, high = parameter.likely or (0.0, 0.0)
    return max(abs(parameter.nominal), 0.5 * (high - low))


def fitted(trials: Sequence[Table], bench: IdentifiedBench, seconds: float = 6.0, steps: int = 10,
           difference: float = 0.6) -> dict[str, float]:
    """Fit the simulation to the first `seconds` of each trial, from the parameters of the fitted path.

    The estimate is the maximum a posteriori after at most `steps` steps.  Its prior is the posterior of the force path,
    widened by the `difference` between force path and simulation, relative to the size of each parameter.  1σ of a
    sample is 1 N.  Returns all parameters by name, SI.
    """
    simulated = [_Simulated(t, seconds) for t in trials]
    names = [n for n in REFITTED if n in bench.sigma]
    width = np.array([np.hypot(bench.sigma[n], difference * _size(ESTIMATED[n])) for n in names])
    own = [(k, n) for k in range(len(trials)) for n in OWN if len(trials) > 1]
    mean = np.concatenate([[bench.values[n] for n in names], np.zeros(len(own))])
    scale = np.concatenate([width, [OWN[n] for _, n in own]])
    low = np.array([*(ESTIMATED[n].low for n in names), *(-5.0 * OWN[n] for _, n in own)])
    high = np.array([*(ESTIMATED[n].high for n in names), *(5.0 * OWN[n] for _, n in own)])
    # the variables are 10 at the prior mean, since SciPy's finite-difference step is relative to them
    bounds = [10.0 + (edge - mean) / scale for edge in (low, high)]

    def values(x: Array, trial: int) -> dict[str, float]:
        told = {**bench.values, **dict(zip(names, x[:len(names)].tolist(), strict=True))}
        for (k, name), deviation in zip(own, x[len(names):], strict=True):
            if k == trial:
                told[name] += float(deviation)
        return told

    def residual(u: Array) -> Array:
        x = mean + scale * (u - 10.0)
        return np.concatenate([*(s.residual(values(x, k)) for k, s in enumerate(simulated)), u - 10.0])

    start = np.clip(np.full(mean.size, 10.0), bounds[0] + 1e-6, bounds[1] - 1e-6)
    x = mean + scale * (least_squares(residual, start, bounds=bounds, diff_step=3e-3, max_nfev=steps).x - 10.0)
    return {**bench.values, **dict(zip(names, x[:len(names)].tolist(), strict=True))}
