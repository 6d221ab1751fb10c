"""Hypotheses of the catalogue: the parameters that each effect frees in the forward model, and its part of the bench.

An effect is a hypothesis: it adds prior variance along directions in the space of `physics.forward.path_constants`. One
entry a variant; variants of an effect (time constants, drum radii, kinds of backlash) have one name.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from physics.forward.force_path import KNEE_RAD
from physics.forward.path_constants import LOAD_PER_STEP, PRESLIDING
from physics.forward.path_parameters import stretch_m, stretch_of
from physics.parameters import PARAMETERS

Values = Mapping[str, float]
Read = Callable[[Values, Values], float]
"""Value of an effect's parameter from the constants of the trial and of the bench in the reference condition."""
FRICTION, ELASTICITY, GEOMETRY, SENSOR, TIMING, DRIVE = (
    "friction path", "elasticity and gains", "geometry", "sensor", "timing", "drive")
PARTS: Final = (FRICTION, ELASTICITY, GEOMETRY, SENSOR, TIMING, DRIVE)


class Direction(NamedTuple):
    """A direction in coordinates of the constants, by name, and the 1σ of the effect's size along it."""

    along: Mapping[str, float]
    sd: float


class Variant(NamedTuple):
    """Variant of an effect: the `directions` to fit, and in `at` the values of constants that are fixed before."""

    directions: tuple[Direction, ...]
    at: Mapping[str, float]


class Hypothesis(NamedTuple):
    """An effect as a hypothesis: its part of the bench, its variants at given bench constants, its parameters' values.

    `reads`: parameter of the catalogue → function of the constants of the trial and of the bench.  `needs`:
    signals without which the effect moves no output.
    """

    part: str
    variants: Callable[[Values], tuple[Variant, ...]]
    reads: Mapping[str, Read]
    needs: tuple[str, ...] = ()


def _frees(*directions: tuple[Mapping[str, float], float], at: Mapping[str, float] | None = None) -> Variant:
    return Variant(tuple(Direction(*given) for given in directions), at or {})


def _one(part: str, name: str, sd: float, parameter: str = "", needs: tuple[str, ...] = (), factor: float = 1.0
         ) -> Hypothesis:
    return Hypothesis(part, lambda values: (_frees(({name: 1.0}, sd)),),
                      {parameter or name: lambda values, bench: factor * values[name]}, needs)


def _wrap(values: Values) -> tuple[Variant, ...]:
    return (_frees(({"fabric": 0.5, "wrap": 1.0 - 0.5 * values["wrap"]}, 0.7)),)


def _stiffer(values: Values) -> tuple[Variant, ...]:
    # the stretch is 1/s as long; where homing fixes the encoder's zero at a preload, the taut, unloaded rope's moves
    along = {"stiffness": 1.0, "curve2": values["curve2"], "curve3": 2.0 * values["curve3"]}
    homed = float(stretch_m(values, PARAMETERS["home_preload"].nominal))
    return (_frees((along, 0.25)), _frees((along | {"cable_compliance": -1.0, "zero": homed}, 0.25)))


def _creeps(values: Values) -> tuple[Variant, ...]:
    return tuple(_frees(({"creep_compliance": 1.0}, 3e-5), ({"creep_time": 1.0}, 0.7), at={"creep_time": seconds})
                 for seconds in (0.3, 1.5, 8.0))


def _sticks(values: Values) -> tuple[Variant, ...]:
    # of cable and fabric apart: a variant's speed is that of both, and reference trials may need another one of either;
    # a bench that hardly sticks in its reference condition determines neither speed nor lag of its Stribeck curve
    return tuple(_frees(({"breakaway": 1.0}, 0.8), ({"fabric_breakaway": 1.0}, 0.8), ({"stribeck_speed": 1.0}, 0.8),
                        ({"stribeck_memory": 1.0}, 0.6), at=at)
                 for at in ({}, {"stribeck_speed": 0.006}, {"stribeck_speed": 0.02}))


