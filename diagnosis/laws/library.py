"""Library of candidate terms of a trial: constants that may be modulated, and modulations on grids of their parameters.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from estimation.forward_model import ForwardModel
from estimation.path_model import PathModel
from physics.effects.carriers import PATH_CARRIERS, needed
from physics.terms import Carrier, Course

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
        return {name: c for name, c in PATH_CARRIERS.items() if set(needed(name)) <= set(outputs)}
    return _carriers_of_rig(model)


def _carriers_of_rig(model: ForwardModel, sessions: float = 5.0) -> dict[str, Carrier]:
    """Return the free constants of a rig; 1σ of a term is 0.4, relative, or `sessions` times the session's."""
    parts = {name: h.part for h in model.hypotheses.values() for variant in h.variants(
        model.constants.named(np.zeros(len(model.constants)))) for d in variant.directions for name in d.along}
    made = {}
    for i in model.constants.free:
        row = model.constants.rows[i]
        if row.form == "log" or row.name.endswith("gain"):
            made[row.name] = Carrier("", 0.4, parts.get(row.name, "rig"), row.meaning)
        elif row.unit and row.session_sd:
            made[row.name] = Carrier(row.unit, sessions * row.session_sd, parts.get(row.name, "rig"), row.meaning)
    return made


def candidates(course: Course, hz: tuple[float, float] = (3.0, 25.0)) -> Candidates:
    """Return the grids of all modulations that the course of a trial allows; `hz`: range of the vibrations.

    Steps stand in 2 % of the trial, twice as dense where force acts: without force no step shows.  Bumps of the phase
    stand in 3 % of the cycle, sines half a period of the trial apart.
    """
    length, stroke = float(course.time_s[-1]), float(np.ptp(course.position_m))
    grids: dict[str, list[dict[str, float]]] = {
        name: [{}] for name in ("constant", "time", "tension", "tension_squared", "direction")}
    load = np.abs(course.tension_n)
    passed = np.cumsum(load + max(float(load.mean()), 1e-9))
    grids["step"] = [{"at_s": float(s)} for s in np.interp(np.arange(0.06, 0.95, 0.02) * passed[-1], passed,
                                                           course.time_s)]
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
