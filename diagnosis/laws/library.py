"""Library of candidate terms of a trial: constants that may be modulated, and modulations on grids of their parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from estimation.forward_model import ForwardModel
from estimation.likelihood_data import GRID_S, Recording
from estimation.path_model import PathModel
from physics.constant_table import ConstantTable
from physics.effects.hypotheses import DRIVE, ELASTICITY, FRICTION, GEOMETRY, SENSOR, TIMING
from physics.laws import Array
from physics.terms import MODULATIONS, Carrier, Course

_C = Carrier
PATH_CARRIERS: Final[Mapping[str, Carrier]] = {
    "zero": _C("m", 3e-3, GEOMETRY, "zero of the rope"),
    "arm": _C("m/rad", 2e-3, GEOMETRY, "lever arm of the knee"),
    "stiffness": _C("", 0.25, ELASTICITY, "stiffness of the path"),
    "cable": _C("", 0.4, FRICTION, "friction of the cable"),
    "fabric": _C("", 0.5, FRICTION, "friction of the fabric"),
    "dry": _C("N", 2.0, FRICTION, "friction that no load changes"),
    "viscous": _C("N·s/m", 12.0, FRICTION, "viscous friction of the rope"),
    "cable_travel": _C("", 0.7, FRICTION, "pre-sliding travel of the cable"),
    "start_gain": _C("", 0.06, SENSOR, "gain of START"),
    "start_offset": _C("N", 2.0, SENSOR, "START"),
    "end_gain": _C("", 0.06, SENSOR, "gain of END"),
    "end_offset": _C("N", 2.0, SENSOR, "END"),
    "start_lag": _C("s", 0.01, TIMING, "lag of START"),
    "end_lag": _C("s", 0.01, TIMING, "lag of END"),
    "drive_coulomb": _C("N", 5.0, DRIVE, "Coulomb friction of the servo"),
    "drive_viscous": _C("N·s/m", 60.0, DRIVE, "viscous friction of the servo"),
    "drive_offset": _C("N", 3.0, DRIVE, "servo force"),
    "demand_gain": _C("", 0.1, DRIVE, "gain of the servo's force"),
}
"""Constants of the bench that terms may modulate; sizes as the catalogue's effects of the same constant have them."""
VIBRATING: Final = frozenset({"end_offset", "start_offset", "drive_offset", "offset"})
"""Constants that a sine in time may modulate: a signal that vibrates, whatever the force."""
SHARES: Final = (0.05, 0.15, 0.4)
"""Time constants of decays, relative to the length of the trial."""


class Candidates(NamedTuple):
    """Parameter sets of each modulation that a trial allows, by name."""

    grids: Mapping[str, list[dict[str, float]]]

    def size(self, carriers: int, vibrating: int) -> int:
        """Return the number of candidate terms of `carriers` constants, `vibrating` of which a sine may modulate."""
        return sum(len(grid) * (vibrating if name == "time_sine" else carriers) for name, grid in self.grids.items())


def carriers_of(model: ForwardModel, outputs: tuple[str, ...]) -> dict[str, Carrier]:
    """Return the constants of a model that terms may modulate if `outputs` were recorded, by name."""
    if isinstance(model, PathModel):
        missing = [prefix for prefix, output in (("end_", "tension_end_n"), ("drive_", "servo_force_n"),
                                                 ("demand_", "servo_force_n")) if output not in outputs]
        return {name: c for name, c in PATH_CARRIERS.items() if not name.startswith(tuple(missing) or ("-",))}
    return _carriers_of_rig(model)


def _carriers_of_rig(model: ForwardModel, sessions: float = 5.0) -> dict[str, Carrier]:
    """Return the free constants of a rig; 1σ of a term is 0.4, relative, or `sessions` times the session's."""
    parts = {name: h.part for h in model.hypotheses.values() for variant in h.variants(
        model.constants.named(np.zeros(len(model.constants)))) for d in variant.directions for name in d.along}
    made = {}
    for i in model.constants.free:
        row = model.constants.rows[i]
        if row.form == "log" or row.name.endswith("gain"):
            made[row.name] = _C("", 0.4, parts.get(row.name, "rig"), row.meaning)
        elif row.unit and row.session_sd:
            made[row.name] = _C(row.unit, sessions * row.session_sd, parts.get(row.name, "rig"), row.meaning)
    return made


