"""Effects as a TOML table: `[effects.NAME]` with each parameter as a number, or as a table that has a `value`.

The rule of this file: one grammar for whoever states effects, by hand or from a diagnosis; simulator and
controller read the same text.  What else stands beside a value (interval, unit) is evidence and read by nobody here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from parameters import InputError
from physics.effects.catalogue import complete
from physics.older_files import current_names

TABLE: Final = "effects"
EVIDENCE: Final = "found"
"""Name of the table with the data that the effects were found on."""


def stated(given: Mapping[str, Any], where: str) -> dict[str, dict[str, float]]:
    """Return the effects that a file states, name → parameter → value, SI; {} if it has no such table.

    Raises `InputError`, beginning with `where`, for an unknown effect or parameter, text in place of a number, or a
    value out of bounds. Effects found on another rig than the bench of this catalogue are refused, too.
    """
    table = given.get(TABLE, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {TABLE} is not a table; write [{TABLE}.NAME] with the effect's parameters.")
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
        raise InputError(
            f"{where}: {TABLE}.{name} = {row!r} is not a table; write [{TABLE}.{name}] and its parameters.")
    values = {}
    for key, cell in current_names(row, f"{where} [{TABLE}.{name}]").items():
        value = cell.get("value") if isinstance(cell, Mapping) else cell
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{where}: {TABLE}.{name}.{key} = {cell!r} is no number; give one, or {{ value = … }}.")
        values[key] = float(value)
    return values
