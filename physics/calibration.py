"""What a bench was measured to be: at most thirty scalars, each with its evidence.

The rule of this file: a calibration holds scalars only, never a sequence, and the controller knows
nothing else of the plant.  `bowden identify` writes it; the packaged nominal one is the paper's
numbers where the paper gives them and assumptions, marked so, where it does not.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from parameters import InputError, checked, declarations, read_toml
from physics.parameters import assumed

VERSION = 1
NOMINAL = "nominal"


@dataclass(frozen=True)
class Evidence:
    """Where one scalar comes from: 95 % interval, R² of its fit (NaN: none), ISO date, trial."""

    low: float
    high: float
    r_squared: float = math.nan
    date: str = ""
    trial: str = ""


@dataclass(frozen=True)
class Calibration:
    """Scalars of one bench, SI; `label` is "nominal" or the file it was read from, `bench` the bench it belongs to."""

    stiffness_a: float = assumed("stiffness_a")
    stiffness_b: float = assumed("stiffness_b")
    stiffness_c: float = assumed("rope_zero")
    swing_k: float = assumed("rope_per_knee")
    swing_p: float = assumed("swing_p")
    home_preload: float = assumed("home_preload")
    cable_exponent: float = assumed("cable_exponent")
    fabric_friction: float = assumed("mu2")
    wrap_offset: float = assumed("phi0")
    wrap_slope: float = assumed("fabric_wrap")
    cable_compliance: float = assumed("cable_compliance")
    presliding: float = assumed("presliding")
    fabric_presliding: float = assumed("fabric_presliding")
    breakaway: float = assumed("breakaway")
    breakaway_speed: float = assumed("stribeck_speed")
    breakaway_memory: float = assumed("stribeck_memory")
    fabric_share: float = assumed("fabric_share")
    drive_bandwidth: float = assumed("servo_bandwidth")
    loop_delay: float = assumed("servo_delay")
    start_noise: float = assumed("start_noise")
    start_lag: float = assumed("start_lag")
    start_offset: float = assumed("start_offset")
    evidence: Mapping[str, Evidence] = field(default_factory=dict)
    label: str = NOMINAL
    bench: str = ""

    @property
    def turning_point_n(self) -> float:
        """Force at which (10) turns over and its inverse ends (88.2 N for the paper's numbers)."""
        return -self.stiffness_b / (2 * self.stiffness_a) if self.stiffness_a < 0 else math.inf


def scalars() -> tuple[str, ...]:
    """Names of the scalars, in the order of the file."""
    return tuple(name for name, _, _ in declarations(Calibration))


def nominal() -> Calibration:
    """The packaged calibration: the paper's numbers and marked assumptions, belonging to no bench."""
    return Calibration()


def read(path: str | Path, *, bench: str = "") -> Calibration:
    """Read a calibration; `bench` names the bench on the bus, "" accepts any.

    Raises `InputError` for another version, another bench, an unknown or missing scalar, a wrong unit or range.
    """
    where = str(path)
    table = read_toml(Path(path))
    if table.get("version") != VERSION:
        raise InputError(f"{where}: version = {table.get('version')!r}, expected {VERSION}; run bowden identify again.")
    owner = str(table.get("bench", ""))
    if bench and owner and owner != bench:
        raise InputError(f"{where}: bench = {owner!r}, but the bench on the bus is {bench!r}; identify that bench.")
    given = table.get("scalars", {})
    if not isinstance(given, dict):
        raise InputError(f"{where}: scalars is not a table; expected one [scalars.NAME] table per scalar.")
    return _build(where, given, owner)


def _build(where: str, given: Mapping[str, Any], owner: str) -> Calibration:
    known = {name: declared for name, _, declared in declarations(Calibration)}
    for name in given:
        if name not in known:
            raise InputError(f"{where}: unknown scalar {name}; expected one of {', '.join(known)}.")
    values, evidence = {}, {}
    for name, declared in known.items():
        row = given.get(name)
        if not isinstance(row, dict) or "value" not in row:
            raise InputError(f"{where}: scalar {name} is missing; add [scalars.{name}] with value and unit.")
        if row.get("unit", declared.unit) != declared.unit:
            raise InputError(f"{where}: {name} is in {row['unit']!r}, expected {declared.unit!r}; convert it.")
        values[name] = row["value"]
        low, high = _interval(where, name, row)
        evidence[name] = Evidence(low, high, float(row.get("r_squared", math.nan)), str(row.get("date", "")),
                                  str(row.get("trial", "")))
    given_as = checked(Calibration(**values, evidence=evidence, label=where, bench=owner), where=where)
    floats: dict[str, Any] = {name: float(getattr(given_as, name)) for name in known}
    return dataclasses.replace(given_as, **floats)


def _interval(where: str, name: str, row: Mapping[str, Any]) -> tuple[float, float]:
    interval = row.get("interval", [math.nan, math.nan])
    if not isinstance(interval, list) or len(interval) != 2 or not all(isinstance(v, int | float) for v in interval):
        raise InputError(f"{where}: interval of {name} is {interval!r}, expected [low, high]; give two numbers.")
    low, high = float(interval[0]), float(interval[1])
    if low > high:
        raise InputError(f"{where}: interval of {name} is [{low:g}, {high:g}], low above high; swap them.")
    return low, high


def write(calibration: Calibration) -> str:
    """The calibration as TOML text, scalars in the order of their declaration; `read` gives the same one back."""
    lines = [f"version = {VERSION}", f'bench = "{calibration.bench}"']
    for name, _, declared in declarations(Calibration):
        lines += ["", f"[scalars.{name}]  # {declared.text}", f"value = {getattr(calibration, name)!r}",
                  f'unit = "{declared.unit}"']
        evidence = calibration.evidence.get(name)
        if evidence is not None and math.isfinite(evidence.low + evidence.high):
            lines.append(f"interval = [{evidence.low!r}, {evidence.high!r}]")
        if evidence is not None and math.isfinite(evidence.r_squared):
            lines.append(f"r_squared = {evidence.r_squared!r}")
        if evidence is not None:
            lines += [f'{key} = "{text}"' for key, text in (("date", evidence.date), ("trial", evidence.trial)) if text]
    return "\n".join(lines) + "\n"


def refuse_beyond_validity(calibration: Calibration, peak_n: float) -> None:
    """Raise `InputError` when the desired peak lies beyond the turning point of (10), where it has no inverse."""
    limit = calibration.turning_point_n
    if peak_n >= limit:
        raise InputError(
            f"calibration {calibration.label}: a peak of {peak_n:g} N is beyond the turning point of its stiffness, "
            f"{limit:.1f} N; give a lower peak or identify the stiffness again."
        )
