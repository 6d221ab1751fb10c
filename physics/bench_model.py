"""Bench model: the identified properties of one bench, in one file that simulator, controller and diagnosis load.

Named numbers with their evidence (`[parameters.NAME]`: value, unit, 95 % interval, R², date, trial), effects beyond
them (`[effects.NAME]`) and the data that they were found on (`[found]`). A file may have either part: `bowden
identify` writes the first, `bowden diagnose` the second.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from parameters import InputError, Remark, read_toml
from physics import calibration, end_discrepancy, setup_check, terms
from physics.calibration import Calibration, Correlation, ScalarEvidence
from physics.conversions import RELATED, SIMULATED, UNRELATED, converted
from physics.effects.catalogue import CATALOGUE, EFFECTS_TABLE, EVIDENCE, complete, stated
from physics.end_discrepancy import EndDiscrepancy
from physics.older_files import OLDER_TABLES, READ, VERSION, translated
from physics.parameters import BY_PLANT, ESTIMATED, PARAMETERS, healthy
from physics.terms import Term

FITTED: Final = "fitted"
"""Name of the TOML table with the trials and errors of a `bowden fit`."""
RIG: Final = "rig"
"""Name of the TOML table with the constants of a rig of another kind, which no simulation reads."""
SIMULATION: Final = "simulation"
"""Name of the TOML table with the parameters of the many-segment simulation that `bowden fit` fitted to the trials."""
TABLES: Final = ("version", "bench", "parameters", *OLDER_TABLES, end_discrepancy.TABLE, EFFECTS_TABLE, EVIDENCE,
                 FITTED, RIG, SIMULATION, calibration.CORRELATION_TABLE, setup_check.TABLE, terms.ARRAY)
"""Tables of a bench model; a plant model may hold tables of nominal values, too."""
Values = Mapping[str, float]


@dataclass(frozen=True)
class BenchModel:
    """One bench, SI.

    `values`: by name of `physics.parameters`, in any form of `physics.conversions`; `evidence`: 95 % interval, R²,
    date and trial by the same names; `effects`: name → parameter → value; `found`: the data that the effects were
    found on; `fitted`: figures of `bowden fit` (empty: the values are not from a fit); `rig`: constants of a rig of
    another kind by name, each with value, unit and interval; `simulation`: parameters of the simulation that were
    fitted by themselves, with their evidence, in place of those converted from `values`; `bench`: the bench's name
    ("": none); `label`: the file, or "nominal"; `discrepancy`: START → END beyond the values, of gait trials with END;
    `correlation`: of the values that were estimated together; `terms`: modulated
    constants, found by `bowden discover`.
    """

    values: Values = field(default_factory=dict)
    evidence: Mapping[str, ScalarEvidence] = field(default_factory=dict)
    effects: Mapping[str, Values] = field(default_factory=dict)
    found: Mapping[str, Any] = field(default_factory=dict)
    bench: str = ""
    label: str = calibration.NOMINAL
    fitted: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    discrepancy: EndDiscrepancy | None = None
    correlation: Correlation | None = None
    simulation: Values = field(default_factory=dict)
    simulation_evidence: Mapping[str, ScalarEvidence] = field(default_factory=dict)
    terms: tuple[Term, ...] = ()

    def _repr_html_(self) -> str:
        """Return a table for a notebook: each value with its unit and 95 % interval, then the effects."""
        from html import escape

        rows = [(name, value, PARAMETERS[name].unit if name in PARAMETERS else "", self.evidence.get(name))
                for name, value in self.values.items()]
        rows += [(f"{effect}: {name}", value, "", None) for effect, given in self.effects.items()
                 for name, value in given.items()]
        body = "".join(
            f"<tr><td>{escape(name.replace('_', ' '))}</td><td>{value:.4g} {escape(unit)}</td><td>"
            f"{'' if known is None else f'{known.low:.4g} … {known.high:.4g}'}</td></tr>"
            for name, value, unit, known in rows)
        heads = "<tr><th>parameter</th><th>value</th><th>95 % interval</th></tr>"
        return f"<p><b>{escape(self.label)}</b></p><table>{heads}{body}</table>"

    @property
    def calibration(self) -> Calibration:
        """Return the controller's view; an unknown scalar has its assumed value and is named in `lacking`."""
        return calibration.of_values(self.values, self.evidence, label=self.label, bench=self.bench,
                                     beyond=self.discrepancy, together=self.correlation)

    def simulation_values(self) -> dict[str, float]:
        """Return every parameter of the simulation, with the effects; nominal where the model has none."""
        return {**healthy(), **self.related(), **{
            name: value for row in self.effects.values() for name, value in row.items()}}

    def simulated(self) -> dict[str, dict[str, float]]:
        """Return the values that the simulation runs on, table → key → value, without effects.

        A value outside the simulation's bounds is replaced by the bound, with a `Remark`.
        """
        told = converted(SIMULATED, converted(UNRELATED, self.values)) | converted(UNRELATED, self.simulation)
        tables: dict[str, dict[str, float]] = {}
        for key, name in BY_PLANT.items():
            if name in told:
                table, _, parameter = key.partition(".")
                tables.setdefault(table, {})[parameter] = self._within(name, told[name])
        return tables

    def _within(self, name: str, value: float) -> float:
        p = PARAMETERS[name]
        kept = min(max(value, p.low), p.high)
        if not math.isclose(kept, value, rel_tol=1e-9, abs_tol=1e-12):
            warnings.warn(f"{self.label}: {name} = {value:g} {p.unit} is outside {p.low:g} … {p.high:g}; simulated "
                          f"with {kept:g}.", Remark, stacklevel=3)
        return kept

    def related(self) -> dict[str, float]:
        """Return the parameters that a fit of the simulation estimates, without effects, as far as they are stated."""
        told = converted(RELATED, converted(SIMULATED, self.values)) | dict(self.simulation)
        return {name: told[name] for name in ESTIMATED if name in told}

    def at_work(self) -> dict[str, float]:
        """Return the parameters that the effects set, by name."""
        return {name: value for effect, given in self.effects.items()
                for name, value in complete(effect, given).items()
                if name in {p.name for p in CATALOGUE[effect].parameters}}

    def text(self) -> str:
        """Return the model as TOML; `read` gives the same one back, comments and intervals of effects aside."""
        lines = [f"version = {VERSION}", f'bench = "{self.bench}"', *calibration.rows(self.values, self.evidence),
                 *calibration.correlation_lines(self.correlation), *end_discrepancy.rows(self.discrepancy)]
        if self.fitted:
            lines += ["", f"[{FITTED}]", *(f"{key} = {_cell(value)}" for key, value in self.fitted.items())]
        lines += calibration.rows(self.simulation, self.simulation_evidence, SIMULATION)
        for name, row in self.rig.items():
            lines += ["", f"[{RIG}.{name}]", *(f"{key} = {_cell(value)}" for key, value in row.items())]
        if self.found:
            lines += ["", f"[{EVIDENCE}]", *(f"{key} = {_cell(value)}" for key, value in self.found.items())]
        for name, values in self.effects.items():
            lines += ["", f"[{EFFECTS_TABLE}.{name}]  # {CATALOGUE[name].words}",
                      *(f"{key} = {value!r}" for key, value in values.items())]
        lines += terms.rows(self.terms)
        return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_cell(each)}" for key, each in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_cell(each) for each in value) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value).lower() if isinstance(value, bool) else repr(value)


