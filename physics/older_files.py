"""Files of older versions, translated to today's tables and names; every other module reads today's alone.

Version 1 of a calibration has `[scalars.NAME]`, with the controller's names, for `[parameters.NAME]`.  The first
`bowden fit` wrote `[constants.NAME]`, later ones `[parameters.NAME]`, for `[simulation.NAME]`.  `RENAMED` lists names
of parameters.
"""

import warnings
from collections.abc import Mapping
from typing import Any, Final

from parameters import Remark

VERSION: Final = 2
READ: Final = (1, VERSION)
"""Versions that are read."""
SCALARS: Final = "scalars"
CONSTANTS: Final = "constants"
OLDER_TABLES: Final = (SCALARS, CONSTANTS)
RENAMED: Final[Mapping[str, str]] = {"moment_arm_m": "rope_per_knee", "moment_arm": "rope_per_knee_quadratic",
                                     "knee_ratio": "rope_per_knee"}
"""Names that older files give to parameters, and today's."""
FIRST: Final[Mapping[str, str]] = {
    "stiffness_c": "rope_zero", "swing_k": "rope_per_knee", "fabric_friction": "mu2", "wrap_offset": "phi0",
    "wrap_slope": "fabric_wrap", "breakaway_speed": "stribeck_speed", "breakaway_memory": "stribeck_memory",
    "drive_bandwidth": "servo_bandwidth", "loop_delay": "servo_delay"}
"""Names of version 1, and today's; its other names are today's."""
FIRST_UNIT: Final = "rad/rad"
"""Unit of version 1 for what is 1/rad today."""
FORCE_PATH: Final[Mapping[str, str]] = {
    "creep": "creep_compliance", "rest_speed": "stribeck_speed", "memory": "stribeck_memory", "cable_rest": "breakaway",
    "fabric_rest": "fabric_breakaway", "drum": "drum_radius", "lead": "cable_compliance", "before": "fabric_share",
    "drift": "friction_drift"}
"""Names of constants of the force path in older logbooks, and today's."""
PARAMETERS_TABLE: Final = "parameters"
SIMULATION_TABLE: Final = "simulation"
FITTED_TABLE: Final = "fitted"


def translated(tables: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the tables of a bench model with today's names; `where` is the file that a `Remark` names."""
    found = dict(tables)
    if isinstance(scalars := found.pop(SCALARS, None), Mapping):
        found[PARAMETERS_TABLE] = {FIRST.get(name, name): _in_today_s_unit(row) for name, row in scalars.items()}
    if isinstance(constants := found.pop(CONSTANTS, None), Mapping):
        found |= {SIMULATION_TABLE: constants, "version": VERSION}
    own = found.get(PARAMETERS_TABLE)
    if FITTED_TABLE in found and SIMULATION_TABLE not in found and isinstance(own, Mapping) and "mu1" in own:
        # the zero of that fit was of an unloaded rope, where no bench homes
        found |= {SIMULATION_TABLE: own, PARAMETERS_TABLE: {n: r for n, r in own.items() if n != "home_preload"}}
    for name in (PARAMETERS_TABLE, SIMULATION_TABLE):
        if isinstance(rows := found.get(name), Mapping):
            found[name] = current_names(rows, where)
    return found


def renamed_in_sql(table: str, column: str) -> str:
    """Return the SQL statement that gives a column of JSON lists today's names of the force path's constants."""
    text = column
    for old, name in FORCE_PATH.items():
        text = f"replace({text}, '\"{old}\"', '\"{name}\"')"
    return f"UPDATE {table} SET {column} = {text}"


def _in_today_s_unit(row: Any) -> Any:
    written = isinstance(row, Mapping) and row.get("unit") == FIRST_UNIT
    return {key: value for key, value in row.items() if key != "unit"} if written else row


def current_names(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return `table` with today's names; one `Remark`, beginning with `where`, lists the renamed ones."""
    old = [name for name in table if name in RENAMED]
    if old:
        listed = ", ".join(f"{name} is called {RENAMED[name]} today" for name in old)
        warnings.warn(f"{where}: {listed}; read as such.", Remark, stacklevel=2)
    return {RENAMED.get(name, name): value for name, value in table.items()}
