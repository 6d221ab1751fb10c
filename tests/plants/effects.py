"""Hidden effects: each of the catalogue that a bench of the family can have, in the family's own numbers.

The rule of this file: an effect is a function (rng, bench) → (changed bench, the true values by the catalogue's
parameter names).  Sizes are within the catalogue's likely ranges and differ from the healthy bench by more than like
benches do.  Effects add to what a healthy bench has already, so the truth is the bench's whole number, not the change.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable

import numpy as np

from tests.plants.bench import Bench, replaced

Rng = np.random.Generator
Hidden = tuple[Bench, dict[str, float]]
Effect = Callable[[Rng, Bench], Hidden]


def _sign(rng: Rng) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _log(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _factor(field: str, low: tuple[float, float], high: tuple[float, float], name: str = "") -> Effect:
    def drawn(rng: Rng, bench: Bench) -> Hidden:
        value = getattr(bench, field) * rng.uniform(*(low if rng.random() < 0.5 else high))
        return replaced(bench, **{field: value}), {name or field: value}
    return drawn


def _either(field: str, low: float, high: float, name: str = "") -> Effect:
    """Add low … high of either sign."""
    def drawn(rng: Rng, bench: Bench) -> Hidden:
        value = getattr(bench, field) + _sign(rng) * rng.uniform(low, high)
        return replaced(bench, **{field: value}), {name or field: value}
    return drawn


def _more(field: str, low: float, high: float, name: str = "") -> Effect:
    """Add low … high, evenly in the logarithm."""
    def drawn(rng: Rng, bench: Bench) -> Hidden:
        value = getattr(bench, field) + _log(rng, low, high)
        return replaced(bench, **{field: value}), {name or field: value}
    return drawn


def load_slope_at_40(bench: Bench) -> float:
    """The load slope as the catalogue refers it, to the friction at 40 N, of the bench's own at its own reference."""
    return bench.load_slope / (1.0 + bench.load_slope * (40.0 - bench.load_reference) / 40.0)


def _load(rng: Rng, bench: Bench) -> Hidden:
    bench = replaced(bench, load_slope=bench.load_slope + math.copysign(rng.uniform(0.25, 0.4), bench.load_slope))
    return bench, {"load_slope": load_slope_at_40(bench)}


def _wrap(rng: Rng, bench: Bench) -> Hidden:
    less = rng.random() < 0.5 and bench.wrap_slope > 0.9
    value = bench.wrap_slope + (-1.0 if less else 1.0) * rng.uniform(0.5, 0.8)
    return replaced(bench, wrap_slope=value), {"fabric_wrap": value}


def _stribeck(rng: Rng, bench: Bench) -> Hidden:
    more, speed = rng.uniform(0.5, 1.2), _log(rng, 0.004, 0.03)
    bench = replaced(bench, sheath_ratio=bench.sheath_ratio + more, fabric_ratio=bench.fabric_ratio + more,
                     stribeck_speed=speed)
    return bench, {"stribeck_ratio": 0.5 * (bench.sheath_ratio + bench.fabric_ratio), "stribeck_speed": speed}


def _presliding(rng: Rng, bench: Bench) -> Hidden:
    value = _log(rng, max(0.3e-3, 1.6 * max(bench.presliding, bench.fabric_presliding)), 1.2e-3)
    return replaced(bench, presliding=value, fabric_presliding=value), {"presliding": value}


def _creep(rng: Rng, bench: Bench) -> Hidden:
    compliance, seconds = rng.uniform(2e-5, 4e-5), _log(rng, 0.2, 20.0)
    return replaced(bench, creep=compliance, creep_s=seconds), {
        "creep_compliance": compliance, "creep_time": seconds}


def _eccentric(rng: Rng, bench: Bench) -> Hidden:
    size, phase = rng.uniform(0.2e-3, 0.5e-3), rng.uniform(-math.pi, math.pi)
    return replaced(bench, eccentricity=size, eccentricity_phase=phase), {
        "eccentricity": size, "eccentricity_phase": phase}


def _gain(side: str) -> Effect:
    return _factor(f"{side}_gain", (0.92, 0.97), (1.03, 1.08))


