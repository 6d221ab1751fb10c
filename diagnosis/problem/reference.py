"""What the measurement is compared with: healthy values, and the bands inside which nothing is to be found.

The rule of this file: a band comes from a calibration's own interval and from how far like benches differ,
or, on a rig that nothing is known of, there is none: then what an ideal transmission lacks is to be found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from diagnosis.data.table import Table
from diagnosis.problem.blocks import Block
from diagnosis.problem.fit import Free
from physics.effects.catalogue import CATALOGUE
from physics.plant.leg import KNEE_AT_FIT
from physics.relations.relation_parameters import LEG, SLOTS, healthy, ideal
from physics.relations.transmission import STRETCH_BEND, STRETCH_LINEAR

BAND: Final = 3.0
"""Half width of a hard band, in 1σ of like benches."""
LIKE_THIS_BENCH: Final = (0.7, 1.4)
"""Rope per knee angle against the bench's own, within which a trial is taken to come from such a bench."""


@dataclass(frozen=True)
class Reference:
    """Healthy values, and what a baseline may move; `kind`: calibration, nominal or none."""

    kind: str
    values: Mapping[str, float]
    nuisance: tuple[Free, ...]


SCALARS: Final[Mapping[str, tuple[tuple[str, ...], Callable[..., float]]]] = {
    "mu1": (("cable_exponent",), lambda e: e / SLOTS["theta1"].healthy),
    "mu2": (("fabric_friction",), lambda m: m),
    "phi0": (("wrap_offset",), lambda w: w),
    "fabric_wrap": (("wrap_slope",), lambda k: k),
    "cable_share": (("cable_compliance", "stiffness_b"), lambda c, b: c / b),
    "presliding": (("presliding",), lambda d: d),
    "knee_ratio": (("swing_k",), lambda k: k),
    "rope_zero": (("stiffness_c",), lambda c: c),
    "stiffness_scale": (("stiffness_b",), lambda b: STRETCH_LINEAR / b),
    "stiffness_shape": (("stiffness_a", "stiffness_b"), lambda a, b: a / STRETCH_BEND * STRETCH_LINEAR / b - 1.0),
    "servo_bandwidth": (("drive_bandwidth",), lambda f: f),
    "servo_delay": (("loop_delay",), lambda d: d),
    "start_offset": (("start_offset",), lambda o: o),
}
"""Slots that a calibration's scalars give: which scalars, and how."""


def of_bench(calibration: Mapping[str, Any] | None) -> Reference:
    """Return the bench of the signal table, its values from `calibration` where that has them."""
    values = {**healthy(), **_brought()}
    given = (calibration or {}).get("scalars", {})
    nuisance = []
    for name, slot in SLOTS.items():
        value, spread = _calibrated(given, name)
        values[name] = slot.healthy if value is None else value
        sigma = math.hypot(slot.sigma, spread)
        if sigma > 0.0:
            at = values[name]
            nuisance.append(Free(name, max(slot.low, at - BAND * sigma), min(slot.high, at + BAND * sigma),
                                 at, sigma, sigma))
    return Reference("nominal" if calibration is None else "calibration", values, tuple(nuisance))


def _calibrated(scalars: Mapping[str, Any], slot: str) -> tuple[float | None, float]:
    """Return a slot's value from the scalars and its 1σ from their intervals; (None, 0) where they lack."""
    names, law = SCALARS.get(slot, ((), float))
    if not names or not all(n in scalars for n in names):
        return None, 0.0
    at = [float(scalars[n]["value"]) for n in names]
    spread = 0.0
    for i, name in enumerate(names):
        low, high = scalars[name].get("interval", (at[i], at[i]))
        ends = [law(*at[:i], float(end), *at[i + 1:]) for end in (low, high)]
        spread = math.hypot(spread, (ends[1] - ends[0]) / (2.0 * 1.96))
    return law(*at), spread


def _brought() -> dict[str, float]:
    """Return the neutral values of parameters that only an effect's own law reads."""
    return {p.name: sum(p.likely) / 2.0 if p.neutral is None else p.neutral
            for effect in CATALOGUE.values() for p in effect.parameters if p.name not in SLOTS}


def of_unknown_rig(blocks: Sequence[Block]) -> Reference:
    """Return an ideal transmission whose offsets, ratios and load-free friction are whatever the data say."""
    values = {**ideal(), **_brought()}
    for block in blocks:
        s = block.signals
        if s.has("rope_m", "knee_angle_rad"):
            slope, level = np.polyfit(s["knee_angle_rad"], s["rope_m"], 1)
            values["knee_ratio"], values["rope_zero"] = float(slope), float(level + slope * KNEE_AT_FIT)
            break
    nuisance = tuple(
        Free(name, slot.low, slot.high, values[name], math.inf, _scale(blocks, slot.unit, values[name]))
        for name, slot in SLOTS.items() if slot.free)
    return Reference("none", values, nuisance)


def _scale(blocks: Sequence[Block], unit: str, at: float) -> float:
    spans = {"N": "tension_start_n", "m": "rope_m", "rad": "knee_angle_rad", "N·s/m": "rope_m_s"}
    if unit == "N·s/m":
        return 1.0
    name = spans.get(unit)
    held = [b.signals[name] for b in blocks if name is not None and b.signals.has(name)]
    return float(np.std(held[0])) if held else max(0.1 * abs(at), 1e-3)


def like_this_bench(tables: Sequence[Table]) -> bool:
    """Return whether rope and knee move together as on the bench of the signal table (unknown: it is assumed)."""
    for given in tables:
        if "servo_position_m" in given and "knee_angle_rad" in given:
            angle, rope = given["knee_angle_rad"], given["servo_position_m"]
            known = np.isfinite(angle) & np.isfinite(rope)
            slope = float(np.polyfit(angle[known], rope[known], 1)[0])
            return LIKE_THIS_BENCH[0] < slope / LEG.moment_arm_m < LIKE_THIS_BENCH[1]
    return any("desired_force_n" in t or "gait_percent" in t for t in tables)