def in_units(table: ConstantTable, q: Array, name: str, carrier: Carrier) -> float:
    """Return dq/da: the change of a coordinate by a unit of a term's coefficient at coordinates `q`.

    A relative coefficient changes the value v by v·a, an absolute one by a.
    """
    index = table.index[name]
    step = table.step[index]
    ahead = q.copy()
    ahead[index] += step
    value = float(table.values(q)[index])
    slope = (float(table.values(ahead)[index]) - value) / step
    return (value if carrier.relative else 1.0) / slope if abs(slope) > 1e-30 else 0.0


def candidates(course: Course, hz: tuple[float, float] = (3.0, 25.0)) -> Candidates:
    """Return the grids of all modulations that the course of a trial allows; `hz`: range of the vibrations.

    Steps stand in 2 % of the trial, bumps of the phase in 3 % of the cycle, sines half a period of the trial apart.
    """
    length, stroke = float(course.time_s[-1]), float(np.ptp(course.position_m))
    grids: dict[str, list[dict[str, float]]] = {
        name: [{}] for name in ("constant", "time", "tension", "tension_squared", "direction")}
    grids["step"] = [{"at_s": share * length} for share in np.arange(0.06, 0.95, 0.02)]
    grids["decay"] = [{"tau_s": share * length} for share in SHARES]
    top = float(np.quantile(course.tension_n, 0.999))
    grids["saturation"] = [{"from_n": share * top} for share in (0.5, 0.65, 0.8, 0.9)]
    grids["load_memory"] = [{"tau_s": seconds} for seconds in (0.3, 1.0, 4.0)]
    turns = np.geomspace(0.35, 8.0, 14)
    grids["position_sine"] = [{"radius_m": stroke / (2.0 * np.pi * count)} for count in turns]
    low = float(course.position_m.min())
    grids["position_bump"] = [{"at_m": low + share * stroke, "width_m": stroke / 25.0}
                              for share in np.arange(0.04, 1.0, 0.04)]
    if course.knee_rad is not None and np.ptp(course.knee_rad) > 0.05:
        span, least = float(np.ptp(course.knee_rad)), float(course.knee_rad.min())
        grids |= {"knee": [{}], "knee_squared": [{}]}
        grids["knee_bump"] = [{"at_rad": least + share * span, "width_rad": span / 25.0}
                              for share in np.arange(0.04, 1.0, 0.04)]
    if course.phase is not None:
        grids["phase_bump"] = [{"phase": float(phase), "width": 0.02} for phase in np.arange(0.0, 1.0, 0.03)]
    grids["time_sine"] = [{"hz": float(f)} for f in np.arange(hz[0], hz[1], 0.5 / length)]
    return Candidates(grids)


class Modulated(NamedTuple):
    """Course of one trial on its simulation grid, averaged over the bins of the data; `end_n`: the model's END tension.
    """

    course: Course
    end_n: Array
    trial: Recording

    def of(self, carrier: str) -> Course:
        """Return the course with the tension that a carrier feels: END's if it is a constant of END."""
        return self.course._replace(tension_n=self.end_n) if carrier.startswith("end_") else self.course

    def bins(self, carrier: str, name: str, parameters: Mapping[str, float]) -> list[Array]:
        """Return the components of a modulation, low-passed and averaged over bins as the data, each of shape (bins,).
        """
        low = butter(2, self.trial.lowpass_hz, fs=1.0 / GRID_S, output="sos")
        return [self.trial.binned(np.asarray(sosfiltfilt(low, part)))
                for part in MODULATIONS[name].function(self.of(carrier), parameters)]


def modulated(model: ForwardModel, q: Array, trial: Recording, phase: Array | None) -> Modulated:
    """Return the signals of a trial that modulations depend on; the tensions are the model's at coordinates `q`.

    `phase`: gait phase of each bin, 0 … 1, or None; held within a bin.
    """
    time = np.asarray(GRID_S * np.arange(trial.time_s.size))
    whole = None if phase is None else np.asarray(
        np.interp(time, trial.binned(time), np.unwrap(2.0 * np.pi * phase)) / (2.0 * np.pi) % 1.0)
    position, speed, start, end, joint = model.course(q, trial)
    return Modulated(Course(time, position, speed, start, joint, whole), end, trial)
