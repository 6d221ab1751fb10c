"""Calibration of a bench: at most 32 measured scalars, each with its evidence, and a discrepancy beyond them.

A calibration is the controller's view of a bench model (`physics.bench_model`): scalars and the posterior of a
discrepancy, never a force over time; the controller has no other data of the plant. `bowden identify` measures it. The
packaged nominal one has the paper's numbers if the paper gives them, else assumptions, marked so. The correlation of
the identified values completes their intervals to a joint covariance.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from parameters import InputError, Remark, checked, declarations, read_toml
from physics import end_discrepancy, stretch
from physics.conversions import UNRELATED, converted, to_scalars
from physics.end_discrepancy import EndDiscrepancy
from physics.laws import Array
from physics.older_files import READ, VERSION, translated
from physics.parameters import PARAMETERS, Parameter, assumed

NOMINAL = "nominal"
PARAMETER_TABLE = "parameters"
"""Table of a bench model with the scalars of its calibration."""
FLAT = 0.05
"""Slope of the stretch below which it counts as flat, as a share of (10)'s linear coefficient."""
LATER = ("stretch_short", "stretch_wide", "identified_to", "fabric_breakaway", "load_slope", "viscous",
         "viscous_tension", "start_gain", "homed_friction", "homed_softness")
"""Scalars that a file of version 1 may lack; a missing one has its assumed value, with a remark."""
CORRELATION_TABLE: Final = "correlation"
"""Table of a bench model: `names` of the parameters, and the `rows` of the matrix."""


class Correlation(NamedTuple):
    """Parameters by name, and their correlation, row by row."""

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]

    def over(self, names: Sequence[str]) -> Array:
        """Return the correlation of `names`, shape (names, names); a name without one is independent."""
        whole, place = np.eye(len(names)), {name: i for i, name in enumerate(self.names)}
        known = [k for k, name in enumerate(names) if name in place]
        at = [place[names[k]] for k in known]
        whole[np.ix_(known, known)] = np.array(self.rows).reshape(len(self.names), -1)[np.ix_(at, at)]
        return whole


def correlation_of(names: Sequence[str], covariance: Array) -> Correlation:
    """Return the correlation of the covariance of `names`, shape (names, names); a name without a variance is left out.
    """
    variance = np.diag(covariance)
    known = np.flatnonzero(np.isfinite(variance) & (variance > 0.0)).tolist()
    sd: Array = np.sqrt(variance[known])
    rounded = np.round(covariance[np.ix_(known, known)] / np.outer(sd, sd), 4)
    return Correlation(tuple(names[k] for k in known), tuple(tuple(row) for row in rounded.tolist()))


def correlation_lines(known: Correlation | None) -> list[str]:
    """Return the lines of the table in a bench model's file; `stated_correlation` reads them back."""
    if known is None:
        return []
    names = ", ".join(f'"{name}"' for name in known.names)
    return ["", f"[{CORRELATION_TABLE}]  # of the parameters whose intervals were estimated together",
            f"names = [{names}]", "rows = [", *(f"    [{', '.join(map(repr, row))}]," for row in known.rows), "]"]


