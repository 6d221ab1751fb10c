"""Parameters that each catalogue effect frees in the forward model of a rig of another kind than the bench.

A rig's friction has a size G, N, and two shares of it that depend on load (a) and speed (b); the remainder is dry:

    F = G·[(1 − a − b)·s·(1 + α·s) + a·s·T/T₀]·(1 + r·e^(−(v/vₛ)²)) + G·b·(v + β·abs(v))/v₀     s Dahl's state

T is START of a drive that carries it, and all that accelerates or lifts of a turning axis.  Between two tensions the
load's share is the capstan's, START = END·e^(±c·s), with G·a = T₀·sinh c.

`prefix` "" for friction between two tensions, "drive_" for that of a drive; `load`, `speed`: T₀ and v₀ of the rig.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

from physics.effects.hypotheses import (
    DRIVE,
    ELASTICITY,
    FRICTION,
    SENSOR,
    THETA1,
    Direction,
    Hypothesis,
    Values,
    Variant,
)
from physics.forward.path_constants import PRESLIDING
from physics.forward.rig_constants import BETWEEN, LINK, WEIGHT, WEIGHT_ANGLE
from physics.forward.rig_forces import shares_of

FAINT: Final = 0.5
"""Ratio of the torque of gravity to the friction below which the axis counts as one without a hanging mass."""
LOAD_N: Final = 40.0
"""Tension, N, at which `load_slope` of the catalogue is stated."""


def parts_of(values: Values, prefix: str, load: float, speed: float) -> tuple[float, float, float]:
    """Return dry friction, N, friction per N of load at the RMS load, and viscous friction, N·s/m."""
    size = values[prefix + "friction"]
    dry, a, b = (float(share) for share in shares_of(values, prefix))
    return size * dry, size * a / load, size * b / speed


def _variant(*directions: tuple[Mapping[str, float], float]) -> Callable[[Values], tuple[Variant, ...]]:
    return lambda values: (Variant(tuple(Direction(*given) for given in directions), {}),)


def _share(prefix: str, name: str, sd: float) -> Callable[[Values], tuple[Variant, ...]]:
    """Return the variant that changes one part of the friction alone; `name`: load, viscous or dry."""
    def variants(values: Values) -> tuple[Variant, ...]:
        a, b = values[prefix + "load_share"], values[prefix + "viscous_share"]
        along = {prefix + "friction": 1.0, prefix + "load_share": float(name == "load") - a,
                 prefix + "viscous_share": float(name == "viscous") - b}
        return (Variant((Direction(along, sd),), {}),)
    return variants


def _heavier(values: Values) -> tuple[Variant, ...]:
    """Return the variant of a mass that is added to or removed from an axis with weight: inertia and gravity change, on
    an arm's links, too."""
    if values["unbalance"] < FAINT * values["drive_friction"]:
        return ()
    weights = [n for n in values if n == "unbalance" or (n.startswith(WEIGHT) and not n.startswith(WEIGHT_ANGLE))]
    inertias = [n for n in values if n == "inertia" or n.startswith((LINK, BETWEEN))]
    return (Variant((*(Direction({name: 1.0}, 0.4) for name in weights),
                     *(Direction({name: 1.0}, 0.4 * abs(values[name])) for name in inertias)), {}),)


def _reads_more(values: Values) -> tuple[Variant, ...]:
    """Return the variant of a larger gain of START: offset, ratio, dry and viscous friction grow alike; the capstan's
    exponent stays."""
    a, b = values["load_share"], values["viscous_share"]
    return (Variant((Direction({"ratio": values["ratio"], "offset": values["offset"], "friction": 1.0 - a,
                                "load_share": -a * (1.0 - a), "viscous_share": a * b}, 0.06),), {}),)


