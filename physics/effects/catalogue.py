"""The catalogue of effects, for plant, compensation, diagnosis, report and `docs/effects.md`.

An effect is declared once, in `physics.effects.declarations` or at run time by `register`; readers of the catalogue
name no effect in their own code. A file states effects as `[effects.NAME]`, each parameter as a number, or as a table
that has a `value`; what else stands beside a value (interval, unit) is evidence and not read here.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final

from parameters import InputError
from physics.converter import SensorParameters
from physics.effects.declarations import EFFECTS
from physics.effects.effect import Effect, EffectParameter, Trajectory, Values, unchanged, value_of
from physics.older_files import current_names
from physics.plant.state_layout import PlantParameters

__all__ = ["CATALOGUE", "Effect", "EffectParameter", "Trajectory", "Values", "apply", "compensate", "register",
           "registered", "unchanged", "value_of"]

BUS: Final = frozenset({"late_s", "late_share", "lost_share"})
TABLES: Final[Mapping[str, frozenset[str]]] = {
    "plant": frozenset(f.name for f in fields(PlantParameters)),
    "start_sensor": frozenset(f.name for f in fields(SensorParameters)),
    "end_sensor": frozenset(f.name for f in fields(SensorParameters)),
    "bus": BUS,
}
"""Parameters that a forward submodel may set, by table of a plant model."""
EFFECTS_TABLE: Final = "effects"
EVIDENCE: Final = "found"
"""Name of the table with the data that the effects were found on."""

_effects: Final[dict[str, Effect]] = {}
CATALOGUE: Final[Mapping[str, Effect]] = MappingProxyType(_effects)
"""Every effect by name, in the order of declaration; grows with `register`."""


def register(effect: Effect) -> None:
    """Add an effect to the catalogue; raises `ValueError` when its name is taken or its forward sets nothing known."""
    if effect.name in _effects:
        raise ValueError(f"the catalogue already has an effect {effect.name}")
    for target in effect.forward:
        table, _, key = target.partition(".")
        if key not in TABLES.get(table, frozenset()):
            raise ValueError(f"{effect.name}: forward sets {target}, which no table of a plant model has")
    for p in effect.parameters:
        if not p.low <= p.likely[0] <= p.likely[1] <= p.high:
            raise ValueError(f"{effect.name}: {p.name} is likely in {p.likely}, outside {p.low} … {p.high}")
    _effects[effect.name] = effect


@contextmanager
def registered(effect: Effect) -> Iterator[Effect]:
    """Add `effect` to the catalogue inside this context."""
    register(effect)
    try:
        yield effect
    finally:
        del _effects[effect.name]


def apply(found: Mapping[str, Values]) -> dict[str, dict[str, float]]:
    """Return the plant model, table → parameter → value, with the effects of `found` (name → values) active.

    A missing value takes its neutral or, without one, the middle of its likely range. `trial_s` among the values is
    the length of the trial, for effects that are relative to it. Raises `InputError` for an unknown name.
    """
    tables: dict[str, dict[str, float]] = {}
    for name, given in found.items():
        values = complete(name, given)
        for target, law in _effects[name].forward.items():
            table, _, key = target.partition(".")
            tables.setdefault(table, {})[key] = law(values)
    return tables


def compensate(
    course: Trajectory, found: Mapping[str, Values], calibrated: Values = MappingProxyType({}),
) -> Trajectory:
    """Return the trajectory that a controller commands to reach `course` in spite of the effects of `found`.

    Submodels that two effects share receive the values of both, then those `calibrated`, by name; effects that set an
    exponent come before those that scale it, as in the catalogue.
    """
    own = {name: complete(name, given) for name, given in found.items()}
    values = {**calibrated, **{key: value for each in own.values() for key, value in each.items()}}
    for name in sorted(own, key=list(_effects).index):
        course = _effects[name].inverse(course, values)
    return course


def complete(name: str, given: Values) -> dict[str, float]:
    """Return all values of the effect `name`, those not `given` neutral; raises `InputError` for an unknown
    parameter."""
    if name not in _effects:
        raise InputError(f"effects: {name} is not in the catalogue; expected one of {', '.join(sorted(_effects))}.")
    known = {p.name: p for p in _effects[name].parameters}
    for key, value in given.items():
        if key == "trial_s":
            continue
        if key not in known:
            raise InputError(f"effects: {name} has no parameter {key}; expected one of {', '.join(known)}.")
        if not known[key].low <= value <= known[key].high:
            raise InputError(
                f"effects: {name}.{key} = {value:g} is outside {known[key].low:g} … {known[key].high:g}"
                f" {known[key].unit}".rstrip() + "; give a value within."
            )
    absent = {p.name: sum(p.likely) / 2.0 if p.neutral is None else p.neutral for p in known.values()}
    return {**absent, **given}


def stated(given: Mapping[str, Any], where: str) -> dict[str, dict[str, float]]:
    """Return the effects that a file states, name → parameter → value, SI; {} if it has no such table.

    Raises `InputError`, beginning with `where`, for an unknown effect or parameter, text in place of a number, or a
    value out of bounds. Effects found on another rig than the bench of this catalogue are refused, too.
    """
    table = given.get(EFFECTS_TABLE, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {EFFECTS_TABLE} is not a table; write [{EFFECTS_TABLE}.NAME] with the effect's "
                         "parameters.")
    evidence = given.get(EVIDENCE, {})
    if table and isinstance(evidence, Mapping) and evidence.get("reference") == "none":
        raise InputError(
            f"{where}: found on a rig that no calibration fits; give effects that were found on a bench like this one.")
    found = {name: _values(name, row, where) for name, row in table.items()}
    for name, values in found.items():
        try:
            complete(name, values)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    return found


def _values(name: str, row: Any, where: str) -> dict[str, float]:
    if not isinstance(row, Mapping):
        raise InputError(f"{where}: {EFFECTS_TABLE}.{name} = {row!r} is not a table; write [{EFFECTS_TABLE}.{name}] "
                         "and its parameters.")
    values = {}
    for key, cell in current_names(row, f"{where} [{EFFECTS_TABLE}.{name}]").items():
        value = cell.get("value") if isinstance(cell, Mapping) else cell
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{where}: {EFFECTS_TABLE}.{name}.{key} = {cell!r} is no number; give one, or "
                             "{ value = … }.")
        values[key] = float(value)
    return values


for _effect in EFFECTS:
    register(_effect)