def _runs_out(values: Values) -> tuple[Variant, ...]:
    return tuple(_frees(({"eccentric_sin": 1.0}, 3e-4), ({"eccentric_cos": 1.0}, 3e-4), at={"drum_radius": radius})
                 for radius in (0.016, 0.02, 0.025, 0.031, 0.038))


def _yields(values: Values) -> tuple[Variant, ...]:
    both = (({"cable_travel": 1.0, "fabric_travel": 1.0}, 1.0), ({"cable_travel": 1.0, "fabric_travel": -1.0}, 0.4))
    # over another travel friction lags the sliding speed by another time and is full at another speed, and the shape of
    # its rise shows, which reference trials with a short travel hardly determine
    return (_frees(*both), _frees(*both, ({"stribeck_memory": 1.0}, 0.4), ({"stribeck_speed": 1.0}, 0.4),
                                  ({"sharpness": 1.0}, 0.3)),
            _frees(({"cable_travel": 1.0}, 1.0)), _frees(({"fabric_travel": 1.0}, 1.0)))


def _curves(values: Values) -> tuple[Variant, ...]:
    """Return the variants k·(θ − pivot)² of the lever arm: about the straight knee, and about `KNEE_RAD`."""
    offsets = (-KNEE_RAD, 0.0)  # pivot less KNEE_RAD, about which the forward model is expanded
    return tuple(_frees(({"arm2": 1.0, "arm": -2.0 * off, "zero": off**2}, 1.5e-3)) for off in offsets)


END: Final = ("tension_end_n",)
FORCE: Final = ("servo_force_n",)
THETA1: Final = math.pi / 2
"""Bend of the sheath, rad, by which an exponent is reported as a coefficient: the nominal bench's."""
PHI: Final = 0.65
"""Wrap, rad, at the loaded knee by which an exponent is reported as a coefficient: the nominal bench's."""

