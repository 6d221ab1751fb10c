"""Parameters of the simulation from reference trials, in two steps.

First the force path is fitted and converted to parameters of the simulation.  Then the simulation itself is fitted,
starting from these parameters.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from estimation import simulation
from estimation.data.table import Table
from estimation.fitted_quantities import FittedQuantity, quantities
from estimation.forward_model import step_taken
from estimation.joint_fit import fit_reference
from estimation.likelihood_data import LOWPASS_HZ
from estimation.path_model import PATH_MODEL
from estimation.reference_fit import ReferenceFit
from physics.bench_model import BenchModel
from physics.calibration import ScalarEvidence
from physics.forward.path_constants import INDEX, SESSION_SD
from physics.forward.path_parameters import DIRECT, plant_of, readings, simulation_values
from physics.laws import Array
from physics.parameters import ESTIMATED, Parameter
from physics.plant import imposed
from physics.plant.imposed import ImposedMotion, Tensions
from physics.plant.state_layout import PlantParameters

Values = Mapping[str, float]

REFITTED: Final = (
    "mu1", "mu2", "fabric_wrap", "load_slope", "viscous", "stribeck_ratio", "presliding", "fabric_presliding_ratio",
    "stiffness_scale", "stiffness_shape", "cable_share", "rope_zero", "rope_per_knee", "timestamp_skew", "end_delay")
"""Parameters of the second fit: those in which the force path and the simulation differ."""
OWN: Final = {name: float(SESSION_SD[INDEX[row]]) for name, row in (
    ("rope_zero", "zero"), ("start_offset", "start_offset"), ("end_offset", "end_offset"))}
"""Parameters that deviate from trial to trial, with the published 1σ between sessions, SI."""


def identified(trials: Sequence[Table]) -> tuple[ReferenceFit | None, str]:
    """Fit the force path to reference trials of one bench; (None, a sentence) if they are of no rope over a knee."""
    outputs = [n for n in PATH_MODEL.signals if all(n in t for t in trials)]
    recordings = [PATH_MODEL.record(dataclasses.replace(t, columns={
        n: v for n, v in t.columns.items() if n not in PATH_MODEL.signals or n in outputs})) for t in trials]
    try:
        fit = fit_reference(PATH_MODEL, recordings)
    except (ZeroDivisionError, np.linalg.LinAlgError):  # no rope has such constants
        return None, f"{trials[0].source}: no constants of the model predict the trials."
    unlike = fit.unlike(recordings[0], trials[0].source)
    return (None if unlike else fit), unlike


def parameters_of(fit: ReferenceFit) -> dict[str, FittedQuantity]:
    """Return the parameters of the simulation that the outputs of a fitted force path can determine, SI."""
    every, found = [*REFITTED, *DIRECT, "cable_bend", "rope_per_knee_quadratic", "drive_presliding"], quantities(
        fit, simulation_values)
    return {n: found[n] for n in every if ("tension_end_n" in fit.outputs or not n.startswith("end_"))
            and ("servo_force_n" in fit.outputs or not n.startswith(("drive_", "demand_")))}


def bench_model_of(fit: ReferenceFit) -> BenchModel:
    """Return a fitted force path as a bench model: each determined parameter with its 95 % interval."""
    found = parameters_of(fit)
    return BenchModel({n: q.value for n, q in found.items()}, {
        n: ScalarEvidence(*q.interval()) for n, q in found.items()})


class _SimulatedTrial:
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


def fitted(trials: Sequence[Table], fit: ReferenceFit, seconds: float = 6.0, steps: int = 10,
           difference: float = 0.6) -> dict[str, float]:
    """Fit the simulation to the first `seconds` of each trial, from the parameters of the fitted path.

    The estimate is the maximum a posteriori after at most `steps` steps.  Its prior is the posterior of the force path,
    widened by the `difference` between force path and simulation, relative to the size of each parameter.  1σ of a
    sample is 1 N.  Returns all parameters by name, SI.
    """
    simulated, known = [_SimulatedTrial(t, seconds) for t in trials], parameters_of(fit)
    start_values = simulation_values(fit.model.constants.named(fit.bench_coordinates()))
    names = [n for n in REFITTED if n in known]
    width = np.array([np.hypot(known[n].sd, difference * _size(ESTIMATED[n])) for n in names])
    own = [(k, n) for k in range(len(trials)) for n in OWN if len(trials) > 1]
    mean = np.concatenate([[known[n].value for n in names], np.zeros(len(own))])
    scale = np.concatenate([width, [OWN[n] for _, n in own]])
    low = np.array([*(ESTIMATED[n].low for n in names), *(-5.0 * OWN[n] for _, n in own)])
    high = np.array([*(ESTIMATED[n].high for n in names), *(5.0 * OWN[n] for _, n in own)])
    # the variables are 10 at the prior mean, since SciPy's finite-difference step is relative to them
    bounds = [10.0 + (edge - mean) / scale for edge in (low, high)]

    def values(x: Array, trial: int) -> dict[str, float]:
        told = {**start_values, **dict(zip(names, x[:len(names)].tolist(), strict=True))}
        for (k, name), deviation in zip(own, x[len(names):], strict=True):
            if k == trial:
                told[name] += float(deviation)
        return told

    def residual(u: Array) -> Array:
        step_taken()
        x = mean + scale * (u - 10.0)
        return np.concatenate([*(s.residual(values(x, k)) for k, s in enumerate(simulated)), u - 10.0])

    start = np.clip(np.full(mean.size, 10.0), bounds[0] + 1e-6, bounds[1] - 1e-6)
    x = mean + scale * (least_squares(residual, start, bounds=bounds, diff_step=3e-3, max_nfev=steps).x - 10.0)
    return {**start_values, **dict(zip(names, x[:len(names)].tolist(), strict=True))}
