"""Plant model: nominal values by table, effects by their names, and the wire's effects on PDOs.

A table's values replace the nominal ones, and serial and session scatter them like any. Values measured on a bench
(`physics.bench_model`) and effects act with exactly the stated values, whatever serial and session drew.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from eds.bench.bench_network import tpdo_cob_id
from eds.declaration import PathNodes
from parameters import InputError, read_toml
from physics import bench_model
from physics.effects import catalogue as effects
from physics.older_files import current_names
from physics.terms import Term
from virtual_bus.machine.scatter import Tables
from virtual_bus.wire.faults import Fault

WIRE: Final = "bus"
NAMES: Final = (effects.EFFECTS_TABLE, WIRE)
PATHS: Final = "path"
"""Table of tables that hold for one force path, [path.NAME.…]; the other tables hold for each path."""


class PlantModel(NamedTuple):
    """One plant model: `where` it comes from, its tables of nominal values, effects, faults of the wire, and terms."""

    where: str
    tables: Mapping[str, Any]
    effects: Tables
    faults: tuple[Fault, ...]
    terms: tuple[Term, ...] = ()

    def at_work(self, tables: Tables) -> Tables:
        """Return `tables` with the effects included."""
        return {group: values | self.effects.get(group, {}) for group, values in tables.items()}


def read(given: str | Path | Mapping[str, Any] | None, nodes: PathNodes, path: str = "") -> PlantModel:
    """Read the plant model of a force path from a TOML file or from its tables; raises `InputError`.

    `nodes`: the path's, whose PDOs faults of the wire delay; `path`: its name where a bench has several.
    """
    where, tables = "plant_model", dict(given) if isinstance(given, Mapping) else {}
    if isinstance(given, str | Path):
        where, tables = str(given), read_toml(Path(given))
    if path:
        tables = _of_path(tables, path, where)
    known = bench_model.from_tables(tables, where)
    stated = effects.apply(known.effects)
    wire = {**_numbers(tables.get(WIRE, {}), where), **stated.pop(WIRE, {})}
    for table, values in known.simulated().items():
        stated[table] = {**values, **stated.get(table, {})}
    own = {name: current_names(table, f"{where} [{name}]") if isinstance(table, Mapping) else table
           for name, table in tables.items() if name not in (*NAMES, *bench_model.TABLES)}
    return PlantModel(where, own, stated, faults(wire, nodes), known.terms)


def _of_path(tables: Mapping[str, Any], path: str, where: str) -> dict[str, Any]:
    """Return the tables of one path: those of [path.NAME] in place of, or merged into, those of every path."""
    found = {name: table for name, table in tables.items() if name != PATHS}
    own = tables.get(PATHS, {})
    if not isinstance(own, Mapping) or not all(isinstance(table, Mapping) for table in own.values()):
        raise InputError(f"{where}: {PATHS} is no table of tables; write [{PATHS}.{path}.plant] or the like.")
    for name, table in own.get(path, {}).items():
        both = isinstance(table, Mapping) and isinstance(found.get(name), Mapping)
        found[name] = {**found[name], **table} if both else table
    return found


def _numbers(table: Any, where: str) -> dict[str, float]:
    known = sorted(effects.BUS)
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {WIRE} is not a table; write [{WIRE}] with some of {', '.join(known)}.")
    for name, value in table.items():
        if name not in effects.BUS:
            raise InputError(f"{where} [{WIRE}]: unknown key {name}; expected one of {', '.join(known)}.")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
            raise InputError(f"{where} [{WIRE}]: {name} = {value!r} is no number from 0 to 1; give seconds or a share.")
    return {name: float(value) for name, value in table.items()}


def faults(wire: Mapping[str, float], nodes: PathNodes) -> tuple[Fault, ...]:
    """Return the faults that make the PDOs of every input late or lost: `late_s`, `late_share`, `lost_share`."""
    made: list[Fault] = []
    inputs = [tpdo_cob_id(node) for node in nodes if node]
    if wire.get("late_s", 0.0) > 0.0:
        made += [Fault("delay", cob_id=cob_id, probability=wire.get("late_share", 1.0), delay_us=1e6 * wire["late_s"])
                 for cob_id in inputs]
    if wire.get("lost_share", 0.0) > 0.0:
        made += [Fault("drop", cob_id=cob_id, probability=wire["lost_share"]) for cob_id in inputs]
    return tuple(made)
