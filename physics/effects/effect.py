"""Declaration of an effect, read by plant, compensation, diagnosis and report.

Types only. Values are named as in `physics.parameters`, all are SI.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from physics.laws import Array
from physics.parameters import PARAMETERS
from physics.sampling_laws import Staleness

Values = Mapping[str, float]
Submodel = Callable[[Values], float]


class EffectParameter(NamedTuple):
    """One number of an effect: hard bounds low…high, the range where it is likely, the value at which it is absent.

    `neutral` None: no value means absence; the healthy one is the calibration's (or it only shapes the others).
    """

    name: str
    unit: str
    low: float
    high: float
    likely: tuple[float, float]
    neutral: float | None
    text: str


def of_table(name: str) -> EffectParameter:
    """Return a parameter of the table as an effect's parameter, with the bounds of a fit on a bench like the nominal
    one.
    """
    p = PARAMETERS[name]
    if p.likely is None:
        raise ValueError(f"{name}: the table says no likely range under a fault")
    return EffectParameter(name, p.unit, *p.search_bounds, p.likely, p.neutral, p.meaning)


class Trajectory(NamedTuple):
    """Demands of one run on the transmission, by sample, and the corrections of an extended controller.

    The first block is given; an inverse returns a copy with some of the second block changed. Arrays of one length,
    SI; slips −1…1; exponents are μθ as positive numbers, turned by the slips.
    """

    progress: Array
    desired_n: Array
    tension_n: Array
    knee_rad: Array
    knee_rad_s: Array
    rope_m: Array
    rope_m_s: Array
    time_s: Array

    rope_slip: Array
    fabric_slip: Array
    cable_exponent: Array
    fabric_exponent: Array
    start_extra_n: Array
    stretch_m: Array
    rope_extra_m: Array
    knee_extra_rad: Array
    start_gain: Array
    start_offset_n: Array
    lead_s: float


Inverse = Callable[[Trajectory, Values], Trajectory]


def unchanged(course: Trajectory, values: Values) -> Trajectory:
    """Return `course`: nothing that a controller could do by START, rope and knee undoes this effect."""
    del values
    return course


@dataclass(frozen=True)
class Effect:
    """One physical cause, declared once.

    `site`: place on the bench. `law`, `source`: formula and origin. `forward`: "table.parameter" → function of the
    values, for the tables plant, start_sensor, end_sensor and bus of a plant model. `inverse`: compensation.
    `signature`: its visible sign; `words`: the sentence for a report; `rivals`: competing effects; `experiment`: the
    one that separates them, by its name in `physics.effects.separating_experiments`. `stale`: of an effect of the wire,
    the staleness of the values at a cycle time, s; `grid`: of one of the converter, the quantisation step of readings,
    N.
    """

    name: str
    site: str
    law: str
    source: str
    parameters: tuple[EffectParameter, ...]
    forward: Mapping[str, Submodel]
    signature: str
    words: str
    rivals: tuple[str, ...]
    experiment: str
    inverse: Inverse = unchanged
    stale: Callable[[Values, float], Staleness] | None = None
    grid: Submodel | None = None


def value_of(name: str) -> Submodel:
    """Return the submodel that passes the parameter `name` on unchanged."""
    return lambda values: values[name]


def effect_of(name: str, site: str, law: str, source: str, parameters: Sequence[str], signature: str, words: str,
              rivals: tuple[str, ...], experiment: str, *, inverse: Inverse = unchanged,
              forward: Mapping[str, Submodel] | None = None, stale: Callable[[Values, float], Staleness] | None = None,
              grid: Submodel | None = None) -> Effect:
    """Return an effect of `parameters` of the table, each of which sets the plant's values that its row names.

    `forward`: values of the plant that it sets besides.
    """
    sets = {target: value_of(own) for own in parameters for target in PARAMETERS[own].plant.split()}
    return Effect(name, site, law, source, tuple(map(of_table, parameters)), {**sets, **(forward or {})}, signature,
                  words, rivals, experiment, inverse, stale, grid)
