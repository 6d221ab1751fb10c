"""A bench by serial and day: structure and constants from streams of their own.

The rule of this file: each choice and each constant has its own stream, named by it, so that a structure says nothing
of a constant and a row more changes no other row.  Ranges are the project's list for the family (docs/family.md).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable

import numpy as np

from tests.plants.bench import IMPLEMENTATIONS, KNEES, LOADED_KNEE, STRETCHES, STRIBECKS, Bench, Structure, replaced

SET_ASIDE = 3
"""Serials with serial % SET_ASIDE == SET_ASIDE − 1 are set aside: used once, at the end."""


MOST_START_N = 95.0
"""Greatest START tension at 60 N END while everything slides, on the worst day."""
MOST_STUCK_N = 105.0
"""The same at rest, with breakaway; the master stops at 120 N."""
MOST_RATIO, BREAKAWAY = 1.6, 0.3
"""Greatest static over sliding friction as drawn, and what a day adds to it at most."""


def stream(name: str, *numbers: int) -> np.random.Generator:
    """The random numbers that belong to a name and some numbers, in any process the same."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([zlib.crc32(name.encode()), *numbers])))


def set_aside(serial: int) -> bool:
    """Whether a serial is kept for the last run."""
    return serial % SET_ASIDE == SET_ASIDE - 1