HYPOTHESES: Final[Mapping[str, Hypothesis]] = {
    "cable_friction": _one(FRICTION, "cable", 0.4, "mu1", factor=1.0 / THETA1),
    "fabric_friction": _one(FRICTION, "fabric", 0.5, "mu2", factor=1.0 / PHI),
    "fabric_wrap": Hypothesis(FRICTION, _wrap, {"fabric_wrap": lambda v, b: 0.15 * v["wrap"] / max(
        0.05, 1.0 - 0.5 * v["wrap"])}),
    "cable_bend": Hypothesis(FRICTION, lambda v: (_frees(({"cable": 0.5, "bend": 1.0}, 0.35)),), {
        "cable_bend": lambda v, b: v["bend"] / max(0.2, 1.0 - 0.5 * v["bend"])}),
    "load_dependent_friction": Hypothesis(FRICTION, lambda v: (_frees(
        ({"load": 1.0}, 0.35), ({"cable": 1.0, "fabric": 1.0}, 0.08)),), {
            "load_slope": lambda v, b: v["load"] / (1.0 + LOAD_PER_STEP * v["load"])}),
    "viscous_friction": Hypothesis(
        FRICTION, lambda v: (_frees(({"viscous": 1.0}, 12.0)), _frees(({"drag": 1.0}, 12.0))), {
            "viscous": lambda v, b: v["viscous"] + v["drag"]}),
    "stribeck": Hypothesis(FRICTION, _sticks, {
                "stribeck_ratio": lambda v, b: 1.0 + 0.5 * (v["breakaway"] + v["fabric_breakaway"]),
                "stribeck_speed": lambda v, b: v["stribeck_speed"],
                "stribeck_memory": lambda v, b: v["stribeck_memory"]}),
    "presliding": Hypothesis(FRICTION, _yields, {
            "presliding": lambda v, b: PRESLIDING * math.sqrt(v["cable_travel"] * v["fabric_travel"])}),
    "friction_drift": _one(FRICTION, "friction_drift", 0.5),
    "stiffness": Hypothesis(ELASTICITY, _stiffer, {
        "stiffness_scale": lambda v, b: stretch_of(v)["stiffness_scale"]}),
    "fabric_creep": Hypothesis(ELASTICITY, _creeps, {
        "creep_compliance": lambda v, b: v["creep_compliance"], "creep_time": lambda v, b: v["creep_time"]}),
    "end_gain": _one(ELASTICITY, "end_gain", 0.06, needs=END),
    "start_gain": _one(ELASTICITY, "start_gain", 0.06),
    "slack": Hypothesis(GEOMETRY, lambda v: (_frees(({"zero": 1.0}, 3e-3)),), {
        "slack": lambda v, b: v["zero"] - b["zero"]}),
    "knee_backlash": Hypothesis(GEOMETRY, lambda v: (_frees(({"play": 1.0}, 0.013)), _frees(({"gap": 1.0}, 0.013))), {
        "knee_backlash": lambda v, b: 2.0 * (v["play"] + v["gap"])}),
    "moment_arm": Hypothesis(GEOMETRY, _curves, {"rope_per_knee_quadratic": lambda v, b: v["arm2"]}),
    "drum_eccentricity": Hypothesis(GEOMETRY, _runs_out, {
        "eccentricity": lambda v, b: math.hypot(v["eccentric_sin"], v["eccentric_cos"]),
        "eccentricity_phase": lambda v, b: math.atan2(v["eccentric_cos"], v["eccentric_sin"])}),
    "end_mass": Hypothesis(SENSOR, lambda v: (_frees(
        ({"end_mass": 1.0, "end_swing": 0.25}, 0.1), ({"end_swing": 1.0}, 0.01)),), {
            "end_mass": lambda v, b: v["end_mass"]}, END),
    "end_offset": _one(SENSOR, "end_offset", 2.0, needs=END),
    "start_offset": _one(SENSOR, "start_offset", 2.0),
    "end_drift": _one(SENSOR, "end_drift", 2.0, needs=END),
    "start_drift": _one(SENSOR, "start_drift", 2.0),
    "end_delay": Hypothesis(TIMING, lambda v: (_frees(({"end_lag": 1.0}, 0.012)),), {
        "end_delay": lambda v, b: v["end_lag"] - b["end_lag"]}, END),
    "end_filter": _one(TIMING, "end_filter", 0.012, needs=END),
    "timestamp_skew": Hypothesis(TIMING, lambda v: (_frees(({"end_lag": 1.0, "start_lag": 1.0}, 0.012)),), {
        "timestamp_skew": lambda v, b: v["start_lag"] - b["start_lag"]}),
    "drive_coulomb": _one(DRIVE, "drive_coulomb", 5.0, needs=FORCE),
    "drive_viscous": _one(DRIVE, "drive_viscous", 60.0, needs=FORCE),
    "drive_offset": _one(DRIVE, "drive_offset", 3.0, needs=FORCE),
    "drive_asymmetry": _one(DRIVE, "drive_asymmetry", 0.5, needs=FORCE),
    "drive_inertia": _one(DRIVE, "drive_inertia", 1.5, needs=FORCE),
    "drive_viscous_asymmetry": _one(DRIVE, "drive_viscous_asymmetry", 0.5, needs=FORCE),
    "drive_presliding": _one(DRIVE, "drive_travel", 2.5, "drive_presliding", FORCE, PRESLIDING),
    "demand_gain": _one(DRIVE, "demand_gain", 0.1, needs=FORCE),
}
"""Effects that the forward model of the force path can have.  Sizes: the catalogue's likely ranges as a 1σ."""
ELSEWHERE: Final[Mapping[str, str]] = {
    "saturation": "limits of the drive are no output of the force path", "supply_sag": "as saturation",
    "unbalance": "shown by an axis recorded in rad",
    "drive_stribeck": "confounded with Coulomb friction within one gait", "quantisation": "read off the values",
    "late_pdo": "read off staleness and repeats", "lost_pdo": "read off staleness and repeats"}
"""Effects of the catalogue that the forward model has no constant for, and why."""