def stated_correlation(tables: Mapping[str, Any], where: str) -> Correlation | None:
    """Return the correlation that a file's tables state, None without one.  Raises `InputError`."""
    table = tables.get(CORRELATION_TABLE)
    if table is None:
        return None
    names = table.get("names", ()) if isinstance(table, Mapping) else ()
    try:
        matrix = np.array(table["rows"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        matrix = np.zeros(0)
    whole = matrix.shape == (len(names), len(names)) and bool(np.isfinite(matrix).all())
    if not whole or np.abs(matrix - matrix.T).max(initial=0.0) > 1e-3 or np.abs(matrix).max(initial=0.0) > 1.0:
        raise InputError(f"{where}: [{CORRELATION_TABLE}] rows are no correlation of its {len(names)} names, expected "
                         "a symmetric matrix of numbers within −1 … 1; run bowden identify again.")
    return Correlation(tuple(map(str, names)), tuple(tuple(row) for row in matrix.tolist()))


@dataclass(frozen=True)
class ScalarEvidence:
    """Evidence of one scalar: 95 % interval, R² of its fit (NaN: none), ISO date, trial.

    The interval counts the model's own error; `repeatability` is half of the narrower one within which the value
    comes out again on the same bench by the same model (95 %, ISO 5725; NaN: the interval's).
    """

    low: float
    high: float
    r_squared: float = math.nan
    date: str = ""
    trial: str = ""
    repeatability: float = math.nan


@dataclass(frozen=True)
class Calibration:
    """Scalars of one bench, SI; `label` is "nominal" or the file it was read from, `bench` the bench it belongs to.

    `discrepancy`: START → END beyond the scalars' prediction; None without a gait trial.  `correlation`: of the scalars
    that were estimated together.
    """

    stiffness_a: float = assumed("stiffness_a")
    stiffness_b: float = assumed("stiffness_b")
    rope_zero: float = assumed("rope_zero")
    stretch_short: float = assumed("stretch_short")
    stretch_wide: float = assumed("stretch_wide")
    identified_to: float = assumed("identified_to")
    rope_per_knee: float = assumed("rope_per_knee")
    swing_p: float = assumed("swing_p")
    home_preload: float = assumed("home_preload")
    cable_exponent: float = assumed("cable_exponent")
    mu2: float = assumed("mu2")
    phi0: float = assumed("phi0")
    fabric_wrap: float = assumed("fabric_wrap")
    cable_compliance: float = assumed("cable_compliance")
    presliding: float = assumed("presliding")
    fabric_presliding: float = assumed("fabric_presliding")
    breakaway: float = assumed("breakaway")
    fabric_breakaway: float = assumed("fabric_breakaway")
    stribeck_speed: float = assumed("stribeck_speed")
    stribeck_memory: float = assumed("stribeck_memory")
    load_slope: float = assumed("load_slope")
    viscous: float = assumed("viscous")
    viscous_tension: float = assumed("viscous_tension")
    fabric_share: float = assumed("fabric_share")
    servo_bandwidth: float = assumed("servo_bandwidth")
    servo_delay: float = assumed("servo_delay")
    start_noise: float = assumed("start_noise")
    start_lag: float = assumed("start_lag")
    start_gain: float = assumed("start_gain")
    homed_friction: float = assumed("homed_friction")
    homed_softness: float = assumed("homed_softness")
    start_offset: float = assumed("start_offset")
    evidence: Mapping[str, ScalarEvidence] = field(default_factory=dict)
    label: str = NOMINAL
    bench: str = ""
    lacking: tuple[str, ...] = ()
    discrepancy: EndDiscrepancy | None = None
    correlation: Correlation | None = None

    @property
    def turning_point_n(self) -> float:
        """Return the force, N, at which (10) turns over and its inverse ends (88.2 N for the paper's numbers)."""
        return -self.stiffness_b / (2 * self.stiffness_a) if self.stiffness_a < 0 else math.inf

    @property
    def limit_n(self) -> float:
        """Return the force, N, at which the whole stretch turns over: (10)'s own turning point if nothing departs from
        (10)."""
        return self.turning_point_n if not self.stretch_short and not self.stretch_wide else stretch.limit_n(self, 0.0)

    @property
    def reach_n(self) -> float:
        """Return the force, N, beyond which the stretch is continued along its tangent: not identified, or almost flat.
        """
        return min(self.identified_to, stretch.limit_n(self, FLAT * self.stiffness_b))

    def determined(self) -> dict[str, dict[str, Any]]:
        """Return value, unit, 95 % interval and R² of the scalars that a trial determined, by name."""
        return {name: {"value": getattr(self, name), "unit": declared.unit, "low": proof.low, "high": proof.high,
                       "r_squared": proof.r_squared}
                for name, _, declared in declarations(Calibration)
                if (proof := self.evidence.get(name)) is not None and proof.trial}


def scalars() -> tuple[str, ...]:
    """Return the names of the scalars, in the order of the file."""
    return tuple(name for name, _, _ in declarations(Calibration))


def nominal() -> Calibration:
    """Return the packaged calibration: the paper's numbers and marked assumptions, belonging to no bench."""
    return Calibration()


def read(path: str | Path, *, bench: str = "") -> Calibration:
    """Read the calibration of a bench model; `bench` names the bench on the bus, "" accepts any.

    Raises `InputError` for another version, another bench, an unknown or missing parameter, a wrong unit or range.
    """
    where = str(path)
    tables = translated(read_toml(Path(path)), where)
    owner = str(tables.get("bench", ""))
    if bench and owner and owner != bench:
        raise InputError(f"{where}: bench = {owner!r}, but the bench on the bus is {bench!r}; identify that bench.")
    values, evidence = stated(tables, where)
    if not values:
        raise InputError(f"{where}: states no parameter; give a file that bowden identify wrote.")
    return of_values(values, evidence, label=where, bench=owner, beyond=end_discrepancy.stated(tables, where),
                     together=stated_correlation(tables, where))


def stated(tables: Mapping[str, Any], where: str, name: str = PARAMETER_TABLE
           ) -> tuple[dict[str, float], dict[str, ScalarEvidence]]:
    """Return values and evidence by parameter, as the table `name` of a bench model states them.

    Raises `InputError`.
    """
    rows = tables.get(name, {})
    if not isinstance(rows, Mapping):
        raise InputError(f"{where}: {name} is not a table; expected one [{name}.NAME] table per parameter.")
    if rows and tables.get("version") not in READ:
        raise InputError(
            f"{where}: version = {tables.get('version')!r}, expected {VERSION}; run bowden identify again.")
    values: dict[str, float] = {}
    evidence: dict[str, ScalarEvidence] = {}
    for key, row in rows.items():
        if key not in PARAMETERS:
            raise InputError(f"{where}: unknown parameter {key}; expected one of {', '.join(PARAMETERS)}.")
        p = PARAMETERS[key]
        values[p.name] = _value(where, key, p, row)
        low, high = _interval(where, key, row)
        evidence[p.name] = ScalarEvidence(low, high, float(row.get("r_squared", math.nan)), str(row.get("date", "")),
                                          str(row.get("trial", "")), float(row.get("repeatability", math.nan)))
    return values, evidence


def _value(where: str, key: str, p: Parameter, row: Any) -> float:
    if not isinstance(row, Mapping) or "value" not in row:
        raise InputError(f"{where}: {key} has no value; write [parameters.{p.name}] with value and unit.")
    if row.get("unit", p.unit) != p.unit:
        raise InputError(f"{where}: {key} is in {row['unit']!r}, expected {p.unit!r}; convert it.")
    value = row["value"]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {key} = {value!r} is not a number; {p.meaning}.")
    low, high = _accepted(p)
    if not low <= value <= high:
        within = f"{low:g} … {high:g} {p.unit}".rstrip()
        raise InputError(f"{where}: {key} = {value!r} is outside {within}; {p.meaning}.")
    return float(value)


def _accepted(p: Parameter) -> tuple[float, float]:
    """Return the bounds of a value in a file: those of a measurement, and of a fit if one estimates it."""
    low, high = p.rig_bounds if p.assumed is None else (p.assumed.low, p.assumed.high)
    if p.is_estimated:
        low, high = min(low, p.low), max(high, p.high)
    # of two signals either may be the later one
    return (min(low, -high), high) if p.name in ("end_delay", "timestamp_skew") else (low, high)


def _interval(where: str, name: str, row: Mapping[str, Any]) -> tuple[float, float]:
    interval = row.get("interval", [math.nan, math.nan])
    if not isinstance(interval, list) or len(interval) != 2 or not all(isinstance(v, int | float) for v in interval):
        raise InputError(f"{where}: interval of {name} is {interval!r}, expected [low, high]; give two numbers.")
    low, high = float(interval[0]), float(interval[1])
    if low > high:
        raise InputError(f"{where}: interval of {name} is [{low:g}, {high:g}], low above high; swap them.")
    return low, high


def of_values(
    values: Mapping[str, float], evidence: Mapping[str, ScalarEvidence], *, label: str, bench: str = "",
    beyond: EndDiscrepancy | None = None, together: Correlation | None = None,
) -> Calibration:
    """Return the controller's view of a bench's `values`, by name of the table and in any form.

    A scalar that does not follow from them has its assumed value and is named in `lacking`.
    """
    told = to_scalars({**converted(UNRELATED, values), **values})
    told = {name: _inside(name, value) for name, value in told.items()}
    lacking = tuple(name for name in scalars() if name not in told)
    if "fabric_breakaway" in lacking and "breakaway" in told:
        told["fabric_breakaway"] = told["breakaway"]
    if untold := [name for name in lacking if name not in LATER]:
        warnings.warn(f"{label}: says nothing of {', '.join(untold)}; taken as assumed.", Remark, stacklevel=2)
    known = {name: evidence[name] for name in scalars() if name in evidence}
    fields: dict[str, Any] = {name: float(value) for name, value in told.items()}
    return checked(Calibration(**fields, evidence=known, label=label, bench=bench, lacking=lacking,
                               discrepancy=beyond, correlation=together), where=label)


def _inside(name: str, value: float) -> float:
    """Return a scalar within the bounds of a measurement; a fit to trials may lie beyond them."""
    known = PARAMETERS[name].assumed
    return value if known is None else min(max(value, known.low), known.high)


def values_of(calibration: Calibration) -> tuple[dict[str, float], dict[str, ScalarEvidence]]:
    """Return a calibration's values and evidence by name of the table of parameters."""
    return {name: float(getattr(calibration, name)) for name in scalars()}, dict(calibration.evidence)


def rows(values: Mapping[str, float], evidence: Mapping[str, ScalarEvidence], table: str = PARAMETER_TABLE
         ) -> list[str]:
    """Return the lines of `[parameters.NAME]`, in the order of `values`; `stated` reads them back."""
    lines = []
    for name, value in values.items():
        p, known = PARAMETERS[name], evidence.get(name)
        lines += ["", f"[{table}.{name}]  # {p.meaning}", f"value = {value!r}", f'unit = "{p.unit}"']
        if known is not None and math.isfinite(known.low + known.high):
            lines.append(f"interval = [{known.low!r}, {known.high!r}]")
        if known is not None and math.isfinite(known.repeatability):
            lines.append(f"repeatability = {known.repeatability!r}")
        if known is not None and math.isfinite(known.r_squared):
            lines.append(f"r_squared = {known.r_squared!r}")
        if known is not None:
            lines += [f'{key} = "{text}"' for key, text in (("date", known.date), ("trial", known.trial)) if text]
    return lines


def write(calibration: Calibration) -> str:
    """Return the calibration as the TOML text of a bench model; `read` gives the same one back."""
    return "\n".join([
        f"version = {VERSION}", f'bench = "{calibration.bench}"', *rows(*values_of(calibration)),
        *correlation_lines(calibration.correlation), *end_discrepancy.rows(calibration.discrepancy)]) + "\n"


def said_of(calibration: Calibration, start_n: float) -> list[str]:
    """Return warnings, a sentence each, before a bench pulls `start_n` at START by this calibration."""
    said = []
    if calibration.lacking:
        said.append(f"calibration {calibration.label} is of an older version without {', '.join(calibration.lacking)}; "
                    "neutral values are taken; run bowden identify again.")
    if start_n > calibration.identified_to:
        said.append(f"calibration {calibration.label}: the peak takes {start_n:.0f} N at START and the bench was "
                    f"identified up to {calibration.identified_to:.0f} N; beyond it the stretch is extrapolated.")
    return said


def refuse_beyond_validity(calibration: Calibration, peak_n: float) -> None:
    """Raise `InputError` when the desired peak lies beyond the turning point of (10), where it has no inverse."""
    limit = calibration.limit_n
    if peak_n >= limit:
        raise InputError(
            f"calibration {calibration.label}: a peak of {peak_n:g} N is beyond the turning point of its stiffness, "
            f"{limit:.1f} N; give a lower peak or identify the stiffness again."
        )
