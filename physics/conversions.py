"""One quantity in several forms: as simulation, calibration and fit of the simulation write it, in both directions.

Each conversion is next to its inverse. A quantity that a form does not contain (the bend of the sheath, the rope
inside it, the fabric on the knee) keeps the given or the nominal value.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

from physics.parameters import CALIBRATED, PARAMETERS, nominal

Values = Mapping[str, float]


class Form(NamedTuple):
    """A quantity as a function of others: `name` = `law`(values of `of`, in this order)."""

    name: str
    of: tuple[str, ...]
    law: Callable[..., float]


def _on_knee(before: float, after: float) -> float:
    return 1.0 - before - after


_ON_KNEE: Final = _on_knee(PARAMETERS["fabric_share_before"].nominal, PARAMETERS["fabric_share_after"].nominal)

GAIN_PER_HZ: Final = PARAMETERS["servo_position_gain"].nominal / PARAMETERS["servo_bandwidth"].nominal
"""Gain of the servo's position loop, 1/s, per Hz of its bandwidth: that of the nominal bench."""

MEASURED: Final = (
    Form("cable_exponent", ("mu1", "theta1"), lambda mu, theta: mu * theta),
    Form("stiffness_a", ("stretch_a", "stiffness_shape", "stiffness_scale"), lambda a, h, s: a * (1.0 + h) / s),
    Form("stiffness_b", ("stretch_b", "stiffness_scale"), lambda b, s: b / s),
    Form("cable_compliance", ("lead_compliance", "sheath_compliance", "stiffness_scale"),
         lambda lead, sheath, s: (lead + 0.5 * sheath) / s),
    Form("breakaway", ("stribeck_ratio",), lambda ratio: max(0.0, ratio - 1.0)),
    Form("servo_bandwidth", ("servo_position_gain",), lambda gain: gain / GAIN_PER_HZ),
    Form("fabric_share", ("fabric_share_before", "fabric_share_after"),
         lambda before, after: before + 0.5 * _on_knee(before, after)),
)
"""Quantities that identification measures, from the simulation's."""
SIMULATED: Final = (
    Form("mu1", ("cable_exponent", "theta1"), lambda exponent, theta: exponent / theta),
    Form("stiffness_scale", ("stiffness_b", "stretch_b"), lambda b, nominal_b: nominal_b / b),
    Form("stiffness_shape", ("stiffness_a", "stretch_a", "stiffness_b", "stretch_b"),
         lambda a, nominal_a, b, nominal_b: a / nominal_a * nominal_b / b - 1.0),
    Form("lead_compliance", ("cable_compliance", "sheath_compliance", "stiffness_b", "stretch_b"),
         lambda c, sheath, b, nominal_b: c * nominal_b / b - 0.5 * sheath),
    Form("stribeck_ratio", ("breakaway",), lambda beta: 1.0 + beta),
    Form("servo_position_gain", ("servo_bandwidth",), lambda bandwidth: GAIN_PER_HZ * bandwidth),
    Form("fabric_share_before", ("fabric_share",), lambda share: share - 0.5 * _ON_KNEE),
    Form("fabric_share_after", ("fabric_share",), lambda share: 1.0 - share - 0.5 * _ON_KNEE),
)
"""Quantities of the simulation, from those that identification measures; the fabric on the knee has its nominal
share."""
RELATED: Final = (
    Form("cable_share", ("lead_compliance", "sheath_compliance", "stretch_b"),
         lambda lead, sheath, b: (lead + 0.5 * sheath) / b),
    Form("fabric_presliding_ratio", ("fabric_presliding", "presliding"), lambda fabric, rope: fabric / rope),
)
"""Quantities that a fit of the simulation estimates, from the simulation's."""
UNRELATED: Final = (
    Form("lead_compliance", ("cable_share", "sheath_compliance", "stretch_b"),
         lambda share, sheath, b: share * b - 0.5 * sheath),
    Form("fabric_presliding", ("fabric_presliding_ratio", "presliding"), lambda ratio, rope: ratio * rope),
)
"""Quantities of the simulation, from those that a fit of it estimates."""
MEASURABLE: Final = frozenset(name for form in MEASURED for name in form.of) | (
    CALIBRATED - {form.name for form in MEASURED})
"""Simulation parameters that a calibration determines, directly or by a conversion of `MEASURED`."""


UNTOLD: Final = frozenset({"theta1", "stretch_a", "stretch_b", "sheath_compliance"})
"""Quantities that a conversion refers to and that the converted form does not contain; nominal if not given."""


def converted(forms: Iterable[Form], given: Values) -> dict[str, float]:
    """Return `given` converted to each of `forms` that has all its quantities; forms in `UNTOLD` are skipped."""
    base = nominal()
    values = dict(given)
    for form in forms:
        if all(name in given for name in form.of if name not in UNTOLD):
            values[form.name] = float(form.law(*(given.get(name, base[name]) for name in form.of)))
    return values


def from_scalars(scalars: Values) -> dict[str, float]:
    """Convert a calibration's scalars, by name, to quantities of the table in every form."""
    return converted(RELATED, converted(SIMULATED, {n: v for n, v in scalars.items() if n in CALIBRATED}))


def to_scalars(values: Values) -> dict[str, float]:
    """Return the scalars of a calibration that follow from `values`, quantities of the table; the inverse of the
    above."""
    return {name: value for name, value in converted(MEASURED, values).items() if name in CALIBRATED}