def _late(rng: Rng, bench: Bench) -> Hidden:
    cycles, share = int(rng.integers(1, 6)), float(rng.uniform(0.1, 0.6))
    return replaced(bench, late_cycles=cycles, late_share=share), {"late": 1e-3 * cycles, "late_share": share}


PATH: dict[str, Effect] = {
    "cable_friction": _factor("mu1", (0.4, 0.7), (1.4, 2.2)),
    "fabric_friction": _factor("mu2", (0.35, 0.6), (1.5, 2.2)),
    "fabric_wrap": _wrap,
    "cable_bend": _either("cable_bend", 0.3, 0.5),
    "load_dependent_friction": _load,
    "viscous_friction": _more("viscous", 8.0, 20.0),
    "stribeck": _stribeck,
    "presliding": _presliding,
    "friction_drift": _either("friction_drift", 0.3, 0.7),
    "stiffness": _factor("stiffness", (0.75, 0.88), (1.13, 1.35), "stiffness_scale"),
    "fabric_creep": _creep,
    "slack": _more("slack", 0.8e-3, 4e-3),
    "knee_backlash": _more("play", math.radians(0.5), math.radians(2.0), "knee_backlash"),
    "moment_arm": _either("moment_arm2", 0.8e-3, 1.97e-3, "rope_per_knee_quadratic"),
    "drum_eccentricity": _eccentric,
}
SENSOR: dict[str, Effect] = {
    "end_mass": _more("end_mass", 0.05, 0.15),
    "end_gain": _gain("end"), "start_gain": _gain("start"),
    "end_offset": _either("end_offset", 1.0, 3.0), "start_offset": _either("start_offset", 1.0, 3.0),
    "end_drift": _either("end_drift", 1.0, 3.0), "start_drift": _either("start_drift", 1.0, 3.0),
    "end_filter": _more("end_filter", 5e-3, 20e-3),
}
DRIVE: dict[str, Effect] = {
    "drive_coulomb": _more("drive_coulomb", 3.0, 8.0), "drive_viscous": _more("drive_viscous", 30.0, 120.0),
    "drive_offset": _either("drive_offset", 1.5, 5.0), "drive_asymmetry": _either("drive_asymmetry", 0.4, 0.7),
    "drive_inertia": _factor("drive_kg", (0.4, 0.55), (1.6, 3.0), "drive_inertia"),
    "drive_viscous_asymmetry": _either("drive_viscous_asymmetry", 0.4, 0.8),
    "drive_presliding": _more("drive_presliding", 0.4e-3, 2e-3),
    "demand_gain": _factor("demand_gain", (0.85, 0.94), (1.06, 1.15)),
}
WIRE: dict[str, Effect] = {
    "end_delay": _more("end_delay", 5e-3, 20e-3), "timestamp_skew": _more("skew", 5e-3, 20e-3, "timestamp_skew"),
    "quantisation": _more("quantum", 0.4, 2.0), "lost_pdo": _more("lost_share", 0.02, 0.2), "late_pdo": _late,
}
OUTSIDE: dict[str, Effect] = {
    "end_resonance": _more("resonance", 0.5, 1.0),
    "torn_strand": _more("torn", 0.06, 0.15),
}
"""Outside the catalogue: END's cantilever rings at 9 Hz; a strand that bears only while the load falls."""

EFFECTS = PATH | SENSOR | DRIVE | WIRE
"""Every effect of the catalogue that the family has, by the catalogue's name."""
IN_PLANT = frozenset(PATH | SENSOR | DRIVE | OUTSIDE)
"""Those that a plant behind nodes can have; dead times, rounding and lost PDOs are the converters' or the wire's."""
ABSENT = {"unbalance": "the family's drums are round and balanced",
          "saturation": "shows only in a drive that is driven to its limit: use the plant's force_limit",
          "supply_sag": "no supply in the family's drive",
          "drive_stribeck": "the family's drives rub by Coulomb's law and a film's"}
"""What the catalogue has and the family has not, with the reason."""


def hide(bench: Bench, names: Iterable[str], seed: int) -> Hidden:
    """The bench with all of `names` in it, one after the other, drawn from the seed; and the true values of all."""
    said: dict[str, float] = {}
    for name in names:
        rng = np.random.default_rng((seed, bench.serial, zlib.crc32(name.encode())))
        bench, values = (EFFECTS | OUTSIDE)[name](rng, bench)
        said |= values
    return bench, said