def nominal() -> BenchModel:
    """Return the packaged model: the paper's numbers and marked assumptions, belonging to no bench."""
    return of_calibration(calibration.nominal())


def of_calibration(known: Calibration) -> BenchModel:
    """Return the model of a calibration."""
    values, evidence = calibration.values_of(known)
    return BenchModel(values, evidence, bench=known.bench, label=known.label,
                      discrepancy=known.discrepancy, correlation=known.correlation)


def read(path: str | Path, *, bench: str = "") -> BenchModel:
    """Read a model that `bowden identify`, `bowden diagnose` or `write` wrote; raises `InputError`.

    `bench`: the bench that it must belong to; "" for any.
    """
    tables = read_toml(Path(path))
    for name in tables:
        if name not in TABLES:
            raise InputError(f"{path}: unknown table {name}; expected {', '.join(f'[{t}]' for t in TABLES[2:])}.")
    model = from_tables(tables, str(path))
    if not (model.values or model.effects or model.found or model.terms):
        raise InputError(f"{path}: states neither parameters nor effects; give what bowden identify or diagnose wrote.")
    if bench and model.bench and model.bench != bench:
        raise InputError(
            f"{path}: bench = {model.bench!r}, but the bench on the bus is {bench!r}; identify that bench.")
    return model


def from_tables(tables: Mapping[str, Any], where: str) -> BenchModel:
    """Return the bench model in a file's tables; tables of other readers are ignored.  Raises `InputError`."""
    if "version" in tables and tables["version"] not in READ:
        raise InputError(f"{where}: version = {tables['version']!r}, expected {VERSION}; run bowden identify again.")
    tables = translated(tables, where)
    values, evidence = calibration.stated(tables, where)
    simulation, simulation_evidence = calibration.stated(tables, where, SIMULATION)
    found = tables.get(EVIDENCE, {})
    if not isinstance(found, Mapping):
        raise InputError(f"{where}: {EVIDENCE} is not a table; write it as [{EVIDENCE}].")
    fitted, rig = (table if isinstance(table := tables.get(name), Mapping) else {} for name in (FITTED, RIG))
    if rig:
        raise InputError(f"{where}: tells the constants of a rig of another kind, which nothing simulates; diagnose "
                         "its trials with its reference trials, --healthy.")
    return BenchModel(values, evidence, stated(tables, where), found, str(tables.get("bench", "")), where, fitted,
                      discrepancy=end_discrepancy.stated(tables, where),
                      correlation=calibration.stated_correlation(tables, where), simulation=simulation,
                      simulation_evidence=simulation_evidence, terms=terms.stated(tables, where))