def tension_hypotheses(load: float, speed: float, peak: float) -> dict[str, Hypothesis]:
    """Return the effects between two tensions of a rig; `peak`: largest tension, N."""
    def part(k: int) -> Callable[[Values, Values], float]:
        return lambda values, bench: parts_of(values, "", load, speed)[k]

    def coefficient(values: Values, bench: Values) -> float:
        return math.asinh(parts_of(values, "", load, speed)[1]) / THETA1

    def slope(values: Values, bench: Values) -> float:
        dry, per_load, _ = parts_of(values, "", load, speed)
        return -dry / max(dry + per_load * LOAD_N, 1e-9)

    def turned_over(values: Values, bench: Values) -> float:
        # the position turns the friction from −1 to 0 over travel·ln 2, and stretches the cable by lead·friction
        return values["travel"] + PRESLIDING * values["lead"] * values["friction"]

    return {
        "cable_friction": Hypothesis(FRICTION, _variant(
            ({"friction": 1.0}, 0.7), ({"load_share": 1.0}, 0.2), ({"viscous_share": 1.0}, 0.2)), {
                "mu1": coefficient, "coulomb": part(0), "viscous": part(2)}),
        "viscous_friction": Hypothesis(FRICTION, _share("", "viscous", 0.5), {"viscous": part(2)}),
        "load_dependent_friction": Hypothesis(FRICTION, _share("", "load", 0.5), {
            "mu1": coefficient, "load_slope": slope}),
        "stribeck": Hypothesis(FRICTION, _variant(({"rest": 1.0}, 0.5), ({"rest_speed": 1.0}, 0.8)), {
            "stribeck_ratio": lambda v, b: 1.0 + v["rest"], "stribeck_speed": lambda v, b: v["rest_speed"]}),
        "presliding": Hypothesis(FRICTION, _variant(({"travel": 1.0}, 1.0)), {"presliding": turned_over}),
        "friction_drift": Hypothesis(FRICTION, _variant(({"drift": 1.0}, 0.5)), {
            "friction_drift": lambda v, b: v["drift"]}),
        "start_gain": Hypothesis(SENSOR, _reads_more, {"start_gain": lambda v, b: v["ratio"] / b["ratio"]}),
        "end_gain": Hypothesis(SENSOR, lambda v: (Variant((Direction({"ratio": -v["ratio"]}, 0.06),), {}),), {
            "end_gain": lambda v, b: b["ratio"] / v["ratio"]}),
        "start_offset": Hypothesis(SENSOR, _variant(({"offset": 1.0}, 0.05 * peak)), {
            "start_offset": lambda v, b: v["offset"] - b["offset"]}),
    }


def spring_hypotheses() -> dict[str, Hypothesis]:
    """Return the effects of the spring of a series-elastic drive."""
    return {"stiffness": Hypothesis(ELASTICITY, _variant(({"stiffness": 1.0}, 0.3)), {
        "stiffness_scale": lambda v, b: v["stiffness"] * STRETCH_M_PER_N})}


STRETCH_M_PER_N: Final = 3e-4
"""Compliance of the paper's rope and fabric at 40 N, to which `stiffness_scale` of the catalogue refers."""


def give_hypotheses() -> dict[str, Hypothesis]:
    """Return the effect that changes the compliance of a rig's cable, observed by the angle at its END."""
    return {"stiffness": Hypothesis(ELASTICITY, lambda v: (Variant((Direction({"give": v["give"]}, 0.3),), {}),), {
        "stiffness_scale": lambda v, b: b["give"] / v["give"] if v["give"] else 1.0})}


def drive_hypotheses(load: float, speed: float, peak: float, turning: bool) -> dict[str, Hypothesis]:
    """Return the effects of a drive whose force is recorded; `peak`: its largest force."""
    def part(k: int) -> Callable[[Values, Values], float]:
        return lambda values, bench: parts_of(values, "drive_", load, speed)[k]

    def one(name: str, sd: float, parameter: str) -> Hypothesis:
        return Hypothesis(DRIVE, _variant(({name: 1.0}, sd)), {parameter: lambda v, b: v[name]})

    made = {
        "drive_coulomb": Hypothesis(DRIVE, _share("drive_", "dry", 0.7), {"drive_coulomb": part(0)}),
        "drive_viscous": Hypothesis(DRIVE, _share("drive_", "viscous", 0.7), {"drive_viscous": part(2)}),
        "drive_offset": one("drive_offset", 0.1 * peak, "drive_offset"),
        "drive_asymmetry": one("drive_asymmetry", 0.3, "drive_asymmetry"),
        "drive_viscous_asymmetry": one("drive_viscous_asymmetry", 0.3, "drive_viscous_asymmetry"),
        "drive_inertia": Hypothesis(DRIVE, lambda v: (Variant((Direction(
            {"inertia": 1.0}, 0.5 * max(v["inertia"], 1e-12)),), {}),), {"drive_inertia": lambda v, b: v["inertia"]}),
        "drive_stribeck": Hypothesis(DRIVE, _variant(({"drive_rest": 1.0}, 0.5), ({"drive_rest_speed": 1.0}, 0.8)), {
            "drive_stribeck_ratio": lambda v, b: 1.0 + v["drive_rest"],
            "drive_stribeck_speed": lambda v, b: v["drive_rest_speed"]}),
        "drive_presliding": Hypothesis(DRIVE, _variant(({"drive_travel": 1.0}, 1.0)), {
            "drive_presliding": lambda v, b: v["drive_travel"]}),
        "demand_gain": one("demand_gain", 0.1, "demand_gain"),
    }
    if turning:
        made["unbalance"] = Hypothesis(DRIVE, _heavier, {
            "unbalance": lambda v, b: v["unbalance"], "unbalance_phase": lambda v, b: v["unbalance_phase"],
            "drive_inertia": lambda v, b: v["inertia"]})
    return made