def structure(serial: int, implementation: str | None = None) -> Structure:
    """The structure of a serial; with `implementation` given only the rest is drawn."""
    def one(name: str, choices: tuple) -> object:
        return choices[int(stream(f"structure {name}", serial).integers(len(choices)))]

    made = implementation or one("implementation", IMPLEMENTATIONS)
    low, high = {"maxwell": (3, 9), "lugre": (3, 9), "dahl": (1, 1), "fronts": (8, 20)}[made]
    sheath = int(stream("structure sheath nodes", serial).integers(low, high + 1))
    return Structure(
        made, one("stretch", STRETCHES), one("stribeck", STRIBECKS), one("knee", KNEES), one("drive order", (1, 2)),
        sheath, 1 if made == "dahl" else max(2, sheath // 2), one("cells", (2, 3, 4)))


def _even(low: float, high: float) -> Callable[[float], float]:
    return lambda u: low + (high - low) * u


def _log(low: float, high: float) -> Callable[[float], float]:
    return lambda u: low * (high / low) ** u


CONSTANTS: dict[str, Callable[[float], float]] = {
    "theta1": _even(0.5 * math.pi, 1.5 * math.pi),
    "wrap": _even(0.2, 0.9), "wrap_slope": _even(0.0, 2.0),
    "presliding": _log(0.03e-3, 0.5e-3), "fabric_presliding": _log(0.03e-3, 0.5e-3),
    "stribeck_speed": _log(3e-3, 30e-3), "stribeck_memory": _even(0.0, 50e-3),
    "load_slope": _even(-0.2, 0.2), "load_reference": _even(20.0, 60.0), "viscous": _even(0.0, 30.0),
    "lead": _log(1.2e-5, 4e-5), "sheath": _log(0.4e-5, 1.6e-5),
    "before": _even(0.15, 0.4), "after": _even(0.25, 0.45), "power": _even(0.35, 0.7),
    "creep": _even(0.0, 0.5e-5), "creep_s": _log(0.5, 20.0),
    "rope_kg": _log(0.005, 0.05), "loose_drag": _even(0.1, 0.5), "loose_viscous": _log(0.05, 0.5),
    "moment_arm": _even(0.0385, 0.0425), "moment_arm2": _even(-0.5e-3, 0.5e-3), "play_s": _log(3e-3, 12e-3),
    "play_nm": _even(0.1, 0.5), "leg_inertia": _even(0.035, 0.06), "leg_weight": _even(0.5, 1.3),
    "knee_rub": _even(0.15, 0.45), "knee_viscous": _even(0.05, 0.2), "knee_lag": _log(0.5e-3, 2e-3),
    "drum": _even(15e-3, 40e-3), "drive_kg": _even(1.5, 3.5), "drive_coulomb": _even(0.5, 4.0),
    "drive_viscous": _even(5.0, 30.0), "drive_presliding": _log(1e-5, 1e-4), "drive_lag": _log(0.15e-3, 0.8e-3),
    "loop_hz": _even(15.0, 40.0), "eccentricity_phase": _even(-math.pi, math.pi),
    "zero": _even(-50e-3, 50e-3), "start_slack": _even(3e-3, 12e-3),
    "start_lag": _log(0.3e-3, 3e-3), "end_lag": _log(0.3e-3, 3e-3),
    "start_gain": _even(0.995, 1.005), "end_gain": _even(0.995, 1.005),
    "start_offset": _even(-0.1, 0.1), "end_offset": _even(-0.1, 0.1), "end_arm": _even(0.15, 0.35),
}
"""Constant → the value for a number u drawn evenly from 0 … 1."""

CURVES = {"parabola": (0.85, 1.0, 120.0, 250.0), "exponential": (0.4, 0.85, 15.0, 60.0),
          "power": (0.85, 1.0, 3.0, 20.0), "toe": (0.15, 0.5, 3.0, 12.0)}
"""Stretch law → share that is curved, low and high, and the force that it is scaled with, low and high, N."""


def u(name: str, *numbers: int) -> float:
    """The number of a constant's stream, 0 … 1."""
    return float(stream(name, *numbers).random())


def draw(serial: int, day: int = 0, implementation: str | None = None) -> Bench:
    """The bench of a serial on a day; with `implementation` given, with that method in place of the drawn one."""
    kind = structure(serial, implementation)
    values = {name: law(u(f"constant {name}", serial)) for name, law in CONSTANTS.items()}
    total, share = (low + (high - low) * u(f"constant {name}", serial) for name, low, high in (
        ("exponent", 0.10, 0.45), ("sheath share", 0.3, 0.8)))
    values["mu1"] = total * share / values["theta1"]
    values["mu2"] = total * (1.0 - share) / (values["wrap"] + values["wrap_slope"] * abs(LOADED_KNEE))
    less = _reachable(values)
    values["mu1"], values["mu2"] = less * values["mu1"], less * values["mu2"]
    values["breakaway_room"] = _room(values)
    values |= _stribeck(kind, values["breakaway_room"], serial) | _curve(kind, values, serial)
    values["play"] = 0.0 if kind.knee == "none" else math.radians(0.2) * u("constant play", serial)
    bench = Bench(kind, serial, day, **values)
    return on_day(bench) if day else bench


def _stribeck(kind: Structure, room: float, serial: int) -> dict[str, float]:
    excess = _even(0.05, MOST_RATIO - 1.0)
    ratio = {side: 1.0 + room * excess(u(f"constant {side} ratio", serial)) for side in ("sheath", "fabric")}
    return {f"{side}_ratio": value if kind.stribeck in (side, "both") else 1.0 for side, value in ratio.items()}


def _loaded(values: dict[str, float]) -> float:
    """The total exponent of the worst day at the load of 60 N END, sliding."""
    fabric = values["mu2"] * (values["wrap"] + values["wrap_slope"] * abs(LOADED_KNEE))
    return 1.1 * (1.0 + values["load_slope"] * (75.0 - values["load_reference"]) / 40.0) * (
        values["mu1"] * values["theta1"] + fabric)


def _reachable(values: dict[str, float]) -> float:
    """Factor of the friction that keeps START below `MOST_START_N` at 60 N END, sliding, on the worst day."""
    return min(1.0, math.log(MOST_START_N / 60.0) / _loaded(values))


def _room(values: dict[str, float]) -> float:
    """Share of the drawn breakaway that keeps START below `MOST_STUCK_N` at 60 N END, at rest, on the worst day."""
    return min(1.0, max(0.0, math.log(MOST_STUCK_N / 60.0) / _loaded(values) - 1.0) / (MOST_RATIO - 1.0 + BREAKAWAY))


def _curve(kind: Structure, values: dict[str, float], serial: int) -> dict[str, float]:
    low, high, first, last = CURVES[kind.stretch]
    whole = 5e-3 * 5.0 ** u("constant stretch", serial)
    rope = 60.0 * (values["lead"] + values["sheath"])
    return {"stretch_60": max(2e-3, whole - rope), "curve": _even(low, high)(u("constant curve", serial)),
            "bend_n": _log(first, last)(u("constant bend", serial))}


def on_day(bench: Bench) -> Bench:
    """What a day changes: friction ± 10 % each, stiffness ± 3 %, zero ± 0.1 mm, START ± 0.2 N, creep, breakaway."""
    def swing(name: str) -> float:
        return 2.0 * u(f"day {name}", bench.serial, bench.day) - 1.0

    breakaway = 0.5 * BREAKAWAY * bench.breakaway_room * (1.0 + swing("breakaway"))
    kind = bench.structure
    return replaced(
        bench, mu1=bench.mu1 * (1.0 + 0.1 * swing("mu1")), mu2=bench.mu2 * (1.0 + 0.1 * swing("mu2")),
        stiffness=bench.stiffness * (1.0 + 0.03 * swing("stiffness")), zero=bench.zero + 1e-4 * swing("zero"),
        start_offset=bench.start_offset + 0.2 * swing("start offset"),
        creep=bench.creep + 0.5e-5 * (1.0 + swing("creep")),
        sheath_ratio=bench.sheath_ratio + (breakaway if kind.stribeck in ("sheath", "both") else 0.0),
        fabric_ratio=bench.fabric_ratio + (breakaway if kind.stribeck in ("fabric", "both") else 0.0),
        play=bench.play + (0.0 if kind.knee == "none" else math.radians(0.3)))
