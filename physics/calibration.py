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

from parameters import InputError, checked, declarations, parameter, read_toml
from physics import stretch
from physics.parameters import assumed

VERSION = 1
NOMINAL = "nominal"
FLAT = 0.05
"""Share of (10)'s linear term below which a slope is taken for flat."""
LATER = ("stretch_short", "stretch_wide", "identified_to", "fabric_breakaway", "load_slope", "viscous", "start_gain",
         "homed_friction")
"""Scalars that calibrations of older versions lack; they are taken as neutral, and that is said."""


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
    stretch_short: float = parameter(0.0, "m/N", "departure of the stretch from (10), fading over 8 N, s1", low=-1e-2,
                                     high=1e-2, source="(10): none")
    stretch_wide: float = parameter(0.0, "m/N", "departure of the stretch from (10), fading over 30 N, s2", low=-1e-2,
                                    high=1e-2, source="(10): none")
    identified_to: float = parameter(300.0, "N", "START tension up to which the bench was identified", low=1.0,
                                     high=300.0, source="neutral: no bound")
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
    fabric_breakaway: float = parameter(0.0, "", "the same of the fabric on the knee", low=0.0, high=4.0,
                                        source="assumed: none on the day of identification")
    breakaway_speed: float = assumed("stribeck_speed")
    breakaway_memory: float = assumed("stribeck_memory")
    load_slope: float = parameter(0.0, "", "λ: both exponents times 1 + λ·(T/40 N − 1)", low=-0.9, high=2.0,
                                  source="assumed: Amontons' law")
    viscous: float = parameter(0.0, "N·s/m", "viscous friction of the rope in its sheath", low=0.0, high=200.0,
                               source="paper, 3.1: Coulomb friction only")
    fabric_share: float = assumed("fabric_share")
    drive_bandwidth: float = assumed("servo_bandwidth")
    loop_delay: float = assumed("servo_delay")
    start_noise: float = assumed("start_noise")
    start_lag: float = assumed("start_lag")
    start_gain: float = parameter(1.0, "", "START's reading by END's where no friction is between them", low=0.8,
                                  high=1.25, source="assumed: both true")
    homed_friction: float = parameter(1.0, "", "friction that homing finds where it is what was identified", low=0.5,
                                      high=2.0, source="assumed: the model is the bench")
    start_offset: float = assumed("start_offset")
    evidence: Mapping[str, Evidence] = field(default_factory=dict)
    label: str = NOMINAL
    bench: str = ""
    lacking: tuple[str, ...] = ()

    @property
    def turning_point_n(self) -> float:
        """Force at which (10) turns over and its inverse ends (88.2 N for the paper's numbers)."""
        return -self.stiffness_b / (2 * self.stiffness_a) if self.stiffness_a < 0 else math.inf

    @property
    def limit_n(self) -> float:
        """Force at which the whole stretch turns over: (10)'s own turning point where nothing departs from (10)."""
        return self.turning_point_n if not self.stretch_short and not self.stretch_wide else stretch.limit_n(self, 0.0)

    @property
    def reach_n(self) -> float:
        """Force beyond which the stretch is continued along its tangent: not identified, or almost flat."""
        return min(self.identified_to, stretch.limit_n(self, FLAT * self.stiffness_b))


def scalars() -> tuple[str, ...]:
    """Names of the scalars, in the order of the file."""
    return tuple(name for name, _, _ in declarations(Calibration))


def neutral(name: str) -> float:
    """Value of a scalar that says nothing."""
    return float(getattr(Calibration(), name))


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
    lacking = tuple(name for name in LATER if name not in given)
    for name, declared in known.items():
        row = given.get(name)
        if name in lacking:
            values[name] = given["breakaway"]["value"] if name == "fabric_breakaway" else neutral(name)
            continue
        if not isinstance(row, dict) or "value" not in row:
            raise InputError(f"{where}: scalar {name} is missing; add [scalars.{name}] with value and unit.")
        if row.get("unit", declared.unit) != declared.unit:
            raise InputError(f"{where}: {name} is in {row['unit']!r}, expected {declared.unit!r}; convert it.")
        values[name] = row["value"]
        low, high = _interval(where, name, row)
        evidence[name] = Evidence(low, high, float(row.get("r_squared", math.nan)), str(row.get("date", "")),
                                  str(row.get("trial", "")))
    given_as = checked(Calibration(**values, evidence=evidence, label=where, bench=owner, lacking=lacking), where=where)
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


def said_of(calibration: Calibration, start_n: float) -> list[str]:
    """What is to be said before a bench pulls `start_n` at START by this calibration: a sentence each."""
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
